"""The client that waits."""
from __future__ import annotations

import os
import subprocess
import time
from typing import Any, Callable, Iterable, List, Mapping, Optional, Sequence

import grpc

from horopter.v1 import (catalog_pb2, catalog_pb2_grpc, recognition_pb2_grpc, server_pb2, server_pb2_grpc, station_pb2,
                         station_pb2_grpc)

from . import _requests, stations
from ._requests import Hints, Regions
from .errors import HoropterError, from_rpc, pause_before_retry
from .images import ImageLike
from .security import Security, open_channel, server_address
from .stations import Calibration, CameraSetting, Station
from .types import (CatalogObject, ExpectedPart, GraspModel, Gripper, ImportedObject, LookAlike, ObjectVersion, Reference, Scene, SpaceRegion,
                    resource_name)


class Client:
    """A connection to a server. Thread-safe.

    address: "HOST:PORT" or "unix:PATH" (None: HOROPTER_SERVER of the environment, or localhost:50051); deadline_s: for a whole call
    with its retries; retries: how often a busy server is asked again, after the time it asks for, and one that is not there, after
    0.2 s and then twice as long each time; security: TLS and token (None: as the environment says, Security.from_environment).
    Calls raise the errors of `horopter.errors`.

    >>> with Client("localhost:50051") as client:                                   # doctest: +SKIP
    ...     print([o.object_id for o in client.list_objects()])
    """

    def __init__(self, address: Optional[str] = None, deadline_s: float = 600.0, retries: int = 5,
                 security: Optional[Security] = None):
        address = server_address(address)
        security = Security.from_environment() if security is None else security
        self.address = address
        self.deadline_s = deadline_s
        self.retries = retries
        self.security = security
        self._channel = open_channel(grpc, address, security)
        self._catalog = catalog_pb2_grpc.CatalogServiceStub(self._channel)
        self._recognition = recognition_pb2_grpc.RecognitionServiceStub(self._channel)
        self._server = server_pb2_grpc.ServerServiceStub(self._channel)
        self._stations = station_pb2_grpc.StationServiceStub(self._channel)

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def close(self) -> None:
        self._channel.close()

    def _call(self, method: Callable[..., Any], request: Any, deadline_s: Optional[float],
              metadata: _requests.Metadata = ()) -> Any:
        end = time.monotonic() + (self.deadline_s if deadline_s is None else deadline_s)
        for attempt in range(self.retries + 1):
            try:
                return method(request, timeout=max(0.0, end - time.monotonic()), metadata=self.security.metadata() + metadata)
            except grpc.RpcError as rpc_error:
                error: HoropterError = from_rpc(rpc_error)
            pause = pause_before_retry(error, attempt)
            if pause is None or attempt == self.retries or time.monotonic() + pause >= end:
                raise error
            time.sleep(pause)
        raise AssertionError("unreachable")

    def recognize(self, images: Iterable[ImageLike], hints: Hints = None, candidates: Optional[Iterable[str]] = None,
                  reference: Optional[Reference] = None, deadline_s: Optional[float] = None,
                  gripper: Optional[Gripper] = None, min_score: float = 0.0, full: bool = True,
                  overlay: Optional[str] = None, explain: Optional[str] = None, station: Optional[str] = None,
                  station_cameras: Optional[Sequence[str]] = None, cropped: bool = False,
                  ignore_exif: bool = False, further_references: Iterable[Reference] = (),
                  expected: Iterable[ExpectedPart] = (), read_only: bool = False,
                  min_generation: Optional[int] = None, regions: Regions = None,
                  space_regions: Iterable[SpaceRegion] = (), unknown_share: Optional[float] = None) -> Scene:
        """Which parts are in the images of one static scene, where, and how to grip them.

        images: a list of 1 to 32 paths, encoded bytes, arrays (see encode_image) or RawFrames; hints: one CameraHint for all images or a list
        with one or None for each; candidates: ids to look for (default: the whole catalog); gripper: what the robot grips
        with; min_score: parts that score less are left out; full: with covariances, stages and poses per image; overlay:
        "png" (images with the answer drawn on them) or "svg" (drawings to lay over them), in `Scene.overlays`; explain:
        id of an object of which `Scene.explanation` says why it is, or is not, recognised; station: id of the station whose
        cameras took the images, station_cameras: its camera of each (default: camera1, camera2, ..): the server uses what
        it knows of them and learns; `Scene.station` says what came of it; cropped: the images are cut-outs; ignore_exif: the
        focal lengths that image files give are not used (arrays have none); further_references: other objects whose poses in
        the base are known: they decide what a symmetric reference, or two of its kind, leave open (else
        `Scene.base_alternatives`); expected: what should lie there, `Scene.expected` says what does; read_only: the station is
        used, and learns nothing; min_generation: of servers that share a catalog, the answer rests on what was written up to this
        `revision` (Unavailable where the server does not get it within 2 s); regions: where in the images parts are looked for, a list of
        ImageRegions or None (everywhere) for each image; space_regions: boxes in the base instead, where cameras are known;
        unknown_share: of what lies in such scenes and may be taken for a part of the catalog, the share that is none of it (default: 0.1).
        """
        request = _requests.recognize_request(images, hints, candidates, reference, gripper, min_score, full, overlay,
                                              explain, station, station_cameras, cropped, ignore_exif, further_references,
                                              expected, read_only, regions, space_regions, unknown_share)
        return Scene.from_proto(self._call(self._recognition.RecognizeScene, request, deadline_s,
                                           _requests.generation_metadata(min_generation)))

    def server_info(self, deadline_s: Optional[float] = None) -> server_pb2.ServerInfo:
        """Version, limits, load and catalog of the server, as the message."""
        return self._call(self._server.GetServerInfo, server_pb2.GetServerInfoRequest(), deadline_s)

    def list_stations(self, deadline_s: Optional[float] = None) -> List[Station]:
        """All stations, ordered by id, without events."""
        found: List[Station] = []
        request = station_pb2.ListStationsRequest(page_size=200)
        while True:
            answer = self._call(self._stations.ListStations, request, deadline_s)
            found.extend(Station.from_proto(s) for s in answer.stations)
            if not answer.next_page_token:
                return found
            request.page_token = answer.next_page_token

    def get_station(self, station: str, deadline_s: Optional[float] = None) -> Station:
        """A station with what is known of its cameras, and its events."""
        request = station_pb2.GetStationRequest(name=stations.station_name(station))
        return Station.from_proto(self._call(self._stations.GetStation, request, deadline_s))

    def set_station(self, station: str, display_name: Optional[str] = None, cameras: Iterable[CameraSetting] = (),
                    create: bool = True, if_match: str = "", deadline_s: Optional[float] = None) -> Station:
        """Says something of a station and its cameras; makes it where it is missing (else, without create, NotFound)."""
        request = stations.set_request(station, display_name, cameras, create, if_match)
        return Station.from_proto(self._call(self._stations.UpdateStation, request, deadline_s))

    def reset_station(self, station: str, camera: Optional[str] = None, keep_base: bool = False, if_match: str = "",
                      deadline_s: Optional[float] = None) -> Station:
        """Forgets what was learnt, of all cameras or of one; what was given stays. keep_base: where cameras are in the robot's
        base stays, too, though it was learnt."""
        request = stations.reset_request(station, camera, keep_base, if_match)
        return Station.from_proto(self._call(self._stations.ResetStation, request, deadline_s))

    def delete_station(self, station: str, if_match: str = "", deadline_s: Optional[float] = None) -> None:
        request = station_pb2.DeleteStationRequest(name=stations.station_name(station), if_match=if_match)
        self._call(self._stations.DeleteStation, request, deadline_s)

    def import_calibration(self, station: str, camera: str, calibration: Calibration, if_match: str = "",
                           deadline_s: Optional[float] = None) -> Station:
        """Takes a calibration over as what is known of the camera's lens; not one beyond k1."""
        request = stations.import_request(station, camera, calibration, if_match)
        return Station.from_proto(self._call(self._stations.ImportCalibration, request, deadline_s))

    def export_calibration(self, station: str, camera: str, deadline_s: Optional[float] = None) -> Calibration:
        request = station_pb2.ExportCalibrationRequest(name=stations.camera_name(station, camera))
        return Calibration.from_proto(self._call(self._stations.ExportCalibration, request, deadline_s))

    def list_objects(self, deadline_s: Optional[float] = None) -> List[CatalogObject]:
        """All objects, ordered by id, without geometry."""
        objects: List[CatalogObject] = []
        request = catalog_pb2.ListObjectsRequest(page_size=200)
        while True:
            answer = self._call(self._catalog.ListObjects, request, deadline_s)
            objects.extend(CatalogObject.from_proto(o) for o in answer.objects)
            if not answer.next_page_token:
                return objects
            request.page_token = answer.next_page_token

    def get_object(self, object_id: str, full: bool = False, deadline_s: Optional[float] = None,
                   revision: Optional[int] = None) -> CatalogObject:
        """One object with its geometry; full: with the bytes of its CAD file (in `raw`); revision: as it was (object_versions)."""
        request = _requests.get_request(object_id, full, revision)
        return CatalogObject.from_proto(self._call(self._catalog.GetObject, request, deadline_s))

    def object_versions(self, object_id: str, deadline_s: Optional[float] = None) -> List[ObjectVersion]:
        """What the object is and was, newest first; needs a token of the role observer or admin where the server asks for tokens."""
        request = catalog_pb2.ListObjectVersionsRequest(name=resource_name(object_id))
        answer = self._call(self._catalog.ListObjectVersions, request, deadline_s)
        return [ObjectVersion.from_proto(v) for v in answer.versions]

    def restore_object(self, object_id: str, revision: int, if_match: str = "", deadline_s: Optional[float] = None) -> CatalogObject:
        """Makes the object what it was; with if_match only while it has this etag (else Conflict)."""
        request = _requests.restore_request(object_id, revision, if_match)
        return CatalogObject.from_proto(self._call(self._catalog.RestoreObject, request, deadline_s))

    def create_object(self, object_id: str, message: catalog_pb2.Object, deadline_s: Optional[float] = None) -> CatalogObject:
        """Enrols geometry that is at hand as a message, e.g. `raw` of another server's object."""
        return CatalogObject.from_proto(
            self._call(self._catalog.CreateObject, _requests.create_request(object_id, message), deadline_s))

    def import_object(self, object_id: str, file: "str | os.PathLike[str] | bytes", file_name: Optional[str] = None,
                      unit: Optional[str] = None, display_name: str = "", grasps: Iterable[GraspModel] = (),
                      labels: Optional[Mapping[str, str]] = None, deadline_s: Optional[float] = None) -> ImportedObject:
        """Enrols a CAD file or mesh, which the server reads: STEP, IGES, STL, PLY, OBJ, GLB, 3MF, CAO.

        file: a path, or the bytes with file_name, whose extension says the format; unit: of a file that names none: "mm", "cm",
        "m", "in", "ft", "um" (None: mm, of GLB and CAO m); display_name: for people (empty: the product's name in the file). Raises
        InvalidRequest that says what is wrong with the file; needs a token of the role admin where the server asks for tokens.
        """
        request = _requests.import_request(object_id, file, file_name, unit, display_name, grasps, labels)
        return ImportedObject.from_proto(self._call(self._catalog.ImportObject, request, deadline_s))

    def set_grasps(self, object_id: str, grasps: Iterable[GraspModel], deadline_s: Optional[float] = None,
                   if_match: str = "") -> None:
        """Replaces the grasps of an object; with if_match only while it has this etag (else Conflict)."""
        self._call(self._catalog.UpdateObject, _requests.grasps_request(object_id, grasps, if_match), deadline_s)

    def delete_object(self, object_id: str, deadline_s: Optional[float] = None) -> None:
        self._call(self._catalog.DeleteObject, catalog_pb2.DeleteObjectRequest(name=resource_name(object_id)), deadline_s)

    def look_alikes(self, object_id: str, deadline_s: Optional[float] = None) -> List[LookAlike]:
        """Objects that the named one can be taken for."""
        request = catalog_pb2.ListLookAlikesRequest(name=resource_name(object_id))
        return [LookAlike.from_proto(a) for a in self._call(self._catalog.ListLookAlikes, request, deadline_s).look_alikes]

    def enroll_file(self, path: "str | os.PathLike[str]", object_id: str, grasps: "str | os.PathLike[str] | None" = None,
                    units: Optional[str] = None, program: str = "horopter") -> CatalogObject:
        """Enrols a CAD file (STEP, IGES, STL, PLY, OBJ, CAO) with the `horopter` program; `import_object` needs none.

        Raises FileNotFoundError when the program is not there, HoropterError with its message when it refuses.
        """
        command = [program, "--server", self.address, *self.security.arguments(), "object", "add", os.fspath(path), "--id", object_id]
        if grasps is not None:
            command += ["--grasps", os.fspath(grasps)]
        if units is not None:
            command += ["--units", units]
        # Messages name files, whose names may be in any encoding.
        done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=False,
                              env=self.security.environment())
        if done.returncode != 0:
            raise HoropterError("INVALID_ARGUMENT" if done.returncode == 3 else "UNKNOWN", done.stderr.strip())
        return self.get_object(object_id)
