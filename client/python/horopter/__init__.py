"""Client of a Horopter server: known rigid parts in a few images of uncalibrated cameras.

>>> from horopter import Client
>>> with Client("localhost:50051") as client:                                       # doctest: +SKIP
...     scene = client.recognize(["0.png", "1.png", "2.png"])
...     for part in scene.objects:
...         print(part.object_id, part.score, part.scene_from_object)

Metres, radians, right-handed frames; `a_from_b` is a 4 x 4 array that maps points of frame b into frame a:
`x_a = a_from_b @ x_b` in homogeneous coordinates. Cameras look along z, x is right, y is down; the centre of the top-left
pixel is (0, 0).
"""
from .aio import AsyncClient
from .cameras import hint_from_camera_info
from .client import Client
from .errors import (AlreadyExists, Busy, Cancelled, Conflict, DataLoss, DeadlineExceeded, HoropterError, InternalError,
                     InvalidRequest, NotFound, PermissionDenied, TooLarge, Unauthenticated, Unavailable)
from .images import RawFrame, encode_image
from .security import Security
from .stations import Calibration, CameraSetting, Station, StationCamera, StationEvent
from .types import (BaseAlternative, Camera, CameraBasis, CameraHint, CatalogObject, ExpectedOutcome, ExpectedPart, ExpectedReport,
                    ExplainedEdge, ExplainedImage, Explanation, Finding, FoundAlternative, FoundGrasp, FoundObject, GraspModel, Gripper, ImageRegion, ImportedObject, LookAlike,
                    ObjectInImage, ObjectVersion, Reason, Reference, Scene, SpaceRegion, StationFinding, StationReport)

__all__ = [
    "AlreadyExists", "AsyncClient", "BaseAlternative", "Busy", "Calibration", "Camera", "CameraBasis", "CameraHint", "CameraSetting",
    "Cancelled", "CatalogObject", "Client", "Conflict",
    "DataLoss", "DeadlineExceeded", "ExpectedOutcome", "ExpectedPart", "ExpectedReport", "ExplainedEdge", "ExplainedImage", "Explanation", "Finding", "FoundAlternative", "FoundGrasp",
    "FoundObject", "GraspModel", "Gripper", "HoropterError", "ImageRegion", "ImportedObject", "InternalError", "InvalidRequest", "LookAlike", "NotFound",
    "ObjectInImage", "ObjectVersion", "PermissionDenied", "RawFrame", "Reason", "Reference", "Scene", "Security", "SpaceRegion", "Station",
    "StationCamera", "StationEvent", "StationFinding", "StationReport",
    "TooLarge", "Unauthenticated", "Unavailable", "encode_image", "hint_from_camera_info",
]
__version__ = "@HOROPTER_PYTHON_VERSION@"
