#!/usr/bin/env python3
"""The conversions of ros/horopter_ros against stand-ins with the fields of the ROS 2 messages.

    horopter_ros_test.py PACKAGE_FOLDER ROS_FOLDER
"""
import array
import asyncio
import importlib
import os
import re
import sys
import unittest
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

PACKAGE, ROS = map(os.path.abspath, sys.argv[1:3])
sys.path[:0] = [PACKAGE, os.path.join(ROS, "horopter_ros")]

import numpy as np  # noqa: E402

import horopter  # noqa: E402
from horopter_ros import conversions, images, settings  # noqa: E402

FORMATS = horopter.types.recognition_pb2.RawFrame.PixelFormat

# Fields of the messages that the node fills, as their packages define them in ROS 2 Humble and Jazzy, which agree on them; where ROS is
# installed (AMENT_PREFIX_PATH), test_stand_ins_have_the_fields_of_the_definitions compares. A field that is not here cannot be set.
FIELDS = {
    "Header": {"stamp": None, "frame_id": ""},
    "Point": {"x": 0.0, "y": 0.0, "z": 0.0},
    "Vector3": {"x": 0.0, "y": 0.0, "z": 0.0},
    "Quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    "Pose": {"position": "Point", "orientation": "Quaternion"},
    "PoseStamped": {"header": "Header", "pose": "Pose"},
    "PoseWithCovariance": {"pose": "Pose", "covariance": [0.0] * 36},
    "PoseWithCovarianceStamped": {"header": "Header", "pose": "PoseWithCovariance"},
    "Transform": {"translation": "Vector3", "rotation": "Quaternion"},
    "TransformStamped": {"header": "Header", "child_frame_id": "", "transform": "Transform"},
    "ObjectHypothesis": {"class_id": "", "score": 0.0},
    "ObjectHypothesisWithPose": {"hypothesis": "ObjectHypothesis", "pose": "PoseWithCovariance"},
    "BoundingBox3D": {"center": "Pose", "size": "Vector3"},
    "Detection3D": {"header": "Header", "results": [], "bbox": "BoundingBox3D", "id": ""},
    "Detection3DArray": {"header": "Header", "detections": []},
    "JointTrajectoryPoint": {"positions": [], "velocities": [], "accelerations": [], "effort": [], "time_from_start": None},
    "JointTrajectory": {"header": "Header", "joint_names": [], "points": []},
    "Vector3Stamped": {"header": "Header", "vector": "Vector3"},
    "GripperTranslation": {"direction": "Vector3Stamped", "desired_distance": 0.0, "min_distance": 0.0},
    "Grasp": {"id": "", "pre_grasp_posture": "JointTrajectory", "grasp_posture": "JointTrajectory",
              "grasp_pose": "PoseStamped", "grasp_quality": 0.0, "pre_grasp_approach": "GripperTranslation",
              "post_grasp_retreat": "GripperTranslation", "post_place_retreat": "GripperTranslation",
              "max_contact_force": 0.0, "allowed_touch_objects": []},
    "ExpectedOutcome": {"part": "", "label": "", "state": "", "present": 0.0, "missing": 0.0, "displaced": 0.0, "wrong_part": 0.0,
                        "cannot_tell": 0.0, "found_part": "", "found_instance": 0, "distance": 0.0, "rotation": 0.0, "detail": ""},
    "RecognizeResponse": {"success": False, "complete": False, "reasons": [], "message": "", "request_id": "",
                          "detections": "Detection3DArray", "grasps": [], "collision_objects": [], "all_present": False, "expected": []},
    "ObjectType": {"key": "", "db": ""},
    "SolidPrimitive": {"type": 0, "dimensions": [], "polygon": None},
    "MeshTriangle": {"vertex_indices": [0, 0, 0]},
    "Mesh": {"triangles": [], "vertices": []},
    "CollisionObject": {"header": "Header", "pose": "Pose", "id": "", "type": "ObjectType", "primitives": [], "primitive_poses": [],
                        "meshes": [], "mesh_poses": [], "planes": [], "plane_poses": [], "subframe_names": [], "subframe_poses": [],
                        "operation": b"\x00"},
    "PartGrasp": {"part": "", "instance": 0, "name": "", "success": 0.0, "jaw_opening": 0.0, "grasp": "Grasp"},
}


class Message:
    def __init__(self, kind):
        object.__setattr__(self, "_fields", FIELDS[kind])
        for name, value in FIELDS[kind].items():
            if isinstance(value, str) and value in FIELDS:
                value = Message(value)
            object.__setattr__(self, name, list(value) if isinstance(value, list) else value)

    def __setattr__(self, name, value):
        if name not in self._fields:
            raise AttributeError("the message has no field " + name)
        object.__setattr__(self, name, value)


# Packages of the messages that are not ours.
PACKAGE_OF = {"Header": "std_msgs", "Point": "geometry_msgs", "Vector3": "geometry_msgs", "Quaternion": "geometry_msgs", "Pose": "geometry_msgs",
              "PoseStamped": "geometry_msgs", "PoseWithCovariance": "geometry_msgs", "PoseWithCovarianceStamped": "geometry_msgs",
              "Transform": "geometry_msgs", "TransformStamped": "geometry_msgs", "Vector3Stamped": "geometry_msgs",
              "ObjectHypothesis": "vision_msgs", "ObjectHypothesisWithPose": "vision_msgs", "BoundingBox3D": "vision_msgs",
              "Detection3D": "vision_msgs", "Detection3DArray": "vision_msgs", "JointTrajectoryPoint": "trajectory_msgs",
              "JointTrajectory": "trajectory_msgs", "GripperTranslation": "moveit_msgs", "Grasp": "moveit_msgs",
              "CollisionObject": "moveit_msgs", "ObjectType": "object_recognition_msgs", "SolidPrimitive": "shape_msgs",
              "MeshTriangle": "shape_msgs", "Mesh": "shape_msgs"}
CONSTANTS = {"CollisionObject": {"ADD": b"\x00", "REMOVE": b"\x01"}, "SolidPrimitive": {"BOX": 1}}


