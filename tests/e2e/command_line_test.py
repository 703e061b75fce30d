#!/usr/bin/env python3
"""The `horopter` program against a server whose recognition is a stand-in: every example of every --help runs, every
command speaks JSON, every failure has its exit code and says its request.

    command_line_test.py HOROPTER MOCK_HOROPTERD DATASET
"""
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest
import xml.etree.ElementTree as ElementTree

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))
from mock_server import Mock  # noqa: E402

HOROPTER, MOCK, DATASET = map(os.path.abspath, sys.argv[1:4])
INPUTS = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "data", "inputs")


class Workplace(unittest.TestCase):
    """A folder with what the examples name, and a server with an object `bracket`."""

    MOCK_ARGUMENTS = ()

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.mock = Mock(MOCK, *self.MOCK_ARGUMENTS, "--record-dir", os.path.join(self.folder, "recordings"),
                         "--record-sample", "1")
        os.symlink(os.path.abspath(DATASET), os.path.join(self.folder, "parts"))
        shutil.copy(os.path.join(DATASET, "cad", "obj_000001.step"), os.path.join(self.folder, "bracket.step"))
        shutil.copy(os.path.join(DATASET, "grasps", "obj_000001.json"), os.path.join(self.folder, "grasps.json"))
        for i in range(3):
            shutil.copy(os.path.join(DATASET, "val", "000005", "rgb", "%06d.png" % i),
                        os.path.join(self.folder, "%d.png" % i))
        for name in ("left", "right"):
            with open(os.path.join(self.folder, name + ".yaml"), "w", encoding="utf-8") as out:
                out.write("image_width: 1280\nimage_height: 960\ncamera_matrix: {rows: 3, cols: 3, data: "
                          "[1400, 0, 640, 0, 1400, 480, 0, 0, 1]}\ndistortion_model: plumb_bob\n"
                          "distortion_coefficients: {rows: 1, cols: 5, data: [0.01, 0, 0, 0, 0]}\n")
        self.enrol()

    def tearDown(self):
        self.mock.stop()
        shutil.rmtree(self.folder)

    def await_recordings(self, count):
        """Of as many more requests; those of one client that sends them in turn are answered but for the last."""
        folder = os.path.join(self.folder, "recordings")

        def recorded():
            return len(os.listdir(folder)) if os.path.isdir(folder) else 0
        wanted = recorded() + count
        deadline = time.monotonic() + 60
        while recorded() < wanted:
            self.assertLess(time.monotonic(), deadline, "no requests came")
            time.sleep(0.02)

    def enrol(self):
        self.run_horopter("object", "add", "bracket.step", "--id", "bracket")

    def run_horopter(self, *arguments, **options):
        environment = dict(os.environ, HOROPTER_SERVER=self.mock.address, TERM="dumb")
        return subprocess.run([HOROPTER, *arguments], cwd=self.folder, env=environment, capture_output=True, text=True,
                              timeout=60, stdin=subprocess.DEVNULL, check=False, **options)


def commands(path=()):
    """All commands that have no sub-commands, with their help."""
    said = subprocess.run([HOROPTER, *path, "--help"], capture_output=True, text=True, check=True).stdout
    below = re.findall(r"^  ([a-z-]+) +\S", said.split("Subcommands:")[1], re.M) if "Subcommands:" in said else []
    if not below:
        yield path, said
    for name in below:
        yield from commands(path + (name,))


class Examples(Workplace):

    def test_every_example_of_every_help_runs(self):
        seen = 0
        for path, said in commands():
            examples = re.findall(r"^  (horopter .*)$", said.split("Example:")[-1], re.M) if "Example:" in said else []
            self.assertTrue(examples, "no example in the help of %s" % " ".join(path))
            for example in examples:
                with self.subTest(example):
                    self.enrol()
                    if path[0] == "station":  # whatever the example before left of it
                        self.run_horopter("station", "set", "cell1")
                        self.run_horopter("station", "import", "cell1", "left", "left.yaml")
                    if path == ("object", "restore"):
                        self.run_horopter("object", "update", "bracket", "--name", "changed")
                    if path == ("replay",):  # the answers must be of this catalog
                        shutil.rmtree(os.path.join(self.folder, "recordings"))
                        os.mkdir(os.path.join(self.folder, "recordings"))
                        self.run_horopter("recognize", "0.png")
                    if path == ("catalog", "migrate"):  # from one file to another: there is no such database
                        self.run_horopter("catalog", "backup", "parts.db")
                        example = example.replace("postgresql://horopter@db/horopter", "moved.db")
                    environment = dict(os.environ, HOROPTER_SERVER=self.mock.address)
                    done = subprocess.run(["bash", "-c", example.replace("horopter", "'%s'" % HOROPTER, 1)],
                                          cwd=self.folder, env=environment, capture_output=True, text=True, timeout=120,
                                          check=False)
                    self.assertEqual(done.returncode, 0, example + "\n" + done.stdout + done.stderr)
                    seen += 1
        self.assertGreater(seen, 18)
        for made in ("overlay.png", "results.csv", "results.cameras.json", "load.svg", "parts-backup.db", "bracket.png"):
            self.assertGreater(os.path.getsize(os.path.join(self.folder, made)), 100 if "results" not in made else 1)

    def test_completion_and_manual_know_all_commands(self):
        script = os.path.join(self.folder, "completion")
        with open(script, "w", encoding="utf-8") as out:
            out.write(self.run_horopter("completion").stdout)
        ask = 'source "$0"; COMP_WORDS=(horopter %s); COMP_CWORD=%d; _horopter; echo "${COMPREPLY[@]}"'
        for words, index, expected in (("obj", 1, "object"), ("object sh", 2, "show"),
                                       ("recognize a.png --foc", 3, "--focal")):
            said = subprocess.run(["bash", "-c", ask % (words, index), script], capture_output=True, text=True, check=True)
            self.assertIn(expected, said.stdout.split(), words)
        manual = self.run_horopter("manual").stdout
        for path, _ in commands():
            self.assertIn("horopter " + " ".join(path).replace("-", "\\-"), manual)


