"""A running horopter-console and a browser that speaks to it byte by byte, for tests in Python: `sys.path` needs tests/support."""
import http.client
import json
import struct
import urllib.parse

from mock_server import Served

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


class Console(Served):
    """address: HOST:PORT; said: its log so far."""

    def __init__(self, program, server, *arguments):
        super().__init__([program, "--listen", "127.0.0.1:0", "--server", server, *arguments], "serving browsers on ")


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