def kind_of(kind):
    """A class that makes messages of the kind, with its constants."""
    return type(kind, (), {"__new__": lambda cls, kind=kind: Message(kind), **CONSTANTS.get(kind, {})})


MESSAGES = SimpleNamespace(**{kind: kind_of(kind) for kind in FIELDS})


def rotation(axis, angle):
    axis = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def pose(axis, angle, t):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation(axis, angle), t
    return out


def matrix(message):
    return conversions.matrix_of_transform(SimpleNamespace(translation=message.position, rotation=message.orientation))


def a_scene(in_base):
    base_from_scene = pose((1, 2, 3), 0.7, (1, 2, 3)) if in_base else None
    camera_from_scene = pose((0, 1, 1), 0.3, (0, 0, 0.5))
    scene_from_object = pose((1, 0, 1), 1.1, (0.1, 0.2, 0.3))
    generator = np.random.default_rng(5)
    a = generator.normal(size=(6, 6))
    covariance = a @ a.T * 1e-6
    grasp = horopter.FoundGrasp("g", scene_from_object @ pose((0, 0, 1), 0.2, (0, 0, 0.05)),
                                scene_from_object @ pose((0, 0, 1), 0.2, (0, 0, -0.05)), None, None, 0.04, 0.02, 0.5, 0.8, 0)
    part = horopter.FoundObject("bracket", 1, 0.9, scene_from_object, covariance,
                                [horopter.ObjectInImage(0.9, camera_from_scene @ scene_from_object, 2 * covariance)], ["copy"],
                                [grasp], {}, base_from_scene @ scene_from_object if in_base else None,
                                3 * covariance if in_base else None)
    camera = horopter.Camera(True, 640, 480, 600.0, (320.0, 240.0), 0.0, 0.01, camera_from_scene)
    return horopter.Scene(True, [], [], [camera], [part], base_from_scene, None, [], {}, "r", 1, None, 0, None)


