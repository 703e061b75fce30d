"""What can go wrong in a call."""
from __future__ import annotations

from typing import Optional

import grpc

from horopter.v1 import errors_pb2


class HoropterError(Exception):
    """A failed call.

    code: canonical name, e.g. "INVALID_ARGUMENT"; request_id: the call in the server's log, None when the server was not
    reached; field: the offending field of the request, e.g. "images[2].content"; retry_after_s: when a new try makes
    sense, seconds; reason: stable name for programs, e.g. "ETAG_MISMATCH" (ErrorInfo in errors.proto).
    """

    def __init__(self, code: str, message: str, request_id: Optional[str] = None, field: Optional[str] = None,
                 retry_after_s: Optional[float] = None, reason: Optional[str] = None):
        text = message if request_id is None else "%s (request %s)" % (message, request_id)
        super().__init__(text)
        self.code = code
        self.message = message
        self.request_id = request_id
        self.field = field
        self.retry_after_s = retry_after_s
        self.reason = reason


class InvalidRequest(HoropterError):
    """The request has to be changed; `field` names what."""


class NotFound(HoropterError):
    """No such object."""


class AlreadyExists(HoropterError):
    """The id is taken."""


class Conflict(HoropterError):
    """The object has changed since its etag was read."""


class Busy(HoropterError):
    """The queue, or the memory for requests, is full; try again after `retry_after_s`."""


class TooLarge(HoropterError):
    """The request is too large, or memory or disk of the server are full."""


class DeadlineExceeded(HoropterError):
    """No answer within the deadline."""


class Cancelled(HoropterError):
    """The caller cancelled."""


class Unavailable(HoropterError):
    """The server is stopping or not there."""


class DataLoss(HoropterError):
    """What is stored is damaged."""


class PermissionDenied(HoropterError):
    """The caller has not the role for this, or the server may not do it, e.g. write its catalog."""


class Unauthenticated(HoropterError):
    """The server wants to know who calls: no token, or one that is not known or has expired."""


class InternalError(HoropterError):
    """A fault of the server; report it with the request id."""


_CLASSES = {
    "INVALID_ARGUMENT": InvalidRequest,
    "NOT_FOUND": NotFound,
    "ALREADY_EXISTS": AlreadyExists,
    "ABORTED": Conflict,
    "DEADLINE_EXCEEDED": DeadlineExceeded,
    "CANCELLED": Cancelled,
    "UNAVAILABLE": Unavailable,
    "DATA_LOSS": DataLoss,
    "PERMISSION_DENIED": PermissionDenied,
    "UNAUTHENTICATED": Unauthenticated,
    "INTERNAL": InternalError,
}


def _value(metadata, key: str) -> Optional[str]:
    for name, value in metadata or ():
        if name == key:
            return value if isinstance(value, str) else value.decode("utf-8", "replace")
    return None


def _reason(metadata) -> Optional[str]:
    for name, value in metadata or ():
        if name == "grpc-status-details-bin":
            for detail in errors_pb2.Status.FromString(value).details:
                if detail.type_url.endswith("/google.rpc.ErrorInfo"):
                    return errors_pb2.ErrorInfo.FromString(detail.value).reason
    return None


# gRPC of the server breaks calls off (ENHANCE_YOUR_CALM) while messages on their way hold all of its memory, and sends no
# time to try again.
_RETRY_AFTER_BREAK_MS = "1000"


_FIRST_PAUSE_S = 0.2


def pause_before_retry(error: HoropterError, attempt: int) -> Optional[float]:
    """How long to wait before a call is made again that failed for the (attempt + 1)th time, seconds; None: it is not."""
    if isinstance(error, Busy):
        return error.retry_after_s
    # The server was not reached, is stopping, or its answer was lost. Calls may be repeated: a creation has its request_id, other
    # writes write the same again.
    return _FIRST_PAUSE_S * 2 ** attempt if isinstance(error, Unavailable) else None


# What gRPC says of a connection that fails, and our words for it; the first that is found counts.
_FAULTS = (
    ("wrong version number", "it does not speak TLS: call it without ca_file"),
    ("packet length too long", "it does not speak TLS: call it without ca_file"),
    ("certificate verify failed", "the authority that is given does not vouch for its certificate: ca_file"),
    ("is not in peer certificate", "its certificate is for another name: server_name"),
    ("hostname verification", "its certificate is for another name: server_name"),
    ("certificate required", "it wants a client certificate: cert_file and key_file"),
    ("bad certificate", "it does not take the client certificate: cert_file"),
    ("unknown ca", "it does not know the authority of the client certificate: cert_file"),
    ("connection refused", "nothing listens there"),
    ("no such file", "there is no such socket"),
    ("dns resolution failed", "the name of the host is not known"),
    ("domain name not found", "the name of the host is not known"),
    ("network is unreachable", "no network leads there"),
    ("no route to host", "no network leads there"),
    ("socket closed", "it closed the connection: it may want TLS (ca_file), be stopping, or be no horopterd"),
    ("connection reset", "it closed the connection: it may want TLS (ca_file), be stopping, or be no horopterd"),
    ("recvmsg", "it closed the connection: it may want TLS (ca_file), be stopping, or be no horopterd"),
    ("timed out", "it does not answer"),
)


def _connection_fault(details: str) -> str:
    """The details of UNAVAILABLE in words that say what to do, with gRPC's behind them."""
    plain = details.lower().replace("_", " ")
    for sign, words in _FAULTS:
        if sign in plain:
            return "the server cannot be reached: %s (%s)" % (words, details)
    return details


def from_rpc(error: grpc.RpcError) -> HoropterError:
    """The typed error of a failed gRPC call (of grpc or grpc.aio)."""
    code = error.code().name
    trailing, initial = error.trailing_metadata(), error.initial_metadata()
    retry = _value(trailing, "retry-after-ms")
    request_id = _value(initial, "horopter-request-id") or _value(trailing, "horopter-request-id")
    if code == "RESOURCE_EXHAUSTED":
        if retry is None and "RST_STREAM with error code 11" in (error.details() or ""):
            retry = _RETRY_AFTER_BREAK_MS
        kind = TooLarge if retry is None else Busy
    else:
        kind = _CLASSES.get(code, HoropterError)
    details = error.details() or ""
    if code == "UNAVAILABLE" and request_id is None:
        details = _connection_fault(details)
    return kind(code, details, request_id, _value(trailing, "horopter-error-field"),
                None if retry is None else float(retry) / 1e3, _reason(trailing))
