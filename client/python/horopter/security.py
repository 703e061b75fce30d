"""How a client proves who it is and whom it believes."""
from __future__ import annotations

import dataclasses
import os
from typing import Any, Dict, List, Optional, Tuple

import grpc

from .address import check_address, may_use_proxy

# Answers hold CAD files; the server bounds what it takes.
CHANNEL_OPTIONS = (("grpc.max_receive_message_length", -1), ("grpc.max_send_message_length", -1))


_BLANK = " \t\r\n\v\f\ufeff"


def clean_token(text: str, where: str = "token") -> str:
    """White space, line breaks and a mark of byte order around a token are dropped. Raises ValueError, which never holds the
    token: a character that is not printable ASCII, by its line and column."""
    token = text.strip(_BLANK)
    start = len(text) - len(text.lstrip(_BLANK))
    for at, character in enumerate(token, start):
        if not " " <= character <= "~":
            line_start = text.rfind("\n", 0, at) + 1
            raise ValueError("%s: line %d, column %d: a token is of printable ASCII characters"
                             % (where, text.count("\n", 0, at) + 1, at - line_start + 1))
    return token


def read_token(path: str) -> str:
    """The first line of a file that is not blank, cleaned. Raises OSError (the file), ValueError (holds no token, or other than
    one)."""
    with open(path, "rb") as file:
        content = file.read(1 << 16)
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # refused below, by its column
    token = clean_token((text.lstrip(_BLANK).split("\n", 1) or [""])[0], path)
    if not token:
        raise ValueError("%s: holds no token" % path)
    return token


@dataclasses.dataclass(frozen=True)
class Security:
    """TLS, client certificate and token of a connection. Files in PEM.

    tls: encrypted, with the system's authorities where ca_file is None; ca_file: authorities that may vouch for the server,
    implies tls; cert_file, key_file: the client's certificate (mutual TLS); server_name: in the server's certificate, None:
    the host of the address; token: sent with every call, without TLS only to this machine; blanks around it are dropped
    (ValueError: it is not of printable ASCII characters); token_file: instead, see read_token; proxy: other
    machines are reached through the proxy that the environment names (http_proxy, https_proxy, grpc_proxy), but for those of
    no_proxy or NO_PROXY; this machine never is.

    >>> Security(token="secret").is_tls, Security(ca_file="ca.pem").is_tls
    (False, True)
    """

    tls: bool = False
    ca_file: Optional[str] = None
    cert_file: Optional[str] = None
    key_file: Optional[str] = None
    server_name: Optional[str] = None
    token: Optional[str] = dataclasses.field(default=None, repr=False)
    token_file: dataclasses.InitVar[Optional[str]] = None
    proxy: bool = True

    def __post_init__(self, token_file: Optional[str]) -> None:
        if token_file is not None and self.token is not None:
            raise ValueError("token and token_file: give one of them")
        token = self.token
        if token_file is not None:
            token = read_token(token_file)
        elif token is not None:
            if isinstance(token, bytes):
                token = token.decode("latin-1")
            if not isinstance(token, str):
                raise TypeError("token is a string")
            token = clean_token(token) or None
        object.__setattr__(self, "token", token)

    @classmethod
    def from_environment(cls) -> "Security":
        """As the `horopter` program takes it: HOROPTER_TLS_CA, HOROPTER_TLS_CERT, HOROPTER_TLS_KEY, and HOROPTER_TOKEN_FILE or
        HOROPTER_TOKEN. Nothing set: neither TLS nor token. Raises OSError, ValueError (token)."""
        def value(name: str) -> Optional[str]:
            return os.environ.get(name) or None
        file = value("HOROPTER_TOKEN_FILE")
        return cls(ca_file=value("HOROPTER_TLS_CA"), cert_file=value("HOROPTER_TLS_CERT"), key_file=value("HOROPTER_TLS_KEY"),
                   token_file=file, token=None if file else value("HOROPTER_TOKEN"))

    @property
    def is_tls(self) -> bool:
        return self.tls or self.ca_file is not None or self.cert_file is not None

    def metadata(self) -> Tuple[Tuple[str, str], ...]:
        """What every call says of its caller."""
        return () if self.token is None else (("authorization", "Bearer " + self.token),)

    def arguments(self) -> List[str]:
        """The same for the `horopter` program, but for the token (see environment)."""
        named = (("--tls-ca", self.ca_file), ("--tls-cert", self.cert_file), ("--tls-key", self.key_file),
                 ("--tls-server-name", self.server_name))
        switches = (["--tls"] if self.tls else []) + ([] if self.proxy else ["--no-proxy"])
        return switches + [word for name, value in named if value is not None for word in (name, value)]

    def environment(self) -> Dict[str, str]:
        return dict(os.environ, **({} if self.token is None else {"HOROPTER_TOKEN": self.token}))


def server_address(address: Optional[str]) -> str:
    """The address, or that of HOROPTER_SERVER in the environment, or this machine's."""
    return (os.environ.get("HOROPTER_SERVER") or "localhost:50051") if address is None else address


def open_channel(module: Any, address: str, security: Security) -> Any:
    """A channel of `grpc` or `grpc.aio`. Raises OSError (a file), ValueError (the address is none, a token would travel in the
    clear)."""
    check_address(address)
    options = list(CHANNEL_OPTIONS)
    if not (security.proxy and may_use_proxy(address, os.environ)):
        options.append(("grpc.enable_http_proxy", 0))
    if not security.is_tls:
        host = address.rsplit(":", 1)[0]
        local = address.startswith("unix:") or host in ("localhost", "[::1]") or host.startswith("127.")
        if security.token is not None and not local:
            raise ValueError("a token is not sent to %s without TLS" % address)
        return module.insecure_channel(address, options=options)
    if security.server_name is not None:
        options.append(("grpc.ssl_target_name_override", security.server_name))
    credentials = grpc.ssl_channel_credentials(*map(_read, (security.ca_file, security.key_file, security.cert_file)))
    return module.secure_channel(address, credentials, options=options)


def _read(path: Optional[str]) -> Optional[bytes]:
    if path is None:
        return None
    with open(path, "rb") as file:
        return file.read()