class Images(unittest.TestCase):

    def image(self, encoding, pixels, pad=0, big=False):
        rows = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<")).reshape(pixels.shape[0], -1).view(np.uint8)
        rows = np.hstack([rows, np.full((rows.shape[0], pad), 7, np.uint8)])
        return SimpleNamespace(height=pixels.shape[0], width=pixels.shape[1], encoding=encoding, is_bigendian=int(big),
                               step=rows.shape[1], data=rows.tobytes())

    def test_every_encoding_gives_the_same_pixels(self):
        generator = np.random.default_rng(1)
        rgb = generator.integers(0, 255, (5, 7, 3), np.uint8)
        alpha = np.full((5, 7, 1), 9, np.uint8)
        for encoding, pixels in (("rgb8", rgb), ("bgr8", rgb[:, :, ::-1]), ("rgba8", np.dstack([rgb, alpha])),
                                 ("bgra8", np.dstack([rgb[:, :, ::-1], alpha]))):
            for pad in (0, 3):
                out = conversions.image_array(self.image(encoding, np.ascontiguousarray(pixels), pad))
                np.testing.assert_array_equal(out, rgb)
        deep = generator.integers(0, 65535, (5, 7), np.uint16)
        for big in (False, True):
            np.testing.assert_array_equal(conversions.image_array(self.image("mono16", deep, 2, big)), deep)

    def test_what_cannot_be_read_is_said(self):
        image = self.image("mono8", np.zeros((4, 4), np.uint8))
        image.data = image.data[:-1]
        with self.assertRaises(ValueError):
            conversions.image_array(image)
        for encoding in ("bayer_rggb8", "32FC1", ""):
            with self.assertRaisesRegex(ValueError, repr(encoding)):
                conversions.image_array(self.image(encoding, np.zeros((4, 4), np.uint8)))
        with self.assertRaisesRegex(ValueError, "32FC1.*bayer_rggb8.*mono16"):
            conversions.scene_image(self.image("32FC1", np.zeros((4, 4), np.uint8)))
        image = self.image("bayer_rggb16", np.zeros((4, 4), np.uint16))
        image.data = image.data[:-1]
        with self.assertRaises(ValueError):
            conversions.scene_image(image)

    def test_what_a_camera_delivers_goes_to_the_server_as_it_is(self):
        generator = np.random.default_rng(2)
        narrow, deep = generator.integers(0, 255, (4, 6), np.uint8), generator.integers(0, 4095, (4, 6), np.uint16)
        for ros, raw in (("rggb", "RG"), ("bggr", "BG"), ("gbrg", "GB"), ("grbg", "GR")):
            for pad in (0, 3):
                frame = conversions.scene_image(self.image("bayer_%s8" % ros, narrow, pad)).to_proto()
                self.assertEqual((frame.format, frame.data), (FORMATS.Value("PIXEL_FORMAT_BAYER_%s8" % raw), narrow.tobytes()))
                self.assertEqual((frame.width_px, frame.height_px, frame.stride_bytes, frame.bits_in_use), (6, 4, 0, 0))
                for big in (False, True):
                    frame = conversions.scene_image(self.image("bayer_%s16" % ros, deep, pad, big)).to_proto()
                    self.assertEqual(frame.format, FORMATS.Value("PIXEL_FORMAT_BAYER_%s16" % raw))
                    self.assertEqual(frame.data, deep.astype("<u2").tobytes())
        for ros, raw in (("yuv422", "UYVY"), ("uyvy", "UYVY"), ("yuv422_yuy2", "YUYV"), ("yuyv", "YUYV")):
            message = self.image(ros, generator.integers(0, 255, (4, 12), np.uint8), 5)
            message.width = 6
            frame = conversions.scene_image(message).to_proto()
            self.assertEqual((frame.format, len(frame.data)), (FORMATS.Value("PIXEL_FORMAT_" + raw), 48))
        message = self.image("nv21", generator.integers(0, 255, (6, 6), np.uint8))
        message.height = 4
        self.assertEqual(len(conversions.scene_image(message).to_proto().data), 36)
        self.assertEqual(conversions.scene_image(self.image("mono16", deep, 2, True)).dtype, np.uint16)
        for encoding in ("8UC4", "16UC3", "rgba16", "bgra16", "16UC4"):
            channels = 3 if encoding == "16UC3" else 4
            pixels = generator.integers(0, 255, (4, 6, channels)).astype(np.uint16 if "16" in encoding else np.uint8)
            self.assertEqual(conversions.scene_image(self.image(encoding, pixels)).shape, (4, 6, 3))

    def test_camera_info_becomes_a_hint(self):
        info = SimpleNamespace(k=[600.0, 0, 320, 0, 600, 240, 0, 0, 1], d=[-0.1, 0, 0, 0, 0], distortion_model="plumb_bob",
                               p=[500.0, 0, 310, 0, 0, 500, 230, 0, 0, 0, 1, 0], binning_x=0, binning_y=0,
                               roi=SimpleNamespace(x_offset=0, y_offset=0))
        hint = conversions.camera_hint(info)
        self.assertEqual((hint.focal_px, hint.principal_point_px, hint.k1), (600.0, (320.0, 240.0), -0.1))
        self.assertEqual(conversions.camera_hint(info, rectified=True).focal_px, 500.0)
        info.binning_x = info.binning_y = 2
        info.roi.x_offset = 100
        self.assertEqual(conversions.camera_hint(info).focal_px, 300.0)
        self.assertEqual(conversions.camera_hint(info).principal_point_px, (109.75, 119.75))
        info.distortion_model, info.d = "equidistant", [-0.1, 0, 0, 0, 0.1]
        with self.assertRaisesRegex(ValueError, "four numbers"):
            conversions.camera_hint(info)
        info.d = [0.1, 0.02, 0.003, 0.0]
        fisheye = conversions.camera_hint(info)
        self.assertEqual((fisheye.fisheye, fisheye.focal_px, fisheye.k1), ((0.1, 0.02, 0.003, 0.0), 300.0, None))
        info.distortion_model, info.d = "plumb_bob", [-0.1, 0.02, 0.001, -0.002, 0.003]
        lens = conversions.camera_hint(info).to_proto()
        self.assertEqual((lens.k1, lens.k2, lens.p1, lens.p2, lens.k3), (-0.1, 0.02, 0.001, -0.002, 0.003))
        info.distortion_model, info.d = "rational_polynomial", [-0.1, 0, 0, 0, 0, 0.5, 0, 0]
        self.assertEqual(conversions.camera_hint(info).to_proto().k4, 0.5)
        info.distortion_model = "omni"
        with self.assertRaisesRegex(ValueError, "omni"):
            conversions.camera_hint(info)
        info.k = [0.0] * 9
        info.distortion_model = "plumb_bob"
        self.assertIsNone(conversions.camera_hint(info))
        self.assertIsNone(conversions.camera_hint(None))
        self.assertIsNone(conversions.camera_hint(None, np.eye(4)).focal_px)

    def test_the_size_of_an_image_says_what_of_the_sensor_it_is(self):
        # rclpy has arrays of numpy for K and P, and one of Python for D.
        info = SimpleNamespace(width=2560, height=1920, k=np.array([1960.0, 0, 1268, 0, 1960, 956, 0, 0, 1]),
                               d=array.array("d", [0.0] * 5), distortion_model="plumb_bob", binning_x=2, binning_y=2,
                               roi=SimpleNamespace(x_offset=640, y_offset=480, width=1200, height=900, do_rectify=False))

        def of(*size):
            hint = conversions.camera_hint(info, image_size=size)
            return hint.focal_px, hint.principal_point_px[0]
        self.assertEqual(of(600, 450), (980.0, (1268 - 640 + 0.5) / 2 - 0.5))
        self.assertEqual(of(1200, 900), (1960.0, 628.0))
        self.assertEqual(of(1280, 960), (980.0, 1268.5 / 2 - 0.5))
        self.assertEqual(of(2560, 1920), (1960.0, 1268.0))
        with self.assertRaisesRegex(ValueError, "binning of 2 x 2"):
            of(640, 480)
        info.roi.width, info.roi.height = 1280, 960
        with self.assertRaisesRegex(ValueError, "both"):
            of(1280, 960)
        info.roi.width = 2000
        with self.assertRaisesRegex(ValueError, "not within"):
            of(1000, 480)

    def test_a_matrix_that_is_none_is_an_error(self):
        for k, said in (([980, 0, 0, 0, 980, 0, 320, 240, 1], "transposed"), ([980, 0, 320, 0, 980, 240, 0, 0, 980], "0 0 1"),
                        ([980, 0, 320, 0, 300, 240, 0, 0, 1], "0.5 to 2"), ([980, 0, 720, 0, 980, 240, 0, 0, 1], "outside"),
                        ([980, 90, 320, 0, 980, 240, 0, 0, 1], "skew")):
            info = SimpleNamespace(width=640, height=480, k=k, d=[], distortion_model="", binning_x=0, binning_y=0,
                                   roi=SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0))
            with self.assertRaisesRegex(ValueError, said):
                conversions.camera_hint(info, image_size=(640, 480))


