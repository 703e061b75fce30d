#!/usr/bin/env python3
"""Records figures of a benchmark program as a run of the kind `program` (form: runs/README.md).

    record_program.py NAME OUT.json [--programs FOLDER] [--revision REV] [--shared] [--note TEXT] [--from FILE]

NAME: index (the X-tree beside its peers, processor time of a query) or service (round trips over loopback without recognition). --from takes what the program has printed before instead of running it.
"""
import argparse
import os
import re
import subprocess
import sys

import run_files

NUMBER = r"(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)"


def index(text):
    """Rows of the table of index_benchmark: ours, the best peer and its name."""
    lines = [[c.strip() for c in line.strip().strip("|").split("|")] for line in text.splitlines() if line.startswith("|")]
    head = next((cells for cells in lines if cells[0].startswith("data/")), None)
    if head is None:
        return []
    ours = next(i for i, name in enumerate(head) if re.search("x-?tree", name, re.I))
    figures = []
    for cells in lines:
        if cells is head or not re.match(r"[\w.-]+/\d+/\d+/", cells[0]):
            continue
        peers = [(float(c), head[i]) for i, c in enumerate(cells[1:-1], 1) if c and i != ours]
        if cells[ours] and peers:
            best = min(peers)
            figures.append({"what": cells[0], "value": float(cells[ours]), "unit": "us; best peer %g (%s)" % best})
    return figures


def service(text):
    found = re.search(r"(\d+) requests of (\d+) bytes: whole %s / %s ms, without decoding %s / %s ms" % ((NUMBER,) * 4), text)
    if not found:
        return []
    n, size, p50, p99, over50, over99 = found.groups()
    of = "of %s requests of %s bytes" % (n, size)
    return [{"what": "round trip of four VGA JPEGs, p50 " + of, "value": float(p50), "unit": "ms wall"}, {"what": "p99", "value": float(p99), "unit": "ms wall"},
            {"what": "the same less decoding, p50", "value": float(over50), "unit": "ms wall"}, {"what": "p99", "value": float(over99), "unit": "ms wall"}]


PROGRAMS = {
    "index": (("index_benchmark", "--table", "--benchmark_filter=(uniform|clustered)/(3|6)/100000/", "--benchmark_min_time=0.1"), index),
    "service": (("service_overhead", "--requests", "300"), service),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=sorted(PROGRAMS))
    parser.add_argument("out")
    parser.add_argument("--programs", default=os.path.join(run_files.ROOT, "build", "release"))
    parser.add_argument("--revision", default="HEAD")
    parser.add_argument("--shared", action="store_true")
    parser.add_argument("--note")
    parser.add_argument("--from", dest="text")
    arguments = parser.parse_args()
    command, parse = PROGRAMS[arguments.name]
    load = os.getloadavg()[0]
    if arguments.text:
        with open(arguments.text, encoding="utf-8") as file:
            text = file.read()
    else:
        path = os.path.join(arguments.programs, "tests", "bench", command[0])
        if not os.path.exists(path):
            sys.exit("record_program.py: no %s; build it: cmake --build --preset release --target %s" % (path, command[0]))
        done = subprocess.run((path,) + command[1:], capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit("record_program.py: %s ended with %d: %s" % (command[0], done.returncode, done.stderr.strip()))
        text = done.stdout
    figures = parse(text)
    if not figures:
        sys.exit("record_program.py: nothing in what %s printed is a figure" % command[0])
    body = {"figures": figures}
    if arguments.note:
        body["note"] = arguments.note
    run_files.write(arguments.out, "program", arguments.name, arguments.revision, " ".join(command), run_files.machine(arguments.shared, load), len(figures), body)
    print(arguments.out)


if __name__ == "__main__":
    main()
