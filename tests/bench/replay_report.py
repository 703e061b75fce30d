#!/usr/bin/env python3
"""Whether recorded requests are answered the same bit for bit, whatever the number of threads.

    replay_report.py BUILD [--requests N] [--threads 1,2,4] [--width W]

Records N requests (default 1000) of horopterd with the first number of threads: crops of the sample scenes, scaled to W
pixels (default 480), no two alike, three or four images each, two parts enrolled. Then replays them with each number. Prints
how many answers recognised something, and how many differ; exit code 1 when any does. Needs python3-opencv and python3-numpy.
"""
import argparse
import os
import re
import subprocess
import sys
import tempfile
import time

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
DATASET = os.path.join(ROOT, "tests", "data", "parts")
PARTS = ("obj_000019", "obj_000001")
SCENES = ("000005", "000001")
sys.path.insert(0, os.path.join(ROOT, "tests", "support"))
from mock_server import Mock  # noqa: E402

import cv2  # noqa: E402
import numpy as np  # noqa: E402


def serve(program, catalog, threads, *arguments):
    """horopterd; it says where it listens as its stand-in does."""
    return Mock(program, "--db", catalog, "--listen", "127.0.0.1:0", "--cores", "4", "--threads-per-request", str(threads),
                *arguments)


def image_sets(count, wide):
    """Lists of PNG files' bytes."""
    generator = np.random.default_rng(1)
    scenes = []
    for scene in SCENES:
        folder = os.path.join(DATASET, "val", scene, "rgb")
        scenes.append([cv2.imread(os.path.join(folder, name)) for name in sorted(os.listdir(folder))])
    for k in range(count):
        scene = scenes[k % len(scenes)]
        images = []
        for i in sorted(generator.choice(len(scene), 3 + k % 2, replace=False)):
            image = scene[i]
            height, width = image.shape[:2]
            size = int(width * generator.uniform(0.85, 1.0))
            x, y = generator.integers(0, width - size + 1), generator.integers(0, height - size * 3 // 4 + 1)
            crop = cv2.resize(image[y:y + size * 3 // 4, x:x + size], (wide, wide * 3 // 4), interpolation=cv2.INTER_AREA)
            noise = generator.normal(0.0, 2.0, crop.shape)
            images.append(cv2.imencode(".png", np.clip(crop + noise, 0, 255).astype(np.uint8))[1].tobytes())
        yield images


def record(programs, folder, catalog, count, wide, threads):
    recordings = os.path.join(folder, "recordings")
    with serve(programs["horopterd"], catalog, threads, "--record-dir", recordings, "--record-sample", "1") as server:
        for part in PARTS:
            subprocess.run([programs["horopter"], "--server", server.address, "object", "add",
                            os.path.join(DATASET, "cad", part + ".step"), "--id", part], check=True, capture_output=True)
        import horopter
        states = {}
        with horopter.Client(server.address) as client:
            for images in image_sets(count, wide):
                state = client.recognize(images).outcome
                states[state] = states.get(state, 0) + 1
    return recordings, states


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build")
    parser.add_argument("--requests", type=int, default=1000)
    parser.add_argument("--threads", default="1,2,4")
    parser.add_argument("--width", type=int, default=480)
    arguments = parser.parse_args()
    build = os.path.abspath(arguments.build)
    programs = {"horopterd": os.path.join(build, "bin", "horopterd"), "horopter": os.path.join(build, "client", "horopter")}
    sys.path.insert(0, os.path.join(build, "client", "python"))
    numbers = [int(n) for n in arguments.threads.split(",")]
    worst = 0
    with tempfile.TemporaryDirectory() as folder:
        catalog = os.path.join(folder, "parts.db")
        start = time.monotonic()
        recordings, states = record(programs, folder, catalog, arguments.requests, arguments.width, numbers[0])
        files = sorted(os.path.join(recordings, name) for name in os.listdir(recordings))
        print("%d requests recorded with %d thread(s) in %.0f s: %s" %
              (len(files), numbers[0], time.monotonic() - start, ", ".join("%s %d" % s for s in sorted(states.items()))),
              flush=True)
        if len(files) != arguments.requests:
            sys.exit("%d recordings of %d requests" % (len(files), arguments.requests))
        for threads in numbers:
            start = time.monotonic()
            with serve(programs["horopterd"], catalog, threads) as server:
                said = subprocess.run([programs["horopter"], "--server", server.address, "replay", *files],
                                      capture_output=True, text=True, check=False)
            found = re.search(r"(\d+) recordings, (\d+) answers differ", said.stdout)
            if not found:
                sys.exit(said.stdout + said.stderr)
            print("replayed with %d thread(s) in %.0f s: %s of %s differ" %
                  (threads, time.monotonic() - start, found.group(2), found.group(1)), flush=True)
            worst = max(worst, int(found.group(2)))
    sys.exit(1 if worst else 0)


if __name__ == "__main__":
    main()
