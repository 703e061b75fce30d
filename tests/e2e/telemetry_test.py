#!/usr/bin/env python3
"""Metrics, request log, traces and recordings of a running server, from outside.

    telemetry_test.py HOROPTER MOCK_HOROPTERD DATASET DASHBOARD
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
import urllib.parse
import urllib.request

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))
from mock_server import Mock  # noqa: E402

HOROPTER, MOCK, DATASET, DASHBOARD = map(os.path.abspath, sys.argv[1:5])
SCENE = os.path.join(DATASET, "val", "000005")
IMAGE = os.path.join(SCENE, "rgb", "000000.png")


class Served(unittest.TestCase):
    MOCK_ARGUMENTS = ()
    LIMIT_FILES_TO = None

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.log = os.path.join(self.folder, "requests.jsonl")
        self.traces = os.path.join(self.folder, "traces.jsonl")
        self.recordings = os.path.join(self.folder, "recordings")
        command = [MOCK, "--metrics-listen", "127.0.0.1:0", "--request-log", self.log, "--trace-file", self.traces,
                   "--record-dir", self.recordings, *self.MOCK_ARGUMENTS]
        if self.LIMIT_FILES_TO is not None:
            # SIGXFSZ ignored: writing beyond the limit fails, as on a full disk.
            limit = "trap '' XFSZ; ulimit -f %d; exec " % self.LIMIT_FILES_TO
            command = ["bash", "-c", limit + '"$0" "$@"', *command]
        self.mock = Mock(MOCK, command=command)
        self.process, self.address, self.metrics_url = self.mock.process, self.mock.address, self.mock.metrics_url

    def tearDown(self):
        self.mock.stop()
        shutil.rmtree(self.folder)

    def run_horopter(self, *arguments):
        return subprocess.run([HOROPTER, "--server", self.address, *arguments], capture_output=True, text=True, timeout=60,
                              check=False, cwd=self.folder)

    def metrics(self):
        with urllib.request.urlopen(self.metrics_url, timeout=10) as answer:
            return answer.read().decode()

    def metric(self, name):
        """Value of a series, e.g. 'x_total{a="b"}'."""
        found = re.search("^" + re.escape(name) + r" (\S+)$", self.metrics(), re.M)
        return float(found.group(1)) if found else None

    def enrol(self):
        done = self.run_horopter("object", "add", os.path.join(DATASET, "cad", "obj_000001.step"), "--id", "bracket")
        self.assertEqual(done.returncode, 0, done.stderr)

    @staticmethod
    def lines(path):
        with open(path, encoding="utf-8") as file:
            return [json.loads(line) for line in file]


class Metrics(Served):

    def test_calls_are_counted_by_what_became_of_them(self):
        self.enrol()
        for _ in range(3):
            self.assertEqual(self.run_horopter("recognize", IMAGE).returncode, 0)
        self.assertEqual(self.run_horopter("recognize", IMAGE, "--candidates", "nobody").returncode, 3)
        scene = 'method="RecognizeScene"'
        self.assertEqual(self.metric('horopter_requests_total{code="OK",%s}' % scene), 3)
        self.assertEqual(self.metric('horopter_requests_total{code="NOT_FOUND",%s}' % scene), 1)
        self.assertEqual(self.metric('horopter_refusals_total{%s,reason="not_found"}' % scene), 1)
        self.assertEqual(self.metric('horopter_answers_total{state="RECOGNIZED"}'), 3)
        self.assertEqual(self.metric("horopter_objects_found_total"), 3)
        self.assertEqual(self.metric('horopter_request_seconds_count{%s}' % scene), 4)
        self.assertEqual(self.metric('horopter_stage_seconds_count{stage="decode"}'), 3)
        self.assertEqual(self.metric("horopter_catalog_objects"), 1)
        self.assertEqual(self.metric('horopter_build_info{version="mock"}'), 1)
        self.assertGreater(self.metric("process_resident_memory_bytes"), 1e6)
        self.assertEqual((self.metric("horopter_scenes_running"), self.metric("horopter_scenes_waiting")), (0, 0))
        self.assertEqual(self.metric("horopter_memory_reserved_bytes"), 0)
        self.assertGreater(self.metric("horopter_memory_limit_bytes"), 1e6)
        self.assertGreater(self.metric("process_open_fds"), 3)
        self.assertGreater(self.metric("process_max_fds"), self.metric("process_open_fds"))
        self.assertEqual(self.metric('horopter_requests_total{code="OK",method="CreateObject"}'), 1)
        start = time.perf_counter()
        for _ in range(20):
            self.metrics()
        print("a scrape takes %.1f ms" % ((time.perf_counter() - start) * 50))
        if shutil.which("promtool"):
            judged = subprocess.run(["promtool", "check", "metrics"], input=self.metrics(), capture_output=True, text=True,
                                    check=False)
            self.assertEqual(judged.returncode, 0, judged.stdout + judged.stderr)

    def test_what_a_station_finds_is_told_until_it_is_over(self):
        def finding(kind):
            return self.metric('horopter_station_finding{kind="%s",station="bench"}' % kind)

        calibration = os.path.join(self.folder, "camera.yaml")
        with open(calibration, "w", encoding="utf-8") as out:
            out.write("image_width: 1280\nimage_height: 960\ncamera_matrix: {rows: 3, cols: 3, data: [1000, 0, 640, 0, 1000, 480, 0, 0, 1]}\n"
                      "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n")
        self.enrol()
        for command in (("station", "set", "bench"), ("station", "import", "bench", "left", calibration)):
            done = self.run_horopter(*command)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertIsNone(finding("IMAGE_SIZE_CHANGED"))
        done = self.run_horopter("recognize", IMAGE, "--station", "bench", "--station-cameras", "left")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertEqual((finding("IMAGE_SIZE_CHANGED"), finding("BASE_MOVED")), (1, 0))
        self.assertEqual(self.run_horopter("station", "rm", "bench").returncode, 0)
        self.assertEqual(self.run_horopter("station", "set", "bench").returncode, 0)
        self.assertEqual(self.run_horopter("recognize", IMAGE, "--station", "bench", "--station-cameras", "left").returncode, 0)
        self.assertEqual(finding("IMAGE_SIZE_CHANGED"), 0)

    def test_a_line_and_a_trace_a_request(self):
        self.enrol()
        self.run_horopter("recognize", IMAGE)
        lines = [line for line in self.lines(self.log) if line["method"] == "RecognizeScene"]
        self.assertEqual(len(lines), 1)
        self.assertEqual(lines[0]["state"], "RECOGNIZED")
        self.assertEqual((lines[0]["reasons"], lines[0]["time_limited"]), ([], False))
        self.assertEqual(lines[0]["images"], 1)
        self.assertIn("decode", lines[0]["stages_ms"])
        self.assertTrue(lines[0]["peer"].startswith("ipv4:127.0.0.1"))
        spans = [t["resourceSpans"][0]["scopeSpans"][0]["spans"] for t in self.lines(self.traces)]
        mine = [s for s in spans if s[0]["name"].endswith("RecognizeScene")][0]
        self.assertEqual(mine[0]["traceId"], lines[0]["trace_id"])
        self.assertIn("features", [s["name"] for s in mine])

    def test_every_panel_of_the_dashboard_has_data_in_a_running_prometheus(self):
        program = shutil.which("prometheus")
        if program is None:
            self.skipTest("no prometheus")
        self.enrol()
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        config = os.path.join(self.folder, "prometheus.yml")
        with open(config, "w", encoding="utf-8") as out:
            out.write("scrape_configs:\n  - job_name: horopter\n    scrape_interval: 1s\n    static_configs:\n"
                      "      - targets: ['%s']\n" % urllib.parse.urlparse(self.metrics_url).netloc)
        prometheus = subprocess.Popen([program, "--config.file", config, "--storage.tsdb.path",
                                       os.path.join(self.folder, "tsdb"), "--web.listen-address", "127.0.0.1:%d" % port],
                                      stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            with open(DASHBOARD, encoding="utf-8") as file:
                panels = json.load(file)["panels"]
            expressions = [t["expr"].replace("$__rate_interval", "30s") for p in panels for t in p["targets"]]
            self.assertGreater(len(expressions), 12)
            empty = expressions
            deadline = time.monotonic() + 40
            while empty and time.monotonic() < deadline:
                self.run_horopter("recognize", IMAGE)
                time.sleep(1.0)
                empty = [e for e in expressions if not self.result_of(port, e)]
            self.assertEqual(empty, [])
        finally:
            prometheus.send_signal(signal.SIGTERM)
            prometheus.wait(20)

    @staticmethod
    def result_of(port, expression):
        url = "http://127.0.0.1:%d/api/v1/query?query=%s" % (port, urllib.parse.quote(expression))
        try:
            with urllib.request.urlopen(url, timeout=5) as answer:
                return json.load(answer)["data"]["result"]
        except OSError:
            return []


class Recordings(Served):
    MOCK_ARGUMENTS = ("--record-sample", "1")

    def test_a_recording_is_replayed_and_says_what_differs(self):
        self.enrol()
        self.run_horopter("recognize", IMAGE)
        self.run_horopter("recognize", IMAGE, "--candidates", "nobody")
        files = [os.path.join(self.recordings, f) for f in sorted(os.listdir(self.recordings))]
        self.assertEqual(len(files), 2)
        self.assertEqual(self.metric("horopter_recordings_total"), 2)
        same = self.run_horopter("replay", *files)
        self.assertEqual(same.returncode, 0, same.stdout + same.stderr)
        self.assertIn("2 recordings, 0 answers differ", same.stdout)
        # Another catalog: the first object is another one.
        self.run_horopter("object", "add", os.path.join(DATASET, "cad", "obj_000002.step"), "--id", "a-first")
        other = self.run_horopter("replay", *files)
        self.assertEqual(other.returncode, 1)
        self.assertIn('"objects/bracket" -> "objects/a-first"', other.stdout)

    def test_a_recording_is_what_load_replays(self):
        self.enrol()
        self.run_horopter("recognize", IMAGE)
        load = self.run_horopter("load", self.recordings, "--requests", "3", "--json")
        self.assertEqual(load.returncode, 0, load.stderr)
        self.assertEqual(json.loads(load.stdout)["steps"][0]["codes"], {"OK": 3})

    def test_broken_recordings_are_named(self):
        self.run_horopter("recognize", IMAGE)
        path = os.path.join(self.recordings, os.listdir(self.recordings)[0])
        with open(path, "rb") as file:
            whole = file.read()
        for broken in (whole[:-100], whole[:100], b"", b"something else" * 100, whole[:7] + b"9" + whole[8:]):
            name = os.path.join(self.folder, "broken.horec")
            with open(name, "wb") as out:
                out.write(broken)
            for command in ("replay", "load"):
                done = self.run_horopter(command, name)
                self.assertEqual(done.returncode, 3, done.stderr)
                self.assertIn("broken.horec", done.stderr)

    def test_a_server_that_is_not_there_is_said(self):
        self.run_horopter("recognize", IMAGE)
        path = os.path.join(self.recordings, os.listdir(self.recordings)[0])
        self.process.kill()
        self.assertEqual(self.run_horopter("replay", path, "--timeout", "5").returncode, 4)


class FullDisk(Served):
    MOCK_ARGUMENTS = ("--record-sample", "1")
    LIMIT_FILES_TO = 64  # KiB: less than an image

    def test_serving_goes_on_and_a_metric_says_so(self):
        for _ in range(3):
            self.assertEqual(self.run_horopter("recognize", IMAGE).returncode, 0)
        self.assertEqual(self.metric("horopter_recordings_failed_total"), 3)
        lost = "could not be recorded in " + self.recordings
        deadline = time.monotonic() + 30  # the log is read beside us
        while not any(lost in line for line in self.mock.said) and time.monotonic() < deadline:
            time.sleep(0.05)
        self.assertTrue(any(lost in line for line in self.mock.said))
        self.assertEqual(os.listdir(self.recordings), [])


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
