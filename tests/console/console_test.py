#!/usr/bin/env python3
"""horopter-console as browsers and those who are none meet it, against a server whose recognition is a stand-in.

    console_test.py HOROPTER_CONSOLE MOCK_HOROPTERD CAD_READER PACKAGE_FOLDER REPOSITORY
"""
import glob
import hashlib
import json
import os
import random
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import unittest

CONSOLE, MOCK, CAD_READER, PACKAGE, REPOSITORY = map(os.path.abspath, sys.argv[1:6])
HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [PACKAGE, os.path.join(HERE, "..", "support"), HERE]

import horopter  # noqa: E402
from console_calls import MARK, WEB, Browser, Console, frame, frames, message_of  # noqa: E402
from horopter.v1 import answers_pb2, catalog_pb2, recognition_pb2, server_pb2  # noqa: E402
from mock_server import Mock  # noqa: E402

PARTS = os.path.join(REPOSITORY, "tests", "data", "parts")
STEP = os.path.join(PARTS, "cad", "obj_000001.step")
IMAGES = sorted(glob.glob(os.path.join(PARTS, "val", "000011", "rgb", "*.png")))
MANY = ("--requests-per-second", "1000000", "--sign-ins-per-minute", "1000000", "--max-connections", "1000", "--max-connections-per-peer", "1000")


def parsed(kind, content):
    message = kind()
    message.ParseFromString(content)
    return message


def access_file(folder):
    path = os.path.join(folder, "access")
    with open(path, "w", encoding="utf-8") as file:
        for role, name, token in (("admin", "anna", "admin-token"), ("robot", "arm", "robot-token")):
            file.write("%s %s sha256:%s\n" % (role, name, hashlib.sha256(token.encode()).hexdigest()))
    os.chmod(path, 0o600)
    return path


class Folder(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)


