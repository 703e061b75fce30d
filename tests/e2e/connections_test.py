#!/usr/bin/env python3
"""What connections may do to a server: more of them than descriptors, silent ones, pings, streams that are reset. Against a
server whose recognition is a stand-in; frames of HTTP/2 are written by hand.

    connections_test.py MOCK_HOROPTERD PACKAGE_FOLDER
"""
import contextlib
import os
import resource
import shutil
import socket
import struct
import sys
import tempfile
import time
import unittest

MOCK, PACKAGE = map(os.path.abspath, sys.argv[1:3])
sys.path.insert(0, PACKAGE)
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))

import horopter  # noqa: E402
from mock_server import Mock  # noqa: E402

DATA, HEADERS, RST_STREAM, SETTINGS, PING, GOAWAY = 0, 1, 3, 4, 6, 7
ACK = END_HEADERS = 4
ACKNOWLEDGED = 1


def frame(kind, flags=0, stream=0, payload=b""):
    return struct.pack(">I", len(payload))[1:] + bytes([kind, flags]) + struct.pack(">I", stream) + payload


def header_block(path):
    """Literals without indexing, as HPACK writes them."""
    def text(value):
        return bytes([len(value)]) + value.encode()
    fields = ((":method", "POST"), (":scheme", "http"), (":path", path), (":authority", "here"),
              ("content-type", "application/grpc"), ("te", "trailers"))
    return b"".join(b"\0" + text(name) + text(value) for name, value in fields)


class Raw:
    """A connection that speaks frames."""

    def __init__(self, address):
        host, port = address.rsplit(":", 1)
        self.socket = socket.create_connection((host, int(port)), timeout=60)
        self.socket.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + frame(SETTINGS))
        self.unread = b""

    def close(self):
        self.socket.close()

    def send(self, data):
        self.socket.sendall(data)

    def read(self):
        """(kind, flags, payload) of the next frame; None: the server has ended the connection."""
        while len(self.unread) < 9 or len(self.unread) < 9 + int.from_bytes(self.unread[:3], "big"):
            try:
                more = self.socket.recv(65536)
            except ConnectionResetError:
                more = b""
            if not more:
                return None
            self.unread += more
        size = int.from_bytes(self.unread[:3], "big")
        found = (self.unread[3], self.unread[4], self.unread[9:9 + size])
        self.unread = self.unread[9 + size:]
        return found

    def read_until(self, kind):
        while True:
            found = self.read()
            if found is None or found[0] == kind:
                return found


class Served(unittest.TestCase):

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)

    def start(self, *arguments, limits=""):
        command = [MOCK, *arguments]
        if limits:
            command = ["bash", "-c", limits + '; exec "$0" "$@"', *command]
        mock = Mock(MOCK, command=command)
        self.addCleanup(mock.stop)
        return mock

    def silent(self, address, number):
        host, port = address.rsplit(":", 1)
        stack = contextlib.ExitStack()
        self.addCleanup(stack.close)
        for _ in range(number):
            stack.enter_context(socket.create_connection((host, int(port)), timeout=60))
        return stack

    def assert_answers(self, mock):
        with horopter.Client(mock.address, deadline_s=60, retries=3) as client:
            self.assertEqual(client.list_objects(), [])
        self.assertIsNone(mock.process.poll())


class Silent(Served):

    @classmethod
    def setUpClass(cls):
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, max(soft, 4096)), hard))

    def test_more_than_the_soft_limit_of_descriptors_keep_nobody_out(self):
        mock = self.start(limits="ulimit -Sn 1024")
        held = self.silent(mock.address, 1100)
        self.assert_answers(mock)
        held.close()
        self.assert_answers(mock)

    def test_more_than_the_hard_limit_keep_nobody_out(self):
        mock = self.start(limits="ulimit -Hn 256 && ulimit -Sn 256")
        held = self.silent(mock.address, 600)
        self.assert_answers(mock)
        held.close()
        self.assert_answers(mock)


class Bounds(Served):

    def ping(self, connection):
        connection.send(frame(PING, payload=b"01234567"))
        return connection.read_until(PING)

    def wait_for_room(self, mock):
        """Until a new connection is taken: the server notices in its own time that others were closed."""
        for _ in range(600):
            with contextlib.suppress(OSError):
                connection = Raw(mock.address)
                taken = connection.read_until(SETTINGS) is not None
                connection.close()
                if taken:
                    return
            time.sleep(0.1)
        self.fail("no connection is taken")

    def test_of_a_peer_and_what_is_closed_makes_room(self):
        mock = self.start("--max-connections-per-peer", "3")
        held = [Raw(mock.address) for _ in range(3)]
        for connection in held:
            self.addCleanup(connection.close)
            self.assertIsNotNone(self.ping(connection))
        fourth = Raw(mock.address)
        self.addCleanup(fourth.close)
        self.assertIsNone(fourth.read_until(SETTINGS))
        self.assertIsNotNone(self.ping(held[0]))
        for connection in held:
            connection.close()
        self.wait_for_room(mock)
        self.assert_answers(mock)
        self.assertTrue(any("its peer has too many" in line for line in mock.said))

    def test_in_all(self):
        mock = self.start("--max-connections", "2")
        held = [Raw(mock.address) for _ in range(2)]
        for connection in held:
            self.addCleanup(connection.close)
            self.assertIsNotNone(self.ping(connection))
        third = Raw(mock.address)
        self.addCleanup(third.close)
        self.assertIsNone(third.read_until(SETTINGS))
        held[0].close()
        self.assert_answers(mock)


class Pings(Served):

    def test_many_without_data_are_all_acknowledged(self):
        mock = self.start()
        connection = Raw(mock.address)
        self.addCleanup(connection.close)
        for i in range(100):
            connection.send(frame(PING, payload=struct.pack(">Q", i)))
            while True:
                found = connection.read()
                self.assertIsNotNone(found, "the connection ended at ping %d" % i)
                self.assertNotEqual(found[0], GOAWAY, "told to go away at ping %d: %r" % (i, found[2]))
                if found[0] == PING and found[1] & ACKNOWLEDGED:
                    self.assertEqual(found[2], struct.pack(">Q", i))
                    break


class Resets(Served):
    METHODS = ("/horopter.v1.RecognitionService/RecognizeScene", "/horopter.v1.CatalogService/DeleteObject")

    def test_thousands_of_reset_streams_write_little(self):
        logs = [os.path.join(self.folder, name) for name in ("requests.jsonl", "audit.jsonl")]
        mock = self.start("--request-log", logs[0], "--audit-log", logs[1])
        streams = 20000
        blocks = [header_block(path) for path in self.METHODS]
        sent = 0
        while sent < streams:
            connection = Raw(mock.address)
            try:
                for i in range(2000):
                    stream = 2 * i + 1
                    connection.send(frame(HEADERS, END_HEADERS, stream, blocks[i % 2]) +
                                    frame(RST_STREAM, 0, stream, struct.pack(">I", 8)))
                    sent += 1
                connection.send(frame(PING, payload=b"all done"))
                while True:
                    found = connection.read()
                    if found is None or (found[0] == PING and found[1] & ACKNOWLEDGED):
                        break
            except (BrokenPipeError, ConnectionResetError):
                pass  # the server may end such a connection
            finally:
                connection.close()
        self.assert_answers(mock)
        written = sum(map(os.path.getsize, logs)) + len("".join(mock.said))
        self.assertLess(written, 1 << 20)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
