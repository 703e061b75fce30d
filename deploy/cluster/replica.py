#!/usr/bin/env python3
"""Takes a replica out of HAProxy's turn and back: for a restart without a failed call (docs/cluster.md).

    replica.py SOCKET drain NAME     no new calls; returns when it has none left (at most 15 minutes)
    replica.py SOCKET ready NAME     calls as soon as its health says so; returns when it does
    replica.py SOCKET show           state and calls of each
"""
import csv
import io
import socket
import sys
import time

BACKENDS = ("scenes", "others")


def ask(path, command):
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.connect(path)
        connection.sendall((command + "\n").encode())
        answer = b""
        while chunk := connection.recv(65536):
            answer += chunk
    return answer.decode()


def servers(path):
    rows = csv.DictReader(io.StringIO(ask(path, "show stat").lstrip("# ")))
    return [r for r in rows if r["pxname"] in BACKENDS and r["svname"] not in ("FRONTEND", "BACKEND")]


def change(path, name, state, done, most_s=900.0):
    if not any(r["svname"] == name for r in servers(path)):
        raise SystemExit("replica.py: HAProxy knows no replica %r" % name)
    for backend in BACKENDS:
        refused = ask(path, "set server %s/%s state %s" % (backend, name, state)).strip()
        if refused:
            raise SystemExit("replica.py: " + refused)
    end = time.monotonic() + most_s
    while not all(done(r) for r in servers(path) if r["svname"] == name):
        if time.monotonic() > end:
            raise SystemExit("replica.py: %s is not %s after %d s" % (name, state, most_s))
        time.sleep(0.1)


def drain(path, name, most_s=900.0):
    change(path, name, "drain", lambda r: int(r["scur"]) == 0, most_s)


def ready(path, name, most_s=900.0):
    change(path, name, "ready", lambda r: r["status"].startswith("UP"), most_s)


def main(arguments):
    if len(arguments) == 2 and arguments[1] == "show":
        for row in servers(arguments[0]):
            print("%-8s %-10s %-12s %s calls" % (row["pxname"], row["svname"], row["status"], row["scur"]))
    elif len(arguments) == 3 and arguments[1] in ("drain", "ready"):
        (drain if arguments[1] == "drain" else ready)(arguments[0], arguments[2])
    else:
        raise SystemExit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