class Bridge(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.mock = Mock(MOCK, "--delay-ms", "20", "--workers", "4", "--cad-reader", CAD_READER)
        cls.addClassCleanup(cls.mock.stop)
        cls.console = Console(CONSOLE, cls.mock.address, *MANY)
        cls.addClassCleanup(cls.console.stop)
        with horopter.Client(cls.mock.address) as client:
            client.import_object("block", STEP)

    def setUp(self):
        self.browser = Browser(self.console.address)
        self.addCleanup(self.browser.http.close)
        status, _, _ = self.browser.sign_in()
        self.assertEqual(status, 200)

    def test_a_call_is_what_the_server_says_byte_by_byte(self):
        messages, trailers = self.browser.call("ServerService/GetServerInfo")
        self.assertEqual(len(messages), 1)
        self.assertEqual(parsed(server_pb2.ServerInfo, messages[0]).limits.max_images, 32)
        self.assertEqual(trailers["grpc-status"], "0")

    def test_several_calls_share_a_connection(self):
        for _ in range(20):
            messages, _ = self.browser.call("CatalogService/ListObjects")
            self.assertEqual(parsed(catalog_pb2.ListObjectsResponse, messages[0]).objects[0].name, "objects/block")

    def test_photographs_are_recognised(self):
        request = recognition_pb2.RecognizeSceneRequest()
        for path in IMAGES[:4]:
            with open(path, "rb") as file:
                request.images.add(content=file.read())
        messages, trailers = self.browser.call("RecognitionService/RecognizeScene", request.SerializeToString())
        answer = parsed(recognition_pb2.RecognizeSceneResponse, messages[0])
        self.assertEqual((trailers["grpc-status"], answer.objects[0].object, len(answer.cameras)), ("0", "objects/block", 4))

    def test_errors_keep_code_message_and_details(self):
        request = recognition_pb2.RecognizeSceneRequest()
        request.images.add(content=b"no image")
        messages, trailers = self.browser.call("RecognitionService/RecognizeScene", request.SerializeToString())
        self.assertEqual((messages, trailers["grpc-status"]), ([], "3"))
        self.assertEqual(trailers["horopter-error-field"], "images[0].content")
        self.assertIn("images[0]", message_of(trailers))
        self.assertIn("grpc-status-details-bin", trailers)

    def test_an_answer_that_streams_comes_in_pieces(self):
        messages, trailers = self.browser.call("CatalogService/BackupCatalog")
        chunks = [parsed(catalog_pb2.BackupCatalogResponse, message) for message in messages]
        whole = b"".join(chunk.chunk for chunk in chunks)
        self.assertEqual(hashlib.sha256(whole).hexdigest(), chunks[0].sha256)
        self.assertEqual(trailers["grpc-status"], "0")

    def test_answers_are_watched_by_so_many_at_once(self):
        def watch(console):
            browser = Browser(console.address)
            self.addCleanup(browser.http.close)
            browser.sign_in()
            browser.http.request("POST", "/horopter.v1.AnswerService/WatchAnswers", frame(b""), {"Content-Type": WEB, "Cookie": browser.cookie, **MARK})
            return browser, browser.http.getresponse()

        def message(answer):
            size = int.from_bytes(answer.read(5)[1:], "big")
            return parsed(answers_pb2.WatchedAnswer, answer.read(size) if size else b"")

        request = recognition_pb2.RecognizeSceneRequest()
        with open(IMAGES[0], "rb") as file:
            request.images.add(content=file.read())
        with Console(CONSOLE, self.mock.address, "--max-watches", "2", "--max-calls", "1", *MANY) as console:
            (first, one), (_, two) = watch(console), watch(console)
            self.assertEqual([message(one).number, message(two).number], [0, 0])
            self.assertEqual(watch(console)[1].status, 503)
            # They take no place from other calls, and are told.
            self.browser.call("RecognitionService/RecognizeScene", request.SerializeToString())
            told = [message(one), message(two)]
            self.assertEqual(told[0].request_id, told[1].request_id)
            self.assertEqual(told[0].response.objects[0].object, "objects/block")
            self.assertEqual(told[0].request.images[0].content, b"")
            first.http.close()
            one.close()
            deadline = time.monotonic() + 60
            while watch(console)[1].status != 200:
                self.assertLess(time.monotonic(), deadline)
                time.sleep(0.05)

    def test_a_deadline_of_the_browser_is_kept(self):
        request = recognition_pb2.RecognizeSceneRequest()
        with open(IMAGES[0], "rb") as file:
            request.images.add(content=file.read())
        _, trailers = self.browser.call("RecognitionService/RecognizeScene", request.SerializeToString(), grpc_timeout="1m")
        self.assertEqual(trailers["grpc-status"], "4")

    def test_an_unknown_method_is_the_servers_to_refuse(self):
        _, trailers = self.browser.call("CatalogService/NoSuchThing")
        self.assertEqual(trailers["grpc-status"], "12")

    def test_other_packages_are_not_reached(self):
        for path in ("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo", "/horopter.v1.X/../Y",
                     "/horopter.v1.CatalogService", "/horopter.v1.CatalogService/ListObjects?x"):
            status, _, _ = self.browser.ask("POST", path, frame(b""), {"Content-Type": WEB, **MARK})
            self.assertEqual(status, 404, path)
            self.browser.http.close()

    def test_bodies_that_are_no_frames_are_refused_in_words(self):
        for body in (b"", b"\0", b"\0\0\0\0\5abc", b"\1\0\0\0\0", b"\x80\0\0\0\0", b"\0\xff\xff\xff\xff"):
            status, _, said = self.browser.ask("POST", "/horopter.v1.CatalogService/ListObjects", body,
                                               {"Content-Type": WEB, **MARK})
            self.assertEqual(status, 400, body)
            self.assertTrue(said.strip())

    def test_who_goes_away_cancels_his_call(self):
        slow = Mock(MOCK, "--delay-ms", "60000", "--cad-reader", CAD_READER)
        self.addCleanup(slow.stop)
        with horopter.Client(slow.address) as client:
            client.import_object("block", STEP)
        with Console(CONSOLE, slow.address) as console, Browser(console.address) as browser:
            browser.sign_in()
            request = recognition_pb2.RecognizeSceneRequest()
            with open(IMAGES[0], "rb") as file:
                request.images.add(content=file.read())
            body = frame(request.SerializeToString())
            browser.http.request("POST", "/horopter.v1.RecognitionService/RecognizeScene", body,
                                 {"Content-Type": WEB, "Cookie": browser.cookie, **MARK})
            with Browser(console.address) as other:
                other.sign_in()

                def running():
                    messages, _ = other.call("ServerService/GetServerInfo")
                    return parsed(server_pb2.ServerInfo, messages[0]).load.running

                self.assertTrue(self.comes(lambda: running() == 1))
                browser.http.close()
                self.assertTrue(self.comes(lambda: running() == 0))

    def comes(self, what, within=30):
        end = time.monotonic() + within
        while time.monotonic() < end:
            if what():
                return True
            time.sleep(0.02)
        return False

    def test_killed_console_takes_no_robot_along(self):
        console = Console(CONSOLE, self.mock.address, *MANY)
        self.addCleanup(console.stop)
        failed, done, stop = [], [0], threading.Event()

        def robot():
            with horopter.Client(self.mock.address) as client:
                while not stop.is_set() or done[0] < 5:
                    try:
                        client.recognize(IMAGES[:2])
                        done[0] += 1
                    except horopter.HoropterError as error:
                        failed.append(error)
                        return

        thread = threading.Thread(target=robot)
        thread.start()
        self.assertTrue(self.comes(lambda: done[0] >= 2 or failed))
        browsers = [Browser(console.address) for _ in range(20)]
        for browser in browsers:
            self.addCleanup(browser.http.close)
            browser.sign_in()
            browser.http.request("POST", "/horopter.v1.CatalogService/BackupCatalog", frame(b""),
                                 {"Content-Type": WEB, "Cookie": browser.cookie, **MARK})
        console.process.send_signal(signal.SIGKILL)
        console.process.wait()
        before = done[0]
        self.assertTrue(self.comes(lambda: done[0] >= before + 3 or failed))
        stop.set()
        thread.join()
        self.assertEqual(failed, [])

    def test_server_gone_and_back(self):
        mock = Mock(MOCK)
        self.addCleanup(mock.stop)
        with Console(CONSOLE, mock.address) as console, Browser(console.address) as browser:
            browser.sign_in()
            mock.stop()
            _, trailers = browser.call("CatalogService/ListObjects")
            self.assertEqual(trailers["grpc-status"], "14")
            again = Mock(MOCK, "--listen", mock.address)
            self.addCleanup(again.stop)
            self.assertTrue(self.comes(lambda: browser.call("CatalogService/ListObjects")[1]["grpc-status"] == "0"))


class Trust(Folder):
    def setUp(self):
        super().setUp()
        self.mock = Mock(MOCK, "--access-file", access_file(self.folder))
        self.addCleanup(self.mock.stop)

    def test_sign_in_asks_the_server(self):
        with Console(CONSOLE, self.mock.address) as console, Browser(console.address) as browser:
            status, _, said = browser.sign_in("wrong")
            self.assertEqual((status, json.loads(said)["error"]), (401, "the token is not known"))
            self.assertEqual(browser.sign_in("")[0], 401)
            status, fields, _ = browser.sign_in("robot-token")
            self.assertEqual(status, 200)
            cookie = fields["Set-Cookie"]
            for word in ("HttpOnly", "SameSite=Strict", "Path=/"):
                self.assertIn(word, cookie)
            self.assertNotIn("robot-token", cookie)
            self.assertTrue(json.loads(browser.ask("GET", "/session")[2])["signed_in"])
            _, trailers = browser.call("CatalogService/ListObjects")
            self.assertEqual(trailers["grpc-status"], "0")
            _, trailers = browser.call("CatalogService/DeleteObject",
                                       catalog_pb2.DeleteObjectRequest(name="objects/x").SerializeToString())
            self.assertEqual((trailers["grpc-status"], message_of(trailers)),
                             ("7", "'arm' has the role robot, the call needs admin"))
            browser.ask("POST", "/sign-out", "", MARK)
            self.assertFalse(json.loads(browser.ask("GET", "/session")[2])["signed_in"])

    def test_no_call_without_a_session(self):
        with Console(CONSOLE, self.mock.address) as console:
            for cookie in ("", "horopter_session=" + "0" * 64, "horopter_session=; horopter_session=x"):
                with Browser(console.address) as browser:
                    status, _, _ = browser.ask("POST", "/horopter.v1.CatalogService/ListObjects", frame(b""),
                                               {"Content-Type": WEB, "Cookie": cookie, **MARK})
                    self.assertEqual(status, 401)

    def test_a_token_that_ends_in_the_session_ends_it(self):
        with Console(CONSOLE, self.mock.address, *MANY) as console, Browser(console.address) as browser:
            browser.sign_in("robot-token")
            with open(os.path.join(self.folder, "access"), "w", encoding="utf-8") as file:
                file.write("# nobody\n")
            end = time.monotonic() + 30
            while time.monotonic() < end:
                status, fields, body = browser.ask("POST", "/horopter.v1.CatalogService/ListObjects", frame(b""),
                                                   {"Content-Type": WEB, **MARK})
                if status == 401:
                    break
            self.assertEqual(status, 401)
            self.assertFalse(json.loads(browser.ask("GET", "/session")[2])["signed_in"])

    def test_foreign_pages_can_do_nothing(self):
        with Console(CONSOLE, self.mock.address, *MANY) as console:
            own = "http://" + console.address
            for headers in ({}, {"Origin": "http://evil.example", **MARK}, {"Sec-Fetch-Site": "cross-site", **MARK},
                            {"Sec-Fetch-Site": "same-site", **MARK}, {"Origin": "null", **MARK},
                            {"Origin": "https://" + console.address, **MARK}, {"Origin": own}):
                with Browser(console.address) as browser:
                    status, fields, _ = browser.ask("POST", "/sign-in", '{"token": "admin-token"}', headers)
                    self.assertEqual((status, fields["Set-Cookie"]), (403, None), headers)
            with Browser(console.address) as browser:
                status, _, _ = browser.ask("POST", "/sign-in", '{"token": "admin-token"}',
                                           {"Origin": own, "Sec-Fetch-Site": "same-origin", **MARK})
                self.assertEqual(status, 200)
            with Browser(console.address) as browser:  # a name that somebody lets point here
                status, _, _ = browser.ask("GET", "/", headers={"Host": "evil.example:80"})
                self.assertEqual(status, 421)
            with Browser(console.address) as browser:  # which would be asked first: no
                status, fields, _ = browser.ask("OPTIONS", "/sign-in", headers={"Origin": "http://evil.example"})
                self.assertEqual((status, fields["Access-Control-Allow-Origin"]), (405, None))

    def test_tokens_are_not_to_be_guessed(self):
        with Console(CONSOLE, self.mock.address) as console:
            seen = set()
            for i in range(25):
                with Browser(console.address) as browser:
                    seen.add(browser.sign_in("guess%d" % i)[0])
            self.assertEqual(seen, {401, 429})

    def test_every_answer_forbids_what_the_page_does_not_need(self):
        with Console(CONSOLE, self.mock.address) as console, Browser(console.address) as browser:
            for path in ("/", "/session", "/healthz", "/metrics", "/nothing"):
                _, fields, _ = browser.ask("GET", path)
                policy = fields["Content-Security-Policy"]
                self.assertIn("script-src 'self';", policy)
                self.assertNotIn("unsafe", policy)
                self.assertEqual((fields["X-Content-Type-Options"], fields["X-Frame-Options"]), ("nosniff", "DENY"))

    def test_a_session_that_is_idle_is_over(self):
        with Console(CONSOLE, self.mock.address, "--session-idle-minutes", "0.01") as console, Browser(console.address) as browser:
            browser.sign_in("robot-token")
            time.sleep(1.0)
            self.assertFalse(json.loads(browser.ask("GET", "/session")[2])["signed_in"])

    def test_tls_to_browsers_and_to_the_server(self):
        import ssl
        keys = os.path.join(self.folder, "keys")
        subprocess.run([os.path.join(REPOSITORY, "deploy", "credentials.sh"), keys, "--host", "localhost"],
                       check=True, capture_output=True)
        files = {name: path for path in glob.glob(os.path.join(keys, "**"), recursive=True)
                 for name in ("ca.pem", "server.pem", "server.key") if os.path.basename(path) == name}
        tls = Mock(MOCK, "--tls-cert", files["server.pem"], "--tls-key", files["server.key"], "--open-access")
        self.addCleanup(tls.stop)
        port = tls.address.rsplit(":", 1)[1]
        with Console(CONSOLE, "localhost:" + port, "--server-ca", files["ca.pem"], "--tls-cert", files["server.pem"],
                     "--tls-key", files["server.key"], *MANY) as console, Browser(console.address) as browser:
            import http.client
            browser.http = http.client.HTTPSConnection("localhost", int(console.address.rsplit(":", 1)[1]), timeout=60,
                                                       context=ssl.create_default_context(cafile=files["ca.pem"]))
            status, fields, _ = browser.sign_in()
            self.assertEqual(status, 200)
            self.assertIn("Secure", fields["Set-Cookie"])
            for _ in range(5):
                _, trailers = browser.call("CatalogService/ListObjects")
                self.assertEqual(trailers["grpc-status"], "0")
            with Browser(console.address) as plain:
                with self.assertRaises(Exception):
                    plain.ask("GET", "/")
            self.assertTrue(console.running)


class Bounds(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.mock = Mock(MOCK)

    @classmethod
    def tearDownClass(cls):
        cls.mock.stop()

    def raw(self, console):
        host, port = console.address.rsplit(":", 1)
        connection = socket.create_connection((host, int(port)), timeout=30)
        self.addCleanup(connection.close)
        return connection

    def metrics(self, console):
        with Browser(console.address) as browser:
            return browser.ask("GET", "/metrics")[2]

    def test_two_gigabytes_are_refused_before_they_are_sent(self):
        with Console(CONSOLE, self.mock.address) as console, Browser(console.address) as browser:
            browser.sign_in()
            connection = self.raw(console)
            connection.sendall(("POST /horopter.v1.CatalogService/ImportObject HTTP/1.1\r\nHost: localhost\r\nCookie: %s\r\n"
                                "X-Horopter-Console: 1\r\nContent-Type: %s\r\nContent-Length: 2147483648\r\n\r\n"
                                % (browser.cookie, WEB)).encode())
            self.assertTrue(connection.recv(100).startswith(b"HTTP/1.1 413 "))

    def test_bodies_of_unknown_length_are_refused(self):
        with Console(CONSOLE, self.mock.address) as console, Browser(console.address) as browser:
            browser.sign_in()
            connection = self.raw(console)
            connection.sendall(("POST /horopter.v1.CatalogService/ListObjects HTTP/1.1\r\nHost: localhost\r\nCookie: %s\r\n"
                                "X-Horopter-Console: 1\r\nContent-Type: %s\r\nTransfer-Encoding: chunked\r\n\r\n"
                                % (browser.cookie, WEB)).encode())
            self.assertTrue(connection.recv(100).startswith(b"HTTP/1.1 411 "))

    def test_memory_is_bounded_over_all_requests(self):
        with Console(CONSOLE, self.mock.address, "--memory-mb", "1", *MANY) as console, Browser(console.address) as browser:
            browser.sign_in()
            head = ("POST /horopter.v1.CatalogService/ListObjects HTTP/1.1\r\nHost: localhost\r\nCookie: %s\r\n"
                    "X-Horopter-Console: 1\r\nContent-Type: %s\r\nContent-Length: 700000\r\n\r\n" % (browser.cookie, WEB)).encode()
            first = self.raw(console)
            first.sendall(head + b"\0" * 1000)
            deadline = time.monotonic() + 30
            while b"horopter_console_body_bytes 700000" not in self.metrics(console):
                self.assertLess(time.monotonic(), deadline)
            second = self.raw(console)
            second.sendall(head)
            self.assertTrue(second.recv(100).startswith(b"HTTP/1.1 503 "))
            first.close()
            while b"horopter_console_body_bytes 0" not in self.metrics(console):
                self.assertLess(time.monotonic(), deadline)

    def test_connections_of_an_address_are_bounded(self):
        with Console(CONSOLE, self.mock.address, "--max-connections-per-peer", "4") as console:
            held = [self.raw(console) for _ in range(4)]
            deadline = time.monotonic() + 30
            while True:  # those before are accepted first
                extra = self.raw(console)
                extra.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
                try:
                    if extra.recv(100) == b"":
                        break
                except ConnectionError:
                    break
                self.assertLess(time.monotonic(), deadline)
            held[0].sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
            self.assertTrue(held[0].recv(100).startswith(b"HTTP/1.1 200 "))

    def test_requests_of_an_address_are_bounded(self):
        with Console(CONSOLE, self.mock.address, "--requests-per-second", "1") as console:
            seen = set()
            for _ in range(30):
                with Browser(console.address) as browser:
                    seen.add(browser.ask("GET", "/healthz")[0])
            self.assertEqual(seen, {200, 429})

    def test_long_heads_are_refused(self):
        with Console(CONSOLE, self.mock.address) as console:
            connection = self.raw(console)
            connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"a" * 40000)
            self.assertTrue(connection.recv(100).startswith(b"HTTP/1.1 431 "))

    def test_a_hundred_browsers_are_served(self):
        with Console(CONSOLE, self.mock.address, *MANY) as console, Browser(console.address) as browser:
            browser.sign_in()
            held = []
            for _ in range(100):
                other = Browser(console.address)
                self.addCleanup(other.http.close)
                other.cookie = browser.cookie
                other.http.request("POST", "/horopter.v1.ServerService/GetServerInfo", frame(b""),
                                   {"Content-Type": WEB, "Cookie": browser.cookie, **MARK})
                held.append(other)
            for other in held:
                self.assertEqual(frames(other.http.getresponse().read())[1]["grpc-status"], "0")


class Program(Folder):
    def run_it(self, *arguments):
        return subprocess.run([CONSOLE, *arguments], capture_output=True, text=True, timeout=60, check=False)

    def test_exit_codes(self):
        self.assertEqual(self.run_it("--version").returncode, 0)
        for wrong in (("--nonsense",), ("--listen", "nowhere"), ("--tls-cert", "x.pem"), ("--server", "http://x"),
                      ("--listen", "0.0.0.0:0"), ("--server", "192.0.2.1:50051")):
            done = self.run_it(*wrong)
            self.assertEqual(done.returncode, 2, (wrong, done.stderr))
            self.assertTrue(done.stderr.strip(), wrong)
        taken = socket.create_server(("127.0.0.1", 0))
        self.addCleanup(taken.close)
        self.assertEqual(self.run_it("--listen", "127.0.0.1:%d" % taken.getsockname()[1]).returncode, 1)
        self.assertEqual(self.run_it("--page", self.folder).returncode, 1)

    def test_configuration_is_read_and_checked(self):
        path = os.path.join(self.folder, "console.toml")
        for text, code in (('listen="nowhere"\n', 2), ("lisen=\"127.0.0.1:0\"\n", 2), ("[a]\nlisten=\"x\"\n", 2)):
            with open(path, "w", encoding="utf-8") as file:
                file.write(text)
            self.assertEqual(self.run_it("--config", path).returncode, code)
        with open(path, "w", encoding="utf-8") as file:
            file.write(self.run_it("--print-config").stdout)
        with Console(CONSOLE, "localhost:1", "--config", path) as console, Browser(console.address) as browser:
            self.assertEqual(browser.ask("GET", "/healthz")[0], 200)
            console.process.send_signal(signal.SIGHUP)
            self.assertEqual(browser.ask("GET", "/healthz")[0], 200)
            console.process.send_signal(signal.SIGTERM)
            self.assertEqual(console.process.wait(timeout=30), 0)

    def test_files_of_the_page(self):
        os.makedirs(os.path.join(self.folder, "assets"))
        for name, text in (("index.html", "<!doctype html><title>x</title>" * 50), ("assets/a.js", "1" * 5000)):
            with open(os.path.join(self.folder, name), "w", encoding="utf-8") as file:
                file.write(text)
        with Console(CONSOLE, "localhost:1", "--page", self.folder) as console, Browser(console.address) as browser:
            status, fields, body = browser.ask("GET", "/", headers={"Accept-Encoding": "gzip"})
            self.assertEqual((status, fields["Content-Encoding"], fields["Cache-Control"]), (200, "gzip", "no-cache"))
            etag = fields["ETag"]
            self.assertEqual(browser.ask("GET", "/", headers={"If-None-Match": etag})[0], 304)
            status, fields, body = browser.ask("GET", "/assets/a.js")
            self.assertEqual((status, body), (200, b"1" * 5000))
            self.assertIn("immutable", fields["Cache-Control"])
            status, fields, body = browser.ask("HEAD", "/assets/a.js")
            self.assertEqual((status, fields["Content-Length"], body), (200, "5000", b""))
            for path in ("/../index.html", "/assets/../../etc/passwd", "/%2e%2e/etc/passwd", "//etc/passwd"):
                self.assertEqual(browser.ask("GET", path)[0], 404, path)
        with Console(CONSOLE, "localhost:1", "--page", "") as console, Browser(console.address) as browser:
            status, _, body = browser.ask("GET", "/")
            self.assertEqual(status, 200)
            self.assertIn(b"not installed", body)


class Mutated(unittest.TestCase):
    """10,000 requests, each an honest one with bytes changed: none ends the process, and each is answered or cut off."""

    REQUESTS = 10000

    def honest(self, cookie):
        call = ("POST /horopter.v1.%s HTTP/1.1\r\nHost: localhost\r\nCookie: %s\r\nX-Horopter-Console: 1\r\n"
                "Origin: http://localhost\r\nSec-Fetch-Site: same-origin\r\ngrpc-timeout: 5S\r\nContent-Type: %s\r\n"
                "Content-Length: %d\r\n\r\n")
        listing = frame(catalog_pb2.ListObjectsRequest(page_size=5, page_token="abc").SerializeToString())
        get = frame(catalog_pb2.GetObjectRequest(name="objects/block").SerializeToString())
        return [(call % ("CatalogService/ListObjects", cookie, WEB, len(listing))).encode() + listing,
                (call % ("CatalogService/GetObject", cookie, WEB, len(get))).encode() + get,
                b"GET / HTTP/1.1\r\nHost: localhost\r\nAccept-Encoding: gzip\r\nIf-None-Match: \"x\"\r\n\r\n",
                b"GET /session HTTP/1.1\r\nHost: localhost\r\nCookie: " + cookie.encode() + b"\r\n\r\n",
                b"POST /sign-in HTTP/1.1\r\nHost: localhost\r\nX-Horopter-Console: 1\r\nContent-Length: 12\r\n\r\n{\"token\":\"\"}"]

    def mutated(self, chance, text):
        text = bytearray(text)
        for _ in range(chance.choice((1, 1, 2, 4, 16))):
            where, kind = chance.randrange(len(text)) if text else 0, chance.randrange(5)
            if kind == 0 and text:
                text[where] = chance.randrange(256)
            elif kind == 1:
                text[where:where] = bytes(chance.randrange(256) for _ in range(chance.choice((1, 2, 40))))
            elif kind == 2:
                del text[where:where + chance.choice((1, 3, 30))]
            elif kind == 3:
                text[where:where] = text[max(0, where - 40):where]
            else:
                text[where:where] = chance.choice((b"\r\n", b"\r\n\r\n", b"\0", b": ", b"Content-Length: 99999999999999999999\r\n",
                                                   b"Transfer-Encoding: chunked\r\n", b"\xff\xff\xff\xff", b"HTTP/9.9"))
        return bytes(text)

    def test_nothing_ends_the_process(self):
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, hard), hard))
        self.addCleanup(resource.setrlimit, resource.RLIMIT_NOFILE, (soft, hard))
        with Mock(MOCK) as mock, Console(CONSOLE, mock.address, *MANY) as console:
            with Browser(console.address) as browser:
                browser.sign_in()
                cookie = browser.cookie
            honest = self.honest(cookie)
            host, port = console.address.rsplit(":", 1)
            chance, answered, statuses = random.Random(62), 0, {}
            for number in range(self.REQUESTS):
                connection = socket.create_connection((host, int(port)), timeout=30)
                try:
                    connection.sendall(self.mutated(chance, honest[number % len(honest)]))
                    connection.shutdown(socket.SHUT_WR)
                    head = connection.recv(64)
                except ConnectionError:
                    head = b""
                connection.close()
                if head:
                    self.assertRegex(head, rb"^HTTP/1\.1 \d\d\d ")
                    answered += 1
                    statuses[head[9:12]] = statuses.get(head[9:12], 0) + 1
                self.assertTrue(console.running, "request %d ended it" % number)
            print("answered %d of %d: %s" % (answered, self.REQUESTS, sorted(statuses.items())))
            self.assertGreater(answered, self.REQUESTS // 4)
            self.assertTrue({b"200", b"400"} <= set(statuses))
            with Browser(console.address) as browser:
                browser.cookie = cookie
                deadline = time.monotonic() + 60
                while True:  # what those requests held is free again
                    text = browser.ask("GET", "/metrics")[2]
                    if b"horopter_console_running_calls 0" in text and b"horopter_console_body_bytes 0" in text:
                        break
                    self.assertLess(time.monotonic(), deadline, text.decode())
                self.assertEqual(browser.call("CatalogService/ListObjects")[1]["grpc-status"], "0")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[6:])
