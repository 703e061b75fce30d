#!/usr/bin/env python3
"""CAD files that Python clients send: read by a process of its own with bounded memory and time.

    import_test.py HOROPTER MOCK_HOROPTERD CAD_READER PACKAGE_FOLDER DATASET
"""
import asyncio
import os
import shutil
import sys
import tempfile
import threading
import time
import unittest

HOROPTER, MOCK, READER, PACKAGE, DATASET = map(os.path.abspath, sys.argv[1:6])
sys.path.insert(0, PACKAGE)
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))

import numpy as np  # noqa: E402

import horopter  # noqa: E402
from mock_server import Mock  # noqa: E402

STEP = os.path.join(DATASET, "cad", "obj_000001.step")
TETRAHEDRON = b"""solid t
facet normal 0 0 -1\nouter loop\nvertex 0 0 0\nvertex 0 30 0\nvertex 40 0 0\nendloop\nendfacet
facet normal 0 -1 0\nouter loop\nvertex 0 0 0\nvertex 40 0 0\nvertex 0 0 20\nendloop\nendfacet
facet normal -1 0 0\nouter loop\nvertex 0 0 0\nvertex 0 0 20\nvertex 0 30 0\nendloop\nendfacet
facet normal 1 1 1\nouter loop\nvertex 40 0 0\nvertex 0 30 0\nvertex 0 0 20\nendloop\nendfacet
endsolid t
"""


class Served(unittest.TestCase):

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)

    def serve(self, *arguments, reader=READER, retries=0):
        self.mock = Mock(MOCK, "--db", os.path.join(self.folder, "parts.db"), "--cad-reader", reader, *arguments)
        self.addCleanup(self.mock.stop)
        client = horopter.Client(self.mock.address, deadline_s=120, retries=retries)
        self.addCleanup(client.close)
        return client

    def leftovers(self):
        return [name for name in os.listdir(self.folder) if ".import" in name]

    def script(self, text):
        """A program that takes the reader's place."""
        path = os.path.join(self.folder, "reader")
        with open(path, "w", encoding="utf-8") as out:
            out.write("#!/bin/bash\n" + text)
        os.chmod(path, 0o700)
        return path


