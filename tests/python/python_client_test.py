#!/usr/bin/env python3
"""The Python package against a server whose recognition is a stand-in.

    python_client_test.py PACKAGE_FOLDER HOROPTER MOCK_HOROPTERD DATASET
"""
import asyncio
import doctest
import importlib
import os
import pathlib
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import traceback
import unittest
import xml.etree.ElementTree as ElementTree

PACKAGE, HOROPTER, MOCK, DATASET = map(os.path.abspath, sys.argv[1:5])
sys.path.insert(0, PACKAGE)
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))

import grpc  # noqa: E402
import numpy as np  # noqa: E402

import horopter  # noqa: E402
from mock_server import Mock  # noqa: E402
from horopter import types  # noqa: E402

IMAGES = [os.path.join(DATASET, "val", "000005", "rgb", "%06d.png" % i) for i in range(2)]


def random_pose(generator):
    q = generator.normal(size=4)
    q /= np.linalg.norm(q)
    pose = types.matrix_from_proto(types.types_pb2.RigidTransform(
        rotation=types.types_pb2.Quaternion(w=q[0], x=q[1], y=q[2], z=q[3])))
    pose[:3, 3] = generator.normal(size=3)
    return pose


class Values(unittest.TestCase):

    def test_a_pose_comes_back_from_the_wire(self):
        generator = np.random.default_rng(1)
        for k in range(300):
            pose = random_pose(generator)
            if k < 3:  # half turns, where w is 0
                pose[:3, :3] = -np.eye(3)
                pose[k, k] = 1.0
            np.testing.assert_allclose(types.matrix_from_proto(types.matrix_to_proto(pose)), pose, atol=1e-12)

    def test_what_is_no_pose_is_refused(self):
        for bad in (np.eye(3), np.diag([1.0, 1, -1, 1]), 2 * np.eye(4), np.full((4, 4), np.nan)):
            with self.assertRaises(ValueError):
                types.matrix_to_proto(bad)

    def test_row_vectors_are_said(self):
        rows = np.eye(4)
        rows[3, :3] = 0.4, 0.1, 0.0
        for make in (lambda m: horopter.CameraHint(base_from_camera=m).to_proto(),
                     lambda m: horopter.GraspModel("g", m).to_proto(),
                     lambda m: horopter.GraspModel("g", np.eye(4), object_from_pregrasp=m).to_proto(),
                     types.matrix_to_proto):
            with self.assertRaisesRegex(ValueError, "row vectors"):
                make(rows)
            almost = np.eye(4)
            almost[3, 3] = 1.0 + 2e-6
            sheared = np.eye(4)
            sheared[0, 1] = 2e-3
            for bad in (almost, sheared, np.zeros((4, 4)), np.diag([1.0, 1, -1, 1])):
                with self.assertRaises(ValueError):
                    make(bad)
            make(np.eye(4) + 1e-7)

    def test_a_camera_info_is_a_hint(self):
        message = {"width": 1280, "height": 960, "k": [979.75, 0, 633.64, 0, 979.75, 477.58, 0, 0, 1], "d": [0.0] * 5,
                   "distortion_model": "plumb_bob", "binning_x": 1, "binning_y": 1,
                   "roi": {"x_offset": 320, "y_offset": 240, "height": 480, "width": 640}}
        hint = horopter.hint_from_camera_info(message, (640, 480))
        self.assertEqual(hint.focal_px, 979.75)
        np.testing.assert_allclose(hint.principal_point_px, (313.64, 237.58))
        # As camera_calibration and OpenCV name them.
        file = {"image_width": 640, "image_height": 480, "distortion_model": "none",
                "camera_matrix": {"data": [[979.75, 0, 313.64], [0, 979.75, 237.58], [0, 0, 1]]},
                "distortion_coefficients": {"data": [[0.0] * 5]}}
        self.assertEqual(horopter.hint_from_camera_info(file, (640, 480)).principal_point_px, (313.64, 237.58))
        with self.assertWarnsRegex(UserWarning, "scaled by 0.5"):
            self.assertEqual(horopter.hint_from_camera_info(file, (320, 240)).focal_px, 979.75 / 2)
        with self.assertRaisesRegex(ValueError, "transposed"):
            horopter.hint_from_camera_info({"K": np.array([[980, 0, 320], [0, 980, 240], [0, 0, 1.0]]).T})
        self.assertIsNone(horopter.hint_from_camera_info({"k": [0.0] * 9}))
        self.assertTrue(horopter.hint_from_camera_info(dict(file, distortion_model="equidistant"), (640, 480)).fisheye)
        for lens in ({"k1": -0.3}, "0.1 0.2", b"0.1", {"data": "0.1"}):
            with self.assertRaisesRegex(ValueError, "no list of numbers"):
                horopter.hint_from_camera_info(dict(file, distortion_coefficients=lens), (640, 480))
        array = dict(file, distortion_coefficients=np.array([[-0.1], [0.0], [0.0], [0.0]]))
        self.assertEqual(horopter.hint_from_camera_info(array, (640, 480)).k1, -0.1)

    def test_what_stands_around_a_token_is_dropped_and_no_error_shows_it(self):
        for text in ("secret", "secret\r\n", "\ufeff secret\n", "\tsecret\x0b", b"secret\r\n"):
            self.assertEqual(horopter.Security(token=text).metadata(), (("authorization", "Bearer secret"),))
        self.assertEqual(horopter.Security(token=" \n").metadata(), ())
        self.assertNotIn("secret", repr(horopter.Security(token="secret")))
        for text, column in (("sec\nret", 4), ("secret\x00", 7), ("s\u00e9cret", 2), ("sec\tret", 4)):
            with self.assertRaisesRegex(ValueError, "column %d" % column) as caught:
                horopter.Security(token=text)
            for shown in ("sec", "ret"):
                self.assertNotIn(shown, "".join(traceback.format_exception(caught.exception)).split("ValueError:")[-1])
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "token")
            for content, token in ((b"secret\r\n", "secret"), (b"\xef\xbb\xbfsecret", "secret"), (b"\n first\nsecond\xff", "first")):
                with open(path, "wb") as file:
                    file.write(content)
                self.assertEqual(horopter.Security(token_file=path).token, token)
            for content in (b"", b" \n", b"\xff\xfes\0e\0", b"sec\0ret"):
                with open(path, "wb") as file:
                    file.write(content)
                with self.assertRaisesRegex(ValueError, re.escape(path)):
                    horopter.Security(token_file=path)

    def test_an_array_becomes_a_png_of_the_same_pixels(self):
        generator = np.random.default_rng(2)
        for shape, dtype in (((16, 21), np.uint8), ((17, 16, 3), np.uint8), ((16, 16), np.uint16)):
            image = generator.integers(0, np.iinfo(dtype).max, size=shape, dtype=dtype)
            self.assertTrue(np.array_equal(decode_png(horopter.encode_image(image)), image))
            view = image[::-1, ::2]  # not contiguous
            self.assertTrue(np.array_equal(decode_png(horopter.encode_image(view)), view))
        for bad in (np.zeros((4, 4)), np.zeros((4, 4, 4), np.uint8), np.zeros((0, 4), np.uint8)):
            with self.assertRaises(ValueError):
                horopter.encode_image(bad)
        with self.assertRaises(TypeError):
            horopter.encode_image(7)

    def test_arrays_of_either_byte_order_are_the_same_image(self):
        image = np.random.default_rng(3).integers(0, 65535, (16, 20), np.uint16)
        for order in "<>=":
            turned = image.astype(image.dtype.newbyteorder(order))
            self.assertTrue(np.array_equal(decode_png(horopter.encode_image(turned)), image))
        for bad in (np.uint32, np.int16, np.float32, bool):
            with self.assertRaises(ValueError):
                horopter.encode_image(np.zeros((4, 4), bad))
        for buffer in (b"x", bytearray(b"x"), memoryview(b"x")):
            self.assertEqual(horopter.encode_image(buffer), b"x")

    def test_one_image_is_no_list_of_images(self):
        from horopter import _requests
        frame = horopter.RawFrame("GRAY8", 4, 4, bytes(16))
        for bare in (np.zeros((16, 16), np.uint8), np.zeros((16, 16, 3), np.uint8), "a.png", b"x", bytearray(b"x"),
                     memoryview(b"x"), pathlib.Path("a.png"), frame):
            with self.assertRaisesRegex(TypeError, "list"):
                _requests.recognize_request(bare, None, None, None)
        stack = _requests.recognize_request(np.zeros((2, 16, 16, 3), np.uint8), None, None, None)
        self.assertEqual(len(stack.images), 2)
        with self.assertRaisesRegex(TypeError, "candidates"):
            _requests.recognize_request(IMAGES, None, "bracket", None)
        with self.assertRaisesRegex(TypeError, "station_cameras"):
            _requests.recognize_request(IMAGES, None, None, None, station="s", station_cameras="left")

    def test_raw_frames_go_as_they_are(self):
        from horopter import _requests
        deep = np.arange(16, dtype=">u2").reshape(4, 4)
        request = _requests.recognize_request([horopter.RawFrame("BAYER_GB16", 4, 4, deep, bits_in_use=12)], None, None, None,
                                              cropped=True)
        raw = request.images[0].raw
        self.assertEqual((raw.width_px, raw.bits_in_use, raw.data, request.images[0].cropped),
                         (4, 12, deep.astype("<u2").tobytes(), True))
        for bad in ("GRAY12", "UNSPECIFIED", ""):
            with self.assertRaisesRegex(ValueError, "BAYER_RG16"):
                horopter.RawFrame(bad, 4, 4, b"").to_proto()

    def test_an_address_is_host_and_port(self):
        from horopter.address import check_address
        for good in ("localhost:50051", "10.0.0.7:1", "[::1]:50051", "unix:/run/h.sock", "unix:///run/h.sock", "dns:///host:50051",
                     "ipv4:127.0.0.1:50051"):
            check_address(good)
        for bad, says in (("http://localhost:50051", "'localhost:50051'"), ("https://cell:50051/", "TLS"),
                          ("grpc://cell:50051", "URL"), ("localhost", "HOST:PORT"), ("localhost:", "PORT"), ("", "PORT"),
                          ("localhost:http", "PORT"), ("localhost:50051/", "PORT"), ("::1:50051", "PORT"), (":50051", "PORT"),
                          ("host:70000", "PORT")):
            with self.assertRaisesRegex(ValueError, says):
                horopter.Client(bad)

    def test_no_proxy_stands_before_this_machine_nor_before_what_no_proxy_names(self):
        from horopter.address import may_use_proxy
        for here in ("localhost:1", "LOCALHOST:1", "127.0.0.1:1", "127.8.9.10:1", "[::1]:1", "[::ffff:127.0.0.1]:1", "unix:/x",
                     "0.0.0.0:1", "dns:///localhost:1", "ipv4:127.0.0.1:1", socket.gethostname() + ":1"):
            self.assertFalse(may_use_proxy(here, {}), here)
        self.assertTrue(may_use_proxy("robot.example:50051", {"no_proxy": "other.example"}))
        for name in ("no_proxy", "NO_PROXY", "no_grpc_proxy"):
            for entries in ("*", "example", ".example", "a, robot.example ", "robot.example:50051", "*.example", "ROBOT.Example"):
                self.assertFalse(may_use_proxy("robot.example:50051", {name: entries}), entries)
            for entries in ("", "ample", "robot.example:1", "bot.example", "10.0.0.0/8", ","):
                self.assertTrue(may_use_proxy("robot.example:50051", {name: entries}), entries)
            for entries in ("203.0.113.0/24", "203.0.113.7", "203.0.113.7:50051"):
                self.assertFalse(may_use_proxy("203.0.113.7:50051", {name: entries}), entries)
            self.assertTrue(may_use_proxy("203.0.113.7:50051", {name: "203.0.114.0/24,3.7"}))
        self.assertIn("--no-proxy", horopter.Security(proxy=False).arguments())

    def test_projection_is_the_camera_matrix_with_distortion(self):
        camera = horopter.Camera(True, 640, 480, 600.0, (320.0, 240.0), 0.1, 0.01, np.eye(4))
        pixel = camera.project(np.array([[0.1, 0.2, 0.5], [0.0, 0.0, -1.0]]))
        r2 = 0.2 ** 2 + 0.4 ** 2
        np.testing.assert_allclose(pixel[0], [320 + 600 * 0.2 * (1 + 0.1 * r2), 240 + 600 * 0.4 * (1 + 0.1 * r2)])
        self.assertTrue(np.isnan(pixel[1]).all())
        self.assertEqual(camera.K[0, 2], 320.0)
        camera.k2, camera.p1, camera.p2 = 0.05, 0.002, -0.001
        radial = 1 + 0.1 * r2 + 0.05 * r2 * r2
        np.testing.assert_allclose(
            camera.project(np.array([[0.1, 0.2, 0.5]]))[0],
            [320 + 600 * (0.2 * radial + 2 * 0.002 * 0.08 - 0.001 * (r2 + 0.08)),
             240 + 600 * (0.4 * radial + 0.002 * (r2 + 0.32) - 2 * 0.001 * 0.08)])

    def test_a_request_of_a_station_names_its_cameras(self):
        from horopter import _requests
        request = _requests.recognize_request(IMAGES, None, None, None, station="cell")
        self.assertEqual((request.station, [i.camera_id for i in request.images]), ("stations/cell", ["camera1", "camera2"]))
        request = _requests.recognize_request(IMAGES, None, None, None, station="cell", station_cameras=["left", "right"])
        self.assertEqual([i.camera_id for i in request.images], ["left", "right"])
        for wrong in (dict(station="cell", station_cameras=["left"]), dict(station_cameras=["left", "right"])):
            with self.assertRaises(ValueError):
                _requests.recognize_request(IMAGES, None, None, None, **wrong)
        answer = types.recognition_pb2.RecognizeSceneResponse()
        finding = answer.station.findings.add(cameras=["stations/cell/cameras/left"], rotation_rad=0.01)
        finding.kind = 1
        answer.station.station = "stations/cell"
        scene = horopter.Scene.from_proto(answer)
        self.assertEqual((scene.station.station, scene.station.findings[0].kind, scene.station.findings[0].cameras),
                         ("cell", "CAMERA_MOVED", ["left"]))

    def test_a_request_says_what_it_expects_and_all_references(self):
        from horopter import _requests
        pose = random_pose(np.random.default_rng(5))
        request = _requests.recognize_request(
            IMAGES, None, None, horopter.Reference("fixture", pose, position_sigma_m=0.001), station="cell", read_only=True,
            further_references=[horopter.Reference("post", np.eye(4), rotation_sigma_rad=0.01)],
            expected=[horopter.ExpectedPart("bolt", 3), horopter.ExpectedPart(
                "nut", frame_from_object=pose, frame_object="tray", position_tolerance_m=0.01, label="pocket 4")])
        self.assertTrue(request.station_read_only)
        self.assertEqual(request.reference.position_sigma_m, 0.001)
        self.assertFalse(request.reference.HasField("rotation_sigma_rad"))
        self.assertEqual([(r.object, r.rotation_sigma_rad) for r in request.further_references], [("objects/post", 0.01)])
        bolts, nut = request.expected_parts
        self.assertEqual((bolts.object, bolts.count, bolts.HasField("frame_from_object")), ("objects/bolt", 3, False))
        self.assertEqual((nut.frame_object, nut.position_tolerance_m, nut.label), ("objects/tray", 0.01, "pocket 4"))
        self.assertFalse(nut.HasField("rotation_tolerance_rad"))
        with self.assertRaises(ValueError):
            _requests.recognize_request(IMAGES, None, None, None, read_only=True)

    def test_a_request_says_where_parts_are_looked_for_and_an_answer_where_they_were(self):
        from horopter import _requests
        box = horopter.ImageRegion(10.0, 20.5, 30.0, 40.0)
        pose = random_pose(np.random.default_rng(6))
        request = _requests.recognize_request(IMAGES, None, None, None, regions=[[box]] + [None] * (len(IMAGES) - 1),
                                              space_regions=[horopter.SpaceRegion(pose, (0.6, 0.4, 0.1))])
        self.assertEqual([len(i.regions) for i in request.images], [1] + [0] * (len(IMAGES) - 1))
        self.assertEqual(request.images[0].regions[0].y_px, 20.5)
        self.assertEqual(request.regions[0].size_m.y, 0.4)
        np.testing.assert_allclose(types.matrix_from_proto(request.regions[0].base_from_region), pose, atol=1e-12)
        with self.assertRaises(ValueError):
            _requests.recognize_request(IMAGES, None, None, None, regions=[])
        answer = types.recognition_pb2.RecognizeSceneResponse()
        answer.cameras.add().regions.add().CopyFrom(box.to_proto())
        answer.cameras.add(region_empty=True)
        answer.cameras.add()
        self.assertEqual([c.regions for c in horopter.Scene.from_proto(answer).cameras], [[box], [], None])

    def test_an_answer_tells_alternatives_and_what_was_expected(self):
        pb = types.recognition_pb2
        message = pb.RecognizeSceneResponse()
        message.reasons.add(kind=pb.SceneReason.KIND_REFERENCE_AMBIGUOUS)
        message.base_alternatives.add(object="objects/block", instance=1, symmetry_index=2).base_from_scene.rotation.w = 1.0
        message.findings.add(object="objects/block").reference_symmetric.equivalent_poses = 4
        outcome = message.expected.outcomes.add(expected_index=1, label="pocket 4", state=3, displaced_probability=0.7,
                                                present_probability=0.1, cannot_tell_probability=0.2, object="objects/nut",
                                                distance_m=0.03)
        message.expected.outcomes.add(state=99)
        message.expected.unexpected.add(object="objects/bolt", instance=2)
        message.station.findings.add(kind=77)
        scene = horopter.Scene.from_proto(message)
        self.assertTrue(scene.has_reason("REFERENCE_AMBIGUOUS"))
        base = scene.base_alternatives[0]
        self.assertEqual((base.object_id, base.instance, base.symmetry_index), ("block", 1, 2))
        self.assertEqual(scene.findings[0].values, {"equivalent_poses": 4})
        told = scene.expected.outcomes[0]
        self.assertEqual((told.state, told.object_id, told.distance_m, told.rotation_rad), ("DISPLACED", "nut", outcome.distance_m, None))
        self.assertAlmostEqual(sum(told.probabilities.values()), 1.0)
        self.assertEqual(scene.expected.outcomes[1].state, "UNKNOWN")
        self.assertEqual(scene.expected.unexpected, [("bolt", 2)])
        self.assertFalse(scene.expected.all_present)
        self.assertEqual(scene.station.findings[0].kind, "UNKNOWN")

    def test_the_environment_says_who_calls(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "token")
            with open(path, "w", encoding="utf-8") as out:
                out.write("of the file\n")
            kept = dict(os.environ)
            try:
                for name in [n for n in os.environ if n.startswith("HOROPTER_")]:
                    del os.environ[name]
                self.assertEqual(horopter.Security.from_environment(), horopter.Security())
                os.environ.update(HOROPTER_TOKEN="of the environment", HOROPTER_TLS_CA="ca.pem")
                self.assertEqual(horopter.Security.from_environment(),
                                 horopter.Security(ca_file="ca.pem", token="of the environment"))
                os.environ["HOROPTER_TOKEN_FILE"] = path
                self.assertEqual(horopter.Security.from_environment().token, "of the file")
                for name in ("HOROPTER_TOKEN", "HOROPTER_TLS_CA", "HOROPTER_TOKEN_FILE"):
                    del os.environ[name]
                os.environ["HOROPTER_SERVER"] = "localhost:7"
                with horopter.Client() as client:
                    self.assertEqual(client.address, "localhost:7")
                with horopter.Client("localhost:8") as client:
                    self.assertEqual(client.address, "localhost:8")
            finally:
                os.environ.clear()
                os.environ.update(kept)

    def test_both_clients_have_the_same_calls(self):
        def calls(of):
            return {n for n in dir(of) if not n.startswith("_")}
        self.assertEqual(calls(horopter.Client) - calls(horopter.AsyncClient), {"enroll_file"})
        self.assertEqual(calls(horopter.AsyncClient) - calls(horopter.Client), set())

    def test_messages_have_stubs(self):
        folder = os.path.join(PACKAGE, "horopter", "v1")
        for name in ("catalog", "recognition", "station", "types", "server"):
            with open(os.path.join(folder, name + "_pb2.pyi"), encoding="utf-8") as file:
                compile(file.read(), name, "exec")

    def test_the_docstrings_are_right(self):
        for name in ("horopter", "horopter.address", "horopter.client", "horopter.aio", "horopter.types", "horopter.images"):
            self.assertEqual(doctest.testmod(importlib.import_module(name)).failed, 0)


