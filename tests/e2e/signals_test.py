#!/usr/bin/env python3
"""SIGTERM while the catalog is loaded, while calls run, and twice.

    signals_test.py HOROPTER HOROPTERD MOCK_HOROPTERD PACKAGE_FOLDER DATASET
"""
import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
import unittest

HOROPTER, HOROPTERD, MOCK, PACKAGE, DATASET = map(os.path.abspath, sys.argv[1:6])
sys.path.insert(0, PACKAGE)

import grpc  # noqa: E402

import horopter  # noqa: E402
from horopter.v1 import catalog_pb2_grpc  # noqa: E402

IMAGE = os.path.join(DATASET, "val", "000005", "rgb", "000000.png")


class Program:
    """A server; its log is read as it comes: a full pipe would stop it."""

    def __init__(self, *command):
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.said = []
        self.ended = False
        self.changed = threading.Condition()
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        for line in self.process.stdout:
            with self.changed:
                self.said.append(line)
                self.changed.notify_all()
        self.process.stdout.close()
        with self.changed:
            self.ended = True
            self.changed.notify_all()

    def await_line(self, mark):
        def line():
            return next((line for line in self.said if mark in line), None)
        with self.changed:
            self.changed.wait_for(lambda: line() or self.ended, timeout=120)
            if line() is None:
                raise AssertionError("no line with %r: %s" % (mark, "".join(self.said)))
            return line()

    def signal(self, number):
        self.process.send_signal(number)

    def end(self):
        """Exit code; the whole log is in `said`."""
        code = self.process.wait(timeout=60)
        self.reader.join(timeout=60)
        return code

    def kill(self):
        self.process.kill()
        self.end()


class Signals(unittest.TestCase):

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)
        self.db = os.path.join(self.folder, "parts.db")

    def start(self, *arguments):
        program = Program(HOROPTERD, "--db", self.db, "--listen", "127.0.0.1:0", *arguments)
        self.addCleanup(program.kill)
        return program

    def make_old_catalog(self):
        """Two parts, as another version of the program left them: all are prepared again, which takes seconds."""
        server = self.start()
        address = server.await_line("listening on ").split("listening on ")[1].strip()
        for i in (1, 2):
            subprocess.run([HOROPTER, "--server", address, "object", "add",
                            os.path.join(DATASET, "cad", "obj_%06d.step" % i), "--id", "part-%d" % i],
                           check=True, capture_output=True)
        server.signal(signal.SIGTERM)
        self.assertEqual(server.end(), 0)
        with sqlite3.connect(self.db) as db:
            db.execute("UPDATE derived SET version = 0")
        db.close()

    def test_an_old_catalog_is_prepared_beside_what_is_served(self):
        self.make_old_catalog()
        server = self.start("--cores", "1")
        server.await_line("0 objects ready, 2 to be prepared")
        server.kill()  # at once, whatever it was at
        server = self.start("--cores", "1")
        address = server.await_line("listening on ").split("listening on ")[1].strip()
        with horopter.Client(address, deadline_s=60, retries=0) as client:
            info = client.server_info()
            self.assertEqual(info.object_count + info.pending_object_count, 2)
            waiting = [o for o in client.list_objects() if not o.ready]
            if waiting:  # it may have been quick
                self.assertEqual(waiting[-1].raw.recognition_status.state,
                                 horopter.client.catalog_pb2.RecognitionStatus.STATE_PENDING)
            server.await_line("all objects are prepared")
            self.assertTrue(all(o.ready for o in client.list_objects()))
            self.assertEqual(client.server_info().pending_object_count, 0)
        server.signal(signal.SIGTERM)
        self.assertEqual(server.end(), 0)
        server = self.start()
        self.assertNotIn("to be prepared", server.await_line("2 objects ready"))

    def test_while_the_catalog_is_loaded(self):
        self.make_old_catalog()
        server = self.start("--prepare-first")
        server.await_line("loading catalog")
        server.signal(signal.SIGTERM)
        self.assertEqual(server.end(), 0)
        self.assertIn("stopped while the catalog was loaded", "".join(server.said))
        server = self.start("--prepare-first")
        server.await_line("2 objects ready")
        server.signal(signal.SIGTERM)
        self.assertEqual(server.end(), 0)

    def test_a_second_one_does_not_wait_for_calls(self):
        server = self.start()
        address = server.await_line("listening on ").split("listening on ")[1].strip()
        silent = threading.Event()
        self.addCleanup(silent.set)
        with grpc.insecure_channel(address) as channel:
            def never():
                silent.wait()
                yield from ()
            call = catalog_pb2_grpc.CatalogServiceStub(channel).RestoreCatalog.future(never())
            # On the server by the time that a later call of the same connection is answered.
            catalog_pb2_grpc.CatalogServiceStub(channel).ListObjects(horopter.client.catalog_pb2.ListObjectsRequest())
            server.signal(signal.SIGTERM)
            server.await_line("draining")
            self.assertIsNone(server.process.poll())
            server.signal(signal.SIGTERM)
            self.assertEqual(server.end(), 128 + signal.SIGTERM)
            silent.set()
            call.cancel()

    def test_no_accepted_call_fails(self):
        log = os.path.join(self.folder, "requests.jsonl")
        server = Program(MOCK, "--delay-ms", "100", "--workers", "2", "--queue", "6", "--request-log", log)
        self.addCleanup(server.kill)
        address = server.await_line("listening on ").split("listening on ")[1].strip()
        outcomes, stop = [], threading.Event()

        def client():
            with horopter.Client(address, deadline_s=30, retries=0) as c:
                while not stop.is_set():
                    try:
                        c.recognize([IMAGE])
                        outcomes.append("OK")
                    except horopter.HoropterError as error:
                        outcomes.append(error.code)
                        if error.code == "UNAVAILABLE":
                            return
                        time.sleep(0.02)

        threads = [threading.Thread(target=client, daemon=True) for _ in range(12)]
        for thread in threads:
            thread.start()
        deadline = time.monotonic() + 60
        while outcomes.count("OK") < 10 and time.monotonic() < deadline:
            time.sleep(0.01)
        server.signal(signal.SIGTERM)
        self.assertEqual(server.end(), 0)
        stop.set()
        for thread in threads:
            thread.join()
        with open(log, encoding="utf-8") as lines:
            codes = [json.loads(line)["code"] for line in lines]
        self.assertEqual(codes.count("OK"), outcomes.count("OK"))
        # What reached the server was answered; gRPC itself cancels calls that arrive while it closes the connections.
        self.assertLessEqual(set(codes), {"OK", "UNAVAILABLE", "RESOURCE_EXHAUSTED"})
        self.assertLessEqual(set(outcomes), {"OK", "UNAVAILABLE", "RESOURCE_EXHAUSTED", "CANCELLED"})
        print("SIGTERM under load: %s" % {code: outcomes.count(code) for code in sorted(set(outcomes))})


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
