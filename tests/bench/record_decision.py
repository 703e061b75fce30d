#!/usr/bin/env python3
"""Records what the decision says of one data set under several catalogs as a run of the kind `decision` (form: runs/README.md).

    record_decision.py DATASET SPLIT OUT.json [--name NAME] [--programs FOLDER] [--revision REV] [--catalogs true,absent,mirror,stretched]
                       [--others DATASET]... [--decoys NAME=FOLDER]... [--scenes 1,2] [--images N] [--shared]

--catalogs  true: the set's own parts; absent: of each scene all but its own; mirror, stretched: made of the set's parts
--others    the parts of another data set; may be said more than once
--decoys    parts that decoy_parts has made of the set's, and what to call them; may be said more than once
--images    of each scene
"""
import argparse
import os
import re
import subprocess
import sys

import run_files

ANSWER = re.compile(r"^(\d+) (\S+) (\S+) ([\d.]+) worst ([\d.e+]+) px alternatives (\d+)$")
SCENE = re.compile(r"^(\d+) shapes [\d.]+ of ([\d.]+) s:")
RIGHT_PX = 10.0


def answers(text, catalog):
    """Scenes of what decision_report has printed. An answer: score, right, alternatives, part."""
    found, scenes = [], []
    for line in text.splitlines():
        answer, scene = ANSWER.match(line), SCENE.match(line)
        if answer:
            right = catalog == "true" and float(answer.group(5)) <= RIGHT_PX
            found.append([float(answer.group(4)), int(right), int(answer.group(6)), answer.group(3)])
        elif scene:
            scenes.append({"scene": int(scene.group(1)), "catalog": catalog, "answers": found, "seconds": float(scene.group(2))})
            found = []
    return scenes


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset")
    parser.add_argument("split")
    parser.add_argument("out")
    parser.add_argument("--name")
    parser.add_argument("--programs", default="build/release/tests/bench")
    parser.add_argument("--revision", default="HEAD")
    parser.add_argument("--catalogs", default="true,absent,mirror,stretched")
    parser.add_argument("--others", action="append", default=[])
    parser.add_argument("--decoys", action="append", default=[])
    parser.add_argument("--scenes")
    parser.add_argument("--images")
    parser.add_argument("--shared", action="store_true")
    a = parser.parse_args()
    program = os.path.join(a.programs, "decision_report")
    load = os.getloadavg()[0]
    asked = [(c, ["--catalog", c]) for c in a.catalogs.split(",") if c]
    asked += [("of " + os.path.basename(other.rstrip("/")), ["--others", other]) for other in a.others]
    for decoys in a.decoys:
        name, _, folder = decoys.partition("=")
        asked.append((name, ["--decoys", folder]))
    scenes = []
    for catalog, options in asked:
        command = [program, a.dataset, a.split] + options
        for name, value in (("--scenes", a.scenes), ("--images", a.images)):
            command += [name, value] if value else []
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            sys.exit("record_decision.py: %s\n%s" % (" ".join(command), done.stderr[-2000:]))
        scenes += answers(done.stdout, catalog)
    data = os.environ.get("HOROPTER_DATA", "")
    words = [w.replace(data, "$HOROPTER_DATA") if data else w for w in sys.argv[1:]]
    name = a.name or os.path.basename(a.dataset.rstrip("/"))
    words = [w for i, w in enumerate(words) if i != 2 and w not in ("--shared",)]
    run_files.write(a.out, "decision", name, a.revision, " ".join(["tests/bench/record_decision.py"] + words), run_files.machine(a.shared, load),
                    len({s["scene"] for s in scenes}), {"split": a.split, "scenes": scenes})


if __name__ == "__main__":
    main()
