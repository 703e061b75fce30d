#!/usr/bin/env python3
"""What a server does when the machine's clock is set forward and back under it (libfaketime; skipped where it is not installed).

    clock_test.py MOCK_HOROPTERD PACKAGE_FOLDER SOURCES
"""
import datetime
import glob
import hashlib
import json
import os
import shutil
import sys
import tempfile
import threading
import time
import unittest

MOCK, PACKAGE, SOURCES = map(os.path.abspath, sys.argv[1:4])
sys.path.insert(0, PACKAGE)
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))

import horopter  # noqa: E402
from mock_server import Mock  # noqa: E402

LIBRARY = next(iter(glob.glob("/usr/lib/*/faketime/libfaketimeMT.so.1")), None)
IMAGE = os.path.join(SOURCES, "tests", "data", "parts", "val", "000005", "rgb", "000000.png")
DAY_S = 86400
TIMEOUT_S = 120


def digest(text):
    return hashlib.sha256(text.encode()).hexdigest()


@unittest.skipUnless(LIBRARY, "libfaketime is not installed: the clock cannot be set")
class Clock(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)
        self.set_clock(0)
        until = (datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=30)).strftime("%Y-%m-%d")
        with open(self.path("access"), "w", encoding="utf-8") as out:
            out.write("admin boss sha256:%s\nteacher arm sha256:%s until=%s\n" % (digest("boss"), digest("arm"), until))
        # The monotonic clock is never set, on no machine.
        environment = dict(os.environ, LD_PRELOAD=LIBRARY, FAKETIME_TIMESTAMP_FILE=self.path("clock"), FAKETIME_NO_CACHE="1",
                           FAKETIME_DONT_FAKE_MONOTONIC="1", DONT_FAKE_MONOTONIC="1", NO_FAKE_STAT="1")
        command = ["env"] + ["%s=%s" % item for item in environment.items() if "FAKE" in item[0] or item[0] == "LD_PRELOAD"] + [
            MOCK, "--db", self.path("parts.db"), "--delay-ms", "1500", "--access-file", self.path("access"), "--audit-log",
            self.path("audit.jsonl"), "--request-log", self.path("requests.jsonl"), "--record-dir", self.path("recordings"),
            "--record-sample", "1"]
        self.server = Mock(MOCK, command=command)
        self.addCleanup(self.server.stop)
        self.arm, self.boss = self.client("arm"), self.client("boss")

    def path(self, name):
        return os.path.join(self.folder, name)

    def client(self, token):
        client = horopter.Client(self.server.address, deadline_s=TIMEOUT_S, retries=0, security=horopter.Security(token=token))
        self.addCleanup(client.close)
        return client

    def set_clock(self, days):
        with open(self.path("clock.new"), "w", encoding="utf-8") as out:
            out.write("%+d\n" % (days * DAY_S))
        os.rename(self.path("clock.new"), self.path("clock"))

    def during_a_call(self, days, **options):
        """The outcome of a call in whose middle the clock is set."""
        outcome = []

        def call():
            try:
                outcome.append(self.arm.recognize([IMAGE], **options))
            except horopter.HoropterError as error:
                outcome.append(error)

        thread = threading.Thread(target=call, daemon=True)
        thread.start()
        time.sleep(0.4)
        self.set_clock(days)
        thread.join(TIMEOUT_S)
        self.assertTrue(outcome, "the call did not end")
        return outcome[0]

    def lines(self, name):
        with open(self.path(name), encoding="utf-8") as file:
            return [json.loads(line) for line in file]

    def test_nothing_but_what_has_a_date_notices(self):
        self.boss.set_station("cell")
        # Forward by more than a year: what runs ends well, a token whose day is over does not open any more.
        first = self.during_a_call(400)
        self.assertIsInstance(first, horopter.Scene)
        with self.assertRaises(horopter.Unauthenticated):
            self.arm.list_objects()
        station = self.boss.set_station("cell", display_name="in the future")
        # Back: it opens again; what was written in the future can be changed, and is not mistaken for newer.
        second = self.during_a_call(0)
        self.assertIsInstance(second, (horopter.Scene, horopter.Unauthenticated))
        self.assertIsInstance(self.arm.recognize([IMAGE]), horopter.Scene)
        later = self.boss.set_station("cell", display_name="today")
        self.assertEqual(self.boss.get_station("cell").display_name, "today")
        self.assertNotEqual(station.etag, later.etag)
        # A station learns over a step, and tells its events in their order.
        asked = dict(station="cell", station_cameras=["left"])
        self.assertTrue(self.during_a_call(-4000, **asked).station is not None)
        self.arm.recognize([IMAGE], **asked)
        self.set_clock(0)
        self.arm.recognize([IMAGE], **asked)
        # A deadline is neither shorter nor longer for a step.
        self.assertIsInstance(self.during_a_call(400, deadline_s=0.8), horopter.DeadlineExceeded)
        self.set_clock(0)
        self.assertIsInstance(self.during_a_call(-400, deadline_s=0.8), horopter.DeadlineExceeded)
        self.assertIsInstance(self.during_a_call(-4000, deadline_s=TIMEOUT_S), horopter.Scene)
        self.assertIsInstance(self.during_a_call(0, deadline_s=TIMEOUT_S), horopter.Scene)
        # Every call has its id and its line, whatever the clock said.
        requests = self.lines("requests.jsonl")
        ids = [line["request_id"] for line in requests]
        self.assertEqual(len(ids), len(set(ids)))
        self.assertTrue(all(0 <= line["ms"] < 1e3 * TIMEOUT_S and line["queue_ms"] >= 0 for line in requests))
        writes = [line for line in self.lines("audit.jsonl") if line["method"] == "UpdateStation"]
        self.assertEqual(len(writes), 3)
        self.assertGreater(writes[1]["time"], writes[2]["time"] + 300 * DAY_S)
        recognised = [line for line in requests if line["method"] == "RecognizeScene" and line["code"] == "OK"]
        kept = os.listdir(self.path("recordings"))
        self.assertTrue(all(any(line["request_id"] in name for name in kept) for line in recognised), (recognised, kept))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
