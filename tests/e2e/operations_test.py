#!/usr/bin/env python3
"""Configuration, signals, logs and self-check of the server, from outside.

    operations_test.py HOROPTERD MOCK_HOROPTERD PACKAGE_FOLDER SOURCES
"""
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import tomllib
import unittest

HOROPTERD, MOCK, PACKAGE, SOURCES = map(os.path.abspath, sys.argv[1:5])
sys.path.insert(0, PACKAGE)
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support"))

import horopter  # noqa: E402
from mock_server import Mock  # noqa: E402

TIMEOUT_S = 120


def run(*arguments, **options):
    return subprocess.run([HOROPTERD, *arguments], capture_output=True, text=True, timeout=TIMEOUT_S, check=False,
                          stdin=subprocess.DEVNULL, **options)


def wait_for(condition):
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


class Scratch(unittest.TestCase):

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)

    def path(self, name):
        return os.path.join(self.folder, name)

    def write(self, name, text):
        with open(self.path(name), "w", encoding="utf-8") as out:
            out.write(text)
        return self.path(name)

    def serve(self, *arguments, **options):
        """A server that listens."""
        mock = Mock(HOROPTERD, command=[HOROPTERD, "--db", self.path("parts.db"), "--listen", "127.0.0.1:0", *arguments], **options)
        self.addCleanup(mock.stop)
        return mock


class Configuration(Scratch):

    def refusal(self, text, code=2):
        done = run("--config", self.write("c.toml", text), "--db", self.path("no.db"))
        self.assertEqual(done.returncode, code, done.stdout + done.stderr)
        self.assertFalse(os.path.exists(self.path("no.db")), "it went as far as the catalog")
        return done.stdout + done.stderr

    def test_what_is_printed_are_the_defaults_of_any_machine_and_read_back_they_are_the_same(self):
        printed = run("--print-config").stdout
        values = tomllib.loads(printed)
        self.assertIs(values["admin-calls"], True)
        self.assertIs(values["reflection"], True)
        self.assertIs(values["insecure"], False)
        self.assertEqual(values["cores"], 0)
        self.assertEqual(values["db"], "")
        self.assertNotIn(socket.gethostname(), re.findall(r'"([^"]*)"', printed))
        self.assertEqual(run("--config", self.write("p.toml", printed), "--print-config").stdout, printed)

    def test_keys_that_are_no_options_are_refused_with_the_one_that_was_meant(self):
        for text, words in (("worker = 3\n", "'workers'"), ('access_file="keys/access"\n', "'access-file'"),
                            ('Listen="localhost:1"\n', "'listen'"), ("xyzzy=1\n", "'xyzzy' is no option"),
                            ('print-config=true\n', "'print-config' is no option")):
            self.assertIn(words, self.refusal(text))

    def test_sections_and_second_values_are_refused(self):
        self.assertIn("[server]", self.refusal("[server]\nworkers=2\n"))
        self.assertIn("[server]", self.refusal("[server]\n"))
        self.assertIn("'workers' has more than one value", self.refusal("workers=2\nqueue=3\nworkers=4\n"))
        self.assertIn("'workers' has more than one value", self.refusal("workers=[2, 3]\n"))

    def test_a_program_that_is_not_there_is_refused(self):
        self.assertIn("cad-reader: /nowhere/reader: ", self.refusal('cad-reader="/nowhere/reader"\n', code=1))

    def test_a_refusal_names_the_option_as_it_is_written(self):
        for key, value in (("memory-mb", "16"), ("audit-required", "true"), ("tls-client-ca", '"ca.pem"')):
            self.assertIn(key + ": ", self.refusal("%s=%s\n" % (key, value), code=1))

    def test_values_that_are_none_are_refused(self):
        for text in ("workers=many\n", "workers=0\n", "insecure=perhaps\n", "queue=\n"):
            self.refusal(text)

    def test_ports_are_checked(self):
        for key in ("listen", "admin-listen", "metrics-listen"):
            for address in ("localhost:70000", "localhost", "localhost:http", "::1:5"):
                self.assertIn(key + ": '%s'" % address, self.refusal('%s="%s"\n' % (key, address), code=1))

    def test_the_catalog_is_in_the_state_directory(self):
        mock = Mock(HOROPTERD, command=["env", "STATE_DIRECTORY=%s" % self.folder, HOROPTERD, "--listen", "127.0.0.1:0"])
        self.addCleanup(mock.stop)
        self.assertTrue(os.path.exists(self.path("parts.db")))


