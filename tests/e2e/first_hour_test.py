#!/usr/bin/env python3
"""The first hour of three users with a real server: a robot engineer, an operator and an attacker. Each step asserts.

    first_hour_test.py HOROPTER HOROPTERD PACKAGE_FOLDER SOURCES
"""
import asyncio
import hashlib
import json
import os
import re
import resource
import shutil
import signal
import socket
import sqlite3
import struct
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import urllib.request
import zlib

HOROPTER, HOROPTERD, PACKAGE, SOURCES = map(os.path.abspath, sys.argv[1:5])
sys.path.insert(0, PACKAGE)
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))

import grpc  # noqa: E402
import numpy as np  # noqa: E402

import horopter  # noqa: E402
from mock_server import Mock  # noqa: E402

TIMEOUT_S = 300
DATASET = os.path.join(SOURCES, "tests", "data", "parts")
SCENE = os.path.join(DATASET, "val", "000005")
IMAGES = [os.path.join(SCENE, "rgb", "%06d.png" % i) for i in range(4)]
PART = 19  # the one that lies there


def cad(number):
    return os.path.join(DATASET, "cad", "obj_%06d.step" % number)


class Cell(unittest.TestCase):
    """A server with TLS, tokens, logs and metrics, as deploy/credentials.sh sets it up."""

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.mkdtemp()
        cls.keys = os.path.join(cls.folder, "keys")
        subprocess.run([os.path.join(SOURCES, "deploy", "credentials.sh"), cls.keys], check=True, capture_output=True)
        # A teacher, whom the script does not make.
        with open(os.path.join(cls.keys, "teacher.token"), "w", encoding="utf-8") as out:
            out.write("teach-" + "0123456789abcdef" * 2)
        with open(os.path.join(cls.keys, "teacher.token"), "rb") as file:
            digest = hashlib.sha256(file.read()).hexdigest()
        with open(os.path.join(cls.keys, "access"), "a", encoding="utf-8") as out:
            out.write("teacher line sha256:%s\n" % digest)
        cls.servers = []

    @classmethod
    def tearDownClass(cls):
        for server in cls.servers:
            server.stop()
        shutil.rmtree(cls.folder)

    @classmethod
    def path(cls, *names):
        return os.path.join(cls.folder, *names)

    @classmethod
    def start(cls, *arguments, limit=""):
        command = [HOROPTERD, "--db", cls.path("parts.db"), "--listen", "localhost:0", "--tls-cert", cls.path("keys", "server.pem"),
                   "--tls-key", cls.path("keys", "server.key"), "--access-file", cls.path("keys", "access"), "--tls-reload-seconds", "1",
                   "--audit-log", cls.path("audit.jsonl"), "--request-log", cls.path("requests.jsonl"), "--metrics-listen", "127.0.0.1:0",
                   *arguments]
        server = Mock(HOROPTERD, command=["bash", "-c", limit + 'exec "$0" "$@"', *command])
        cls.servers.append(server)
        return server

    def security(self, who=None):
        return horopter.Security(ca_file=self.path("keys", "ca.pem"), token_file=who and self.path("keys", who + ".token"))

    def client(self, server, who, **options):
        client = horopter.Client(server.address, deadline_s=TIMEOUT_S, security=self.security(who), **options)
        self.addCleanup(client.close)
        return client

    def horopter(self, server, *arguments, who="admin"):
        return subprocess.run([HOROPTER, "--server", server.address, "--timeout", "60", "--tls-ca", self.path("keys", "ca.pem"), "--token-file",
                               self.path("keys", who + ".token"), *arguments], capture_output=True, text=True, timeout=TIMEOUT_S, check=False,
                              cwd=self.folder)

    def metric(self, server, name):
        with urllib.request.urlopen(server.metrics_url, timeout=30) as answer:
            found = re.search("^" + re.escape(name) + r" (\S+)$", answer.read().decode(), re.M)
        return float(found.group(1)) if found else None

    @staticmethod
    def wait(condition):
        until = time.monotonic() + TIMEOUT_S
        while not condition() and time.monotonic() < until:
            time.sleep(0.05)
        return condition()

    def lines(self, name):
        with open(self.path(name), encoding="utf-8") as file:
            return [json.loads(line) for line in file]


