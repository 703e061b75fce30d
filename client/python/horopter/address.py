"""Addresses of servers, and whether a proxy stands before them. As client/address.cc."""
from __future__ import annotations

import ipaddress
import socket
from typing import Mapping, Optional, Tuple

# What gRPC resolves by itself.
_SCHEMES = ("dns", "ipv4", "ipv6", "unix", "unix-abstract", "vsock", "xds")


def check_address(address: str) -> None:
    """Raises ValueError: not "HOST:PORT" nor "unix:PATH"."""
    scheme, separator, rest = address.partition("://")
    if separator and scheme not in _SCHEMES:
        host = rest.split("/")[0]
        raise ValueError("%r is a URL; an address is HOST:PORT, here %r%s" % (
            address, host, ", with TLS (Security.tls or ca_file)" if scheme in ("https", "grpcs") else ""))
    if address.split(":")[0] in _SCHEMES[1:]:
        return
    host, port = split_address(address)
    if not host or port is None or not 0 < port < 65536 or any(c in host for c in "/?# "):
        raise ValueError("%r is no address: HOST:PORT, [IPv6]:PORT or unix:PATH" % address)


def split_address(address: str) -> Tuple[str, Optional[int]]:
    """Host without brackets, and port (None: not a number, or none) of an address."""
    for prefix in ("dns:", "ipv4:", "ipv6:"):
        if address.startswith(prefix):
            address = address[len(prefix):]
            if address.startswith("//"):
                address = address[2:].partition("/")[2]
            break
    host, separator, port = address.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    if not separator or (":" in host and not bracketed):
        return address, None
    return (host[1:-1] if bracketed else host), int(port) if port.isascii() and port.isdigit() else None


def _address_of(host: str):
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return None
    return getattr(address, "ipv4_mapped", None) or address


def is_this_machine(address: str) -> bool:
    """By its name or one of its interfaces."""
    if address.startswith(("unix:", "unix-abstract:", "vsock:")):
        return True
    host = split_address(address)[0].rstrip(".").lower()
    if host == "localhost" or host.endswith(".localhost") or host == socket.gethostname().lower():
        return True
    numeric = _address_of(host)
    if numeric is None:
        return False
    if numeric.is_loopback or numeric.is_unspecified:
        return True
    # A socket can be bound to addresses of this machine alone.
    try:
        with socket.socket(socket.AF_INET if numeric.version == 4 else socket.AF_INET6, socket.SOCK_DGRAM) as probe:
            probe.bind((str(numeric), 0))
        return True
    except OSError:
        return False


def matches_no_proxy(host: str, port: Optional[int], entries: str) -> bool:
    """entries: separated by commas: * (all), a domain with what is below it, an address, a network (10.0.0.0/8), each with a
    port if need be."""
    host, numeric = host.rstrip(".").lower(), _address_of(host)
    for entry in (e.strip().lower() for e in entries.split(",")):
        if entry == "*":
            return True
        try:
            if numeric is not None and "/" in entry and numeric in ipaddress.ip_network(entry, strict=False):
                return True
        except ValueError:
            continue
        name, of_port = split_address(entry)
        if of_port is None:
            name = entry[1:-1] if entry.startswith("[") and entry.endswith("]") else entry
        if not name or of_port not in (None, port):
            continue
        if numeric is not None:
            if _address_of(name) == numeric:
                return True
            continue
        name = name.lstrip("*").strip(".")
        if name and (host == name or host.endswith("." + name)):
            return True
    return False


def may_use_proxy(address: str, environment: Mapping[str, str]) -> bool:
    """False for this machine and what no_proxy, NO_PROXY or no_grpc_proxy names."""
    if is_this_machine(address):
        return False
    host, port = split_address(address)
    return not any(matches_no_proxy(host, port, environment.get(name, ""))
                   for name in ("no_grpc_proxy", "no_proxy", "NO_PROXY"))