class Frames(unittest.TestCase):

    def test_a_pose_is_in_the_base_where_it_is_known_else_in_the_first_camera(self):
        for in_base, frame_id in ((True, "base_link"), (False, "left_optical_frame")):
            scene = a_scene(in_base)
            frame = conversions.AnswerFrame(scene, "base_link", ["left_optical_frame"])
            self.assertEqual(frame.frame_id, frame_id)
            part = scene.objects[0]
            expected = part.base_from_object if in_base else part.images[0].camera_from_object
            detections = conversions.detections_message(scene, frame, 7, {}, MESSAGES)
            self.assertEqual((detections.header.frame_id, detections.header.stamp), (frame_id, 7))
            found = detections.detections[0]
            np.testing.assert_allclose(matrix(found.results[0].pose.pose), expected, atol=1e-9)
            name, stamped = conversions.pose_messages(scene, frame, 7, MESSAGES)[0]
            self.assertEqual(name, "bracket_1")
            np.testing.assert_allclose(matrix(stamped.pose.pose), expected, atol=1e-9)
            transform = conversions.transform_messages(scene, frame, 7, MESSAGES)[0]
            self.assertEqual(transform.child_frame_id, "horopter/bracket_1")
            np.testing.assert_allclose(conversions.matrix_of_transform(transform.transform), expected, atol=1e-9)

    def test_covariance_is_that_of_poses_drawn_and_measured_as_ros_does(self):
        """Draws poses (exp(w) R, t + dt), measures x y z and the rotation about the fixed axes, and compares."""
        generator = np.random.default_rng(3)
        scene = a_scene(True)
        part = scene.objects[0]
        covariance = part.base_covariance
        draws = generator.multivariate_normal(np.zeros(6), covariance, 20000)
        truth = part.base_from_object
        measured = []
        for w_dt in draws:
            angle = np.linalg.norm(w_dt[:3])
            turned = rotation(w_dt[:3], angle) @ truth[:3, :3]
            delta = turned @ truth[:3, :3].T  # about the fixed axes of the header's frame
            about = np.array([delta[2, 1] - delta[1, 2], delta[0, 2] - delta[2, 0], delta[1, 0] - delta[0, 1]]) / 2
            measured.append(np.concatenate([w_dt[3:], about]))
        message = np.array(conversions.ros_covariance(covariance)).reshape(6, 6)
        sampled = np.cov(np.array(measured).T)
        scale = np.sqrt(np.outer(np.diag(message), np.diag(message)))
        self.assertLess(np.abs((sampled - message) / scale).max(), 0.05)

    def test_a_frame_that_is_turned_turns_the_covariance(self):
        scene = a_scene(False)
        part = scene.objects[0]
        part.images[0].camera_from_object = None
        scene.cameras[0].camera_from_scene = pose((0, 0, 1), np.pi / 2, (0, 0, 0))
        _, covariance = conversions.AnswerFrame(scene, "b", ["c"]).pose(part)
        # A quarter turn about z: what was along x is along y.
        self.assertAlmostEqual(covariance[4, 4], part.covariance[3, 3])
        self.assertAlmostEqual(covariance[1, 1], part.covariance[0, 0])

    def test_alternatives_share_the_score_and_the_box_turns_with_the_part(self):
        scene = a_scene(True)
        frame = conversions.AnswerFrame(scene, "base_link", ["c"])
        box = {"bracket": ((0.01, 0.0, 0.0), (0.1, 0.2, 0.3))}
        found = conversions.detections_message(scene, frame, 7, box, MESSAGES).detections[0]
        self.assertEqual([r.hypothesis.class_id for r in found.results], ["bracket", "copy"])
        self.assertAlmostEqual(found.results[0].hypothesis.score, 0.45)
        expected = scene.objects[0].base_from_object @ np.array([0.01, 0, 0, 1])
        np.testing.assert_allclose(matrix(found.bbox.center)[:3, 3], expected[:3], atol=1e-9)
        self.assertEqual(found.bbox.size.z, 0.3)


class Grasps(unittest.TestCase):

    def test_a_grasp_is_the_tools_pose_with_its_approach(self):
        scene = a_scene(True)
        frame = conversions.AnswerFrame(scene, "base_link", ["c"])
        tool = pose((0, 0, 1), np.pi / 2, (0, 0, -0.1))
        out = conversions.grasp_messages(scene, frame, 7, MESSAGES, tool, ("left", "right"))[0]
        grasp = scene.objects[0].grasps[0]
        expected = scene.base_from_scene @ grasp.scene_from_gripper
        np.testing.assert_allclose(matrix(out.grasp.grasp_pose.pose), expected @ tool, atol=1e-9)
        v = out.grasp.pre_grasp_approach.direction.vector
        np.testing.assert_allclose([v.x, v.y, v.z], expected[:3, 2], atol=1e-9)  # z approaches
        self.assertAlmostEqual(out.grasp.pre_grasp_approach.desired_distance, 0.1)
        back = out.grasp.post_grasp_retreat.direction.vector
        np.testing.assert_allclose([back.x, back.y, back.z], -expected[:3, 2], atol=1e-9)
        self.assertEqual(out.grasp.pre_grasp_posture.points[0].positions, [0.02, 0.02])
        self.assertEqual(out.grasp.grasp_posture.points[0].positions, [0.01, 0.01])
        self.assertAlmostEqual(out.grasp.grasp_quality, 0.4)
        self.assertEqual(out.grasp.id, "bracket_1/g")