class RobotEngineer(Cell):

    def test_from_a_cad_file_to_a_grasp_in_the_base(self):
        server = self.start()
        # Each wrong way in says what is wrong.
        for security, words in ((horopter.Security(), "it may want TLS"), (self.security(), "token")):
            with horopter.Client(server.address, deadline_s=20, retries=0, security=security) as client:
                with self.assertRaises(horopter.HoropterError) as caught:
                    client.list_objects()
            self.assertIn(words, str(caught.exception))
        robot, admin = self.client(server, "robot"), self.client(server, "admin")
        with self.assertRaises(horopter.PermissionDenied):
            robot.import_object("part", cad(PART))
        # The quick start: a CAD file, images, pictures of the answer.
        example = os.path.join(SOURCES, "client", "python", "examples", "first_part.py")
        done = subprocess.run(["/usr/bin/python3", "-B", example, cad(PART), *IMAGES, "--server", server.address, "--tls-ca",
                               self.path("keys", "ca.pem"), "--token-file", self.path("keys", "admin.token"), "--out", self.path("answer")],
                              capture_output=True, text=True, timeout=TIMEOUT_S, check=False, env=dict(os.environ, PYTHONPATH=PACKAGE))
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        for k in range(4):
            with open(self.path("answer-%d.png" % k), "rb") as file:
                self.assertEqual(file.read(8), b"\x89PNG\r\n\x1a\n")
        part = "obj_%06d" % PART
        self.assertEqual([o.object_id for o in robot.list_objects()], [part])
        # Grasps, by the model of the data set.
        grasp = horopter.GraspModel("top", np.eye(4), 0.2, 0.1)
        admin.set_grasps(part, [grasp])
        admin.import_object("other", cad(1))
        # In the base by a reference, with what should lie there.
        pose = np.array([[0, -1, 0, 0.4], [1, 0, 0, 0.1], [0, 0, 1, 0.02], [0, 0, 0, 1.0]])
        admin.set_station("bench")
        cameras = ["c%d" % k for k in range(4)]
        asked = dict(station="bench", station_cameras=cameras, reference=horopter.Reference(part, pose),
                     expected=[horopter.ExpectedPart(part), horopter.ExpectedPart("other")])
        scene = robot.recognize(IMAGES, **asked)
        self.assertEqual([o.object_id for o in scene.objects], [part])
        self.assertTrue(scene.station.read_only)
        self.assertFalse(scene.station.learnt)
        self.assertEqual(scene.reasons, [])
        np.testing.assert_allclose(scene.objects[0].base_from_object[:3, 3], pose[:3, 3], atol=1e-6)
        states = [o.state for o in scene.expected.outcomes]
        self.assertEqual(len(states), 2)
        self.assertEqual(states[0], "PRESENT")
        self.assertIn(states[1], ("MISSING", "CANNOT_TELL"))
        self.assertFalse(scene.expected.all_present)
        # The truth, by the distances between cameras and part: the scene's frame is free.
        with open(os.path.join(SCENE, "scene_gt.json"), encoding="utf-8") as file:
            truth = json.load(file)
        for k in range(4):
            there = truth[str(k)][0]["cam_t_m2c"]
            found = scene.objects[0].images[k].camera_from_object
            if found is not None:
                self.assertAlmostEqual(np.linalg.norm(found[:3, 3]) * 1e3 / np.linalg.norm(there), 1.0, delta=0.05)
        # One camera fails in one of ten requests: the others answer, and a station is not confused by it.
        teacher = self.client(server, "teacher")
        first = teacher.recognize(IMAGES, station="bench", station_cameras=cameras)
        self.assertFalse(first.station.read_only)
        fewer = teacher.recognize(IMAGES[:3], station="bench", station_cameras=cameras[:3])
        self.assertEqual([o.object_id for o in fewer.objects], [part])
        self.assertEqual([f.kind for f in fewer.station.findings], [])
        # A base pose of last year: the fixture was moved since. The station has learnt where it is and says so; no base is told.
        self.assertTrue(teacher.recognize(IMAGES, station="bench", station_cameras=cameras, reference=horopter.Reference(part, pose)).station.learnt)
        moved = pose.copy()
        moved[0, 3] += 0.3
        old = teacher.recognize(IMAGES, station="bench", station_cameras=cameras, reference=horopter.Reference(part, moved))
        self.assertIn("REFERENCE_CONFLICT", [r.kind for r in old.reasons])
        self.assertIsNone(old.objects[0].base_from_object)
        self.assertEqual([f.kind for f in old.station.findings], ["BASE_MOVED"])
        self.assertEqual(self.metric(server, 'horopter_station_finding{kind="BASE_MOVED",station="bench"}'), 1)
        # A symmetric fixture leaves the base open, which is said with all that agree.
        symmetric = os.path.join(DATASET, "val", "000011", "rgb")
        for name, number in (("symmetric", 18), ("beside", 4), ("behind", 3)):
            admin.import_object(name, cad(number))
        open_ = robot.recognize([os.path.join(symmetric, "%06d.png" % k) for k in range(4)],
                                reference=horopter.Reference("symmetric", pose))
        self.assertIn("REFERENCE_AMBIGUOUS", [r.kind for r in open_.reasons])
        self.assertIsNone(open_.base_from_scene)
        self.assertGreater(len(open_.base_alternatives), 1)
        # Waiting for ever is not asked of anybody.
        with self.assertRaises(horopter.DeadlineExceeded):
            robot.recognize(IMAGES, deadline_s=0.001)

        async def cancelled():
            async with horopter.AsyncClient(server.address, security=self.security("robot")) as client:
                call = asyncio.ensure_future(client.recognize(IMAGES))
                await asyncio.sleep(0.2)
                call.cancel()
                await asyncio.wait([call])
                return call.cancelled() or isinstance(call.exception(), horopter.Cancelled)

        self.assertTrue(asyncio.run(cancelled()))
        self.assertTrue(self.wait(lambda: self.metric(server, "horopter_scenes_running") == 0))
        self.assertEqual(self.metric(server, "horopter_memory_reserved_bytes"), 0)
        # Two robots at one station at once.
        answers = []
        threads = [threading.Thread(target=lambda: answers.append(teacher.recognize(IMAGES[:2], station="bench", station_cameras=cameras[:2])),
                                    daemon=True) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(TIMEOUT_S)
        self.assertEqual(len(answers), 2)
        self.assertEqual(len({a.request_id for a in answers}), 2)
        self.assertEqual(len(robot.get_station("bench").cameras), 4)


class Operator(Cell):

    def test_a_day_of_operations(self):
        server = self.start()
        admin = self.client(server, "admin")
        admin.import_object("part", cad(PART))
        # Rules that ask for figures that there are.
        with urllib.request.urlopen(server.metrics_url, timeout=30) as answer:
            figures = answer.read().decode()
        for name in ("horopter_tls_certificate_end_seconds", "horopter_catalog_pending_objects", "process_open_fds", "horopter_scenes_waiting"):
            self.assertIn("\n" + name + " ", figures)
        # Backups: a bad place is refused at once, a good one can be restored.
        self.assertEqual(self.horopter(server, "catalog", "backup", "/nowhere/at/all.db").returncode, 3)
        done = self.horopter(server, "catalog", "backup", "copy.db")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(self.horopter(server, "object", "rm", "part").returncode, 0)
        self.assertEqual(admin.list_objects(), [])
        done = self.horopter(server, "catalog", "restore", "copy.db")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(self.horopter(server, "catalog", "verify").returncode, 0)
        # Tokens and certificates change in mid-call: the call ends well, later ones are judged by what is there then.
        outcome = []
        robot = self.client(server, "robot", retries=0)
        thread = threading.Thread(target=lambda: outcome.append(robot.recognize(IMAGES)), daemon=True)
        thread.start()
        self.assertTrue(self.wait(lambda: self.metric(server, "horopter_scenes_running") == 1 or outcome))
        with open(self.path("keys", "access"), encoding="utf-8") as file:
            access = file.read()
        with open(self.path("keys", "access.new"), "w", encoding="utf-8") as out:
            out.write("".join(line for line in access.splitlines(True) if not line.startswith("robot")))
        os.rename(self.path("keys", "access.new"), self.path("keys", "access"))
        subprocess.run([os.path.join(SOURCES, "deploy", "credentials.sh"), self.path("fresh")], check=True, capture_output=True)
        for name in ("server.key", "server.pem", "ca.pem"):
            shutil.copy(self.path("fresh", name), self.path("keys"))
        server.process.send_signal(signal.SIGHUP)
        thread.join(TIMEOUT_S)
        self.assertEqual([o.object_id for o in outcome[0].objects], ["part"])
        self.assertTrue(self.wait(lambda: self.refused(robot) == "UNAUTHENTICATED"))
        self.assertEqual(self.refused(admin), "OK")  # on the connection that it has

        def connects():
            with horopter.Client(server.address, deadline_s=20, retries=0, security=self.security("admin")) as client:
                return self.refused(client) == "OK"

        self.assertTrue(self.wait(connects))  # who trusts the new authority
        with open(self.path("keys", "access"), "w", encoding="utf-8") as out:
            out.write(access)
        # Who was refused what is in the audit log.
        robot = self.client(server, "robot", retries=0)
        self.assertTrue(self.wait(lambda: self.refused(robot) == "OK"))
        with self.assertRaises(horopter.PermissionDenied):
            robot.delete_object("part")
        last = self.lines("audit.jsonl")[-1]
        self.assertEqual((last["caller"], last["code"], last["method"]), ("robot", "PERMISSION_DENIED", "DeleteObject"))
        # Names do what they want to no terminal and no log.
        self.assertEqual(self.horopter(server, "object", "update", "part", "--name", "\x1b[2J\x1b]0;mine\x07").returncode, 0)
        for command in (("object", "list"), ("object", "show", "part")):
            self.assertNotIn("\x1b", self.horopter(server, *command).stdout)
        self.assertNotIn("\x1b", "".join(server.said))
        # Killed in the middle of a restore: nothing is lost, and what is left over goes.
        class Slow:
            def __init__(self):
                self.go = threading.Event()

            def __iter__(self):
                yield horopter.client.catalog_pb2.RestoreCatalogRequest(total_bytes=1 << 20, sha256="0" * 64, chunk=b"x" * 1000)
                self.go.wait()

        slow = Slow()
        self.addCleanup(slow.go.set)
        stub = horopter.client.catalog_pb2_grpc.CatalogServiceStub(admin._channel)
        call = stub.RestoreCatalog.future(iter(slow), metadata=admin.security.metadata())
        self.assertTrue(self.wait(lambda: any(".restore" in n for n in os.listdir(self.folder))))
        server.process.kill()
        server.process.wait()
        call.cancel()
        slow.go.set()
        server = self.start()
        self.assertEqual([n for n in os.listdir(self.folder) if ".restore" in n and not n.endswith(".bak")], [])
        self.assertEqual([o.object_id for o in self.client(server, "admin").list_objects()], ["part"])
        server.process.send_signal(signal.SIGTERM)
        self.assertEqual(server.process.wait(TIMEOUT_S), 0)
        # An upgrade: a catalog of another version is prepared beside what is served.
        with sqlite3.connect(self.path("parts.db")) as db:
            db.execute("UPDATE derived SET version = 0")
        db.close()
        server = self.start("--cores", "1")
        self.assertTrue(self.wait(lambda: any("all objects are prepared" in line for line in server.said)))
        admin = self.client(server, "admin", retries=0)
        self.assertEqual([o.ready for o in admin.list_objects()], [True])
        # The end of the day: what runs is answered, what comes later is refused, exit code 0.
        outcome = []
        thread = threading.Thread(target=lambda: outcome.append(admin.recognize(IMAGES[:2])), daemon=True)
        thread.start()
        self.assertTrue(self.wait(lambda: self.metric(server, "horopter_scenes_running") == 1 or outcome))
        server.process.send_signal(signal.SIGTERM)
        self.assertEqual(server.process.wait(TIMEOUT_S), 0)
        thread.join(TIMEOUT_S)
        self.assertEqual(len(outcome), 1)

    @staticmethod
    def refused(client):
        try:
            client.list_objects()
        except horopter.HoropterError as error:
            return error.code
        return "OK"


class Attacker(Cell):

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))  # as many connections as an attacker likes

    def test_nothing_that_is_sent_ends_or_fills_it(self):
        server = self.start(limit="ulimit -Sn 1024; ")
        admin = self.client(server, "admin")
        admin.import_object("part", cad(PART))
        pid, port = server.process.pid, int(server.address.rsplit(":", 1)[1])
        # More silent connections than a process begins with descriptors; what is refused is refused at once.
        silent = []
        for _ in range(1100):
            try:
                silent.append(socket.create_connection(("localhost", port), timeout=20))
            except OSError:
                break
        for connection in silent:
            connection.close()
        self.assertTrue(self.wait(lambda: Operator.refused(admin) == "OK"))
        # What is no TLS, no HTTP/2, no message.
        for garbage in (b"GET / HTTP/1.1\r\n\r\n", os.urandom(4096), b"\x16\x03\x01\xff\xff" + os.urandom(100), b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" * 10):
            with socket.create_connection(("localhost", port), timeout=20) as connection:
                connection.sendall(garbage)
                connection.settimeout(20)
                try:
                    connection.recv(100)
                except OSError:
                    pass
        # Guessed tokens: thousands of refusals, some lines.
        stranger = horopter.Client(server.address, deadline_s=60, retries=0, security=horopter.Security(
            ca_file=self.path("keys", "ca.pem"), token="guess"))
        self.addCleanup(stranger.close)
        before, began = len(server.said), time.monotonic()
        for _ in range(1000):
            self.assertEqual(Operator.refused(stranger), "UNAUTHENTICATED")
        # 50 of a kind in 10 s, and lines that count the others; however long this machine takes for it.
        self.assertLess(len(server.said) - before, 60 * (2 + (time.monotonic() - began) / 10))
        # Calls that are broken off at once.
        stub = horopter.client.recognition_pb2_grpc.RecognitionServiceStub(admin._channel)
        for _ in range(500):
            stub.RecognizeScene.future(horopter.types.recognition_pb2.RecognizeSceneRequest(), metadata=admin.security.metadata()).cancel()
        self.assertTrue(self.wait(lambda: Operator.refused(admin) == "OK"))
        # Images.
        robot = self.client(server, "robot", retries=0)
        with open(IMAGES[0], "rb") as file:
            whole = file.read()
        header = struct.pack(">IIBBBBB", 2**31 - 1, 2**31 - 1, 8, 2, 0, 0, 0)
        bomb = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + header + struct.pack(">I", zlib.crc32(b"IHDR" + header))
        for image in (b"", b"x", whole[:100], bomb, b"\xff\xd8\xff" + os.urandom(1000), b"<svg xmlns='http://www.w3.org/2000/svg'/>", os.urandom(100_000)):
            with self.assertRaises(horopter.HoropterError) as caught:
                robot.recognize([image])
            self.assertIn(caught.exception.code, ("INVALID_ARGUMENT", "RESOURCE_EXHAUSTED"), image[:20])
        # Numbers that no camera has.
        for focal, centre in ((1e300, None), (-1.0, None), (float("nan"), None), (1e-9, None), (500.0, (1e12, 0.0)), (500.0, (float("inf"), 0.0))):
            with self.assertRaises((horopter.InvalidRequest, ValueError), msg=(focal, centre)):
                robot.recognize([whole], hints=horopter.CameraHint(focal_px=focal, principal_point_px=centre))
        # Names and tables.
        for name in ("../../etc/passwd", "a" * 1000, "\x1b[2J", "x\x00y", "'; DROP TABLE object; --", "\u202egnp"):
            with self.assertRaises((horopter.HoropterError, ValueError)):
                robot.recognize([whole], candidates=[name])
            with self.assertRaises((horopter.HoropterError, ValueError)):
                admin.get_object(name)
            with self.assertRaises((horopter.HoropterError, ValueError)):
                robot.recognize([whole], station=name)
        # CAD.
        zeros = zlib.compress(b"\0" * (50 << 20))
        for content, name in ((os.urandom(10_000), "a.step"), (b"ISO-10303-21;" + b"(" * 1_000_000, "deep.step"),
                              (b"solid x\n" * 100_000, "long.stl"), (b"PK\x03\x04" + zeros, "bomb.3mf"), (b"glTF" + b"\xff" * 100, "x.glb"),
                              (b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n", "huge.ply"),
                              (b"v 0 0 0\nf 1 -999999999999 2\n", "x.obj")):
            with self.assertRaises(horopter.HoropterError, msg=name) as caught:
                admin.import_object("bad", content, name)
            self.assertEqual(caught.exception.code, "INVALID_ARGUMENT", (name, caught.exception))
        # It is the same process, holds what it held, and answers.
        self.assertIsNone(server.process.poll())
        self.assertEqual(server.process.pid, pid)
        self.assertEqual([o.object_id for o in admin.list_objects()], ["part"])
        self.assertTrue(self.wait(lambda: self.metric(server, "horopter_memory_reserved_bytes") == 0))
        self.assertEqual([o.object_id for o in robot.recognize(IMAGES[:2]).objects], ["part"])
        self.assertLess(self.metric(server, "process_open_fds"), 200)
        self.assertEqual(sorted(n for n in os.listdir(self.folder) if n.startswith("parts.db.") and n.split(".")[-1] not in ("lock", "reserve")), [])
        self.assertEqual([line for line in server.said if "\x1b" in line], [])


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