class Trust(Scratch):

    def setUp(self):
        super().setUp()
        self.keys = self.path("keys")
        subprocess.run([os.path.join(SOURCES, "deploy", "credentials.sh"), self.keys, "--install", self.path("installed")],
                       check=True, capture_output=True)

    def refusal(self, *arguments):
        done = run("--db", self.path("no.db"), *arguments)
        self.assertEqual(done.returncode, 1, done.stdout + done.stderr)
        self.assertFalse(os.path.exists(self.path("no.db")), "it went as far as the catalog")
        return done.stderr

    def tls(self, certificate="server.pem", key="server.key"):
        return "--tls-cert", os.path.join(self.keys, certificate), "--tls-key", os.path.join(self.keys, key)

    def test_tls_without_an_access_file_needs_a_word_where_others_can_call(self):
        self.assertIn("open-access", self.refusal("--listen", "0.0.0.0:0", *self.tls()))
        for word in (("--open-access",), ("--access-file", self.path("installed/access"))):
            mock = Mock(HOROPTERD, command=[HOROPTERD, "--db", self.path("parts.db"), "--listen", "0.0.0.0:0", *self.tls(), *word])
            mock.stop()

    def test_key_and_certificate_are_a_pair(self):
        self.assertIn("is not the key of the certificate", self.refusal("--listen", "localhost:0", *self.tls(key="robot.key")))
        self.assertIn("no PRIVATE KEY", self.refusal("--listen", "localhost:0", *self.tls(key="robot.pem")))
        self.write("keys/broken.pem", "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n")
        self.assertIn("no CERTIFICATE", self.refusal("--listen", "localhost:0", *self.tls(certificate="broken.pem")))

    def test_a_key_with_a_password_is_refused_and_nobody_is_asked(self):
        subprocess.run(["openssl", "pkcs8", "-topk8", "-in", os.path.join(self.keys, "server.key"), "-passout", "pass:secret",
                        "-out", os.path.join(self.keys, "locked.key")], check=True, capture_output=True)
        self.assertIn("is encrypted", self.refusal("--listen", "localhost:0", *self.tls(key="locked.key")))

    def test_what_is_installed_for_a_server(self):
        kept = {name: os.stat(self.path("installed/" + name)).st_mode & 0o777
                for name in ("keys", "keys/server.pem", "keys/server.key", "keys/ca.pem", "access")}
        self.assertEqual(kept, {"keys": 0o700, "keys/server.pem": 0o600, "keys/server.key": 0o600, "keys/ca.pem": 0o600,
                                "access": 0o644})
        self.assertEqual(len(os.listdir(self.path("installed/keys"))), 3)


class Signals(Scratch):

    def test_hangups_never_end_it_and_open_the_logs_anew(self):
        log = self.path("requests.jsonl")
        server = self.serve("--request-log", log)
        for _ in range(20):
            server.process.send_signal(signal.SIGHUP)
        os.rename(log, log + ".1")
        server.process.send_signal(signal.SIGHUP)
        self.assertTrue(wait_for(lambda: os.path.exists(log)))
        with horopter.Client(server.address, deadline_s=TIMEOUT_S) as client:
            client.list_objects()
        self.assertTrue(wait_for(lambda: os.path.getsize(log) > 0))
        self.assertIsNone(server.process.poll())

    def test_hangups_before_it_listens_do_not_end_it(self):
        process = subprocess.Popen([HOROPTERD, "--db", self.path("parts.db"), "--listen", "127.0.0.1:0"], stdout=subprocess.PIPE,
                                   stderr=subprocess.STDOUT, text=True)
        self.addCleanup(process.stdout.close)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        for line in process.stdout:
            if "loading catalog" in line:
                process.send_signal(signal.SIGHUP)
            if "listening on" in line:
                break
        self.assertIsNone(process.poll())
        process.send_signal(signal.SIGTERM)
        process.stdout.read()
        self.assertEqual(process.wait(timeout=TIMEOUT_S), 0)

    def test_a_log_that_cannot_be_opened_anew_goes_on_where_it_was(self):
        folder = self.path("logs")
        os.mkdir(folder)
        log = os.path.join(folder, "requests.jsonl")
        server = self.serve("--request-log", log)
        held = self.path("held.jsonl")
        os.rename(log, held)
        os.rmdir(folder)
        server.process.send_signal(signal.SIGHUP)
        self.assertTrue(wait_for(lambda: any("cannot be written" in line for line in server.said)))
        with horopter.Client(server.address, deadline_s=TIMEOUT_S) as client:
            client.list_objects()
        self.assertTrue(wait_for(lambda: os.path.getsize(held) > 0))

    def test_systemd_is_told(self):
        told = self.path("notify")
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
            listening.bind(told)
            listening.settimeout(TIMEOUT_S)
            server = Mock(HOROPTERD, command=["env", "NOTIFY_SOCKET=" + told, HOROPTERD, "--db", self.path("parts.db"), "--listen",
                                              "127.0.0.1:0", "--self-check-seconds", "0.05"])
            self.addCleanup(server.stop)
            self.assertEqual(listening.recv(100), b"READY=1")
            self.assertEqual(listening.recv(100), b"WATCHDOG=1")
            server.process.send_signal(signal.SIGTERM)
            while listening.recv(100) != b"STOPPING=1":
                pass
            self.assertEqual(server.process.wait(timeout=TIMEOUT_S), 0)