class Settings(unittest.TestCase):
    """What the node's parameters say of a request."""

    def arguments(self, asked=(), topics=("/left/image_raw", "/right/image_raw"), regions=(), boxes=(), **values):
        known = dict(settings.PARAMETERS, image_topics=["/left/image_raw", "/right/image_raw"], **values)
        return settings.request_arguments(known.__getitem__, list(topics), asked, regions, boxes)

    def test_nothing_said_is_nothing_asked(self):
        self.assertEqual(self.arguments(), {"min_score": 0.0, "gripper": None, "expected": []})

    def test_references_are_poses_as_ros_writes_them(self):
        out = self.arguments(references=["fixture 0.5 0 0.1 0 0 0.7071068 0.7071068", "post"], reference_position_sigma=0.001)
        self.assertEqual(out["reference"].object_id, "fixture")
        np.testing.assert_allclose(out["reference"].base_from_object, pose((0, 0, 1), np.pi / 2, (0.5, 0, 0.1)), atol=1e-6)
        self.assertEqual((out["reference"].position_sigma_m, out["reference"].rotation_sigma_rad), (0.001, None))
        self.assertEqual([r.object_id for r in out["further_references"]], ["post"])
        for bad in ("fixture 1 2 3", "fixture 0 0 0 0 0 0 2", "fixture 0 0 0 0 0 0 x", "fixture nan 0 0 0 0 0 1"):
            with self.assertRaises(ValueError):
                self.arguments(references=[bad])

    def test_a_station_knows_each_topic_s_camera_also_when_one_has_no_image(self):
        out = self.arguments(station="cell", station_cameras=["l", "r"], topics=["/right/image_raw"], station_read_only=True)
        self.assertEqual((out["station"], out["station_cameras"], out["read_only"]), ("cell", ["r"], True))
        self.assertEqual(self.arguments(station="cell", topics=["/right/image_raw"])["station_cameras"], ["camera2"])
        with self.assertRaises(ValueError):
            self.arguments(station="cell", station_cameras=["l"])

    def test_grippers_and_what_is_expected(self):
        out = self.arguments(gripper_fingers=[0.06, 0.014, 0.008], gripper_max_opening=0.1, expected=["nut"])
        self.assertEqual((out["gripper"].fingers_m, out["gripper"].max_opening_m, out["gripper"].cup_length_m),
                         ((0.06, 0.014, 0.008), 0.1, None))
        self.assertEqual([(e.object_id, e.count) for e in out["expected"]], [("nut", 1)])
        out = self.arguments(["bolt=3", "nut"], expected=["other"])
        self.assertEqual([(e.object_id, e.count) for e in out["expected"]], [("bolt", 3), ("nut", 1)])
        for bad in (dict(gripper_fingers=[0.06, 0.0, 0.008]), dict(expected=["bolt="]), dict(expected=["bolt=-1"])):
            with self.assertRaises(ValueError):
                self.arguments(**bad)

    def test_regions_are_of_the_images_that_are_sent_and_of_the_base(self):
        out = self.arguments(regions=["/right/image_raw 10 20 30.5 40", "/right/image_raw 0 0 5 5"])
        self.assertIsNone(out["regions"][0])
        self.assertEqual([(r.x_px, r.y_px, r.width_px, r.height_px) for r in out["regions"][1]], [(10, 20, 30.5, 40), (0, 0, 5, 5)])
        out = self.arguments(regions=["/right/image_raw 10 20 30 40"], topics=["/left/image_raw"])
        self.assertEqual(out["regions"], [None])
        crate = "0.5 0 0.1 0 0 0.7071068 0.7071068 0.6 0.4 0.2"
        box, = self.arguments(space_regions=[crate])["space_regions"]
        np.testing.assert_allclose(box.base_from_region, pose((0, 0, 1), np.pi / 2, (0.5, 0, 0.1)), atol=1e-6)
        self.assertEqual(box.size_m, (0.6, 0.4, 0.2))
        other = "0 0 0 0 0 0 1 1 2 3"
        self.assertEqual([b.size_m for b in self.arguments(boxes=[other], space_regions=[crate])["space_regions"]], [(1, 2, 3)])
        for bad in (dict(regions=["/left/image_raw 1 2 3"]), dict(regions=["/up/image_raw 1 2 3 4"]),
                    dict(regions=["/left/image_raw 1 2 3 x"]), dict(boxes=["0 0 0 0 0 0 1 1 2"]), dict(boxes=["0 0 0 0 0 0 2 1 2 3"]),
                    dict(boxes=["0 0 0 0 0 0 1 1 2 inf"])):
            with self.assertRaises(ValueError):
                self.arguments(**bad)

    def test_deviations_of_camera_poses_reach_the_hint(self):
        hint = conversions.camera_hint(None, np.eye(4), rotation_sigma=0.002, position_sigma=0.001)
        self.assertEqual((hint.rotation_sigma_rad, hint.position_sigma_m), (0.002, 0.001))
        self.assertIsNone(conversions.camera_hint(None, np.eye(4)).position_sigma_m)

    def test_outcomes_become_messages(self):
        message = horopter.types.recognition_pb2.RecognizeSceneResponse()
        message.expected.outcomes.add(expected_index=1, state=3, displaced_probability=0.75, cannot_tell_probability=0.25,
                                      object="objects/nut", instance=2, distance_m=0.5, label="pocket")
        message.expected.outcomes.add(state=2, missing_probability=1.0)
        told = conversions.expected_messages(horopter.Scene.from_proto(message),
                                             [horopter.ExpectedPart("bolt"), horopter.ExpectedPart("nut")], MESSAGES)
        self.assertEqual((told[0].part, told[0].state, told[0].displaced, told[0].cannot_tell, told[0].found_part,
                          told[0].found_instance, told[0].distance, told[0].label),
                         ("nut", "DISPLACED", 0.75, 0.25, "nut", 2, 0.5, "pocket"))
        self.assertTrue(np.isnan(told[0].rotation))
        self.assertEqual((told[1].part, told[1].missing, told[1].found_part), ("bolt", 1.0, ""))


class Anything:
    """A stand-in for what of ROS only has to be there."""

    def __init__(self, *_, **__):
        pass

    def __getattr__(self, _):
        return Anything()

    def __call__(self, *_, **__):
        return Anything()


class FakeNode:
    """rclpy.node.Node: parameters as a launch file sets them, and no more."""
    OVERRIDES = {}
    NOW_NS = 0

    def __init__(self, _):
        self.parameters, self.published = {}, []

    def declare_parameter(self, name, default):
        self.parameters[name] = self.OVERRIDES.get(name, default)

    def get_parameter(self, name):
        return SimpleNamespace(value=self.parameters[name])

    def create_publisher(self, _, topic, *__):
        return SimpleNamespace(publish=lambda message: self.published.append((topic, message)))

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.NOW_NS))

    create_subscription = create_service = lambda *_, **__: None


def node_module():
    """horopter_ros.node with stand-ins for the packages of ROS."""
    def module(name, **contents):
        made = ModuleType(name)
        made.__dict__.update(contents)
        sys.modules[name] = made
    kinds = {kind: kind_of(kind) for kind in FIELDS}
    recognize = type("Recognize", (), {"Result": lambda: Message("RecognizeResponse"), "Feedback": lambda: SimpleNamespace()})
    module("rclpy", init=None)
    module("rclpy.action", ActionServer=Anything, CancelResponse=SimpleNamespace(ACCEPT=1))
    module("rclpy.callback_groups", ReentrantCallbackGroup=Anything)
    module("rclpy.duration", Duration=lambda seconds: seconds)
    module("rclpy.executors", MultiThreadedExecutor=Anything)
    module("rclpy.node", Node=FakeNode)
    module("rclpy.qos", qos_profile_sensor_data=None)
    module("tf2_ros", Buffer=Anything, TransformListener=Anything, TransformBroadcaster=Anything,
           TransformException=type("TransformException", (Exception,), {}))
    module("geometry_msgs")
    module("geometry_msgs.msg", **kinds)
    module("horopter_msgs")
    module("horopter_msgs.action", Recognize=recognize)
    module("horopter_msgs.msg", **kinds)
    module("horopter_msgs.srv", Recognize=Anything)
    module("moveit_msgs")
    module("moveit_msgs.msg", **kinds)
    module("shape_msgs")
    module("shape_msgs.msg", **kinds)
    module("std_srvs")
    module("std_srvs.srv", Trigger=Anything)
    module("sensor_msgs")
    module("sensor_msgs.msg", CameraInfo=Anything, Image=Anything)
    module("trajectory_msgs")
    module("trajectory_msgs.msg", **kinds)
    module("vision_msgs")
    module("vision_msgs.msg", **kinds)
    return importlib.import_module("horopter_ros.node")


