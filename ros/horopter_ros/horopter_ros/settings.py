"""What the node's parameters say of a request. Nothing of ROS is needed to test this."""
import math

import numpy as np

from horopter import ExpectedPart, Gripper, ImageRegion, Reference, SpaceRegion

from .conversions import matrix_of_quaternion

# Parameters beside those of topics and frames, with their defaults; texts are lists of one empty text where nothing is said.
PARAMETERS = {
    "station": "",
    "station_cameras": [""],
    "station_read_only": False,
    "references": [""],
    "reference_rotation_sigma": 0.0,
    "reference_position_sigma": 0.0,
    "camera_rotation_sigma": 0.0,
    "camera_position_sigma": 0.0,
    "gripper_fingers": [0.0, 0.0, 0.0],
    "gripper_max_opening": 0.0,
    "suction_length": 0.0,
    "suction_holder_radius": 0.0,
    "approach": 0.0,
    "min_score": 0.0,
    "sync_slop": 0.0,
    "max_image_age": 0.0,
    "all_images": False,
    "arm_topics": [""],
    "pose_topics": [""],
    "tf_timeout": 0.1,
    "collision_objects": False,
    "collision_max_triangles": 20000,
    "expected": [""],
    "space_regions": [""],
}


def _texts(values):
    return [v for v in values if v]


def _or_none(number):
    """0 stands for what is not said: parameters of ROS have no other way."""
    return number if number else None


def pose_topics(value):
    """{image topic: topic of the pose of its camera}, of those that have one. Raises ValueError."""
    said = list(value("pose_topics"))
    if not _texts(said):
        return {}
    if len(said) != len(value("image_topics")):
        raise ValueError("pose_topics: one for each of image_topics, empty where TF has the pose")
    return {image: pose for image, pose in zip(value("image_topics"), said) if pose}


def arm_topics(value):
    """Topics of cameras that move, all of them among image_topics. Raises ValueError."""
    said = _texts(value("arm_topics"))
    for topic in said:
        if topic not in value("image_topics"):
            raise ValueError("arm_topics: %s is not one of image_topics" % topic)
    return said


def _numbers(text, words, what):
    """Raises ValueError naming `what`: a word that is no finite number."""
    try:
        numbers = [float(w) for w in words]
    except ValueError:
        raise ValueError("%s %r: not a number" % (what, text)) from None
    if not all(map(math.isfinite, numbers)):
        raise ValueError("%s %r: not finite" % (what, text))
    return numbers


def _pose(text, numbers, what):
    """4 x 4 of x y z qx qy qz qw, metres; the quaternion as ROS writes it. Raises ValueError."""
    if abs(math.hypot(*numbers[3:]) - 1.0) > 0.01:
        raise ValueError("%s %r: the quaternion's norm is not 1" % (what, text))
    pose = np.eye(4)
    pose[:3, 3] = numbers[:3]
    pose[:3, :3] = matrix_of_quaternion(*numbers[3:])
    return pose


def image_regions(texts, topics, all_topics):
    """ImageRegions of "TOPIC x y width height" for the image of each topic, None where there is none; None: no text. A topic of
    which no image is sent has nothing that could be searched. Raises ValueError: also a topic that is none of all_topics."""
    if not texts:
        return None
    regions = {}
    for text in texts:
        words = text.split()
        if len(words) != 5:
            raise ValueError("image region %r: TOPIC x y width height" % text)
        if words[0] not in all_topics:
            raise ValueError("image region %r: %s is not one of image_topics" % (text, words[0]))
        regions.setdefault(words[0], []).append(ImageRegion(*_numbers(text, words[1:], "image region")))
    return [regions.get(t) for t in topics]


def space_region(text):
    """Of "x y z qx qy qz qw sx sy sz": the box's middle in the base and its sizes, metres. Raises ValueError."""
    words = text.split()
    if len(words) != 10:
        raise ValueError("space region %r: x y z qx qy qz qw sx sy sz" % text)
    numbers = _numbers(text, words, "space region")
    return SpaceRegion(_pose(text, numbers[:7], "space region"), tuple(numbers[7:]))


def reference(text, rotation_sigma=None, position_sigma=None):
    """Of "ID" or "ID x y z qx qy qz qw" (metres; the quaternion as ROS writes it). Raises ValueError."""
    words = text.split()
    if len(words) not in (1, 8):
        raise ValueError("reference %r: ID, or ID x y z qx qy qz qw" % text)
    pose = np.eye(4)
    if len(words) == 8:
        pose = _pose(text, _numbers(text, words[1:], "reference"), "reference")
    return Reference(words[0], pose, rotation_sigma, position_sigma)


def expected_part(text):
    """Of "ID" or "ID=COUNT". Raises ValueError."""
    part, equals, count = text.partition("=")
    if equals and not (count.isdigit() and int(count) > 0):
        raise ValueError("expected %r: ID or ID=COUNT" % text)
    return ExpectedPart(part.strip(), int(count) if equals else 1)


def gripper(value):
    """Of the gripper's parameters; None where none is set."""
    fingers = [float(v) for v in value("gripper_fingers")]
    has_fingers = len(fingers) == 3 and all(v > 0.0 for v in fingers)
    if any(fingers) and not has_fingers:
        raise ValueError("gripper_fingers: length, width and thickness, all positive")
    length = _or_none(value("suction_length"))
    if not has_fingers and length is None:
        return None
    return Gripper(tuple(fingers) if has_fingers else None, _or_none(value("gripper_max_opening")), length,
                   _or_none(value("suction_holder_radius")), _or_none(value("approach")))


def request_arguments(value, topics, expected=(), regions=(), boxes=()):
    """Keyword arguments of Client.recognize. value: name -> parameter; topics: whose images are sent, in their order among all of
    the node's, so that each names its camera of the station; expected, regions, boxes: of the request (image_regions, space_regions), before the parameters.
    Raises ValueError."""
    out = {"min_score": value("min_score"), "gripper": gripper(value)}
    references = [reference(t, _or_none(value("reference_rotation_sigma")), _or_none(value("reference_position_sigma")))
                  for t in _texts(value("references"))]
    if references:
        out["reference"], out["further_references"] = references[0], references[1:]
    out["expected"] = [expected_part(t) for t in (_texts(expected) or _texts(value("expected")))]
    of_images = image_regions(_texts(regions), topics, value("image_topics"))
    if of_images is not None:
        out["regions"] = of_images
    in_space = [space_region(t) for t in (_texts(boxes) or _texts(value("space_regions")))]
    if in_space:
        out["space_regions"] = in_space
    if value("station"):
        cameras = _texts(value("station_cameras")) or ["camera%d" % (i + 1) for i in range(len(value("image_topics")))]
        if len(cameras) != len(value("image_topics")):
            raise ValueError("station_cameras: one for each of image_topics")
        of_topic = dict(zip(value("image_topics"), cameras))
        out["station"], out["station_cameras"] = value("station"), [of_topic[t] for t in topics]
        out["read_only"] = value("station_read_only")
    return out