def decode_png(data):
    """Pixels of a PNG whose rows are not filtered."""
    import struct
    import zlib
    width, height, bits, kind = struct.unpack(">IIBB", data[16:26])
    at, idat = 8, b""
    while at < len(data):
        length, name = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + length]
        assert struct.unpack(">I", data[at + 8 + length:at + 12 + length])[0] == zlib.crc32(name + body)
        idat += body if name == b"IDAT" else b""
        at += 12 + length
    channels = 3 if kind == 2 else 1
    rows = np.frombuffer(zlib.decompress(idat), np.uint8).reshape(height, -1)
    assert not rows[:, 0].any()
    pixels = np.ascontiguousarray(rows[:, 1:]).view(">u2" if bits == 16 else np.uint8).reshape(height, width, channels)
    return pixels[:, :, 0] if channels == 1 else pixels


class WithServer(unittest.TestCase):

    ARGUMENTS = ()

    def setUp(self):
        self.mock = Mock(MOCK, *self.ARGUMENTS)
        self.client = horopter.Client(self.mock.address)

    def tearDown(self):
        self.client.close()
        self.mock.stop()

    def enrol(self):
        return self.client.enroll_file(os.path.join(DATASET, "cad", "obj_000001.step"), "bracket",
                                       grasps=os.path.join(DATASET, "grasps", "obj_000001.json"), program=HOROPTER)