def stamp_of(seconds):
    return SimpleNamespace(sec=int(seconds), nanosec=round((seconds - int(seconds)) * 1e9))


class OneMoment(unittest.TestCase):

    def buffer(self, images_, **options):
        made = images.ImageBuffer("abc", **options)
        for topic, seconds in images_:
            made.add(topic, SimpleNamespace(header=SimpleNamespace(stamp=stamp_of(seconds)), name=(topic, seconds)))
        return made

    def names(self, found):
        return [image.name for image in found.values()]

    def test_the_newest_that_are_together(self):
        made = self.buffer([("a", 1.0), ("b", 1.01), ("c", 1.02), ("a", 2.0), ("b", 2.01), ("c", 2.3)], slop_s=0.05)
        self.assertEqual(self.names(made.of_one_moment()), [("a", 1.0), ("b", 1.01), ("c", 1.02)])
        made = self.buffer([("a", 2.0), ("b", 2.05), ("c", 2.0)], slop_s=0.05)
        self.assertEqual(len(made.of_one_moment()), 3)  # just so far apart
        self.assertEqual(self.buffer([], slop_s=1.0).of_one_moment(), {})

    def test_order_of_arrival_says_nothing(self):
        generator = np.random.default_rng(3)
        for _ in range(50):
            all_images = [(t, 1.0 + k + 0.01 * i) for k in range(4) for i, t in enumerate("abc")]
            order = generator.permutation(len(all_images))
            made = images.ImageBuffer("abc", slop_s=0.05)
            made.BACK_NS = 10 ** 12
            for k in order:
                topic, seconds = all_images[k]
                made.add(topic, SimpleNamespace(header=SimpleNamespace(stamp=stamp_of(seconds)), name=(topic, seconds)))
            self.assertEqual(self.names(made.of_one_moment()), [("a", 4.0), ("b", 4.01), ("c", 4.02)])

    def test_a_clock_that_was_set_back_begins_anew(self):
        made = self.buffer([("a", 100.0), ("b", 100.0), ("a", 3.0), ("b", 3.0), ("c", 3.0)], slop_s=0.05)
        self.assertEqual(self.names(made.of_one_moment()), [("a", 3.0), ("b", 3.0), ("c", 3.0)])

    def test_without_a_slop_the_newest_of_each(self):
        made = self.buffer([("a", 1.0), ("a", 9.0), ("b", 2.0)])
        self.assertEqual(self.names(made.of_one_moment()), [("a", 9.0), ("b", 2.0)])
        self.assertEqual(self.names(self.buffer([("a", 1.0), ("b", 8.0)], max_age_s=2.0).of_one_moment(int(9e9))), [("b", 8.0)])
        with self.assertRaises(ValueError):
            images.ImageBuffer("a", slop_s=-1.0)


class Collisions(unittest.TestCase):

    MESH = (np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype=float), np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))

    def test_a_mesh_in_the_answers_frame_a_box_of_large_ones_and_what_is_gone_goes(self):
        scene = a_scene(True)
        frame = conversions.AnswerFrame(scene, "base_link", ["optical"])
        told, gone = conversions.collision_messages(scene, frame, 5, {"bracket": self.MESH}, {"bracket_1", "bolt_0"}, MESSAGES)
        self.assertEqual((told.id, told.operation, told.type.key, told.header.frame_id, told.header.stamp),
                         ("bracket_1", b"\x00", "bracket", "base_link", 5))
        np.testing.assert_allclose(matrix(told.pose), frame.pose(scene.objects[0])[0], atol=1e-12)
        self.assertEqual([t.vertex_indices for t in told.meshes[0].triangles], self.MESH[1].tolist())
        np.testing.assert_array_equal([[v.x, v.y, v.z] for v in told.meshes[0].vertices], self.MESH[0])
        self.assertEqual(len(told.mesh_poses), 1)
        self.assertEqual((gone.id, gone.operation, gone.meshes), ("bolt_0", b"\x01", []))
        told, = conversions.collision_messages(scene, frame, 5, {"bracket": self.MESH}, (), MESSAGES, most_triangles=3)
        self.assertEqual((told.meshes, told.primitives[0].type, told.primitives[0].dimensions), ([], 1, [1.0, 2.0, 3.0]))
        np.testing.assert_allclose(matrix(told.primitive_poses[0])[:3, 3], [0.5, 1.0, 1.5])


