"""A running horopter-console and a browser that speaks to it byte by byte, for tests in Python."""
import http.client
import json
import struct
import subprocess
import threading
import urllib.parse

MARK = {"X-Horopter-Console": "1"}
WEB = "application/grpc-web+proto"


def frame(message):
    return struct.pack(">BI", 0, len(message)) + message


def frames(body):
    """(messages, trailers) of an answer's body."""
    messages, trailers = [], None
    while body:
        flags, size = struct.unpack(">BI", body[:5])
        assert len(body) >= 5 + size, "a frame is cut off"
        one, body = body[5:5 + size], body[5 + size:]
        if flags & 0x80:
            assert trailers is None and not body, "the trailers come last"
            trailers = dict(line.split(": ", 1) for line in one.decode().split("\r\n") if line)
        else:
            messages.append(one)
    return messages, trailers


class Console:
    """address: HOST:PORT; said: its log so far."""

    def __init__(self, program, server, *arguments):
        self.process = subprocess.Popen([program, "--listen", "127.0.0.1:0", "--server", server, *arguments],
                                        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.address, self.said, self._up = None, [], threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._up.wait(timeout=60)
        if not self.address:
            self.stop()
            raise AssertionError("the console did not come up: " + "".join(self.said))

    def _read(self):
        for line in self.process.stdout:
            self.said.append(line)
            if "serving browsers on " in line:
                self.address = line.split("serving browsers on ")[1].split(",")[0].strip()
                self._up.set()
        self.process.stdout.close()
        self._up.set()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def stop(self):
        self.process.kill()
        self.process.wait()
        self._reader.join()

    @property
    def running(self):
        return self.process.poll() is None


class Browser:
    """A connection with the session's cookie."""

    def __init__(self, address, timeout=60):
        host, port = address.rsplit(":", 1)
        self.http = http.client.HTTPConnection(host, int(port), timeout=timeout)
        self.cookie = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.http.close()

    def ask(self, method, path, body=None, headers=None):
        """(status, headers, body)"""
        fields = dict(headers or {})
        if self.cookie:
            fields.setdefault("Cookie", self.cookie)
        self.http.request(method, path, body=body, headers=fields)
        answer = self.http.getresponse()
        content = answer.read()
        if answer.getheader("Set-Cookie"):
            self.cookie = answer.getheader("Set-Cookie").split(";")[0]
        return answer.status, answer.headers, content

    def sign_in(self, token=""):
        return self.ask("POST", "/sign-in", json.dumps({"token": token}), MARK)

    def call(self, method, message=b"", **headers):
        """(messages, trailers) of an answer that has the status 200."""
        status, fields, body = self.ask("POST", "/horopter.v1." + method, frame(message),
                                        {"Content-Type": WEB, **MARK, **{k.replace("_", "-"): v for k, v in headers.items()}})
        assert status == 200 and fields["Content-Type"] == WEB, (status, body)
        return frames(body)


def message_of(trailers):
    return urllib.parse.unquote(trailers.get("grpc-message", ""))
