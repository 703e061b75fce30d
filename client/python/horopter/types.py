"""Requests and answers as values; see the package's docstring for frames and units."""
from __future__ import annotations

import dataclasses
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from horopter.v1 import catalog_pb2, recognition_pb2, station_pb2, types_pb2


def matrix_from_proto(transform: types_pb2.RigidTransform) -> np.ndarray:
    """4 x 4; an unset rotation is the identity."""
    q = transform.rotation
    w, x, y, z = q.w, q.x, q.y, q.z
    norm = (w * w + x * x + y * y + z * z) ** 0.5
    out = np.eye(4)
    if norm > 0.0:
        w, x, y, z = w / norm, x / norm, y / norm, z / norm
        out[:3, :3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                       [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                       [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    t = transform.translation_m
    out[:3, 3] = [t.x, t.y, t.z]
    return out


def quaternion_of(rotation: np.ndarray) -> Tuple[float, float, float, float]:
    """w, x, y, z with w >= 0 of a rotation matrix (3 x 3)."""
    m = np.asarray(rotation, dtype=float)
    # Of the four formulas the one with the largest square root: none cancels.
    squares = np.array([1 + m[0, 0] + m[1, 1] + m[2, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2],
                        1 - m[0, 0] + m[1, 1] - m[2, 2], 1 - m[0, 0] - m[1, 1] + m[2, 2]])
    k = int(np.argmax(squares))
    s = 2.0 * np.sqrt(squares[k])
    a, b, c = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    d, e, f = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    q = [[s / 4, a / s, b / s, c / s], [a / s, s / 4, d / s, e / s],
         [b / s, d / s, s / 4, f / s], [c / s, e / s, f / s, s / 4]][k]
    sign = -1.0 if q[0] < 0.0 else 1.0
    return tuple(sign * float(v) for v in q)  # type: ignore[return-value]


def check_pose(matrix: np.ndarray, name: str = "a pose") -> np.ndarray:
    """The 4 x 4 array of a rigid transform, its rotation the nearest orthonormal one. Raises ValueError: the last row is not
    0 0 0 1 within 1e-6, the rotation is off orthonormal by more than 1e-3 or a mirror image."""
    m = np.array(matrix, dtype=float)
    if m.shape != (4, 4) or not np.all(np.isfinite(m)):
        raise ValueError("%s is a finite 4 x 4 array" % name)
    if np.abs(m[3] - (0, 0, 0, 1)).max() > 1e-6:
        rows = np.abs(m[:, 3] - (0, 0, 0, 1)).max() <= 1e-6
        raise ValueError("%s: the last row is not 0 0 0 1%s" % (name, ": row vectors? transpose it" if rows else ""))
    rotation = m[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
        raise ValueError("%s: the upper left 3 x 3 block is no rotation: its rows are not orthonormal" % name)
    if np.linalg.det(rotation) < 0.0:
        raise ValueError("%s: the upper left 3 x 3 block is no rotation but a mirror image" % name)
    u, _, v = np.linalg.svd(rotation)
    m[:3, :3] = u @ v
    m[3] = (0, 0, 0, 1)
    return m


def matrix_to_proto(matrix: np.ndarray, name: str = "a pose") -> types_pb2.RigidTransform:
    """Raises ValueError when the matrix is no rigid transform (check_pose)."""
    m = check_pose(matrix, name)
    w, x, y, z = quaternion_of(m[:3, :3])
    return types_pb2.RigidTransform(rotation=types_pb2.Quaternion(w=w, x=x, y=y, z=z),
                                    translation_m=types_pb2.Vector3(x=m[0, 3], y=m[1, 3], z=m[2, 3]))


def _optional(message: Any, field: str) -> Optional[np.ndarray]:
    return matrix_from_proto(getattr(message, field)) if message.HasField(field) else None


def _covariance(numbers: Sequence[float]) -> Optional[np.ndarray]:
    side = int(round(len(numbers) ** 0.5))
    return np.array(numbers, dtype=float).reshape(side, side) if numbers else None


def enum_name(enum: Any, value: int, prefix: str) -> str:
    """The name of a value without its prefix; "UNKNOWN" of one that a later server has."""
    return enum.Name(value)[len(prefix):] if value in enum.values() else "UNKNOWN"


def object_id(resource: str) -> str:
    """"bracket" of "objects/bracket"."""
    return resource[len("objects/"):] if resource.startswith("objects/") else resource


def resource_name(id_: str) -> str:
    return "objects/" + object_id(id_)


@dataclasses.dataclass
class CameraHint:
    """What is known about a camera; every field may be None.

    focal_px: fx; focal_y_px: fy (None: the same); focal_log_sigma: standard deviation of log(focal_px);
    principal_point_px: x, y; k1, k2, p1, p2, k3: as plumb_bob of ROS's CameraInfo, k4, k5, k6: of rational_polynomial; fisheye: its
    four numbers of equidistant, instead; base_from_camera: 4 x 4, the camera in the robot's base, with its standard deviations
    (None: the server's 0.01 rad about each axis and 0.005 m of each coordinate). A lens
    beyond k1 needs focal_px and principal_point_px: the server then rectifies the image (Camera.rectified).
    """
    focal_px: Optional[float] = None
    focal_log_sigma: Optional[float] = None
    principal_point_px: Optional[Tuple[float, float]] = None
    k1: Optional[float] = None
    base_from_camera: Optional[np.ndarray] = None
    rotation_sigma_rad: Optional[float] = None
    position_sigma_m: Optional[float] = None
    focal_y_px: Optional[float] = None
    k2: Optional[float] = None
    p1: Optional[float] = None
    p2: Optional[float] = None
    k3: Optional[float] = None
    fisheye: Optional[Sequence[float]] = None
    k4: Optional[float] = None
    k5: Optional[float] = None
    k6: Optional[float] = None

    def to_proto(self) -> recognition_pb2.CameraHint:
        hint = recognition_pb2.CameraHint()
        for name in ("focal_px", "focal_y_px", "focal_log_sigma", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6",
                     "rotation_sigma_rad", "position_sigma_m"):
            value = getattr(self, name)
            if value is not None:
                setattr(hint, name, float(value))
        if self.principal_point_px is not None:
            hint.principal_point_x_px, hint.principal_point_y_px = map(float, self.principal_point_px)
        if self.fisheye is not None:
            hint.fisheye.k1, hint.fisheye.k2, hint.fisheye.k3, hint.fisheye.k4 = map(float, self.fisheye)
        if self.base_from_camera is not None:
            hint.camera_from_base.CopyFrom(matrix_to_proto(np.linalg.inv(check_pose(self.base_from_camera, "base_from_camera"))))
        return hint


@dataclasses.dataclass
class Gripper:
    """What the robot grips with: grasps of other kinds are not offered, and what its way is not free for neither.

    fingers_m: length, width and thickness of two parallel fingers; None: there are none. cup_length_m: of a suction cup with
    its holder, of holder_radius_m (None: as the cup); None: there is none. approach_m: straight way to the grasp.
    """
    fingers_m: Optional[Tuple[float, float, float]] = None
    max_opening_m: Optional[float] = None
    cup_length_m: Optional[float] = None
    holder_radius_m: Optional[float] = None
    approach_m: Optional[float] = None

    def to_proto(self) -> recognition_pb2.Gripper:
        out = recognition_pb2.Gripper()
        if self.fingers_m is not None:
            jaw = out.parallel_jaw
            jaw.finger_length_m, jaw.finger_width_m, jaw.finger_thickness_m = map(float, self.fingers_m)
            if self.max_opening_m is not None:
                jaw.max_opening_m = self.max_opening_m
        if self.cup_length_m is not None:
            out.suction.length_m = self.cup_length_m
            if self.holder_radius_m is not None:
                out.suction.holder_radius_m = self.holder_radius_m
        if self.approach_m is not None:
            out.approach_m = self.approach_m
        return out


@dataclasses.dataclass
class Reference:
    """An object (a fixture) whose pose in the robot's base is known, with the standard deviations of that (None: exact): of the
    rotation about each axis, of each coordinate."""
    object_id: str
    base_from_object: np.ndarray
    rotation_sigma_rad: Optional[float] = None
    position_sigma_m: Optional[float] = None

    def to_proto(self) -> recognition_pb2.ReferenceObject:
        out = recognition_pb2.ReferenceObject(object=resource_name(self.object_id),
                                              base_from_object=matrix_to_proto(self.base_from_object, "base_from_object"))
        if self.rotation_sigma_rad is not None:
            out.rotation_sigma_rad = self.rotation_sigma_rad
        if self.position_sigma_m is not None:
            out.position_sigma_m = self.position_sigma_m
        return out


@dataclasses.dataclass
class ExpectedPart:
    """A part, or `count` of a kind, that should be in the scene. frame_from_object: 4 x 4, where, in the robot's base or in the frame of
    frame_object (id of a tray that is recognised); None: anywhere, and the only case of a count above 1. Tolerances: None: the
    server's, 5 mm and 0.1 rad. label: given back."""
    object_id: str
    count: int = 1
    frame_from_object: Optional[np.ndarray] = None
    frame_object: Optional[str] = None
    position_tolerance_m: Optional[float] = None
    rotation_tolerance_rad: Optional[float] = None
    label: str = ""

    def to_proto(self) -> recognition_pb2.ExpectedPart:
        out = recognition_pb2.ExpectedPart(object=resource_name(self.object_id), count=self.count, label=self.label)
        if self.frame_from_object is not None:
            out.frame_from_object.CopyFrom(matrix_to_proto(self.frame_from_object, "frame_from_object"))
        if self.frame_object is not None:
            out.frame_object = resource_name(self.frame_object)
        for name in ("position_tolerance_m", "rotation_tolerance_rad"):
            if getattr(self, name) is not None:
                setattr(out, name, float(getattr(self, name)))
        return out


@dataclasses.dataclass
class ImageRegion:
    """A part of an image in which parts are looked for, pixels from the image's left and upper border, as detectors' boxes."""
    x_px: float
    y_px: float
    width_px: float
    height_px: float

    def to_proto(self) -> recognition_pb2.ImageRegion:
        return recognition_pb2.ImageRegion(x_px=self.x_px, y_px=self.y_px, width_px=self.width_px, height_px=self.height_px)


@dataclasses.dataclass
class SpaceRegion:
    """A box in the robot's base in which parts are looked for, as the inside of a load carrier. base_from_region: 4 x 4, the pose of its
    middle; size_m: along the axes of its own frame."""
    base_from_region: np.ndarray
    size_m: Tuple[float, float, float]

    def to_proto(self) -> recognition_pb2.SpaceRegion:
        out = recognition_pb2.SpaceRegion(base_from_region=matrix_to_proto(self.base_from_region, "base_from_region"))
        out.size_m.x, out.size_m.y, out.size_m.z = map(float, self.size_m)
        return out


@dataclasses.dataclass
class CameraBasis:
    """Something that a camera rests on. source: TEXTURE, FEATURES (corners and edges), PARTS, STATION or GIVEN; matches: points of the
    image that agree, 0 of a station and of what was given; rms_px: of their residuals."""
    source: str
    matches: int
    rms_px: float


@dataclasses.dataclass
class Camera:
    """A recovered camera: square pixels, no skew, Brown's lens (x_d = x (1 + k1 r^2 + k2 r^4) + 2 p1 x y + p2 (r^2 + 2 x^2)); k2, p1
    and p2 are 0 where the images do not prove them. rectified: of the image that the server has rectified by its hint, not of the
    one that was sent; focal_from_exif: found with what the image's file says of the focal length; bases: what the camera
    rests on; unrelated: the image shows nothing of what the others show; regions: where parts were looked for, None: in all of
    the image, empty: nowhere."""
    recovered: bool
    width_px: int
    height_px: int
    focal_px: float
    principal_point_px: Tuple[float, float]
    k1: float
    focal_log_sigma: float
    camera_from_scene: Optional[np.ndarray]
    rectified: bool = False
    focal_from_exif: bool = False
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    bases: List[CameraBasis] = dataclasses.field(default_factory=list)
    unrelated: bool = False
    regions: Optional[List[ImageRegion]] = None

    @property
    def K(self) -> np.ndarray:
        """3 x 3 camera matrix."""
        return np.array([[self.focal_px, 0.0, self.principal_point_px[0]], [0.0, self.focal_px, self.principal_point_px[1]],
                         [0.0, 0.0, 1.0]])

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels (n x 2) of points (n x 3) in the camera's frame; nan behind the camera."""
        points = np.asarray(points, dtype=float)
        z = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
        xy = points[:, :2] / z[:, None]
        r2 = np.sum(xy * xy, axis=1, keepdims=True)
        twice_product = 2.0 * xy[:, :1] * xy[:, 1:]
        tangential = np.hstack([self.p1 * twice_product + self.p2 * (r2 + 2.0 * xy[:, :1] ** 2),
                                self.p1 * (r2 + 2.0 * xy[:, 1:] ** 2) + self.p2 * twice_product])
        xy = xy * (1.0 + self.k1 * r2 + self.k2 * r2 * r2) + tangential
        return self.focal_px * xy + np.array(self.principal_point_px)


@dataclasses.dataclass
class FoundGrasp:
    """A grasp that can be reached. Gripper frame: origin between the finger tips, z approaches, x closes; of a suction grasp
    (cup_radius_m is set, opening and width are 0) in the middle of the rim. success: that it closes where it should, in the robot's
    base where that is known; scene_success: by what the images know of the part alone, at least 0.8."""
    name: str
    scene_from_gripper: np.ndarray
    scene_from_pregrasp: np.ndarray
    base_from_gripper: Optional[np.ndarray]
    base_from_pregrasp: Optional[np.ndarray]
    jaw_opening_m: float
    grip_width_m: float
    quality: float
    success: float
    symmetry_index: int
    cup_radius_m: Optional[float] = None
    scene_success: float = 0.0


@dataclasses.dataclass
class ObjectInImage:
    """score: None when not visible; camera_from_object: None when the camera was not recovered."""
    score: Optional[float]
    camera_from_object: Optional[np.ndarray]
    covariance: Optional[np.ndarray]


@dataclasses.dataclass
class FoundObject:
    """A recognised object.

    covariance: 6 x 6 of (w, dt), w the rotation vector about the scene's axes at the object's origin (radians), dt the
    translation (metres): the true pose is (exp(w) R, t + dt). grasps: best first; dropped_grasps: why others are not there.
    alternatives: ids that the images do not tell it from; left_open: what else it may be, with probabilities, likeliest first.
    """
    object_id: str
    instance: int
    score: float
    scene_from_object: np.ndarray
    covariance: Optional[np.ndarray]
    images: List[ObjectInImage]
    alternatives: List[str]
    grasps: List[FoundGrasp]
    dropped_grasps: Dict[str, int]
    base_from_object: Optional[np.ndarray]
    base_covariance: Optional[np.ndarray]
    left_open: List[FoundAlternative] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class FoundAlternative:
    """What else may stand where an object was found; kind e.g. "POSE", "OBJECT", "MIRROR_IMAGE", "STRETCHED", "FEATURE", "SIZE".

    probability: None where it is not known. scene_from_object: its pose, of the first three kinds. feature_place, feature_size_m: of
    the feature that it has not, frame of the found object, metres. scene_from_camera: a camera (x right, y down, z forward) whose
    image would decide, None where none would; differing_px: length of the edges that differ in it where the object's diameter is 160 px.
    """
    kind: str
    object_id: str
    probability: Optional[float]
    scene_from_object: Optional[np.ndarray]
    feature_place: Optional[np.ndarray]
    feature_size_m: Optional[float]
    scene_from_camera: Optional[np.ndarray]
    base_from_camera: Optional[np.ndarray]
    differing_px: float


@dataclasses.dataclass
class Finding:
    """What the scene leaves open or contradicts; kind e.g. "SCALE_CONFLICT", "UNKNOWN" of a later server's.

    values: what the kind has, by the field's name: axis_in_object and direction_in_object as arrays, the others as numbers
    (sigma_rad, sigma_m, focal_log_sigma, size_ratio, equivalent_frames, equivalent_poses, distance_m, focal_px,
    principal_point_x_px, principal_point_y_px, rotation_sigma_rad, position_sigma_m).
    """
    kind: str
    object_id: Optional[str]
    instance: int
    image: Optional[int]
    values: Dict[str, Any]
    detail: str


@dataclasses.dataclass
class ExplainedEdge:
    """A piece of an edge in one image; state: SUPPORTED, UNSUPPORTED or HIDDEN; edge: index into CatalogObject.edges, None of
    an outline; points_px: n x 2."""
    edge: Optional[int]
    state: str
    points_px: np.ndarray


@dataclasses.dataclass
class ExplainedImage:
    """The object's best pose in one image; lengths of its edges in pixels: in sight, of these supported, and hidden."""
    camera_from_object: np.ndarray
    camera: Camera
    score: float
    visible_px: float
    supported_px: float
    hidden_px: float
    edges: List[ExplainedEdge]


@dataclasses.dataclass
class Explanation:
    """Why an object is, or is not, recognised. failed_test: None when it is recognised, else FEATURES, HYPOTHESIS, LINK,
    SEARCH, SUPPORT, PLACE, CHANCE, FOCAL, PARALLAX, CONTRADICTION or COMMON_CAMERAS; value: what the test measured; needed: 0
    where it has no number; images: None where no pose is known."""
    object_id: str
    failed_test: Optional[str]
    value: float
    needed: float
    other_object: Optional[str]
    detail: str
    images: List[Optional[ExplainedImage]]


@dataclasses.dataclass
class Reason:
    """Why an answer is less than it could be: NOTHING_FOUND, AMBIGUOUS, SCALE_CONFLICT, TOO_FEW_FEATURES, NO_PARALLAX,
    REFERENCE_NOT_FOUND, REFERENCE_CONFLICT, REFERENCE_AMBIGUOUS, EMPTY_CATALOG, BELOW_MIN_SCORE or HINT_CONTRADICTED; "UNKNOWN" of a later server's."""
    kind: str
    detail: str


@dataclasses.dataclass
class StationFinding:
    """Images that contradict what was known of a station. kind: "CAMERA_MOVED", "LENS_CHANGED", "CAMERAS_SWAPPED",
    "IMAGE_SIZE_CHANGED", "BASE_MOVED", "UNKNOWN" of a later server's; cameras: ids; more than one of a moved camera: one of them."""
    kind: str
    cameras: List[str]
    rotation_rad: float
    translation_m: float
    focal_log_ratio: float
    detail: str


@dataclasses.dataclass
class StationReport:
    """What a request of a station made of it. prior_used: what was known of the cameras agreed and was used; learnt: the
    station learnt from the request; read_only: nothing was to be learnt, by the request or for want of the right to teach."""
    station: str
    prior_used: bool
    learnt: bool
    findings: List[StationFinding]
    read_only: bool = False


@dataclasses.dataclass
class BaseAlternative:
    """A pose that the robot's base may have, by an instance of a reference and one of its symmetries (0: as it was found)."""
    base_from_scene: np.ndarray
    object_id: str
    instance: int
    symmetry_index: int


@dataclasses.dataclass
class ExpectedOutcome:
    """What became of an expected part. state: the most probable of PRESENT, MISSING, DISPLACED, WRONG_PART, CANNOT_TELL;
    probabilities: of each, their sum is 1; object_id and instance: what was taken for it or is in its place; distance_m and
    rotation_rad: how far that is from where it should be."""
    expected_index: int
    label: str
    state: str
    probabilities: Dict[str, float]
    object_id: Optional[str]
    instance: int
    distance_m: Optional[float]
    rotation_rad: Optional[float]
    detail: str


@dataclasses.dataclass
class ExpectedReport:
    """What became of the expected parts, one outcome each. unexpected: ids and instances of what nobody expects."""
    outcomes: List[ExpectedOutcome]
    all_present_probability: float
    unexpected: List[Tuple[str, int]]

    @property
    def all_present(self) -> bool:
        return all(o.state == "PRESENT" for o in self.outcomes)


@dataclasses.dataclass
class Scene:
    """An answer. complete: False when time ran short before all was searched; unsearched: what was left out, for that,
    for the catalog's size or because a server of the search gave no answer. reasons: empty when objects were recognised and nothing is in doubt. joint_covariance:
    (6 n) x (6 n) of all poses, in the order of `objects`. supporting_plane: normal and offset (metres) of
    {x : normal . x = offset} in the scene frame. overlays: one PNG or SVG file an image, where asked for. raw: the
    message."""
    complete: bool
    reasons: List[Reason]
    unsearched: List[str]
    cameras: List[Camera]
    objects: List[FoundObject]
    base_from_scene: Optional[np.ndarray]
    joint_covariance: Optional[np.ndarray]
    findings: List[Finding]
    stage_seconds: Dict[str, float]
    request_id: str
    catalog_generation: int
    supporting_plane: Optional[Tuple[np.ndarray, float]]
    objects_below_min_score: int
    raw: recognition_pb2.RecognizeSceneResponse = dataclasses.field(repr=False)
    overlays: List[bytes] = dataclasses.field(default_factory=list, repr=False)
    explanation: Optional[Explanation] = None
    station: Optional[StationReport] = None
    base_alternatives: List[BaseAlternative] = dataclasses.field(default_factory=list)
    expected: Optional[ExpectedReport] = None

    @classmethod
    def from_proto(cls, answer: recognition_pb2.RecognizeSceneResponse) -> "Scene":
        return cls(complete=answer.completeness == recognition_pb2.COMPLETENESS_COMPLETE,
                   reasons=[_reason(r) for r in answer.reasons], unsearched=[u.step for u in answer.unsearched],
                   cameras=[_camera(c) for c in answer.cameras],
                   objects=[_found(o) for o in answer.objects], base_from_scene=_optional(answer, "base_from_scene"),
                   joint_covariance=_covariance(answer.joint_pose_covariance),
                   findings=[_finding(f) for f in answer.findings],
                   stage_seconds={s.stage: s.elapsed.seconds + 1e-9 * s.elapsed.nanos for s in answer.stages},
                   request_id=answer.request_id, catalog_generation=answer.catalog_generation,
                   supporting_plane=_plane(answer), objects_below_min_score=answer.objects_below_min_score,
                   overlays=[o.content for o in answer.overlays],
                   explanation=_explanation(answer.explanation) if answer.HasField("explanation") else None, raw=answer,
                   station=_station(answer.station) if answer.HasField("station") else None,
                   base_alternatives=[BaseAlternative(matrix_from_proto(b.base_from_scene), object_id(b.object), b.instance,
                                                      b.symmetry_index) for b in answer.base_alternatives],
                   expected=_expected(answer.expected) if answer.HasField("expected") else None)

    @property
    def outcome(self) -> str:
        """In one line: "RECOGNIZED", "RECOGNIZED,REFERENCE_NOT_FOUND", "NOTHING_FOUND,TIME_LIMITED"."""
        words = ["RECOGNIZED"] * bool(self.objects) + [r.kind for r in self.reasons]
        return ",".join(words + ["TIME_LIMITED"] * (not self.complete))

    def has_reason(self, kind: str) -> bool:
        return any(r.kind == kind for r in self.reasons)


def _station(report: station_pb2.StationReport) -> StationReport:
    def last(name: str) -> str:
        return name.rsplit("/", 1)[-1]
    findings = [StationFinding(enum_name(station_pb2.StationFinding.Kind, f.kind, "KIND_"), [last(c) for c in f.cameras],
                               f.rotation_rad, f.translation_m, f.focal_log_ratio, f.detail) for f in report.findings]
    return StationReport(last(report.station), report.prior_used, report.learnt, findings, report.read_only)


def _expected(report: recognition_pb2.ExpectedReport) -> ExpectedReport:
    states = recognition_pb2.ExpectedOutcome.State
    outcomes = []
    for o in report.outcomes:
        probabilities = {name: getattr(o, name.lower() + "_probability")
                         for name in ("PRESENT", "MISSING", "DISPLACED", "WRONG_PART", "CANNOT_TELL")}
        outcomes.append(ExpectedOutcome(o.expected_index, o.label, enum_name(states, o.state, "STATE_"), probabilities,
                                        object_id(o.object) if o.object else None, o.instance,
                                        o.distance_m if o.HasField("distance_m") else None,
                                        o.rotation_rad if o.HasField("rotation_rad") else None, o.detail))
    return ExpectedReport(outcomes, report.all_present_probability,
                          [(object_id(u.object), u.instance) for u in report.unexpected])


def _plane(answer: recognition_pb2.RecognizeSceneResponse) -> Optional[Tuple[np.ndarray, float]]:
    if not answer.HasField("supporting_plane_in_scene"):
        return None
    plane = answer.supporting_plane_in_scene
    return np.array([plane.normal.x, plane.normal.y, plane.normal.z]), plane.offset_m


def _source_name(source: int) -> str:
    names = recognition_pb2.CameraBasis.Source
    return names.Name(source)[len("SOURCE_"):] if source in names.values() else "UNKNOWN"


def _camera(c: recognition_pb2.Camera) -> Camera:
    return Camera(c.recovered, c.image_width_px, c.image_height_px, c.focal_px,
                  (c.principal_point_x_px, c.principal_point_y_px), c.k1, c.focal_log_sigma,
                  _optional(c, "camera_from_scene"), c.rectified, c.focal_from_exif,
                  c.k2, c.p1, c.p2,
                  [CameraBasis(_source_name(b.source), b.matches, b.rms_px) for b in c.bases], c.unrelated,
                  [ImageRegion(r.x_px, r.y_px, r.width_px, r.height_px) for r in c.regions]
                  if c.regions or c.region_empty else None)


def _grasp(g: recognition_pb2.RecognizedGrasp) -> FoundGrasp:
    return FoundGrasp(g.name, matrix_from_proto(g.scene_from_gripper), matrix_from_proto(g.scene_from_pregrasp),
                      _optional(g, "base_from_gripper"), _optional(g, "base_from_pregrasp"),
                      g.parallel_jaw.jaw_opening_m, g.parallel_jaw.grip_width_m, g.quality, g.success, g.symmetry_index,
                      g.suction.cup_radius_m if g.HasField("suction") else None, g.scene_success)


def _found(o: recognition_pb2.RecognizedObject) -> FoundObject:
    images = [ObjectInImage(i.score if i.HasField("score") else None, _optional(i, "camera_from_object"),
                            _covariance(i.pose_covariance)) for i in o.images]
    counts = o.grasp_counts
    dropped = {name: getattr(counts, name) for name in ("too_narrow", "below_plane", "blocked", "unsure", "other_gripper")
               if getattr(counts, name) > 0}
    return FoundObject(object_id(o.object), o.instance, o.score, matrix_from_proto(o.scene_from_object),
                       _covariance(o.pose_covariance), images, [object_id(a) for a in o.alternative_objects],
                       [_grasp(g) for g in o.grasps], dropped, _optional(o, "base_from_object"),
                       _covariance(o.base_pose_covariance), [_alternative(a) for a in o.alternatives])


def _alternative(a: recognition_pb2.ObjectAlternative) -> FoundAlternative:
    place = a.feature_place
    is_feature = a.HasField("feature_place")
    return FoundAlternative(enum_name(recognition_pb2.ObjectAlternative.Kind, a.kind, "KIND_"), object_id(a.object),
                            a.probability if a.probability > 0 else None, _optional(a, "scene_from_object"),
                            np.array([place.x, place.y, place.z]) if is_feature else None, a.feature_size_m if is_feature else None,
                            _optional(a, "scene_from_camera"), _optional(a, "base_from_camera"), a.differing_px)


def _explained_edge(e: recognition_pb2.ExplainedEdge) -> ExplainedEdge:
    state = recognition_pb2.ExplainedEdge.State.Name(e.state)[len("STATE_"):]
    return ExplainedEdge(e.edge if e.HasField("edge") else None, state, np.array(e.points_px, dtype=float).reshape(-1, 2))


def _explained_image(i: recognition_pb2.ExplainedImage) -> Optional[ExplainedImage]:
    if not i.HasField("camera_from_object"):
        return None
    return ExplainedImage(matrix_from_proto(i.camera_from_object), _camera(i.camera), i.score, i.visible_px, i.supported_px,
                          i.hidden_px, [_explained_edge(e) for e in i.edges])


def _explanation(e: recognition_pb2.Explanation) -> Explanation:
    test = recognition_pb2.Explanation.Test.Name(e.failed_test)[len("TEST_"):]
    return Explanation(object_id(e.object), test if e.failed_test else None, e.value, e.needed,
                       object_id(e.other_object) if e.other_object else None, e.detail,
                       [_explained_image(i) for i in e.images])


def _finding(f: recognition_pb2.SceneFinding) -> Finding:
    kind = f.WhichOneof("finding")
    values: Dict[str, Any] = {}
    for field, value in getattr(f, kind).ListFields() if kind else ():
        values[field.name] = np.array([value.x, value.y, value.z]) if field.message_type else value
    return Finding(kind.upper() if kind else "UNKNOWN", object_id(f.object) if f.object else None, f.instance,
                   f.image if f.HasField("image") else None, values, f.detail)


def _reason(r: recognition_pb2.SceneReason) -> Reason:
    known = r.kind in recognition_pb2.SceneReason.Kind.values()
    return Reason(recognition_pb2.SceneReason.Kind.Name(r.kind)[len("KIND_"):] if known else "UNKNOWN", r.detail)


@dataclasses.dataclass
class GraspModel:
    """A grasp as enrolled: of two fingers, or of a suction cup when cup_radius_m is set."""
    name: str
    object_from_gripper: np.ndarray
    jaw_opening_m: float = 0.0
    grip_width_m: float = 0.0
    quality: float = 1.0
    object_from_pregrasp: Optional[np.ndarray] = None
    cup_radius_m: Optional[float] = None

    def to_proto(self) -> catalog_pb2.Grasp:
        grasp = catalog_pb2.Grasp(name=self.name, object_from_gripper=matrix_to_proto(self.object_from_gripper, "object_from_gripper"),
                                  quality=self.quality)
        if self.cup_radius_m is not None:
            grasp.suction.cup_radius_m = self.cup_radius_m
        else:
            grasp.parallel_jaw.jaw_opening_m, grasp.parallel_jaw.grip_width_m = self.jaw_opening_m, self.grip_width_m
        if self.object_from_pregrasp is not None:
            grasp.object_from_pregrasp.CopyFrom(matrix_to_proto(self.object_from_pregrasp, "object_from_pregrasp"))
        return grasp

    @classmethod
    def from_proto(cls, g: catalog_pb2.Grasp) -> "GraspModel":
        return cls(g.name, matrix_from_proto(g.object_from_gripper), g.parallel_jaw.jaw_opening_m,
                   g.parallel_jaw.grip_width_m, g.quality if g.HasField("quality") else 1.0,
                   _optional(g, "object_from_pregrasp"), g.suction.cup_radius_m if g.HasField("suction") else None)


@dataclasses.dataclass
class CatalogObject:
    """An enrolled part. edges: polylines (n x 3, metres) in the object's frame; empty in lists. etag: for if_match; ready:
    recognition looks for it (else raw.recognition_status.reason says why not); revision: the catalog's generation of its last
    write, for Client.recognize(min_generation=). raw: the message."""
    object_id: str
    display_name: str
    diameter_m: float
    corner_count: int
    edge_count: int
    triangle_count: int
    symmetries: List[np.ndarray]
    grasps: List[GraspModel]
    edges: List[np.ndarray]
    etag: str
    labels: Dict[str, str]
    ready: bool
    revision: int
    raw: catalog_pb2.Object = dataclasses.field(repr=False)

    @classmethod
    def from_proto(cls, o: catalog_pb2.Object) -> "CatalogObject":
        return cls(object_id(o.name), o.display_name, o.diameter_m, o.vertex_count, o.edge_count, o.triangle_count,
                   [matrix_from_proto(s) for s in o.object_from_symmetric_object],
                   [GraspModel.from_proto(g) for g in o.grasps],
                   [np.array(e.polyline_m, dtype=float).reshape(-1, 3) for e in o.edges], o.etag, dict(o.labels),
                   o.recognition_status.state == catalog_pb2.RecognitionStatus.STATE_READY, o.revision, o)


@dataclasses.dataclass
class ObjectVersion:
    """What an object is or was. since: seconds since 1970, UTC, of the write that made it so; changed_by: who wrote, by the name in
    the server's access file (empty: not known); changed: fields of the object that the write changed, None where what was before is not
    known. object: without geometry, without etag where it is what was."""
    object: CatalogObject
    revision: int
    since: float
    changed_by: str
    changed: Optional[List[str]]

    @classmethod
    def from_proto(cls, version: catalog_pb2.ObjectVersion) -> "ObjectVersion":
        o = version.object
        return cls(CatalogObject.from_proto(o), o.revision, o.update_time.seconds + 1e-9 * o.update_time.nanos, version.changed_by,
                   list(version.changed_fields.paths) if version.HasField("changed_fields") else None)


@dataclasses.dataclass
class ImportedObject:
    """What came of a CAD file: the enrolled part, without geometry, and what is odd about the file."""
    object: CatalogObject
    warnings: List[str]

    @classmethod
    def from_proto(cls, answer: catalog_pb2.ImportObjectResponse) -> "ImportedObject":
        return cls(CatalogObject.from_proto(answer.object), list(answer.warnings))


@dataclasses.dataclass
class LookAlike:
    """An object that another can be taken for; kind: CONGRUENT, SIMILAR, MIRROR, AFFINE or PROJECTIVE."""
    object_id: str
    kind: str
    stretch: List[float]
    matched_corners: int

    @classmethod
    def from_proto(cls, a: catalog_pb2.LookAlike) -> "LookAlike":
        return cls(object_id(a.name), catalog_pb2.LookAlike.Kind.Name(a.kind)[len("KIND_"):], list(a.stretch),
                   a.matched_vertices)