class TheNode(unittest.TestCase):

    TOPICS = ["/left/image_raw", "/right/image_raw"]

    def setUp(self):
        self.node_module = node_module()
        FakeNode.OVERRIDES = {"image_topics": self.TOPICS, "station": "cell", "station_cameras": ["l", "r"],
                              "expected": ["bracket=2"], "camera_position_sigma": 0.001}
        self.node = self.node_module.Recognizer()
        self.node._base_from_camera = lambda frame, stamp: pose((1, 0, 0), np.pi, (0, 0, 0.5))
        self.asked = []
        self.request = SimpleNamespace(candidates=[], deadline=0.0, expected=[], image_regions=[], space_regions=[])
        answer = horopter.types.recognition_pb2.RecognizeSceneResponse(request_id="17")
        answer.expected.outcomes.add(state=1, present_probability=0.9)
        answer.expected.outcomes.add(state=2, missing_probability=0.9)
        self.scene = horopter.Scene.from_proto(answer)
        self.scene.cameras.append(SimpleNamespace(recovered=True, camera_from_scene=np.eye(4)))

    def keep(self, topic, seconds=0.0, value=0):
        self.node._keep_image(topic, SimpleNamespace(
            encoding="mono8", width=4, height=2, step=4, is_bigendian=0, data=bytes([value] * 8),
            header=SimpleNamespace(frame_id="optical", stamp=stamp_of(seconds))))

    def restart(self, **overrides):
        FakeNode.OVERRIDES = {"image_topics": self.TOPICS, "expected": ["bracket=2"], **overrides}
        self.node = self.node_module.Recognizer()
        self.node._base_from_camera = lambda frame, stamp: pose((1, 0, 0), np.pi, (0, 0, 0.5))
        self.node._client = SimpleNamespace(recognize=lambda **arguments: self.asked.append(arguments) or self.scene)

    def ask(self):
        return self.node._recognize(self.request, Message("RecognizeResponse"))

    def test_images_are_of_one_moment_and_a_camera_with_a_gap_is_left_out(self):
        self.restart(sync_slop=0.05)
        for k in range(10):
            self.keep(self.TOPICS[0], 0.1 * k, k)
            if k != 9:
                self.keep(self.TOPICS[1], 0.1 * k + 0.03, 100 + k)
        self.ask()
        self.assertEqual([int(i[0, 0]) for i in self.asked[-1]["images"]], [8, 108])  # not 9 with 108
        self.keep(self.TOPICS[0], 5.0, 50)
        self.keep(self.TOPICS[0], 5.1, 51)
        self.ask()
        self.assertEqual(len(self.asked[-1]["images"]), 2)
        self.restart(sync_slop=0.05, max_image_age=1.0)
        FakeNode.NOW_NS = int(5.2e9)
        self.keep(self.TOPICS[0], 5.0, 50)
        self.keep(self.TOPICS[1], 3.0, 30)
        self.ask()
        self.assertEqual([int(i[0, 0]) for i in self.asked[-1]["images"]], [50])
        FakeNode.NOW_NS = int(60e9)
        self.assertIn("no image", self.ask().message)
        self.restart(sync_slop=0.05, all_images=True)
        self.keep(self.TOPICS[0], 5.0)
        told = self.ask()
        self.assertEqual(told.reasons, ["ERROR"])
        self.assertIn(self.TOPICS[1], told.message)

    def test_an_arm_takes_several_images_with_their_poses(self):
        self.restart(arm_topics=[self.TOPICS[1]], station="cell", station_cameras=["fixed", "arm"], camera_position_sigma=0.002)
        poses = {1: pose((1, 0, 0), 3.0, (0, 0, 1)), 2: pose((0, 1, 0), 2.0, (0, 1, 1))}
        self.node._base_from_camera = lambda frame, stamp: poses.get(stamp.sec)
        self.keep(self.TOPICS[0], 1.0, 10)
        take = lambda: self.node._take(None, SimpleNamespace(success=None, message=""))
        self.assertFalse(take().success)  # none has come in
        for second in (1, 2):
            self.keep(self.TOPICS[1], float(second), second)
            self.assertTrue(take().success)
        self.assertIn("no image has come in since", take().message)
        self.keep(self.TOPICS[1], 7.0, 7)
        self.assertIn("TF has no pose", take().message)
        self.assertEqual(self.ask().request_id, "17")
        asked = self.asked[-1]
        self.assertEqual([int(i[0, 0]) for i in asked["images"]], [10, 1, 2])
        self.assertEqual(asked["station_cameras"], ["fixed", "arm", "arm"])
        for hint, expected in zip(asked["hints"][1:], poses.values()):
            np.testing.assert_array_equal(hint.base_from_camera, expected)
            self.assertEqual(hint.position_sigma_m, 0.002)
        self.assertEqual(self.node._collection.views(), [])  # used
        self.keep(self.TOPICS[1], 2.0, 2)
        self.node._base_from_camera = lambda frame, stamp: poses[2]
        self.assertTrue(take().success)
        self.node._forget(None, SimpleNamespace())
        self.assertEqual(self.node._collection.views(), [])
        with self.assertRaises(ValueError):
            self.restart(arm_topics=["/elsewhere"])

    def test_a_pose_topic_gives_pose_and_deviations(self):
        self.restart(pose_topics=["/left/pose", ""], camera_rotation_sigma=0.5)
        told = Message("PoseWithCovarianceStamped")
        told.header.frame_id = "base_link"
        told.pose.pose = conversions.pose_message(pose((0, 0, 1), 0.3, (1, 2, 3)), MESSAGES)
        told.pose.covariance = list(np.diag([1e-6, 4e-6, 1e-6, 1e-8, 1e-8, 9e-8]).reshape(-1))
        self.node._keep(self.node._camera_poses, self.TOPICS[0], told)
        for topic in self.TOPICS:
            self.keep(topic)
        self.ask()
        left, right = self.asked[-1]["hints"]
        np.testing.assert_allclose(left.base_from_camera, pose((0, 0, 1), 0.3, (1, 2, 3)), atol=1e-12)
        self.assertAlmostEqual(left.position_sigma_m, 2e-3)
        self.assertAlmostEqual(left.rotation_sigma_rad, 3e-4)
        self.assertEqual((right.position_sigma_m, right.rotation_sigma_rad), (None, 0.5))
        told.header.frame_id = "elsewhere"
        self.assertIn("elsewhere", self.ask().message)
        told.header.frame_id, told.pose.covariance = "base_link", [float("nan")] * 36
        self.assertEqual(self.ask().reasons, ["ERROR"])
        with self.assertRaises(ValueError):
            self.restart(pose_topics=["/one"])

    def test_parts_go_into_the_planning_scene_and_out_of_it(self):
        self.restart(collision_objects=True)
        self.keep(self.TOPICS[0])
        mesh = SimpleNamespace(vertices_m=[0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 3], triangles=[0, 1, 2, 0, 1, 3, 0, 2, 3, 1, 2, 3])
        self.node._client.get_object = lambda _: SimpleNamespace(raw=SimpleNamespace(mesh=mesh))
        empty, self.scene = self.scene, a_scene(True)
        self.scene.expected = None
        told = self.ask()
        self.assertEqual([(m.id, m.operation) for m in told.collision_objects], [("bracket_1", b"\x00")])
        self.assertEqual([t for t, _ in self.node.published].count("/collision_object"), 1)
        self.scene = empty
        told = self.ask()
        self.assertEqual([(m.id, m.operation) for m in told.collision_objects], [("bracket_1", b"\x01")])
        self.assertEqual(self.ask().collision_objects, [])

    def test_a_service_call_asks_as_the_parameters_say(self):
        def recognize(**arguments):
            self.asked.append(arguments)
            return self.scene
        self.node._client = SimpleNamespace(recognize=recognize)
        told = self.node._recognize(self.request, Message("RecognizeResponse"))
        self.assertEqual(told.reasons, ["ERROR"])
        self.assertEqual(self.asked, [])
        self.keep(self.TOPICS[1])
        self.assertEqual(self.node.published, [])
        told = self.node._recognize(self.request, Message("RecognizeResponse"))
        self.assertEqual((told.request_id, told.all_present, [e.state for e in told.expected]),
                         ("17", False, ["PRESENT", "MISSING"]))
        asked = self.asked[0]
        self.assertEqual((asked["station"], asked["station_cameras"], len(asked["images"])), ("cell", ["r"], 1))
        self.assertEqual((asked["hints"][0].position_sigma_m, asked["hints"][0].rotation_sigma_rad), (0.001, None))
        self.assertEqual([(e.object_id, e.count) for e in asked["expected"]], [("bracket", 2)])

    def test_an_action_ends_with_its_call_and_can_be_cancelled(self):
        test = self

        class Client:
            seconds = 0.0

            def __init__(self, *_, **__):
                pass

            async def __aenter__(self):
                return self

            async def __aexit__(self, *_):
                pass

            async def recognize(self, **arguments):
                test.asked.append(arguments)
                await asyncio.sleep(self.seconds)
                return test.scene

        self.node_module.AsyncClient = Client
        self.keep(self.TOPICS[0])
        said = []
        goal = SimpleNamespace(request=self.request, is_cancel_requested=True, publish_feedback=lambda f: said.append(f.elapsed),
                               canceled=lambda: said.append("cancelled"), succeed=lambda: said.append("done"),
                               abort=lambda: said.append("aborted"))
        self.assertEqual(self.node._execute(goal).request_id, "17")
        self.assertEqual(said, ["done"])
        Client.seconds = 1e6
        self.assertEqual(self.node._execute(goal).message, "cancelled")
        self.assertEqual(said[-1], "cancelled")
        self.request.expected = ["nonsense=x"]
        self.assertEqual(self.node._execute(goal).reasons, ["ERROR"])
        self.assertEqual(said[-1], "aborted")


