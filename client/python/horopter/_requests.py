"""Requests, as both clients send them."""
from __future__ import annotations

import os
import uuid
from typing import Iterable, Mapping, Optional, Sequence, Tuple, Union

from google.protobuf import field_mask_pb2

from horopter.v1 import catalog_pb2, recognition_pb2

from .images import ImageLike, RawFrame, check_images, encode_image
from .types import (CameraHint, ExpectedPart, GraspModel, Gripper, ImageRegion, Reference, SpaceRegion,
                    resource_name)

Hints = Union[None, CameraHint, Sequence[Optional[CameraHint]]]
Regions = Optional[Sequence[Optional[Sequence[ImageRegion]]]]
Metadata = Tuple[Tuple[str, str], ...]


def generation_metadata(min_generation: Optional[int]) -> Metadata:
    """What a call says of the writes that its answer has to rest on. Raises ValueError: no whole number from 0 on."""
    if min_generation is None:
        return ()
    if isinstance(min_generation, bool) or not isinstance(min_generation, int) or min_generation < 0:
        raise ValueError("min_generation: need a whole number from 0 on")
    return (("horopter-min-generation", str(min_generation)),)


def recognize_request(images: Iterable[ImageLike], hints: Hints, candidates: Optional[Iterable[str]],
                      reference: Optional[Reference], gripper: Optional[Gripper] = None, min_score: float = 0.0,
                      full: bool = True, overlay: Optional[str] = None,
                      explain: Optional[str] = None, station: Optional[str] = None,
                      station_cameras: Optional[Sequence[str]] = None, cropped: bool = False,
                      ignore_exif: bool = False, further_references: Iterable[Reference] = (),
                      expected: Iterable[ExpectedPart] = (),
                      read_only: bool = False, regions: Regions = None,
                      space_regions: Iterable[SpaceRegion] = (),
                      unknown_share: Optional[float] = None) -> recognition_pb2.RecognizeSceneRequest:
    check_images(images)
    for name, value in (("candidates", candidates), ("station_cameras", station_cameras)):
        if isinstance(value, (str, bytes)):
            raise TypeError("%s is a list, also of one: [%r]" % (name, value))
    if overlay not in (None, "png", "svg"):
        raise ValueError("overlay is None, 'png' or 'svg'")
    view = recognition_pb2.ANSWER_VIEW_FULL if full else recognition_pb2.ANSWER_VIEW_BASIC
    request = recognition_pb2.RecognizeSceneRequest(min_score=min_score, view=view, ignore_exif=ignore_exif)
    if gripper is not None:
        request.gripper.CopyFrom(gripper.to_proto())
    for image in images:
        out = request.images.add(cropped=cropped)
        if isinstance(image, RawFrame):
            out.raw.CopyFrom(image.to_proto())
        else:
            out.content = encode_image(image)
    if isinstance(hints, CameraHint):
        hints = [hints] * len(request.images)
    if hints is not None:
        if len(hints) != len(request.images):
            raise ValueError("%d hints for %d images" % (len(hints), len(request.images)))
        for image, hint in zip(request.images, hints):
            if hint is not None:
                image.camera_hint.CopyFrom(hint.to_proto())
    if regions is not None:
        if len(regions) != len(request.images):
            raise ValueError("regions of %d images for %d images" % (len(regions), len(request.images)))
        for image, boxes in zip(request.images, regions):
            image.regions.extend(b.to_proto() for b in boxes or ())
    request.regions.extend(r.to_proto() for r in space_regions)
    if unknown_share is not None:
        request.unknown_share = unknown_share
    for candidate in candidates or ():
        request.candidate_objects.append(resource_name(candidate))
    if reference is not None:
        request.reference.CopyFrom(reference.to_proto())
    request.further_references.extend(r.to_proto() for r in further_references)
    request.expected_parts.extend(e.to_proto() for e in expected)
    if overlay is not None:
        request.overlay.format = recognition_pb2.OverlayOptions.Format.Value("FORMAT_" + overlay.upper())
    if explain is not None:
        request.explain_object = resource_name(explain)
    if station_cameras is not None and station is None:
        raise ValueError("station_cameras without a station")
    if read_only and station is None:
        raise ValueError("read_only without a station")
    request.station_read_only = read_only
    if station is not None:
        cameras = list(station_cameras or ("camera%d" % (i + 1) for i in range(len(request.images))))
        if len(cameras) != len(request.images):
            raise ValueError("%d cameras of the station for %d images" % (len(cameras), len(request.images)))
        request.station = "stations/" + station
        for image, camera in zip(request.images, cameras):
            image.camera_id = camera
    return request


def get_request(object_id: str, full: bool, revision: Optional[int] = None) -> catalog_pb2.GetObjectRequest:
    view = catalog_pb2.OBJECT_VIEW_FULL if full else catalog_pb2.OBJECT_VIEW_GEOMETRY
    return catalog_pb2.GetObjectRequest(name=resource_name(object_id), view=view, revision=revision or 0)


def restore_request(object_id: str, revision: int, if_match: str) -> catalog_pb2.RestoreObjectRequest:
    return catalog_pb2.RestoreObjectRequest(name=resource_name(object_id), revision=revision, if_match=if_match)


def grasps_request(object_id: str, grasps: Iterable[GraspModel], if_match: str) -> catalog_pb2.UpdateObjectRequest:
    wanted = catalog_pb2.Object(name=resource_name(object_id), grasps=[g.to_proto() for g in grasps])
    return catalog_pb2.UpdateObjectRequest(object=wanted, update_mask=field_mask_pb2.FieldMask(paths=["grasps"]),
                                           if_match=if_match)


def import_request(object_id: str, file: "str | os.PathLike[str] | bytes", file_name: Optional[str], unit: Optional[str],
                   display_name: str, grasps: Iterable[GraspModel],
                   labels: Optional[Mapping[str, str]]) -> catalog_pb2.ImportObjectRequest:
    if isinstance(file, (bytes, bytearray, memoryview)):
        content = bytes(file)
        if file_name is None:
            raise ValueError("file_name: bytes have no name, whose extension says the format")
    else:
        with open(file, "rb") as opened:
            content = opened.read()
        file_name = file_name or os.path.basename(os.fspath(file))
    return catalog_pb2.ImportObjectRequest(object_id=object_id, file_name=file_name, content=content, unit=unit or "",
                                           display_name=display_name, grasps=[g.to_proto() for g in grasps],
                                           labels=dict(labels or {}), request_id=uuid.uuid4().hex)


def create_request(object_id: str, message: catalog_pb2.Object) -> catalog_pb2.CreateObjectRequest:
    # A repetition of this very call, after an answer that was lost, is not a second creation.
    return catalog_pb2.CreateObjectRequest(object_id=object_id, object=message, request_id=uuid.uuid4().hex)