class Reach(Scratch):

    def test_a_server_that_cannot_be_reached_any_more_ends(self):
        admin = self.path("admin.sock")
        server = self.serve("--admin-listen", "unix:" + admin, "--self-check-seconds", "0.05")
        with horopter.Client("unix:" + admin, deadline_s=TIMEOUT_S) as client:
            client.list_objects()
        os.unlink(admin)
        self.assertEqual(server.process.wait(timeout=TIMEOUT_S), 3)
        self.assertTrue(any("cannot be reached any more" in line for line in server.said))

    def test_tls_and_client_certificates_do_not_keep_it_from_looking(self):
        keys = self.path("keys")
        subprocess.run([os.path.join(SOURCES, "deploy", "credentials.sh"), keys], check=True, capture_output=True)
        told = self.path("notify")
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
            listening.bind(told)
            listening.settimeout(TIMEOUT_S)
            server = Mock(HOROPTERD, command=["env", "NOTIFY_SOCKET=" + told, HOROPTERD, "--db", self.path("parts.db"), "--listen",
                                              "127.0.0.1:0", "--self-check-seconds", "0.05", "--tls-cert", keys + "/server.pem",
                                              "--tls-key", keys + "/server.key", "--tls-client-ca", keys + "/ca.pem"])
            self.addCleanup(server.stop)
            self.assertEqual(listening.recv(100), b"READY=1")
            for _ in range(3):
                self.assertEqual(listening.recv(100), b"WATCHDOG=1")
        self.assertFalse(any("does not reach itself" in line for line in server.said))

    def test_it_may_have_as_many_files_as_it_is_allowed(self):
        server = Mock(HOROPTERD, command=["bash", "-c", 'ulimit -Sn 256; exec "$0" "$@"', HOROPTERD, "--db", self.path("parts.db"),
                                          "--listen", "127.0.0.1:0"])
        self.addCleanup(server.stop)
        with open("/proc/%d/limits" % server.process.pid, encoding="utf-8") as file:
            soft, hard = re.search(r"^Max open files +(\S+) +(\S+)", file.read(), re.M).groups()
        self.assertEqual(soft, hard)


class Audit(Scratch):
    """/dev/full is a disk without room."""

    def start(self, *arguments):
        mock = Mock(MOCK, "--audit-log", "/dev/full", *arguments)
        self.addCleanup(mock.stop)
        return mock

    def delete(self, mock):
        with horopter.Client(mock.address, deadline_s=TIMEOUT_S, retries=0) as client:
            try:
                client.delete_object("nobody")
            except horopter.HoropterError as error:
                return error.code
        return "OK"

    def test_a_lost_line_is_an_error_in_the_log(self):
        mock = self.start()
        self.assertEqual(self.delete(mock), "NOT_FOUND")
        self.assertTrue(wait_for(lambda: any("[error]" in line and "audit log is lost" in line for line in mock.said)))

    def test_where_the_audit_is_required_nothing_is_written_without_it(self):
        mock = self.start("--audit-required")
        self.assertEqual(self.delete(mock), "FAILED_PRECONDITION")
        with horopter.Client(mock.address, deadline_s=TIMEOUT_S, retries=0) as client:
            self.assertEqual(client.list_objects(), [])

    def test_what_begins_has_a_line_where_the_audit_is_required(self):
        log = self.path("audit.jsonl")
        mock = Mock(MOCK, "--audit-log", log, "--audit-required")
        self.addCleanup(mock.stop)
        self.assertEqual(self.delete(mock), "NOT_FOUND")
        with open(log, encoding="utf-8") as file:
            lines = file.read().splitlines()
        self.assertEqual(len(lines), 2)
        self.assertIn('"begins":true', lines[0])
        self.assertIn('"code":"NOT_FOUND"', lines[1])

    def test_it_cannot_be_required_without_a_file(self):
        done = run("--db", self.path("no.db"), "--audit-required")
        self.assertEqual(done.returncode, 1)
        self.assertIn("audit-required", done.stderr)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