class Packages(unittest.TestCase):

    @staticmethod
    def fields_of(path):
        """Names of the fields of a .msg file: neither constants nor comments."""
        out = set()
        with open(path, encoding="utf-8") as file:
            for line in file:
                words = line.split("#")[0].split()
                if len(words) >= 2 and "=" not in words[1] and not (len(words) > 2 and words[2].startswith("=")):
                    out.add(words[1])
        return out

    def test_stand_ins_have_the_fields_of_the_definitions(self):
        roots = [os.path.join(p, "share") for p in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if p]
        checked = 0
        for kind, package in PACKAGE_OF.items():
            for root in roots:
                path = os.path.join(root, package, "msg", kind + ".msg")
                if os.path.exists(path):
                    self.assertEqual(self.fields_of(path), set(FIELDS[kind]), path)
                    checked += 1
        if not checked:
            self.skipTest("no definitions of ROS here (AMENT_PREFIX_PATH)")
        self.assertEqual(checked, len(PACKAGE_OF))

    def test_every_message_that_is_used_belongs_to_a_package_of_the_manifest(self):
        manifest = ElementTree.parse(os.path.join(ROS, "horopter_ros", "package.xml")).getroot()
        depends = {d.text for d in manifest.findall("exec_depend")}
        with open(os.path.join(ROS, "horopter_ros", "horopter_ros", "node.py"), encoding="utf-8") as file:
            imported = set(re.findall(r"^from (\w+)\.(?:msg|srv|action) import", file.read(), re.M))
        self.assertGreater(len(imported), 5)
        self.assertLessEqual(imported, depends)

    def test_definitions_and_manifests_name_what_they_use(self):
        for package in ("horopter_msgs", "horopter_ros"):
            manifest = ElementTree.parse(os.path.join(ROS, package, "package.xml")).getroot()
            self.assertEqual(manifest.find("name").text, package)
        with open(os.path.join(ROS, "horopter_msgs", "CMakeLists.txt"), encoding="utf-8") as file:
            lists = file.read()
        for kind in ("msg", "srv", "action"):
            for name in os.listdir(os.path.join(ROS, "horopter_msgs", kind)):
                self.assertIn('"%s/%s"' % (kind, name), lists)
        def fields(*path):
            with open(os.path.join(ROS, "horopter_msgs", *path), encoding="utf-8") as file:
                parts = file.read().split("---\n")
            return [{line.split()[1] for line in part.splitlines() if line.strip() and not line.startswith("#")} for part in parts]
        self.assertEqual(fields("msg", "PartGrasp.msg"), [set(FIELDS["PartGrasp"])])
        self.assertEqual(fields("msg", "ExpectedOutcome.msg"), [set(FIELDS["ExpectedOutcome"])])
        asked, told = fields("srv", "Recognize.srv")
        self.assertEqual(told, set(FIELDS["RecognizeResponse"]))
        self.assertEqual(fields("action", "Recognize.action"), [asked, told, {"elapsed"}])
        node = os.path.join(ROS, "horopter_ros", "horopter_ros", "node.py")
        with open(node, encoding="utf-8") as file:
            compile(file.read(), node, "exec")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