class Json(Workplace):

    def values(self, *arguments):
        done = self.run_horopter(*arguments, "--json")
        self.assertEqual(done.returncode, 0, done.stderr)
        text = done.stdout.strip()
        try:
            return [json.loads(text)]
        except ValueError:
            return [json.loads(line) for line in text.splitlines()]

    def test_every_command_speaks_json(self):
        self.assertEqual(self.values("object", "list")[0]["objects"][0]["id"], "bracket")
        status = self.values("status")[0]
        self.assertTrue(status["serving"])
        self.assertEqual((status["objects"], status["load"]["running"], status["limits"]["workers"]), (1, 0, 2))
        self.assertEqual(self.values("object", "show", "bracket")[0]["name"], "objects/bracket")
        self.assertEqual(self.values("object", "preview", "bracket", "--out", "p.png")[0]["file"], "p.png")
        self.assertEqual(self.values("object", "update", "bracket", "--name", "x")[0]["verb"], "updated")
        history = self.values("object", "history", "bracket")[0]["versions"]
        self.assertEqual([(v["changed"], v["name"]) for v in history], [(["display_name"], "x"), ([], history[1]["name"])])
        back = self.values("object", "restore", "bracket", str(history[1]["revision"]))[0]
        self.assertEqual((back["verb"], self.values("object", "show", "bracket")[0]["display_name"]), ("restored", history[1]["name"]))
        self.values("object", "restore", "bracket")  # undoes that
        self.assertEqual(self.values("object", "show", "bracket")[0]["display_name"], "x")
        self.assertEqual(self.values("object", "look-alikes", "bracket")[0]["look_alikes"], [])
        self.assertEqual(self.values("object", "verify", "bracket")[0]["problems"], [])
        self.assertEqual(self.values("catalog", "verify")[0]["objects"], 1)
        self.assertEqual(self.values("catalog", "rebuild")[0]["objects"], 1)
        self.assertGreater(self.values("catalog", "backup", "b.db")[0]["bytes"], 1000)
        self.assertEqual(self.values("catalog", "export", "e")[0]["objects"], ["bracket"])
        self.assertEqual(self.values("catalog", "import", "e")[0]["objects"], 1)
        self.assertEqual(self.values("object", "export", "bracket", "--out", "f")[0]["objects"], ["bracket"])
        answer = self.values("recognize", "0.png")[0]
        self.assertEqual((answer["completeness"], answer["reasons"]), ("COMPLETENESS_COMPLETE", []))
        scenes = self.values("dataset", "recognize", "parts", "val", "--scenes", "1,5", "--out", "r.csv")
        self.assertEqual([s.get("scene") for s in scenes], [1, 5, None])
        self.assertIn("ALL", self.values("dataset", "evaluate", "parts", "val", "r.csv")[0]["tiers"])
        load = self.values("load", "parts/val/000005", "--requests", "2")[0]
        self.assertEqual(load["steps"][0]["codes"], {"OK": 2})
        self.assertEqual(load["steps"][0]["accuracy"]["AR"], 0.0)
        self.assertEqual(self.values("object", "rm", "bracket")[0], {"id": "bracket", "verb": "removed"})

    def test_expected_parts_that_are_not_there_have_an_exit_code(self):
        for name, x, label in (("kit", 0.3, "pocket 1"), ("at_home", 0.015, "pocket 2")):
            with open(os.path.join(self.folder, name + ".json"), "w", encoding="utf-8") as out:
                json.dump({"expected_parts": [{
                    "object": "bracket", "label": label, "rotation_tolerance_rad": 3.0,
                    "frame_from_object": {"rotation": {"w": 1}, "translation_m": {"x": x, "y": 0.02, "z": 0.5}}}]}, out)
        for word, code, said in (("bracket", 0, "expected bracket: present (0.90)"),
                                 ("bracket=2", 5, "expected bracket: missing (0.7"),
                                 ("kit.json", 5, "expected bracket, pocket 1: displaced"),
                                 ("at_home.json", 0, "expected bracket, pocket 2: present")):
            # The stand-in's base is its scene.
            done = self.run_horopter("recognize", "0.png", "--reference", "bracket", "--expect", word)
            self.assertEqual(done.returncode, code, done.stdout + done.stderr)
            self.assertIn(said, done.stdout)
        done = self.run_horopter("recognize", "0.png", "--expect", "bracket=2", "--json")
        self.assertEqual(done.returncode, 5)
        self.assertEqual(json.loads(done.stdout)["expected"]["outcomes"][1]["state"], "STATE_MISSING")
        for bad in ("bracket=none", "nobody", "no_such.json", "grasps.json"):
            self.assertEqual(self.run_horopter("recognize", "0.png", "--expect", bad).returncode, 3, bad)

    def test_regions_reach_the_server_and_come_back(self):
        done = self.run_horopter("recognize", "0.png", "1.png", "--region", "2:10,20,30,40", "--region", "2:50,60,70,80", "--json")
        self.assertEqual(done.returncode, 0, done.stderr)
        cameras = json.loads(done.stdout)["cameras"]
        self.assertEqual([len(c["regions"]) for c in cameras], [0, 2])
        self.assertEqual(cameras[1]["regions"][1], {"x_px": 50, "y_px": 60, "width_px": 70, "height_px": 80})
        # A camera half a metre above the base that looks down, and a box at its feet.
        box = ["0", "0", "0", "1", "0", "0", "0", "0.1", "0.1", "0.02"]
        pose = ["0", "0", "0.5", "0", "1", "0", "0"]
        done = self.run_horopter("recognize", "0.png", "--focal", "700", "--camera-pose", *pose, "--region-box", *box, "--json")
        self.assertEqual(done.returncode, 0, done.stderr)
        region = json.loads(done.stdout)["cameras"][0]["regions"][0]
        self.assertAlmostEqual(region["x_px"] + region["width_px"] / 2, 320, delta=1)
        for words in (["--region", "1:700,0,9,9"], ["--region", "3:0,0,9,9"], ["--region", "1:0,0,9"], ["--region-box", *box]):
            self.assertEqual(self.run_horopter("recognize", "0.png", *words).returncode, 3, words)
        told = self.values("dataset", "recognize", "parts", "val", "--scenes", "5", "--true-regions", "parts", "--out", "r.csv")
        self.assertEqual(told[0]["scene"], 5)

    def test_a_station_tells_given_from_learnt_and_takes_several_poses_in_one_call(self):
        pose = ["0.1", "0.2", "0.9", "0", "1", "0", "0"]
        done = self.run_horopter("station", "set", "cell", "--camera-pose", "left", *pose, "--camera-pose", "right", *pose,
                                 "--camera-pose-sigma", "0.002", "0.001")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("2 cameras", done.stdout)
        shown = self.run_horopter("station", "show", "cell").stdout
        self.assertEqual(shown.count("in the robot base, given: 0.1000 0.2000 0.9000 m (1.00 mm, 0.115 degrees)"), 2, shown)
        self.assertEqual(self.run_horopter("station", "reset", "cell", "--keep-base").returncode, 0)
        read_only = self.values("recognize", "0.png", "--station", "cell", "--station-cameras", "left", "--read-only")[0]
        self.assertTrue(read_only["station"]["read_only"])
        for wrong in (("station", "set", "cell", "--camera-pose", "left", *pose[:-1], "x"),
                      ("station", "set", "cell", "--camera-pose", "left", *pose, "right"),
                      ("recognize", "0.png", "--read-only"),
                      ("recognize", "0.png", "1.png", "--station", "cell", "--station-cameras", "left,left"),
                      ("recognize", "0.png", "--camera-pose-sigma", "0.01", "0.01"),
                      ("recognize", "0.png", "--reference-sigma", "0.01", "0.01")):
            self.assertEqual(self.run_horopter(*wrong).returncode, 3, wrong)

    def test_one_bad_object_of_a_dataset_keeps_no_other_out(self):
        some = os.path.join(self.folder, "some")
        for kind, ending in (("cad", "step"), ("grasps", "json")):
            os.makedirs(os.path.join(some, kind))
            for i in (1, 2, 3):
                name = "obj_%06d.%s" % (i, ending)
                shutil.copy(os.path.join(DATASET, kind, name), os.path.join(some, kind, name))
        with open(os.path.join(some, "grasps", "obj_000002.json"), "w", encoding="utf-8") as out:
            out.write('{"grasps": [')
        done = self.run_horopter("dataset", "enroll", some, "--json")
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("1 of 3 objects not enrolled", json.loads(done.stderr)["error"]["message"])
        listed = [json.loads(line) for line in done.stdout.splitlines()]
        self.assertEqual([o["id"] for o in listed], ["obj_000001", "obj_000002", "obj_000003"])
        self.assertIn("obj_000002.json", listed[1]["error"])
        there = [o["id"] for o in self.values("object", "list")[0]["objects"]]
        self.assertEqual(there, ["bracket", "obj_000001", "obj_000003"])

    def test_errors_are_json_with_request_and_field(self):
        done = self.run_horopter("recognize", "0.png", "--candidates", "nobody", "--json")
        self.assertEqual(done.returncode, 3)
        error = json.loads(done.stderr)["error"]
        self.assertEqual(error["code"], "NOT_FOUND")
        self.assertEqual(error["field"], "candidate_objects[0]")
        self.assertRegex(error["request_id"], r"^[0-9a-f]{8}-\d{6}$")

    def test_cameras_of_results_hold_the_distortion(self):
        self.values("dataset", "recognize", "parts", "val", "--scenes", "5", "--out", "r.csv")
        with open(os.path.join(self.folder, "r.cameras.json"), encoding="utf-8") as file:
            camera = json.load(file)["5"]["0"]
        self.assertEqual(len(camera["cam_K"]), 9)
        self.assertEqual(len(camera["cam_dist"]), 4)  # k1 k2 p1 p2