class BehindAProxy(WithServer):
    """Of a proxy that does not answer."""

    def test_this_machine_is_reached_all_the_same(self):
        script = "import horopter, sys; print(len(horopter.Client(sys.argv[1], deadline_s=20).list_objects()))"
        silent = socket.create_server(("127.0.0.1", 0))
        proxy = "http://127.0.0.1:%d" % silent.getsockname()[1]
        environment = dict(os.environ, PYTHONPATH=PACKAGE, http_proxy=proxy, https_proxy=proxy, grpc_proxy=proxy)
        for name in ("no_proxy", "NO_PROXY"):
            environment.pop(name, None)
        with silent:
            done = subprocess.run([sys.executable, "-B", "-c", script, self.mock.address], capture_output=True, text=True,
                                  env=environment, check=False)
            self.assertEqual(done.stdout.strip(), "0", done.stderr)
            done = subprocess.run([HOROPTER, "--server", self.mock.address, "--timeout", "20", "object", "list"],
                                  capture_output=True, text=True, env=environment, check=False)
            self.assertEqual(done.returncode, 0, done.stderr)


class KeptAlive(WithServer):
    """A client that pings as often as gRPC can."""

    ARGUMENTS = ("--delay-ms", "2500", "--workers", "1")
    OPTIONS = (("grpc.keepalive_time_ms", 1000), ("grpc.keepalive_timeout_ms", 20000), ("grpc.http2.max_pings_without_data", 0),
               ("grpc.keepalive_permit_without_calls", 1))

    def test_pings_end_no_call_and_no_connection(self):
        from horopter import _requests
        from horopter.v1 import catalog_pb2, catalog_pb2_grpc, recognition_pb2_grpc
        with grpc.insecure_channel(self.mock.address, options=self.OPTIONS) as channel:
            recognition = recognition_pb2_grpc.RecognitionServiceStub(channel)
            request = _requests.recognize_request(IMAGES[:1], None, None, None)
            # One at work, one in the queue.
            for call in [recognition.RecognizeScene.future(request, timeout=60) for _ in range(2)]:
                call.result()
            backup = catalog_pb2_grpc.CatalogServiceStub(channel).BackupCatalog(catalog_pb2.BackupCatalogRequest(), timeout=60)
            self.assertGreater(sum(len(piece.chunk) for piece in backup), 0)
            states = []
            channel.subscribe(states.append)
            time.sleep(5)  # idle, for more pings than gRPC allows by itself
            self.assertEqual(set(states), {grpc.ChannelConnectivity.READY})


