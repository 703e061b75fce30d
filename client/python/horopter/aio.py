"""The client for asyncio."""
from __future__ import annotations

import asyncio
import os
import time
from typing import Any, Callable, Iterable, List, Mapping, Optional, Sequence

import grpc
import grpc.aio

from horopter.v1 import (catalog_pb2, catalog_pb2_grpc, recognition_pb2_grpc, server_pb2, server_pb2_grpc, station_pb2,
                         station_pb2_grpc)

from . import _requests, stations
from ._requests import Hints, Regions
from .errors import from_rpc, pause_before_retry
from .images import ImageLike
from .security import Security, open_channel, server_address
from .stations import Calibration, CameraSetting, Station
from .types import (CatalogObject, ExpectedPart, GraspModel, Gripper, ImportedObject, LookAlike, ObjectVersion, Reference, Scene, SpaceRegion,
                    resource_name)


class AsyncClient:
    """As `Client`, for one event loop. Cancelling the task cancels the call.

    >>> async def parts():                                                           # doctest: +SKIP
    ...     async with AsyncClient("localhost:50051") as client:
    ...         return (await client.recognize(["0.png", "1.png"])).objects
    """

    def __init__(self, address: Optional[str] = None, deadline_s: float = 600.0, retries: int = 5,
                 security: Optional[Security] = None):
        address = server_address(address)
        security = Security.from_environment() if security is None else security
        self.deadline_s = deadline_s
        self.retries = retries
        self.security = security
        self._channel = open_channel(grpc.aio, address, security)
        self._catalog = catalog_pb2_grpc.CatalogServiceStub(self._channel)
        self._recognition = recognition_pb2_grpc.RecognitionServiceStub(self._channel)
        self._server = server_pb2_grpc.ServerServiceStub(self._channel)
        self._stations = station_pb2_grpc.StationServiceStub(self._channel)

    async def __aenter__(self) -> "AsyncClient":
        return self

    async def __aexit__(self, *_: Any) -> None:
        await self.close()

    async def close(self) -> None:
        await self._channel.close()

    async def _call(self, method: Callable[..., Any], request: Any, deadline_s: Optional[float],
                    metadata: _requests.Metadata = ()) -> Any:
        end = time.monotonic() + (self.deadline_s if deadline_s is None else deadline_s)
        for attempt in range(self.retries + 1):
            try:
                return await method(request, timeout=max(0.0, end - time.monotonic()), metadata=self.security.metadata() + metadata)
            except grpc.aio.AioRpcError as rpc_error:
                error = from_rpc(rpc_error)
            pause = pause_before_retry(error, attempt)
            if pause is None or attempt == self.retries or time.monotonic() + pause >= end:
                raise error
            await asyncio.sleep(pause)
        raise AssertionError("unreachable")

    async def recognize(self, images: Iterable[ImageLike], hints: Hints = None,
                        candidates: Optional[Iterable[str]] = None, reference: Optional[Reference] = None,
                        deadline_s: Optional[float] = None, gripper: Optional[Gripper] = None, min_score: float = 0.0,
                        full: bool = True, overlay: Optional[str] = None, explain: Optional[str] = None,
                        station: Optional[str] = None, station_cameras: Optional[Sequence[str]] = None,
                        cropped: bool = False, ignore_exif: bool = False, further_references: Iterable[Reference] = (),
                        expected: Iterable[ExpectedPart] = (), read_only: bool = False,
                        min_generation: Optional[int] = None, regions: Regions = None,
                        space_regions: Iterable[SpaceRegion] = (), unknown_share: Optional[float] = None) -> Scene:
        """As Client.recognize."""
        request = _requests.recognize_request(images, hints, candidates, reference, gripper, min_score, full, overlay,
                                              explain, station, station_cameras, cropped, ignore_exif, further_references,
                                              expected, read_only, regions, space_regions, unknown_share)
        return Scene.from_proto(await self._call(self._recognition.RecognizeScene, request, deadline_s,
                                                 _requests.generation_metadata(min_generation)))

    async def list_objects(self, deadline_s: Optional[float] = None) -> List[CatalogObject]:
        """As Client.list_objects."""
        objects: List[CatalogObject] = []
        request = catalog_pb2.ListObjectsRequest(page_size=200)
        while True:
            answer = await self._call(self._catalog.ListObjects, request, deadline_s)
            objects.extend(CatalogObject.from_proto(o) for o in answer.objects)
            if not answer.next_page_token:
                return objects
            request.page_token = answer.next_page_token

    async def get_object(self, object_id: str, full: bool = False, deadline_s: Optional[float] = None,
                         revision: Optional[int] = None) -> CatalogObject:
        """As Client.get_object."""
        request = _requests.get_request(object_id, full, revision)
        return CatalogObject.from_proto(await self._call(self._catalog.GetObject, request, deadline_s))

    async def object_versions(self, object_id: str, deadline_s: Optional[float] = None) -> List[ObjectVersion]:
        """As Client.object_versions."""
        request = catalog_pb2.ListObjectVersionsRequest(name=resource_name(object_id))
        answer = await self._call(self._catalog.ListObjectVersions, request, deadline_s)
        return [ObjectVersion.from_proto(v) for v in answer.versions]

    async def restore_object(self, object_id: str, revision: int, if_match: str = "",
                             deadline_s: Optional[float] = None) -> CatalogObject:
        """As Client.restore_object."""
        request = _requests.restore_request(object_id, revision, if_match)
        return CatalogObject.from_proto(await self._call(self._catalog.RestoreObject, request, deadline_s))

    async def delete_object(self, object_id: str, deadline_s: Optional[float] = None) -> None:
        request = catalog_pb2.DeleteObjectRequest(name=resource_name(object_id))
        await self._call(self._catalog.DeleteObject, request, deadline_s)

    async def look_alikes(self, object_id: str, deadline_s: Optional[float] = None) -> List[LookAlike]:
        """As Client.look_alikes."""
        request = catalog_pb2.ListLookAlikesRequest(name=resource_name(object_id))
        answer = await self._call(self._catalog.ListLookAlikes, request, deadline_s)
        return [LookAlike.from_proto(a) for a in answer.look_alikes]

    async def server_info(self, deadline_s: Optional[float] = None) -> server_pb2.ServerInfo:
        """As Client.server_info."""
        return await self._call(self._server.GetServerInfo, server_pb2.GetServerInfoRequest(), deadline_s)

    async def list_stations(self, deadline_s: Optional[float] = None) -> List[Station]:
        """As Client.list_stations."""
        found: List[Station] = []
        request = station_pb2.ListStationsRequest(page_size=200)
        while True:
            answer = await self._call(self._stations.ListStations, request, deadline_s)
            found.extend(Station.from_proto(s) for s in answer.stations)
            if not answer.next_page_token:
                return found
            request.page_token = answer.next_page_token

    async def get_station(self, station: str, deadline_s: Optional[float] = None) -> Station:
        """As Client.get_station."""
        request = station_pb2.GetStationRequest(name=stations.station_name(station))
        return Station.from_proto(await self._call(self._stations.GetStation, request, deadline_s))

    async def set_station(self, station: str, display_name: Optional[str] = None, cameras: Iterable[CameraSetting] = (),
                          create: bool = True, if_match: str = "", deadline_s: Optional[float] = None) -> Station:
        """As Client.set_station."""
        request = stations.set_request(station, display_name, cameras, create, if_match)
        return Station.from_proto(await self._call(self._stations.UpdateStation, request, deadline_s))

    async def reset_station(self, station: str, camera: Optional[str] = None, keep_base: bool = False, if_match: str = "",
                            deadline_s: Optional[float] = None) -> Station:
        """As Client.reset_station."""
        request = stations.reset_request(station, camera, keep_base, if_match)
        return Station.from_proto(await self._call(self._stations.ResetStation, request, deadline_s))

    async def delete_station(self, station: str, if_match: str = "", deadline_s: Optional[float] = None) -> None:
        request = station_pb2.DeleteStationRequest(name=stations.station_name(station), if_match=if_match)
        await self._call(self._stations.DeleteStation, request, deadline_s)

    async def import_calibration(self, station: str, camera: str, calibration: Calibration, if_match: str = "",
                                 deadline_s: Optional[float] = None) -> Station:
        """As Client.import_calibration."""
        request = stations.import_request(station, camera, calibration, if_match)
        return Station.from_proto(await self._call(self._stations.ImportCalibration, request, deadline_s))

    async def export_calibration(self, station: str, camera: str, deadline_s: Optional[float] = None) -> Calibration:
        request = station_pb2.ExportCalibrationRequest(name=stations.camera_name(station, camera))
        return Calibration.from_proto(await self._call(self._stations.ExportCalibration, request, deadline_s))

    async def create_object(self, object_id: str, message: catalog_pb2.Object, deadline_s: Optional[float] = None) -> CatalogObject:
        """As Client.create_object."""
        return CatalogObject.from_proto(
            await self._call(self._catalog.CreateObject, _requests.create_request(object_id, message), deadline_s))

    async def import_object(self, object_id: str, file: "str | os.PathLike[str] | bytes", file_name: Optional[str] = None,
                            unit: Optional[str] = None, display_name: str = "", grasps: Iterable[GraspModel] = (),
                            labels: Optional[Mapping[str, str]] = None, deadline_s: Optional[float] = None) -> ImportedObject:
        """As Client.import_object."""
        request = _requests.import_request(object_id, file, file_name, unit, display_name, grasps, labels)
        return ImportedObject.from_proto(await self._call(self._catalog.ImportObject, request, deadline_s))

    async def set_grasps(self, object_id: str, grasps: Iterable[GraspModel], deadline_s: Optional[float] = None,
                         if_match: str = "") -> None:
        """As Client.set_grasps."""
        await self._call(self._catalog.UpdateObject, _requests.grasps_request(object_id, grasps, if_match), deadline_s)