class Files(Served):

    def test_step_gives_what_the_program_enrols(self):
        client = self.serve()
        client.enroll_file(STEP, "by-program", program=HOROPTER)
        made = client.import_object("by-server", STEP, labels={"line": "3"})
        self.assertTrue(made.object.ready)
        self.assertEqual(made.object.labels, {"line": "3"})
        one, other = client.get_object("by-program", full=True), client.get_object("by-server", full=True)
        self.assertGreater(other.edge_count, 5)
        for field in ("vertices_m", "edges", "mesh", "diameter_m", "object_from_symmetric_object", "source", "display_name"):
            self.assertEqual(getattr(one.raw, field), getattr(other.raw, field), field)
        self.assertEqual(self.leftovers(), [])

    def test_bytes_with_a_unit_and_grasps(self):
        client = self.serve()
        grasp = horopter.GraspModel("top", np.eye(4), 0.02, 0.5)
        made = client.import_object("tet", TETRAHEDRON, "tet.stl", unit="cm", display_name="Tet", grasps=[grasp])
        self.assertEqual(made.object.display_name, "Tet")
        self.assertAlmostEqual(made.object.diameter_m, 0.5, places=6)
        self.assertEqual([g.name for g in made.object.grasps], ["top"])
        with self.assertRaises(ValueError):
            client.import_object("tet2", TETRAHEDRON)

    def test_async(self):
        client = self.serve()

        async def add():
            async with horopter.AsyncClient(client.address) as other:
                return await other.import_object("tet", TETRAHEDRON, "tet.stl")

        self.assertAlmostEqual(asyncio.run(add()).object.diameter_m, 0.05, places=6)

    def test_what_is_wrong_is_said_and_nothing_is_left(self):
        client = self.serve()
        with open(STEP, "rb") as file:
            step = file.read()
        cases = ((step[:len(step) // 2], "half.step", None, "content"), (b"", "empty.stl", None, "content"),
                 (os.urandom(5000), "noise.step", None, "content"), (os.urandom(5000), "noise.iges", None, "content"),
                 (TETRAHEDRON, "tet.dwg", None, "content"), (step, "part.step", "in", "content"),
                 (TETRAHEDRON, "tet.stl", "parsec", "content"), (TETRAHEDRON, "../tet.stl", None, "file_name"),
                 (TETRAHEDRON, "/etc/tet.stl", None, "file_name"), (TETRAHEDRON, "a\x1b[31m.stl", None, "file_name"),
                 (TETRAHEDRON, "x" * 300 + ".stl", None, "file_name"), (TETRAHEDRON, "", None, "file_name"),
                 (TETRAHEDRON.replace(b"40", b"1e999"), "far.stl", None, "content"),
                 (TETRAHEDRON.replace(b"40", b"nan"), "nan.stl", None, "content"))
        for content, name, unit, field in cases:
            with self.subTest(name=name), self.assertRaises(horopter.InvalidRequest) as caught:
                client._call(client._catalog.ImportObject, horopter.client.catalog_pb2.ImportObjectRequest(
                    object_id="bad", file_name=name, content=content, unit=unit or ""), None)
            self.assertEqual(caught.exception.field, field, caught.exception)
        with self.assertRaises(horopter.InvalidRequest) as caught:
            client.import_object("No Id", TETRAHEDRON, "tet.stl")
        self.assertEqual(caught.exception.field, "object_id")
        self.assertEqual(client.list_objects(), [])
        client.import_object("tet", TETRAHEDRON, "tet.stl")
        with self.assertRaises(horopter.AlreadyExists):
            client.import_object("tet", TETRAHEDRON, "tet.stl")
        self.assertEqual(self.leftovers(), [])

    def test_a_file_that_takes_too_much_memory_is_refused(self):
        client = self.serve("--cad-memory-mb", "64")
        with self.assertRaises(horopter.InvalidRequest) as caught:
            client.import_object("part", STEP)
        self.assertEqual(caught.exception.field, "content")
        self.assertEqual(client.list_objects(), [])

    def test_the_reader_may_be_named_from_where_the_server_stands(self):
        client = self.serve(reader=os.path.relpath(READER))
        self.assertEqual(client.import_object("tet", TETRAHEDRON, "tet.stl").object.object_id, "tet")

    def test_a_server_without_a_reader_says_so(self):
        client = self.serve(reader="")
        with self.assertRaises(horopter.HoropterError) as caught:
            client.import_object("tet", TETRAHEDRON, "tet.stl")
        self.assertEqual(caught.exception.code, "UNIMPLEMENTED")


class Bounds(Served):
    """Scripts in the reader's place do what a hostile file may bring it to."""

    def refused(self, text, *arguments):
        client = self.serve(*arguments, reader=self.script(text))
        with self.assertRaises(horopter.HoropterError) as caught:
            client.import_object("tet", TETRAHEDRON, "tet.stl")
        self.assertEqual(self.leftovers(), [])
        self.assertEqual(client.list_objects(), [])
        return caught.exception

    def test_a_crash_is_the_files_fault_and_the_server_lives(self):
        error = self.refused("kill -SEGV $$\n")
        self.assertEqual((error.code, error.field), ("INVALID_ARGUMENT", "content"))
        self.assertIn("signal 11", error.message)

    def test_processor_time_is_bounded(self):
        error = self.refused("ulimit -t 1\nwhile :; do :; done\n", "--cad-seconds", "1")
        self.assertIn("processor time", error.message)

    def test_an_answer_without_end_is_cut_off(self):
        error = self.refused("exec cat /dev/zero\n")
        self.assertIn("larger object", error.message)

    def test_an_answer_that_is_none_is_refused(self):
        self.assertEqual(self.refused("echo nonsense\n").field, "content")

    def test_it_has_nothing_of_the_servers(self):
        error = self.refused('echo "$(env | grep -v -e ^_ -e ^PWD -e ^SHLVL -e ^OLDPWD)|$(ls /proc/$$/fd | tr "\\n" " ")|$*"\nexit 3\n')
        # bash has its script open.
        self.assertRegex(error.message, r"LC_ALL=C.UTF-8\|0 1 2 (255 )?(3 )?\|tet.stl +2048 120")

    def test_at_the_deadline_it_is_killed_with_what_it_started(self):
        reader = self.script("sleep 1000 & echo $$ $! > %s/pids\nwait\n" % self.folder)
        client = self.serve(reader=reader)
        with self.assertRaises(horopter.DeadlineExceeded):
            client.import_object("tet", TETRAHEDRON, "tet.stl", deadline_s=2.0)
        with open(os.path.join(self.folder, "pids"), encoding="utf-8") as file:
            pids = [int(p) for p in file.read().split()]
        self.assertEqual(len(pids), 2)
        deadline = time.monotonic() + 60
        while any(self.lives(p) for p in pids) and time.monotonic() < deadline:
            time.sleep(0.02)
        self.assertEqual([p for p in pids if self.lives(p)], [])
        while self.leftovers() and time.monotonic() < deadline:
            time.sleep(0.02)
        self.assertEqual(self.leftovers(), [])

    def test_one_at_a_time_and_others_are_told_when_to_come_again(self):
        go = os.path.join(self.folder, "go")
        reader = self.script("touch %s/began\nwhile [ ! -e %s ]; do sleep 0.05; done\nexec %s \"$@\"\n" % (self.folder, go, READER))
        client = self.serve(reader=reader)
        first = []
        thread = threading.Thread(target=lambda: first.append(client.import_object("one", TETRAHEDRON, "tet.stl")), daemon=True)
        thread.start()
        deadline = time.monotonic() + 60
        while not os.path.exists(os.path.join(self.folder, "began")) and time.monotonic() < deadline:
            time.sleep(0.02)
        with self.assertRaises(horopter.Busy) as caught:
            client.import_object("two", TETRAHEDRON, "tet.stl")
        self.assertGreater(caught.exception.retry_after_s, 0)
        with open(go, "w", encoding="utf-8"):
            pass
        thread.join(120)
        self.assertEqual(first[0].object.object_id, "one")
        client.import_object("two", TETRAHEDRON, "tet.stl")

    def test_what_a_killed_server_left_is_cleared_away(self):
        reader = self.script("touch %s/began\nsleep 1000\n" % self.folder)
        client = self.serve(reader=reader)

        def add():
            try:
                client.import_object("tet", TETRAHEDRON, "tet.stl")
            except horopter.HoropterError:
                pass

        thread = threading.Thread(target=add, daemon=True)
        thread.start()
        deadline = time.monotonic() + 60
        while not os.path.exists(os.path.join(self.folder, "began")) and time.monotonic() < deadline:
            time.sleep(0.02)
        self.mock.stop()
        thread.join(120)
        self.assertEqual(len(self.leftovers()), 1)
        gone = ["parts.db.12.3.backup", "parts.db.12.3.backup.12.unfinished", "parts.db.schema-7.bak.12.unfinished",
                "parts.db.before-restore-2.bak.12.unfinished-journal"]
        kept = ["parts.db.before-restore.bak", "parts.db.schema-7.bak", "parts.db.notes", "other.db.1.2.restore", "my.parts.db.1.2.restore"]
        for name in gone + kept:
            with open(os.path.join(self.folder, name), "w", encoding="utf-8"):
                pass
        self.serve()
        self.assertEqual(self.leftovers(), [])
        there = os.listdir(self.folder)
        self.assertEqual([n for n in gone if n in there], [])
        self.assertEqual([n for n in kept if n not in there], [])

    @staticmethod
    def lives(pid):
        try:
            with open("/proc/%d/stat" % pid, encoding="utf-8") as file:
                return file.read().rsplit(")", 1)[1].split()[0] != "Z"
        except OSError:
            return False


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