class Hints(Workplace):

    def test_what_does_not_fit_is_refused_before_the_request(self):
        for arguments, said in (
                (("--focal", "1000", "1000", "1000"), "3 for 2"),
                (("--focal", "1000", "--camera", "left.yaml"), "give one of them"),
                (("--camera", "nosuch.yaml"), "cannot be opened"),
                (("--camera-pose", "0", "0", "0", "1", "0", "0", "0"), "each of the 2 images"),
                (("--camera-pose", *("0 0 0 2 0 0 0 0 0 0 1 0 0 0".split())), "norm")):
            done = self.run_horopter("recognize", "0.png", "1.png", *arguments)
            self.assertEqual(done.returncode, 3, arguments)
            self.assertIn(said, done.stderr)

    def test_a_hint_reaches_the_server(self):
        done = self.run_horopter("recognize", "0.png", "1.png", "--focal", "-5")
        self.assertEqual(done.returncode, 3)
        self.assertIn("camera_hint.focal_px", done.stderr)
        done = self.run_horopter("recognize", "0.png", "1.png", "--camera", "left.yaml", "--camera-pose",
                                 *("0 0 -0.5 1 0 0 0 0.1 0 -0.5 1 0 0 0".split()))
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_a_calibration_of_another_shape_is_refused(self):
        with open(os.path.join(self.folder, "square.yaml"), "w", encoding="utf-8") as out:
            out.write("image_width: 500\nimage_height: 500\nK: [500, 0, 250, 0, 500, 250, 0, 0, 1]\n")
        done = self.run_horopter("recognize", "0.png", "--camera", "square.yaml")
        self.assertEqual(done.returncode, 3)
        self.assertIn("500 x 500", done.stderr)

    def test_calibrations_of_other_programs_arrive(self):
        cameras = os.path.join(INPUTS, "cameras")
        for name in ("nested.yaml", "opencv.xml", "bop_camera.json", "kalibr_camchain.yaml#cam1", "ros_rational.yaml",
                     "ros_roi_same_aspect.yaml", "opencv_fisheye.yml", "colmap_cameras.txt"):
            done = self.run_horopter("recognize", "0.png", "--camera", os.path.join(cameras, name))
            self.assertEqual((name, done.returncode, done.stderr), (name, 0, ""))
        done = self.run_horopter("recognize", os.path.join(INPUTS, "images", "whole_0.heic"), "--camera",
                                 os.path.join(cameras, "nested.yaml"))
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        done = self.run_horopter("recognize", "0.png", "1.png", "--camera", "left.yaml")
        self.assertEqual((done.returncode, done.stderr.count("supposed to be scaled by 0.5")), (0, 1))
        for name, said in (("colmajor.yaml", "transposed"), ("identityK.yaml", "focal length of 1 "),
                           ("stereo.yml", "FILE#1")):
            for command in (("recognize", "0.png", "--camera"), ("station", "import", "cell1", "left")):
                done = self.run_horopter(*command, os.path.join(cameras, name))
                self.assertEqual(done.returncode, 3, name)
                self.assertIn(said, done.stderr)
        for name in ("ros_roi_same_aspect.yaml", "ros_binned.yaml"):
            self.run_horopter("station", "set", "cell1", "--fixed", "left")
            done = self.run_horopter("station", "import", "cell1", "left", os.path.join(cameras, name))
            self.assertEqual(done.returncode, 0, done.stderr)
            self.run_horopter("station", "export", "cell1", "left", "out.yaml")
            with open(os.path.join(self.folder, "out.yaml"), encoding="utf-8") as file:
                said = file.read()
            self.assertIn("image_width: 640", said)
            self.assertIn("[979.75, 0, 313.64, 0, 979.75, 237.58, 0, 0, 1]", said)

    def test_grasps_of_row_vectors_are_refused(self):
        done = self.run_horopter("object", "add", "bracket.step", "--id", "other", "--grasps",
                                 os.path.join(INPUTS, "grasps", "transposed.json"))
        self.assertEqual(done.returncode, 3)
        self.assertIn("row vectors?", done.stderr)

    def test_no_token_ends_the_program(self):
        def run(token, *arguments):
            environment = dict(os.environb, HOROPTER_SERVER=self.mock.address.encode())
            environment = {os.fsencode(k): v if isinstance(v, bytes) else v.encode() for k, v in environment.items()}
            environment.pop(b"HOROPTER_TOKEN", None)
            if token is not None:
                environment[b"HOROPTER_TOKEN"] = token
            return subprocess.run([HOROPTER, *arguments, "object", "list"], cwd=self.folder, env=environment, capture_output=True,
                                  text=True, timeout=60, check=False)
        for token in (b"0123456789abcdef\r\n", b" 0123456789abcdef", b"\xef\xbb\xbf0123456789abcdef", b"\n"):
            done = run(token)
            self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertEqual(run(None, "--token-file", os.path.join(INPUTS, "tokens", "crlf")).returncode, 0)
        for token in (b"0123456789\nabcdef", b"0123456789\x80abcdef", b"0123456789\x1babcdef"):
            with open(os.path.join(self.folder, "token"), "wb") as out:
                out.write(b"\xff" + token)
            for done, where in ((run(token), "HOROPTER_TOKEN: line 1, column 11"), (run(None, "--token-file", "token"), "column 1")):
                self.assertEqual(done.returncode, 3, done.stderr)
                self.assertIn(where, done.stderr)
                self.assertNotIn("0123456789", done.stderr + done.stdout)
                self.assertNotIn("abcdef", done.stderr + done.stdout)


