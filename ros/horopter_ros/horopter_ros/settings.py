"""What the node's parameters say of a request. Nothing of ROS is needed to test this."""
import math

import numpy as np

from horopter import ExpectedPart, Gripper, Reference

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


def reference(text, rotation_sigma=None, position_sigma=None):
    """Of "ID" or "ID x y z qx qy qz qw" (metres; the quaternion as ROS writes it). Raises ValueError."""
    words = text.split()
    if len(words) not in (1, 8):
        raise ValueError("reference %r: ID, or ID x y z qx qy qz qw" % text)
    pose = np.eye(4)
    if len(words) == 8:
        try:
            numbers = [float(w) for w in words[1:]]
        except ValueError:
            raise ValueError("reference %r: not a number" % text) from None
        if not all(map(math.isfinite, numbers)) or abs(math.hypot(*numbers[3:]) - 1.0) > 0.01:
            raise ValueError("reference %r: the quaternion's norm is not 1" % text)
        pose[:3, 3] = numbers[:3]
        pose[:3, :3] = matrix_of_quaternion(*numbers[3:])
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


def request_arguments(value, topics, expected=()):
    """Keyword arguments of Client.recognize. value: name -> parameter; topics: whose images are sent, in their order among all of
    the node's, so that each names its camera of the station; expected: of the request, before the parameter. Raises ValueError."""
    out = {"min_score": value("min_score"), "gripper": gripper(value)}
    references = [reference(t, _or_none(value("reference_rotation_sigma")), _or_none(value("reference_position_sigma")))
                  for t in _texts(value("references"))]
    if references:
        out["reference"], out["further_references"] = references[0], references[1:]
    out["expected"] = [expected_part(t) for t in (_texts(expected) or _texts(value("expected")))]
    if value("station"):
        cameras = _texts(value("station_cameras")) or ["camera%d" % (i + 1) for i in range(len(value("image_topics")))]
        if len(cameras) != len(value("image_topics")):
            raise ValueError("station_cameras: one for each of image_topics")
        of_topic = dict(zip(value("image_topics"), cameras))
        out["station"], out["station_cameras"] = value("station"), [of_topic[t] for t in topics]
        out["read_only"] = value("station_read_only")
    return out
