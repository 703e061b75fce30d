#!/usr/bin/env python3
"""Requests as large as the server takes, 40 at once: its memory stays below the ceiling that it states.

    ceiling_test.py HOROPTER HOROPTERD MAXIMAL_REQUESTS CAD_FILE

Small limits, so that the test is short; the stages are the real ones.
"""
import os
import subprocess
import sys
import tempfile
import unittest

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))
from mock_server import Mock  # noqa: E402

HOROPTER, HOROPTERD, MAXIMAL_REQUESTS, CAD_FILE = map(os.path.abspath, sys.argv[1:5])


class Ceiling(unittest.TestCase):

    def test_of_requests_messages_and_stages_together(self):
        with tempfile.TemporaryDirectory() as folder:
            # One fits with its images and the stages' share; all 40 messages, parsed, would be 660 MB.
            with Mock(HOROPTERD, "--db", os.path.join(folder, "parts.db"), "--listen", "127.0.0.1:0", "--queue", "100",
                      "--max-message-mb", "8", "--max-object-mb", "8", "--memory-mb", "160") as server:
                # With nothing to look for the stages are left out.
                subprocess.run([HOROPTER, "--server", server.address, "object", "add", CAD_FILE, "--id", "part"], check=True,
                               capture_output=True)
                done = subprocess.run([MAXIMAL_REQUESTS, "--server", server.address, "--pid", str(server.process.pid),
                                       "--calls", "40", "--timeout", "60"], capture_output=True, text=True, timeout=120,
                                      check=False)
                self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
                self.assertIn("RESOURCE_EXHAUSTED", done.stdout)
                # What gRPC breaks off is no bad request.
                self.assertNotIn("INVALID_ARGUMENT", "".join(server.said))
                print(done.stdout)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
