"""Stations: the fixed cameras of a cell, which calibrate themselves by working."""
from __future__ import annotations

import dataclasses
import datetime
from typing import Any, Iterable, List, Optional, Sequence, Tuple

import numpy as np

from google.protobuf import field_mask_pb2

from horopter.v1 import station_pb2

from .cameras import check_camera_matrix
from .types import enum_name, matrix_from_proto, matrix_to_proto

_PREFIX = "stations/"


@dataclasses.dataclass
class CameraSetting:
    """What people say of a station's camera. motion: FIXED, MOVING (on the arm: only its lens is kept) or ZOOMING (only its place
    is kept), None: as it was; base_from_camera: 4 x 4, where a fixed camera is in the robot's base, with its standard deviations
    (None: the server's 0.01 rad and 0.005 m)."""
    camera_id: str
    motion: Optional[str] = None
    base_from_camera: Optional[np.ndarray] = None
    rotation_sigma_rad: Optional[float] = None
    position_sigma_m: Optional[float] = None

    def to_proto(self, station: str) -> station_pb2.StationCamera:
        out = station_pb2.StationCamera(name=camera_name(station, self.camera_id))
        if self.motion is not None:
            if self.motion not in ("FIXED", "MOVING", "ZOOMING"):
                raise ValueError("motion is FIXED, MOVING or ZOOMING, not %r" % (self.motion,))
            out.motion = station_pb2.StationCamera.Motion.Value("MOTION_" + self.motion)
        if self.base_from_camera is not None:
            out.base_from_camera.CopyFrom(matrix_to_proto(self.base_from_camera, "base_from_camera"))
        if self.rotation_sigma_rad is not None:
            out.base_rotation_sigma_rad = self.rotation_sigma_rad
        if self.position_sigma_m is not None:
            out.base_position_sigma_m = self.position_sigma_m
        return out


@dataclasses.dataclass
class Calibration:
    """A camera as ROS and OpenCV describe it. K: 3 x 3; d: plumb bob; deviations of log(focal length), principal point (pixels) and
    k1; None on input: the server's."""
    width_px: int
    height_px: int
    K: np.ndarray
    d: Sequence[float] = (0.0,)
    focal_log_sigma: Optional[float] = None
    principal_point_sigma_px: Optional[float] = None
    k1_sigma: Optional[float] = None

    def to_proto(self) -> station_pb2.CameraCalibration:
        out = station_pb2.CameraCalibration(image_width_px=self.width_px, image_height_px=self.height_px,
                                            k=check_camera_matrix(self.K), d=[float(v) for v in self.d])
        for name in ("focal_log_sigma", "principal_point_sigma_px", "k1_sigma"):
            if getattr(self, name) is not None:
                setattr(out, name, getattr(self, name))
        return out

    @classmethod
    def from_proto(cls, c: station_pb2.CameraCalibration) -> "Calibration":
        return cls(c.image_width_px, c.image_height_px, np.array(c.k, dtype=float).reshape(3, 3), list(c.d), c.focal_log_sigma,
                   c.principal_point_sigma_px, c.k1_sigma)


@dataclasses.dataclass
class StationCamera:
    """A camera of a station. base_source: GIVEN (by people), LEARNT (from references) or None; base_sigmas: standard deviations of
    base_from_camera, radians and metres; rig_sigmas: of camera_from_rig. calibration, camera_from_rig, base_from_camera: None
    where they are not known."""
    camera_id: str
    motion: str
    request_count: int
    calibration: Optional[Calibration]
    camera_from_rig: Optional[np.ndarray]
    rig_sigmas: Tuple[float, float]
    base_from_camera: Optional[np.ndarray]
    base_source: Optional[str]
    base_sigmas: Optional[Tuple[float, float]]
    base_request_count: int


@dataclasses.dataclass
class StationEvent:
    """kind: CAMERA_MOVED, LENS_CHANGED, CAMERAS_SWAPPED, RESET, CALIBRATION_IMPORTED, CAMERA_ADDED, BASE_LEARNT, BASE_MOVED;
    "UNKNOWN" of a later server's."""
    kind: str
    time: datetime.datetime
    request_id: str
    cameras: List[str]
    detail: str


@dataclasses.dataclass
class Station:
    """A station. events: the latest first, none in lists; etag: for if_match; raw: the message."""
    station_id: str
    display_name: str
    cameras: List[StationCamera]
    request_count: int
    etag: str
    events: List[StationEvent]
    raw: station_pb2.Station = dataclasses.field(repr=False)

    @classmethod
    def from_proto(cls, s: station_pb2.Station) -> "Station":
        return cls(_last(s.name), s.display_name, [_camera(c) for c in s.cameras], s.request_count, s.etag,
                   [StationEvent(enum_name(station_pb2.StationEvent.Kind, e.kind, "KIND_"),
                                 e.time.ToDatetime(datetime.timezone.utc), e.request_id, [_last(c) for c in e.cameras], e.detail)
                    for e in s.events], s)


def station_name(station: str) -> str:
    return station if station.startswith(_PREFIX) else _PREFIX + station


def camera_name(station: str, camera: str) -> str:
    return "%s/cameras/%s" % (station_name(station), camera)


def _last(name: str) -> str:
    return name.rsplit("/", 1)[-1]


def _camera(c: station_pb2.StationCamera) -> StationCamera:
    def pose(field: str) -> Optional[np.ndarray]:
        return matrix_from_proto(getattr(c, field)) if c.HasField(field) else None
    known = c.HasField("base_from_camera")
    return StationCamera(
        _last(c.name), enum_name(station_pb2.StationCamera.Motion, c.motion, "MOTION_"), c.request_count,
        Calibration.from_proto(c.calibration) if len(c.calibration.k) == 9 else None, pose("camera_from_rig"),
        (c.rotation_sigma_rad, c.translation_sigma_m), pose("base_from_camera"),
        enum_name(station_pb2.StationCamera.BaseSource, c.base_source, "BASE_SOURCE_") if known else None,
        (c.base_rotation_sigma_rad, c.base_position_sigma_m) if known else None, c.base_request_count)


def set_request(station: str, display_name: Optional[str], cameras: Iterable[CameraSetting], create: bool,
                if_match: str) -> station_pb2.UpdateStationRequest:
    message = station_pb2.Station(name=station_name(station), cameras=[c.to_proto(station) for c in cameras])
    paths = ["cameras"] if message.cameras else []
    if display_name is not None:
        message.display_name = display_name
        paths.append("display_name")
    return station_pb2.UpdateStationRequest(station=message, update_mask=field_mask_pb2.FieldMask(paths=paths),
                                            allow_missing=create, if_match=if_match)


def reset_request(station: str, camera: Optional[str], keep_base: bool, if_match: str) -> station_pb2.ResetStationRequest:
    name: Any = station_name(station) if camera is None else camera_name(station, camera)
    return station_pb2.ResetStationRequest(name=name, keep_base=keep_base, if_match=if_match)


def import_request(station: str, camera: str, calibration: Calibration,
                   if_match: str) -> station_pb2.ImportCalibrationRequest:
    return station_pb2.ImportCalibrationRequest(name=camera_name(station, camera), calibration=calibration.to_proto(),
                                                if_match=if_match)
