#!/usr/bin/env python3
"""TLS, client certificates and tokens of deploy/credentials.sh, against a server whose recognition is a stand-in: who is
let in, who is refused and with which code, by the program and by the Python client.

    trust_test.py HOROPTER MOCK_HOROPTERD PACKAGE_FOLDER SOURCES
"""
import calendar
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.request

HOROPTER, MOCK, PACKAGE, SOURCES = map(os.path.abspath, sys.argv[1:5])
sys.path.insert(0, PACKAGE)

import grpc  # noqa: E402

import horopter  # noqa: E402

CREDENTIALS = os.path.join(SOURCES, "deploy", "credentials.sh")
CAD = os.path.join(SOURCES, "tests", "data", "parts", "cad", "obj_000001.step")


def make_credentials(folder, *arguments):
    subprocess.run([CREDENTIALS, folder, *arguments], check=True, capture_output=True)
    return folder


class Served(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.top = tempfile.mkdtemp()
        cls.good = make_credentials(os.path.join(cls.top, "good"))
        cls.other = make_credentials(os.path.join(cls.top, "other"))
        # Of the same authority, but over.
        cls.expired = os.path.join(cls.top, "expired")
        os.mkdir(cls.expired)
        for name in ("ca.pem", "ca.key"):
            shutil.copy(os.path.join(cls.good, name), cls.expired)
        make_credentials(cls.expired, "--days", "-1")

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.top)

    def start(self, *arguments):
        process = subprocess.Popen([MOCK, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.addCleanup(process.stdout.close)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        for line in process.stdout:
            if "metrics on port " in line:
                self.metrics_url = "http://127.0.0.1:%s/metrics" % line.split("metrics on port ")[1].strip()
            if "listening on " in line:
                return line.split("listening on ")[1].strip()
        raise AssertionError("the server did not come up")

    def server_files(self, folder):
        return ("--tls-cert", os.path.join(folder, "server.pem"), "--tls-key", os.path.join(folder, "server.key"))

    def security(self, authority=None, client=None, who="robot", token=None):
        return horopter.Security(
            ca_file=os.path.join(authority or self.good, "ca.pem"),
            cert_file=None if client is None else os.path.join(client, who + ".pem"),
            key_file=None if client is None else os.path.join(client, who + ".key"), token=token)

    def token(self, who, folder=None):
        with open(os.path.join(folder or self.good, who + ".token"), encoding="utf-8") as file:
            return file.read().strip()

    def code(self, address, security, call=lambda c: c.list_objects()):
        """OK or the code of the refusal."""
        with horopter.Client(address, deadline_s=5.0, retries=0, security=security) as client:
            try:
                call(client)
            except horopter.HoropterError as error:
                return error.code
        return "OK"

    def run_horopter(self, address, *arguments, token_file=None):
        command = [HOROPTER, "--server", address, "--timeout", "20", "--tls-ca", os.path.join(self.good, "ca.pem")]
        if token_file is not None:
            command += ["--token-file", os.path.join(self.good, token_file)]
        return subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=60, check=False)


def delete(client):
    client.delete_object("nobody")


class Tls(Served):

    def test_who_trusts_the_authority_is_let_in_and_others_do_not_connect(self):
        address = self.start(*self.server_files(self.good))
        self.assertEqual(self.code(address, self.security()), "OK")
        self.assertEqual(self.code(address, self.security(authority=self.other)), "UNAVAILABLE")
        self.assertEqual(self.code(address, horopter.Security()), "UNAVAILABLE")  # in the clear
        self.assertEqual(self.run_horopter(address, "object", "list").returncode, 0)
        plain = subprocess.run([HOROPTER, "--server", address, "--timeout", "3", "object", "list"], capture_output=True,
                               timeout=60, check=False)
        self.assertEqual(plain.returncode, 4)

    def message(self, address, security):
        with horopter.Client(address, deadline_s=5.0, retries=0, security=security) as client:
            with self.assertRaises(horopter.Unavailable) as caught:
                client.list_objects()
        return caught.exception.message

    def test_python_says_in_its_own_words_what_is_wrong(self):
        address = self.start(*self.server_files(self.good))
        self.assertIn("it may want TLS", self.message(address, horopter.Security()))
        self.assertIn("does not vouch for its certificate", self.message(address, self.security(authority=self.other)))
        plain = self.start()
        self.assertIn("it does not speak TLS", self.message(plain, self.security()))
        self.assertIn("nothing listens there", self.message("localhost:1", horopter.Security()))

    def test_metrics_tell_the_end_of_the_certificate(self):
        live = os.path.join(self.top, "watched")
        shutil.copytree(self.good, live)

        def end():
            with urllib.request.urlopen(self.metrics_url, timeout=10) as answer:
                found = re.search(r"^horopter_tls_certificate_end_seconds (\S+)$", answer.read().decode(), re.M)
            return float(found.group(1))

        def not_after(folder):
            line = subprocess.run(["openssl", "x509", "-noout", "-enddate", "-in", os.path.join(folder, "server.pem")], check=True,
                                  capture_output=True, text=True, env={**os.environ, "LC_ALL": "C"}).stdout
            return calendar.timegm(time.strptime(line.strip(), "notAfter=%b %d %H:%M:%S %Y GMT"))

        self.start(*self.server_files(live), "--metrics-listen", "127.0.0.1:0")
        self.assertEqual(end(), not_after(self.good))
        self.assertGreater(end(), time.time())
        shutil.copy(os.path.join(self.expired, "server.pem"), live)
        self.assertEqual(end(), not_after(self.expired))
        self.assertLess(end(), time.time())
        os.remove(os.path.join(live, "server.pem"))
        self.assertEqual(end(), 0)

    def test_an_expired_server_is_not_believed(self):
        address = self.start(*self.server_files(self.expired))
        self.assertEqual(self.code(address, self.security()), "UNAVAILABLE")

    def test_client_certificates_of_the_authority_alone_are_taken(self):
        address = self.start(*self.server_files(self.good), "--tls-client-ca", os.path.join(self.good, "ca.pem"))
        self.assertEqual(self.code(address, self.security(client=self.good)), "OK")
        self.assertEqual(self.code(address, self.security()), "UNAVAILABLE")
        self.assertEqual(self.code(address, self.security(client=self.other)), "UNAVAILABLE")
        self.assertEqual(self.code(address, self.security(client=self.expired)), "UNAVAILABLE")

    def test_certificates_are_changed_without_a_restart(self):
        live, link = os.path.join(self.top, "live"), os.path.join(self.top, "link")
        shutil.copytree(self.expired, live)
        os.symlink("live", link)
        address = self.start(*self.server_files(link), "--tls-reload-seconds", "1")
        self.assertEqual(self.code(address, self.security()), "UNAVAILABLE")
        os.symlink("good", link + ".new")
        os.rename(link + ".new", link)
        deadline = time.monotonic() + 20
        while self.code(address, self.security()) != "OK":
            self.assertLess(time.monotonic(), deadline)
            time.sleep(0.2)


class Tokens(Served):

    def setUp(self):
        self.audit = tempfile.mktemp(dir=self.top)
        self.address = self.start(*self.server_files(self.good), "--access-file", os.path.join(self.good, "access"),
                                  "--audit-log", self.audit)

    def test_each_caller_has_its_role(self):
        code = lambda token, call=lambda c: c.list_objects(): self.code(self.address, self.security(token=token), call)
        self.assertEqual(code(None), "UNAUTHENTICATED")
        self.assertEqual(code(self.token("robot", self.other)), "UNAUTHENTICATED")
        self.assertEqual(code(self.token("robot")), "OK")
        self.assertEqual(code(self.token("robot"), delete), "PERMISSION_DENIED")
        self.assertEqual(code(self.token("admin"), delete), "NOT_FOUND")

    def test_the_program_takes_tokens_and_tells_refusals(self):
        add = ("object", "add", CAD, "--id", "bracket")
        self.assertEqual(self.run_horopter(self.address, *add).returncode, 3)
        refused = self.run_horopter(self.address, *add, token_file="robot.token")
        self.assertEqual(refused.returncode, 3)
        self.assertIn("PERMISSION_DENIED", refused.stderr)
        self.assertEqual(self.run_horopter(self.address, *add, token_file="admin.token").returncode, 0)
        self.assertEqual(self.run_horopter(self.address, "object", "list", token_file="robot.token").returncode, 0)
        with open(self.audit, encoding="utf-8") as file:
            lines = file.read().splitlines()
        self.assertEqual(len(lines), 3)
        self.assertIn('"caller":"robot"', lines[1])
        self.assertIn('"code":"PERMISSION_DENIED"', lines[1])
        self.assertIn('"caller":"admin"', lines[2])
        with horopter.Client(self.address, security=self.security(token=self.token("admin"))) as client:
            self.assertEqual(client.enroll_file(CAD, "second", program=HOROPTER).object_id, "second")

    def test_a_token_is_not_sent_in_the_clear(self):
        with self.assertRaises(ValueError):
            horopter.Client("cell-pc:50051", security=horopter.Security(token="secret"))
        done = subprocess.run([HOROPTER, "--server", "cell-pc:50051", "--token-file", os.path.join(self.good, "robot.token"),
                               "object", "list"], capture_output=True, text=True, timeout=60, check=False)
        self.assertEqual(done.returncode, 3)
        self.assertIn("without TLS", done.stderr)


class Certificates(Served):

    def test_a_certificate_is_an_identity(self):
        address = self.start(*self.server_files(self.good), "--tls-client-ca", os.path.join(self.good, "ca.pem"),
                             "--access-file", os.path.join(self.good, "access"))
        robot, admin = (self.security(client=self.good, who=who) for who in ("robot", "admin"))
        self.assertEqual(self.code(address, robot), "OK")
        self.assertEqual(self.code(address, robot, delete), "PERMISSION_DENIED")
        self.assertEqual(self.code(address, admin, delete), "NOT_FOUND")


class Reflection(Served):

    def reflects(self, address):
        # Field 7 (list_services) of ServerReflectionRequest, empty.
        with grpc.insecure_channel(address) as channel:
            call = channel.stream_stream("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo")
            try:
                next(call(iter([b"\x3a\x00"]), timeout=10))
            except grpc.RpcError as error:
                self.assertEqual(error.code(), grpc.StatusCode.UNIMPLEMENTED)
                return False
        return True

    def test_it_is_where_it_is_wanted(self):
        self.assertTrue(self.reflects(self.start()))
        socket = "unix:" + os.path.join(self.top, "admin.sock")
        self.assertFalse(self.reflects(self.start("--admin-listen", socket)))
        self.assertTrue(self.reflects(socket))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
