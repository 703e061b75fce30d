#!/usr/bin/env python3
"""Nothing of the recorded wire contract goes unsaid, and changes that would break a client are noticed.

    compatibility_test.py PROTO_FOLDER PROTOC
"""
import os
import re
import shutil
import sys
import tempfile
import unittest

import contract

FOLDER, PROTOC = sys.argv[1:3]


class Contract(unittest.TestCase):

    def test_nothing_of_the_recorded_contract_is_gone(self):
        gone, new = contract.gone_and_new(contract.recorded(FOLDER), contract.contract(FOLDER, PROTOC))
        self.assertEqual(gone, [], "clients rely on these; see proto/README.md")
        for line in new:
            print("not recorded yet: %s" % line)


class Changes(unittest.TestCase):
    """Each with a copy of the real files, changed in one place."""

    def after(self, file, pattern, replacement):
        with tempfile.TemporaryDirectory() as scratch:
            copy = os.path.join(scratch, "proto")
            shutil.copytree(FOLDER, copy)
            path = os.path.join(copy, "horopter", "v1", file)
            with open(path, encoding="utf-8") as old:
                text = old.read()
            changed, count = re.subn(pattern, replacement, text, count=1)
            self.assertEqual(count, 1, pattern)
            with open(path, "w", encoding="utf-8") as new:
                new.write(changed)
            # Against what there is now: what is not recorded yet is watched all the same.
            return contract.gone_and_new(contract.contract(FOLDER, PROTOC), contract.contract(copy, PROTOC))

    def test_breaking_changes_are_noticed(self):
        for name, file, pattern, replacement in (
                ("a field removed", "types.proto", r"  double z = 3;\n", ""),
                ("a field renumbered", "types.proto", r"double z = 3;", "double z = 7;"),
                ("a field retyped", "types.proto", r"double z = 3;", "float z = 3;"),
                ("a field renamed", "types.proto", r"double z = 3;", "double depth = 3;"),
                ("presence lost", "recognition.proto", r"optional double focal_px = 1;", "double focal_px = 1;"),
                ("a list made single", "recognition.proto", r"repeated Camera cameras", "Camera cameras"),
                ("a field out of its oneof", "recognition.proto", r"    RawFrame raw = 3;\n  \}\n", "  }\n  RawFrame raw = 3;\n"),
                ("an enum value renamed", "recognition.proto", r"PRIORITY_BATCH", "PRIORITY_BULK"),
                ("an enum value renumbered", "recognition.proto", r"PRIORITY_BATCH = 2", "PRIORITY_BATCH = 3"),
                ("a method renamed", "catalog.proto", r"rpc DeleteObject\(", "rpc RemoveObject("),
                ("a method's answer changed", "catalog.proto", r"\(GetObjectRequest\) returns \(Object\)",
                 "(GetObjectRequest) returns (ListObjectsResponse)"),
                ("a stream made single", "catalog.proto", r"returns \(stream BackupCatalogResponse\)",
                 "returns (BackupCatalogResponse)"),
                ("a service renamed", "server.proto", r"service ServerService", "service InfoService")):
            with self.subTest(name):
                gone, _ = self.after(file, pattern, replacement)
                self.assertNotEqual(gone, [])

    def test_additions_are_let_pass(self):
        for name, file, pattern, replacement in (
                ("a field", "types.proto", r"(  double z = 3;\n)", r"\1  string note = 99;\n"),
                ("a oneof's field", "recognition.proto", r"(    RawFrame raw = 3;\n)", r"\1    string address = 99;\n"),
                ("an enum value", "recognition.proto", r"(  PRIORITY_BATCH = 2;\n)", r"\1  PRIORITY_IDLE = 99;\n"),
                ("a message", "types.proto", r"$", "\nmessage Circle {\n  double radius_m = 1;\n}\n"),
                ("a method", "server.proto", r"(service ServerService \{\n)",
                 r"\1  rpc GetMore(GetServerInfoRequest) returns (ServerInfo);\n"),
                ("a comment", "types.proto", r"$", "\n// Nothing.\n")):
            with self.subTest(name):
                gone, new = self.after(file, pattern, replacement)
                self.assertEqual(gone, [])
                self.assertEqual(new == [], name == "a comment")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
