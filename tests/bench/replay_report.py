#!/usr/bin/env python3
"""Whether recorded requests are answered the same bit for bit, whatever the number of threads.

    replay_report.py BUILD [--requests N] [--threads 1,2,4] [--width W] [--images LEAST,MOST] [--scenes 5,1] [--seed S]
                     [--no-repeat]

Records N requests (default 1000) of horopterd with the first number of threads: crops of the sample scenes, scaled to W
pixels (default 480), no two alike, so many images each, the scenes' parts enrolled. Then replays them with each number, with
--no-repeat only with the others: the recordings stand for the first. Prints how many answers recognised something, and how
many differ; exit code 1 when any does. Needs python3-opencv and python3-numpy.
"""
import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
DATASET = os.path.join(ROOT, "tests", "data", "parts")
sys.path.insert(0, os.path.join(ROOT, "tests", "support"))
from mock_server import Mock  # noqa: E402

import cv2  # noqa: E402
import numpy as np  # noqa: E402


def serve(program, catalog, threads, *arguments):
    """horopterd; it says where it listens as its stand-in does."""
    return Mock(program, "--db", catalog, "--listen", "127.0.0.1:0", "--cores", "4", "--threads-per-request", str(threads),
                *arguments)


def numbers_of(text):
    return [int(n) for n in text.split(",")]


def parts_of(scene):
    """Ids of the objects in a scene."""
    with open(os.path.join(DATASET, "val", "%06d" % scene, "scene_gt.json"), encoding="utf-8") as file:
        return sorted({"obj_%06d" % instance["obj_id"] for image in json.load(file).values() for instance in image})


def image_sets(arguments):
    """Lists of PNG files' bytes."""
    count, wide = arguments.requests, arguments.width
    least, most = arguments.images
    generator = np.random.default_rng(arguments.seed)
    scenes = []
    for scene in arguments.scenes:
        folder = os.path.join(DATASET, "val", "%06d" % scene, "rgb")
        scenes.append([cv2.imread(os.path.join(folder, name)) for name in sorted(os.listdir(folder))])
    for k in range(count):
        scene = scenes[k % len(scenes)]
        images = []
        for i in sorted(generator.choice(len(scene), least + k % (most - least + 1), replace=False)):
            image = scene[i]
            height, width = image.shape[:2]
            size = int(width * generator.uniform(0.85, 1.0))
            x, y = generator.integers(0, width - size + 1), generator.integers(0, height - size * 3 // 4 + 1)
            crop = cv2.resize(image[y:y + size * 3 // 4, x:x + size], (wide, wide * 3 // 4), interpolation=cv2.INTER_AREA)
            noise = generator.normal(0.0, 2.0, crop.shape)
            images.append(cv2.imencode(".png", np.clip(crop + noise, 0, 255).astype(np.uint8))[1].tobytes())
        yield images


def record(programs, folder, catalog, arguments, threads):
    recordings = os.path.join(folder, "recordings")
    with serve(programs["horopterd"], catalog, threads, "--record-dir", recordings, "--record-sample", "1") as server:
        for part in sorted({part for scene in arguments.scenes for part in parts_of(scene)}):
            subprocess.run([programs["horopter"], "--server", server.address, "object", "add",
                            os.path.join(DATASET, "cad", part + ".step"), "--id", part], check=True, capture_output=True)
        import horopter
        states = {}
        with horopter.Client(server.address) as client:
            for images in image_sets(arguments):
                state = client.recognize(images).outcome
                states[state] = states.get(state, 0) + 1
    return recordings, states


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build")
    parser.add_argument("--requests", type=int, default=1000)
    parser.add_argument("--threads", default="1,2,4")
    parser.add_argument("--width", type=int, default=480)
    parser.add_argument("--images", type=numbers_of, default=[3, 4])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-repeat", action="store_true")
    parser.add_argument("--scenes", type=numbers_of, default=[5, 1])
    arguments = parser.parse_args()
    build = os.path.abspath(arguments.build)
    programs = {"horopterd": os.path.join(build, "bin", "horopterd"), "horopter": os.path.join(build, "client", "horopter")}
    sys.path.insert(0, os.path.join(build, "client", "python"))
    numbers = numbers_of(arguments.threads)
    worst = 0
    with tempfile.TemporaryDirectory() as folder:
        catalog = os.path.join(folder, "parts.db")
        start = time.monotonic()
        recordings, states = record(programs, folder, catalog, arguments, numbers[0])
        files = sorted(os.path.join(recordings, name) for name in os.listdir(recordings))
        print("%d requests recorded with %d thread(s) in %.0f s: %s" %
              (len(files), numbers[0], time.monotonic() - start, ", ".join("%s %d" % s for s in sorted(states.items()))),
              flush=True)
        if len(files) != arguments.requests:
            sys.exit("%d recordings of %d requests" % (len(files), arguments.requests))
        for threads in numbers[1:] if arguments.no_repeat else numbers:
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
