#!/usr/bin/env python3
"""What the tools around recognition cost, against a server whose recognition is a stand-in. Prints one line a figure.

    tools_report.py BUILD [--quick]

BUILD: a build folder with horopter, mock_horopterd and the Python package. Needs Debian's python3-grpcio, -protobuf, -numpy.

- Load tool: share of one core that `horopter load` takes at 100 requests/s of one small image, and of a whole scene; and
  that a client takes that does nothing but call (bare_client): the difference is the tool's own.
- Percentiles of latency: of answers after 20 to 120 ms the load tool's against the server's own request log (which misses
  the way there and back) and against those of its own list of requests computed here; of answers after 70 ms against those
  of a bare client that calls the same server at the same time.
- Metrics: time of a scrape, after these runs.
- Python: median round trip of the package less that of the C++ client, both one request at a time, alternating.
"""
import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
import urllib.request

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
SCENE = os.path.join(ROOT, "tests", "data", "parts", "val", "000005")
sys.path.insert(0, os.path.join(ROOT, "tests", "support"))
from mock_server import Mock  # noqa: E402

import numpy as np  # noqa: E402


class Programs:
    def __init__(self, build):
        self.horopter = os.path.join(build, "client", "horopter")
        self.mock = os.path.join(build, "tests", "e2e", "mock_horopterd")
        self.bare_client = os.path.join(build, "tests", "bench", "bare_client")
        self.python = os.path.join(build, "client", "python")

    def load(self, server, *arguments):
        said = subprocess.run([self.horopter, "--server", server.address, "load", *arguments, "--json"], check=True,
                              capture_output=True, text=True).stdout
        return json.loads(said)["steps"][0]


def small_images(folder):
    """A folder with one image of 64 x 48."""
    import horopter
    os.makedirs(folder)
    with open(os.path.join(folder, "0.png"), "wb") as out:
        out.write(horopter.encode_image(np.random.default_rng(1).integers(0, 255, (48, 64), np.uint8)))
    return folder


def bare(programs, server, folder, rate, seconds, *arguments):
    """A running bare client."""
    return subprocess.Popen([programs.bare_client, "--server", server.address, "--image", os.path.join(folder, "0.png"),
                             "--rate", str(rate), "--seconds", str(seconds), *arguments], stdout=subprocess.PIPE, text=True)


def load_overhead(programs, folder, seconds):
    with Mock(programs.mock, "--workers", "4") as server:
        print("bare client, 100/s, one image of 64 x 48:", bare(programs, server, folder, 100, seconds).communicate()[0].strip())
        for name, source in (("one image of 64 x 48", folder), ("scene of 4 images of 640 x 480", SCENE)):
            step = programs.load(server, source, "--rate", "100", "--duration", str(seconds), "--warmup", "20")
            print("load tool, 100/s, %s: %.2f %% of a core (%d answered)" %
                  (name, 100 * step["client_cpu_share"], step["codes"].get("OK", 0)))


def print_percentiles(what, step, measured):
    for name, share in (("p50", 50), ("p90", 90), ("p99", 99)):
        said = step["latency"][name + "_ms"]
        print("percentiles, %s, %s of %d: load tool %.2f ms; %s" % (what, name, step["requests"], said, ", ".join(
            "%s %.2f ms (%+.2f %%)" % (who, np.percentile(ms, share), 100 * (said / np.percentile(ms, share) - 1))
            for who, ms in measured.items())))


def percentiles(programs, folder, seconds):
    log = os.path.join(os.path.dirname(folder), "requests.jsonl")
    table = os.path.join(os.path.dirname(folder), "requests.csv")
    bare_table = os.path.join(os.path.dirname(folder), "bare.csv")
    with Mock(programs.mock, "--workers", "32", "--queue", "1000", "--delay-ms", "20", "--delay-spread-ms", "100",
              "--request-log", log) as server:
        step = programs.load(server, folder, "--rate", "50", "--poisson", "--duration", str(seconds), "--csv", table)
    with open(table, encoding="utf-8") as file:
        own = [1e3 * (float(r["done_s"]) - float(r["due_s"])) for r in csv.DictReader(file)]
    with open(log, encoding="utf-8") as file:
        seen = [json.loads(line) for line in file]
    seen = [line["ms"] for line in seen if line["method"] == "RecognizeScene"][-len(own):]  # without the warm-up
    print_percentiles("20 to 120 ms", step, {"request log": seen, "its list": own})
    with Mock(programs.mock, "--workers", "32", "--queue", "1000", "--delay-ms", "70") as server:
        # Two whole seconds longer: there while the load tool starts, too.
        other = bare(programs, server, folder, 50, seconds + 2, "--csv", bare_table)
        step = programs.load(server, folder, "--rate", "50", "--poisson", "--duration", str(seconds))
        other.communicate()
    print_percentiles("70 ms", step, {"bare client": np.loadtxt(bare_table)})


def scrape(programs, folder):
    with Mock(programs.mock, "--metrics-listen", "127.0.0.1:0") as server:
        programs.load(server, folder, "--requests", "300")
        times = []
        for _ in range(200):
            start = time.perf_counter()
            with urllib.request.urlopen(server.metrics_url) as answer:
                size = len(answer.read())
            times.append(1e3 * (time.perf_counter() - start))
    print("metrics, a scrape of %d bytes: median %.2f ms, p95 %.2f ms" %
          (size, np.median(times), np.percentile(times, 95)))


def round_trips(programs, folder, rounds):
    import horopter
    with open(os.path.join(folder, "0.png"), "rb") as file:
        image = file.read()
    python, cpp = [], []
    with Mock(programs.mock) as server, horopter.Client(server.address) as client:
        for _ in range(20):
            client.recognize([image])
        for _ in range(rounds):  # alternating: what else the machine does meets both
            for _ in range(100):
                start = time.perf_counter()
                client.recognize([image])
                python.append(1e3 * (time.perf_counter() - start))
            cpp.append(programs.load(server, folder, "--requests", "100", "--warmup", "20")["latency"]["p50_ms"])
    print("round trip, medians: Python %.2f ms, C++ %.2f ms: Python adds %.2f ms" %
          (np.median(python), np.median(cpp), np.median(python) - np.median(cpp)))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build")
    parser.add_argument("--quick", action="store_true", help="shorter runs")
    arguments = parser.parse_args()
    programs = Programs(os.path.abspath(arguments.build))
    sys.path.insert(0, programs.python)
    seconds = 3 if arguments.quick else 20
    with tempfile.TemporaryDirectory() as folder:
        images = small_images(os.path.join(folder, "images"))
        load_overhead(programs, images, seconds)
        percentiles(programs, images, 2 * seconds)
        scrape(programs, images)
        round_trips(programs, images, 2 if arguments.quick else 10)


if __name__ == "__main__":
    main()