class Catalog(WithServer):

    def test_enrol_list_change_and_delete(self):
        enrolled = self.enrol()
        self.assertEqual(enrolled.object_id, "bracket")
        self.assertGreater(len(enrolled.edges), 5)
        self.assertEqual(enrolled.edges[0].shape[1], 3)
        self.assertEqual([o.object_id for o in self.client.list_objects()], ["bracket"])
        self.assertEqual(self.client.server_info().object_count, 1)
        self.assertEqual(self.client.look_alikes("bracket"), [])
        self.assertTrue(enrolled.ready)
        grasps = [horopter.GraspModel("g", np.eye(4), 0.05, 0.02, 0.5), horopter.GraspModel("s", np.eye(4), cup_radius_m=0.01)]
        self.client.set_grasps("bracket", grasps, if_match=enrolled.etag)
        back = self.client.get_object("bracket").grasps
        self.assertEqual([(g.name, g.quality, g.jaw_opening_m, g.cup_radius_m) for g in back],
                         [("g", 0.5, 0.05, None), ("s", 1.0, 0.0, 0.01)])
        with self.assertRaises(horopter.Conflict) as conflict:
            self.client.set_grasps("bracket", [], if_match=enrolled.etag)
        self.assertEqual((conflict.exception.reason, conflict.exception.field), ("ETAG_MISMATCH", "if_match"))
        self.assertEqual(len(self.client.get_object("bracket").grasps), 2)
        copy = self.client.create_object("copy", self.client.get_object("bracket", full=True).raw)
        self.assertEqual(copy.diameter_m, enrolled.diameter_m)
        self.client.delete_object("bracket")
        with self.assertRaises(horopter.NotFound) as caught:
            self.client.get_object("bracket")
        self.assertRegex(caught.exception.request_id, r"^[0-9a-f]{8}-\d{6}$")

    def test_an_object_goes_back_to_what_it_was(self):
        enrolled = self.enrol()
        self.client.set_grasps("bracket", [horopter.GraspModel("g", np.eye(4), 0.05, 0.02)])
        versions = self.client.object_versions("bracket")
        self.assertEqual([(v.changed, len(v.object.grasps)) for v in versions], [(["grasps"], 1), (None, len(enrolled.grasps))])
        self.assertGreater(versions[0].revision, versions[1].revision)
        self.assertGreaterEqual(versions[0].since, versions[1].since)
        former = self.client.get_object("bracket", revision=versions[1].revision)
        self.assertEqual((former.etag, len(former.edges)), ("", len(enrolled.edges)))
        with self.assertRaises(horopter.Conflict):
            self.client.restore_object("bracket", versions[1].revision, if_match=enrolled.etag)
        back = self.client.restore_object("bracket", versions[1].revision, if_match=versions[0].object.etag)
        self.assertEqual(len(back.grasps), len(enrolled.grasps))
        with self.assertRaises(horopter.NotFound):
            self.client.restore_object("bracket", 999)

        async def ask():
            async with horopter.AsyncClient(self.mock.address) as client:
                history = await client.object_versions("bracket")
                undone = await client.restore_object("bracket", history[1].revision)
                return history, undone, await client.get_object("bracket", revision=history[0].revision)

        history, undone, gone = asyncio.run(ask())
        self.assertEqual((len(history), len(undone.grasps), len(gone.grasps)), (3, 1, len(enrolled.grasps)))

    def test_more_objects_than_a_page(self):
        raw = self.client.get_object(self.enrol().object_id, full=True).raw
        raw.ClearField("source")
        for i in range(205):
            self.client.create_object("o%03d" % i, raw)
        self.assertEqual(len(self.client.list_objects()), 206)

    def test_a_name_in_another_encoding_is_no_obstacle(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(os.fsencode(folder), b"Tr\xe4ger.step")
            shutil.copy(os.path.join(DATASET, "cad", "obj_000001.step"), path)
            enrolled = self.client.enroll_file(os.fsdecode(path), "bracket", program=HOROPTER)
            self.assertEqual(enrolled.raw.source.file_name, "Tr\xe4ger.step")
            with self.assertRaises(horopter.HoropterError):  # the message names a file that is not there
                self.client.enroll_file(os.fsdecode(path) + ".step", "gone", program=HOROPTER)

    def test_a_refused_file_says_why(self):
        with self.assertRaises(horopter.HoropterError) as caught:
            self.client.enroll_file(IMAGES[0], "x", program=HOROPTER)
        self.assertIn(".png", str(caught.exception))


class Stations(WithServer):

    def test_a_station_is_made_taught_told_and_removed(self):
        self.enrol()
        pose = random_pose(np.random.default_rng(9))
        made = self.client.set_station("cell", "press 4", [
            horopter.CameraSetting("left", base_from_camera=pose, position_sigma_m=0.001), horopter.CameraSetting("arm", "MOVING")])
        self.assertEqual((made.station_id, made.display_name, [c.camera_id for c in made.cameras]), ("cell", "press 4", ["left", "arm"]))
        left, arm = made.cameras
        self.assertEqual((left.motion, left.base_source, left.base_sigmas), ("FIXED", "GIVEN", (0.01, 0.001)))
        np.testing.assert_allclose(left.base_from_camera, pose, atol=1e-12)
        self.assertEqual((arm.motion, arm.base_source, arm.base_sigmas, arm.base_from_camera), ("MOVING", None, None, None))
        self.assertEqual([s.station_id for s in self.client.list_stations()], ["cell"])
        calibration = horopter.Calibration(640, 480, [[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]], [0.01], focal_log_sigma=0.01)
        told = self.client.import_calibration("cell", "left", calibration)
        self.assertEqual(told.events[0].kind, "CALIBRATION_IMPORTED")
        self.assertEqual(self.client.export_calibration("cell", "left").K[0, 0], 600.0)
        scene = self.client.recognize(IMAGES, station="cell", station_cameras=["left", "arm"], read_only=True,
                                      expected=[horopter.ExpectedPart("bracket", 2)])
        self.assertTrue(scene.station.read_only)
        self.assertEqual([o.state for o in scene.expected.outcomes], ["PRESENT", "MISSING"])
        self.assertFalse(scene.expected.all_present)
        self.assertEqual(self.client.reset_station("cell", "left").events[0].kind, "RESET")
        with self.assertRaises(horopter.Conflict):
            self.client.delete_station("cell", if_match="another")
        with self.assertRaises(horopter.NotFound):
            self.client.set_station("elsewhere", create=False)
        with self.assertRaises(ValueError):
            self.client.set_station("cell", cameras=[horopter.CameraSetting("left", "STANDING")])

        async def remove():
            async with horopter.AsyncClient(self.mock.address) as client:
                self.assertEqual((await client.get_station("cell")).cameras[0].camera_id, "left")
                await client.delete_station("cell")
                return await client.list_stations()
        self.assertEqual(asyncio.run(remove()), [])


class Retries(unittest.TestCase):

    def test_a_server_that_is_not_there_yet_is_asked_again(self):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            address = "127.0.0.1:%d" % free.getsockname()[1]
        with horopter.Client(address, retries=0) as client:
            with self.assertRaises(horopter.Unavailable):
                client.list_objects(deadline_s=20.0)
        started = subprocess.Popen(["sh", "-c", "sleep 1; exec \"$@\"", "later", MOCK, "--listen", address],
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            with horopter.Client(address, retries=9) as client:
                self.assertEqual(client.list_objects(deadline_s=120.0), [])
        finally:
            started.terminate()
            started.wait()


class Answers(unittest.TestCase):

    def test_reasons_and_findings_have_their_names_and_values(self):
        pb = types.recognition_pb2
        message = pb.RecognizeSceneResponse(completeness=pb.COMPLETENESS_TIME_LIMITED)
        message.reasons.add(kind=pb.SceneReason.KIND_NO_PARALLAX, detail="d")
        message.reasons.add(kind=77)
        message.unsearched.add(cause=pb.UnsearchedStep.CAUSE_TIME, step="aspects")
        turn = message.findings.add(object="objects/nut", detail="t").turn_undetermined
        turn.axis_in_object.z, turn.sigma_rad = 1.0, 0.5
        message.findings.add(image=2).focal_and_depth.focal_log_sigma = 0.1
        message.findings.add(detail="of a later server")
        scene = horopter.Scene.from_proto(message)
        self.assertEqual(scene.outcome, "NO_PARALLAX,UNKNOWN,TIME_LIMITED")
        self.assertTrue(scene.has_reason("NO_PARALLAX"))
        self.assertEqual(scene.unsearched, ["aspects"])
        self.assertEqual([f.kind for f in scene.findings], ["TURN_UNDETERMINED", "FOCAL_AND_DEPTH", "UNKNOWN"])
        np.testing.assert_array_equal(scene.findings[0].values["axis_in_object"], [0, 0, 1])
        self.assertEqual(scene.findings[0].values["sigma_rad"], 0.5)
        self.assertEqual((scene.findings[1].image, scene.findings[1].values), (2, {"focal_log_sigma": 0.1}))


class BrokenOff(unittest.TestCase):

    def test_a_call_that_grpc_broke_off_for_memory_is_asked_again(self):
        class Refused(grpc.RpcError):
            def __init__(self, details):
                super().__init__()
                self.details = lambda: details
                self.code = lambda: grpc.StatusCode.RESOURCE_EXHAUSTED
                self.trailing_metadata = self.initial_metadata = lambda: ()

        busy = horopter.errors.from_rpc(Refused("Received RST_STREAM with error code 11"))
        self.assertIsInstance(busy, horopter.Busy)
        self.assertEqual(busy.retry_after_s, 1.0)
        large = horopter.errors.from_rpc(Refused("Received message larger than max (9 vs. 8)"))
        self.assertIsInstance(large, horopter.TooLarge)


class Recognize(WithServer):

    def test_the_answer_has_poses_covariances_and_grasps(self):
        self.enrol()
        with open(IMAGES[1], "rb") as file:
            as_bytes = file.read()
        scene = self.client.recognize([IMAGES[0], as_bytes, np.zeros((48, 64, 3), np.uint8)])
        self.assertEqual((scene.outcome, scene.complete, scene.unsearched), ("RECOGNIZED", True, []))
        self.assertEqual((scene.cameras[2].width_px, scene.cameras[2].height_px), (64, 48))
        part = scene.objects[0]
        self.assertEqual(part.object_id, "bracket")
        np.testing.assert_allclose(part.scene_from_object,
                                   [[0, -1, 0, 0.01], [1, 0, 0, 0.02], [0, 0, 1, 0.5], [0, 0, 0, 1]], atol=1e-12)
        np.testing.assert_allclose(np.diag(part.covariance), 1e-6 * np.arange(1, 7))
        self.assertEqual(scene.joint_covariance.shape, (6, 6))
        self.assertEqual(part.grasps[0].name, "above")
        self.assertAlmostEqual(part.grasps[0].scene_from_pregrasp[2, 3], 0.4)
        self.assertEqual(len(part.images), 3)
        other = part.left_open[0]
        self.assertEqual((other.kind, other.object_id, other.probability, other.feature_place), ("MIRROR_IMAGE", "bracket", 0.1, None))
        self.assertAlmostEqual(other.scene_from_camera[2, 3], 0.5)
        self.assertIsNone(other.base_from_camera)
        self.assertEqual(self.client.recognize(IMAGES, unknown_share=0.3).objects[0].left_open[0].probability, 0.3)
        with self.assertRaises(horopter.InvalidRequest):
            self.client.recognize(IMAGES, unknown_share=1.0)
        self.assertIsNone(part.base_from_object)
        self.assertIn("features", scene.stage_seconds)

    def test_the_answer_is_as_much_as_is_asked_for(self):
        self.enrol()
        basic = self.client.recognize(IMAGES, full=False, gripper=horopter.Gripper(fingers_m=(0.05, 0.01, 0.005)))
        self.assertIsNone(basic.objects[0].covariance)
        self.assertEqual((basic.objects[0].images, basic.stage_seconds), ([], {}))
        none = self.client.recognize(IMAGES, min_score=0.95)
        self.assertEqual((none.objects, none.objects_below_min_score), ([], 1))
        self.assertTrue(none.has_reason("BELOW_MIN_SCORE"))
        lens = horopter.CameraHint(focal_px=600.0, focal_y_px=610.0, principal_point_px=(320.0, 240.0), k1=-0.1, p1=0.001)
        self.assertTrue(all(c.rectified for c in self.client.recognize(IMAGES, hints=lens).cameras))

    def test_an_answer_rests_on_the_writes_that_are_named(self):
        self.enrol()
        written = self.client.get_object("bracket").revision
        self.assertGreater(written, 0)
        scene = self.client.recognize(IMAGES, min_generation=written)
        self.assertGreaterEqual(scene.catalog_generation, written)
        with self.assertRaises(horopter.Unavailable) as caught:
            self.client.recognize(IMAGES, min_generation=written + 1000)
        self.assertIn("generation %d is asked for" % (written + 1000), str(caught.exception))
        for bad in (-1, 1.5, True, "7"):
            with self.assertRaises(ValueError):
                self.client.recognize(IMAGES, min_generation=bad)
        program = [HOROPTER, "--server", self.mock.address, "--retries", "0"]
        for generation, code in ((written, 0), (written + 1000, None)):
            done = subprocess.run(program + ["--min-generation", str(generation), "recognize", *IMAGES], capture_output=True, text=True)
            if code is None:
                self.assertNotEqual(done.returncode, 0)
                self.assertIn("generation %d is asked for" % generation, done.stderr)
            else:
                self.assertEqual(done.returncode, code, done.stderr)

        async def ask():
            async with horopter.AsyncClient(self.mock.address) as client:
                return await client.recognize(IMAGES, min_generation=written + 1000)
        with self.assertRaises(horopter.Unavailable):
            asyncio.run(ask())

    def test_the_base_frame_comes_with_a_reference(self):
        self.enrol()
        pose = random_pose(np.random.default_rng(3))
        scene = self.client.recognize(IMAGES[:1], reference=horopter.Reference("bracket", pose))
        np.testing.assert_allclose(scene.base_from_scene, pose, atol=1e-12)

    def test_bad_requests_are_typed_and_name_the_field(self):
        with self.assertRaises(horopter.InvalidRequest) as caught:
            self.client.recognize([IMAGES[0], b"no image"])
        self.assertEqual((caught.exception.field, caught.exception.reason), ("images[1].content", "FIELD_INVALID"))
        with self.assertRaises(horopter.InvalidRequest) as caught:
            self.client.recognize(IMAGES, hints=[None, horopter.CameraHint(focal_px=-1.0)])
        self.assertEqual(caught.exception.field, "images[1].camera_hint.focal_px")
        self.assertEqual(caught.exception.reason, "FIELD_INVALID")
        with self.assertRaises(horopter.InvalidRequest) as caught:
            self.client.recognize(IMAGES, hints=[None, horopter.CameraHint(focal_px=600.0, fisheye=(0.1, 0, 0, 0))])
        self.assertEqual(caught.exception.field, "images[1].camera_hint.principal_point_x_px")
        with self.assertRaises(horopter.InvalidRequest) as caught:
            self.client.recognize(IMAGES, gripper=horopter.Gripper())
        self.assertEqual(caught.exception.field, "gripper")
        with self.assertRaises(ValueError):
            self.client.recognize(IMAGES, hints=[None])
        with self.assertRaises(TypeError):
            self.client.recognize(IMAGES[0])
        with self.assertRaises(OSError):
            self.client.recognize(["gone.png"])

    def test_the_asynchronous_client_answers_the_same(self):
        self.enrol()
        waited = self.client.recognize(IMAGES)

        async def ask():
            async with horopter.AsyncClient(self.mock.address) as client:
                scenes = await asyncio.gather(*(client.recognize(IMAGES) for _ in range(4)))
                listed = await client.list_objects()
                one = await client.get_object("bracket")
                self.assertEqual(await client.look_alikes("bracket"), [])
                await client.delete_object("bracket")
                with self.assertRaises(horopter.NotFound):
                    await client.get_object("bracket")
                return scenes, listed, one

        scenes, listed, one = asyncio.run(ask())
        for scene in scenes:
            np.testing.assert_array_equal(scene.objects[0].scene_from_object, waited.objects[0].scene_from_object)
        self.assertEqual(listed[0].object_id, one.object_id)

    def test_the_example_draws(self):
        self.enrol()
        with tempfile.TemporaryDirectory() as folder:
            example = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "client", "python", "examples",
                                   "draw_answer.py")
            done = subprocess.run([sys.executable, "-B", example, "--server", self.mock.address, "--out", folder, *IMAGES],
                                  capture_output=True, text=True, env=dict(os.environ, PYTHONPATH=PACKAGE), check=False)
            self.assertEqual(done.returncode, 0, done.stderr)
            svg = ElementTree.parse(os.path.join(folder, "answer-1.svg")).getroot()
            lines = [e for e in svg if e.tag.endswith("polyline")]
            self.assertGreater(len(lines), 5)
            self.assertTrue(any(e.get("stroke") == "orange" for e in lines))


class Busy(WithServer):

    ARGUMENTS = ("--delay-ms", "400", "--workers", "1", "--queue", "0")

    def test_a_busy_server_is_asked_again_or_said_to_be_busy(self):
        async def ask(retries):
            async with horopter.AsyncClient(self.mock.address, retries=retries) as client:
                return await asyncio.gather(client.recognize(IMAGES[:1]), client.recognize(IMAGES[:1]),
                                            return_exceptions=True)

        answers = asyncio.run(ask(0))
        refused = [a for a in answers if isinstance(a, horopter.Busy)]
        self.assertEqual(len(refused), 1)
        self.assertGreater(refused[0].retry_after_s, 0.05)
        for answer in asyncio.run(ask(20)):
            self.assertIsInstance(answer, horopter.Scene)

    def test_deadlines_and_servers_that_are_gone(self):
        with self.assertRaises(horopter.DeadlineExceeded):
            self.client.recognize(IMAGES[:1], deadline_s=0.1)
        self.mock.stop()
        with self.assertRaises(horopter.Unavailable):
            self.client.list_objects(deadline_s=5.0)


class Overhead(WithServer):
    """Prints what a call costs; judges nothing, the machine may be busy."""

    def test_the_round_trip_is_short(self):
        image = np.zeros((32, 32), np.uint8)
        self.client.recognize([image])
        times = []
        for _ in range(50):
            start = time.perf_counter()
            self.client.recognize([image])
            times.append(time.perf_counter() - start)
        print("round trip, median of 50: %.2f ms" % (1e3 * sorted(times)[25]))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