class Failures(Workplace):

    MOCK_ARGUMENTS = ("--delay-ms", "300", "--workers", "1", "--queue", "0")

    def test_exit_codes(self):
        self.assertEqual(self.run_horopter("--version").returncode, 0)
        self.assertRegex(self.run_horopter("--version").stdout, r"^horopter \d+\.\d+\.\d+(-rc\d+)?\n$")
        self.assertEqual(self.run_horopter("nonsense").returncode, 2)
        self.assertEqual(self.run_horopter("object", "show", "nobody").returncode, 3)
        self.assertEqual(self.run_horopter("object", "history", "nobody").returncode, 3)
        self.assertEqual(self.run_horopter("object", "restore", "bracket").returncode, 3)  # it was never changed
        self.assertEqual(self.run_horopter("object", "restore", "bracket", "99").returncode, 3)
        stale = self.run_horopter("object", "restore", "bracket", "1", "--if-match", "stale")
        self.assertEqual((stale.returncode, "if_match" in stale.stderr), (1, True), stale.stderr)
        self.assertEqual(self.run_horopter("load", "no/such/folder").returncode, 3)
        os.mkdir(os.path.join(self.folder, "empty"))
        self.assertEqual(self.run_horopter("load", "empty").returncode, 3)
        self.assertEqual(self.run_horopter("recognize", "0.png", "--timeout", "0.05").returncode, 4)
        done = self.run_horopter("status", "--server", "127.0.0.1:1", "--timeout", "5")
        self.assertEqual(done.returncode, 4)
        self.assertIn("127.0.0.1:1", done.stderr)
        self.assertIn("nothing listens there", done.stderr)
        done = self.run_horopter("status", "--tls", "--timeout", "5")
        self.assertEqual(done.returncode, 4)
        self.assertIn("does not speak TLS", done.stderr)
        self.assertEqual(self.run_horopter("catalog", "backup", "no/such/folder/b.db").returncode, 3)
        self.assertEqual(self.run_horopter("catalog", "backup", "/proc/b.db").returncode, 3)
        self.assertEqual(self.run_horopter("catalog", "backup", "").returncode, 3)

    def test_no_name_reaches_the_terminal_as_a_command(self):
        self.run_horopter("object", "update", "bracket", "--name", "\x1b[2Jgone")
        for words in (("object", "list"), ("recognize", "0.png")):
            said = self.run_horopter(*words).stdout
            self.assertNotIn("\x1b", said)
            self.assertIn("\\x1b[2Jgone", said)

    def test_an_image_set_with_a_missing_image_names_it(self):
        done = self.run_horopter("recognize", "0.png", "gone.png")
        self.assertEqual(done.returncode, 3)
        self.assertIn("gone.png", done.stderr)

    def test_a_busy_server_is_asked_again(self):
        busy = subprocess.Popen([HOROPTER, "load", "parts/val/000005", "--requests", "20", "--server", self.mock.address],
                                cwd=self.folder, stdout=subprocess.DEVNULL)
        self.await_recordings(1)
        for _ in range(5):  # between two of the load's requests the server is not busy
            refused = self.run_horopter("recognize", "0.png", "--retries", "0", "--json")
            if refused.returncode != 0:
                break
        self.assertEqual(refused.returncode, 4, refused.stderr)
        self.assertGreater(json.loads(refused.stderr)["error"]["retry_after_ms"], 0)
        patient = self.run_horopter("recognize", "0.png", "--retries", "50")
        self.assertEqual(patient.returncode, 0, patient.stderr)
        self.assertIn("trying again", patient.stderr)
        self.assertEqual(busy.wait(), 0)

    def test_refusals_are_counted_by_code(self):
        done = self.run_horopter("load", "parts/val/000005", "--rate", "20", "--duration", "1", "--json")
        self.assertEqual(done.returncode, 0, done.stderr)
        codes = json.loads(done.stdout)["steps"][0]["codes"]
        self.assertGreater(codes["RESOURCE_EXHAUSTED"], 5)
        self.assertGreater(codes["OK"], 1)

    def test_ctrl_c_keeps_what_is_there(self):
        for command, made in ((("load", "parts/val/000005", "--duration", "60", "--csv", "l.csv"), "l.csv"),
                              (("dataset", "recognize", "parts", "val", "--out", "r.csv"), "r.cameras.json")):
            process = subprocess.Popen([HOROPTER, *command, "--server", self.mock.address], cwd=self.folder,
                                       stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            self.await_recordings(2)
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=20)
            self.assertEqual(process.returncode, 130, errors)
            self.assertIn("interrupted", errors)
            with open(os.path.join(self.folder, made), encoding="utf-8") as file:
                self.assertGreaterEqual(len(file.readlines()), 2, made)

    def test_a_server_that_goes_away_in_mid_run_leaves_the_part_before(self):
        process = subprocess.Popen([HOROPTER, "load", "parts/val/000005", "--duration", "60", "--json-file", "l.json",
                                    "--server", self.mock.address], cwd=self.folder, stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True)
        self.await_recordings(2)
        self.mock.stop()
        _, errors = process.communicate(timeout=30)
        self.assertEqual(process.returncode, 4, errors)
        with open(os.path.join(self.folder, "l.json"), encoding="utf-8") as file:
            step = json.load(file)["steps"][0]
        self.assertTrue(step["server_gone"])
        self.assertGreater(step["codes"]["OK"], 0)


class Interrupted(Workplace):
    """Ctrl-C while a server takes connections and never says a word."""

    OFFLINE = (("completion",), ("manual",), ("dataset", "evaluate"), ("catalog", "migrate"))

    def setUp(self):
        super().setUp()
        self.run_horopter("recognize", "0.png")  # something to replay
        self.run_horopter("catalog", "backup", "copy.db")

    def begin(self, example):
        """The running command and its connection: it waits for the server's first word."""
        silent = socket.socket()
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        silent.settimeout(0.5)
        process = subprocess.Popen(["bash", "-c", "exec '%s' %s" % (HOROPTER, example)], cwd=self.folder,
                                   env=dict(os.environ, HOROPTER_SERVER="127.0.0.1:%d" % silent.getsockname()[1]),
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        with silent:
            while True:
                try:
                    return process, silent.accept()[0]
                except TimeoutError:
                    if process.poll() is not None:
                        raise AssertionError("it ended before it asked: %s" % (process.communicate(),)) from None

    def test_every_command_ends_at_once_says_so_and_leaves_nothing_half_done(self):
        before = sorted(os.listdir(self.folder))
        asked = 0
        for path, said in commands():
            if path in self.OFFLINE:
                continue
            example = re.findall(r"^  horopter (.*)$", said.split("Example:")[-1], re.M)[0]
            with self.subTest(" ".join(path)):
                if path == ("catalog", "restore"):  # there only now: a backup does not write over a file
                    os.rename(os.path.join(self.folder, "copy.db"), os.path.join(self.folder, "parts-backup.db"))
                    before.append("parts-backup.db")
                process, connection = self.begin(example)
                with connection:
                    start = time.monotonic()
                    process.send_signal(signal.SIGINT)
                    _, errors = process.communicate(timeout=60)
                self.assertEqual(process.returncode, 130, errors)
                self.assertIn("interrupted", errors)
                self.assertLess(time.monotonic() - start, 20.0)
                asked += 1
        self.assertGreater(asked, 15)
        # Results so far are kept, copies of the catalog are whole or not there.
        kept = {"results.csv", "results.cameras.json", "load.csv"}
        self.assertEqual([f for f in sorted(os.listdir(self.folder)) if f not in before and f not in kept], [])


class Terminals(Workplace):
    MOCK_ARGUMENTS = ("--delay-ms", "3200", "--workers", "1")

    def on_a_terminal(self, term, *arguments):
        """What the program writes to a terminal, with what it ended."""
        ours, theirs = os.openpty()
        environment = dict(os.environ, HOROPTER_SERVER=self.mock.address, TERM=term)
        process = subprocess.Popen([HOROPTER, *arguments], cwd=self.folder, env=environment, stdin=subprocess.DEVNULL,
                                   stdout=theirs, stderr=theirs)
        os.close(theirs)
        written = b""
        while True:
            try:
                piece = os.read(ours, 4096)
            except OSError:  # the other end is closed
                break
            if not piece:
                break
            written += piece
        os.close(ours)
        return process.wait(), written

    def test_a_terminal_without_colours_sees_a_bar_and_no_escape_codes(self):
        for term in ("dumb", "xterm"):
            code, written = self.on_a_terminal(term, "load", "parts/val/000005", "--requests", "2", "--max-images", "1")
            self.assertEqual(code, 0, written)
            self.assertIn(b"\rrequests [", written)
            self.assertNotIn(b"\x1b", written)

    def test_without_a_terminal_there_is_no_bar(self):
        done = self.run_horopter("load", "parts/val/000005", "--requests", "1", "--max-images", "1")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertNotIn("\r", done.stdout + done.stderr)

    def test_without_any_output_the_work_is_done(self):
        environment = dict(os.environ, HOROPTER_SERVER=self.mock.address)
        closed = subprocess.run(["bash", "-c", "exec '%s' load parts/val/000005 --requests 1 --csv quiet.csv >&- 2>&- <&-" % HOROPTER],
                                cwd=self.folder, env=environment, check=False, timeout=60)
        self.assertEqual(closed.returncode, 0)
        with open(os.path.join(self.folder, "quiet.csv"), encoding="utf-8") as file:
            self.assertEqual(len(file.readlines()), 2)


class Versions(Workplace):
    MOCK_ARGUMENTS = ("--version-name", "9.9.9")

    def test_a_recording_of_another_version_names_both_when_it_differs(self):
        self.run_horopter("recognize", "0.png")
        self.run_horopter("object", "add", "parts/cad/obj_000002.step", "--id", "a-first")
        recordings = os.path.join(self.folder, "recordings")
        done = self.run_horopter("replay", os.path.join(recordings, os.listdir(recordings)[0]))
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertRegex(done.stdout, r"recorded by version 9\.9\.9, this server is version \d")

    def test_a_server_without_the_call_is_said_to_be_another_version(self):
        # A gRPC server that has none of the services.
        import grpc
        from concurrent import futures
        server = grpc.server(futures.ThreadPoolExecutor(1))
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        try:
            for command in (("object", "list"), ("recognize", "0.png"), ("replay", "0.png")):
                done = self.run_horopter(*command, "--server", "127.0.0.1:%d" % port)
                self.assertEqual(done.returncode, 1, done.stderr)
                self.assertIn("does not know this call", done.stderr)
        finally:
            server.stop(None)


class Pictures(Workplace):

    def test_the_server_draws_png_and_svg(self):
        done = self.run_horopter("recognize", "0.png", "1.png", "--out", "over.svg")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("overlay in over-1.svg, over-2.svg", done.stdout)
        for i in (1, 2):
            root = ElementTree.parse(os.path.join(self.folder, "over-%d.svg" % i)).getroot()
            self.assertGreater(len(list(root.iter("{http://www.w3.org/2000/svg}polyline"))), 5)

    def test_a_drawing_is_what_its_name_says_and_has_a_place_before_anybody_searches(self):
        for name, begin in (("over.jpg", b"\xff\xd8\xff"), ("over.JPEG", b"\xff\xd8\xff"), ("over.png", b"\x89PNG"),
                            ("over", b"\x89PNG")):
            done = self.run_horopter("recognize", "0.png", "1.png", "--out", name)
            self.assertEqual(done.returncode, 0, done.stderr)
            with open(os.path.join(self.folder, name), "rb") as file:
                self.assertTrue(file.read(4).startswith(begin), name)
        self.assertEqual(self.run_horopter("object", "preview", "bracket", "--out", "p.jpg").returncode, 0)
        with open(os.path.join(self.folder, "p.jpg"), "rb") as file:
            self.assertEqual(file.read(3), b"\xff\xd8\xff")
        # Of a server that is not there nobody could tell more.
        for arguments in (("recognize", "0.png"), ("explain", "bracket", "0.png")):
            for name, says in (("gone/over.png", "no folder gone"), ("over.gif", ".png, .jpg or .svg"), ("parts", "folder")):
                done = self.run_horopter("--server", "127.0.0.1:1", *arguments, "--out", name)
                self.assertEqual(done.returncode, 3, done.stderr)
                self.assertIn(says, done.stderr)
        done = self.run_horopter("object", "add", "bracket.step", "--id", "other", "--preview", "gone/p.png")
        self.assertEqual(done.returncode, 3)
        self.assertNotIn("other", self.run_horopter("object", "list").stdout)

    def test_a_url_is_no_address(self):
        done = self.run_horopter("--server", "http://" + self.mock.address, "object", "list")
        self.assertEqual(done.returncode, 3)
        self.assertIn("here '%s'" % self.mock.address, done.stderr)

    def test_names_in_another_encoding_become_utf_8(self):
        shutil.copy(os.path.join(self.folder, "bracket.step"), os.path.join(os.fsencode(self.folder), b"Tr\xe4ger.step"))
        done = subprocess.run([os.fsencode(HOROPTER), b"object", b"add", b"Tr\xe4ger.step", b"--id", b"b2", b"--name", b"Tr\xe4ger"],
                              cwd=self.folder, env=dict(os.environ, HOROPTER_SERVER=self.mock.address), capture_output=True,
                              check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        shown = self.run_horopter("object", "show", "b2").stdout
        self.assertRegex(shown, "name +Tr\xe4ger")
        self.assertIn("Tr\xe4ger.step", shown)
        done = subprocess.run([os.fsencode(HOROPTER), b"object", b"show", b"Tr\xe4ger"], cwd=self.folder,
                              env=dict(os.environ, HOROPTER_SERVER=self.mock.address), capture_output=True, check=False)
        self.assertEqual(done.returncode, 3, done.stderr)  # refused by the server, which could read it

    def bop(self, name, models="models", object_="obj_000015", scene="000001", rgb="rgb", suffix=""):
        """One object and one scene of the samples in another layout; the folder of the scene."""
        folder = os.path.join(self.folder, name)
        os.makedirs(os.path.join(folder, models))
        shutil.copy(os.path.join(DATASET, "models", "obj_000015.ply"), os.path.join(folder, models, object_ + ".ply"))
        with open(os.path.join(DATASET, "models", "models_info.json"), encoding="utf-8") as file:
            info = json.load(file)
        with open(os.path.join(folder, models, "models_info.json"), "w", encoding="utf-8") as file:
            json.dump({"15": info["15"]}, file)
        to = os.path.join(folder, "test", scene)
        shutil.copytree(os.path.join(DATASET, "val", "000001", "rgb"), os.path.join(to, rgb))
        for kind in ("scene_camera", "scene_gt", "scene_gt_info"):
            shutil.copy(os.path.join(DATASET, "val", "000001", kind + ".json"), os.path.join(to, kind + suffix + ".json"))
        return to

    def test_datasets_as_bop_publishes_them_are_enrolled_recognised_and_scored(self):
        self.run_horopter("object", "rm", "bracket")
        made = {name: self.bop(name, **layout) for name, layout in {
            "cad": {"models": "models_cad"}, "eval": {"models": "models_eval"}, "reconst": {"models": "models_reconst"},
            "scene": {"scene": "01"}, "object": {"object_": "obj_15"}, "sensor": {"rgb": "rgb_cam1", "suffix": "_cam1"},
            "nan": {}, "partial": {}, "no_truth": {}, "broken_truth": {}}.items()}
        path = os.path.join(made["nan"], "scene_gt_info.json")
        with open(path, encoding="utf-8") as file:
            text = file.read()
        with open(path, "w", encoding="utf-8") as file:
            file.write(re.sub(r'"visib_fract": [0-9.]+', '"visib_fract": NaN', text, count=1))
        path = os.path.join(made["partial"], "scene_gt_info.json")
        with open(path, encoding="utf-8") as file:
            info = json.load(file)
        info.pop("2")
        with open(path, "w", encoding="utf-8") as file:
            json.dump(info, file)
        for kind in ("scene_gt", "scene_gt_info", "scene_camera"):
            os.remove(os.path.join(made["no_truth"], kind + ".json"))
            with open(os.path.join(made["broken_truth"], kind + ".json"), "w", encoding="utf-8") as file:
                file.write("{")
        for name in made:
            with self.subTest(name):
                done = self.run_horopter("dataset", "enroll", name)
                self.assertEqual(done.returncode, 0, done.stderr + done.stdout)
                done = self.run_horopter("dataset", "recognize", name, "test", "--out", "r.csv")
                self.assertEqual(done.returncode, 0, done.stderr)
                self.assertIn("5 images", done.stdout)
                with open(os.path.join(self.folder, "r.csv"), encoding="utf-8") as file:
                    self.assertEqual(len(file.readlines()), 6)
                if "truth" not in name:
                    done = self.run_horopter("dataset", "evaluate", name, "test", "r.csv")
                    self.assertEqual(done.returncode, 0, done.stderr)

    def test_target_files_say_which_images_are_taken_together(self):
        self.run_horopter("object", "rm", "bracket")
        self.bop("multi")
        path = os.path.join(self.folder, "multi", "test_targets_multiview_bop25.json")
        with open(path, "w", encoding="utf-8") as file:
            json.dump([{"scene_id": 1, "im_ids": [0, 2], "obj_id": 15, "inst_count": 1}, {"scene_id": 1, "im_ids": [1]}], file)
        self.run_horopter("dataset", "enroll", "multi")
        done = self.run_horopter("dataset", "recognize", "multi", "test", "--out", "r.csv")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("2 images", done.stdout)
        self.assertIn("1 images", done.stdout)
        done = self.run_horopter("dataset", "recognize", "multi", "test", "--targets", "none", "--out", "r.csv")
        self.assertIn("5 images", done.stdout)
        with open(path, "w", encoding="utf-8") as file:
            json.dump([{"scene_id": 1, "im_ids": [0, 7]}], file)
        done = self.run_horopter("dataset", "recognize", "multi", "test", "--out", "r.csv")
        self.assertEqual(done.returncode, 3)
        self.assertIn("no image 7", done.stderr)

    def test_explain_tells_the_test_and_the_edges(self):
        done = self.run_horopter("explain", "bracket", "0.png", "1.png", "--out", "why.png")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("TEST_SUPPORT", done.stdout)
        self.assertIn("edge 0: 80 of 80 px without support", done.stdout)
        self.assertTrue(os.path.exists(os.path.join(self.folder, "why.png")))
        said = json.loads(self.run_horopter("explain", "bracket", "0.png", "--json").stdout)
        self.assertEqual(said["failed_test"], "TEST_SUPPORT")
        self.assertEqual((said["value"], said["needed"]), (0.25, 0.5))
        nobody = self.run_horopter("explain", "nobody", "0.png")
        self.assertEqual(nobody.returncode, 3)
        self.assertIn("explain_object", nobody.stderr)


class Latency(Workplace):

    MOCK_ARGUMENTS = ("--delay-ms", "100", "--workers", "8")

    def test_percentiles_agree_with_the_time_the_server_takes(self):
        done = self.run_horopter("load", "parts/val/000005", "--max-images", "1", "--rate", "20", "--duration", "3",
                                 "--json", "--warmup", "2")
        step = json.loads(done.stdout)["steps"][0]
        self.assertEqual(step["codes"], {"OK": 60})
        self.assertGreaterEqual(step["latency"]["p50_ms"], 100.0)
        self.assertLess(step["client_cpu_share"], 0.5)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
