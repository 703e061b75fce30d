#!/usr/bin/env python3
"""Says whether the results of one scene are right: every target found, in every image within 10 px, and nothing else.

    demo_verdict.py DATASET SCENE RESULTS.csv SCORES.json       exit 0 right, 1 wrong
"""
import collections
import csv
import json
import os
import sys


def main():
    dataset, scene, results, scores = sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4]
    with open(os.path.join(dataset, "val_targets_multiview_bop25.json"), encoding="utf-8") as file:
        wanted = collections.Counter({t["obj_id"]: t["inst_count"] for t in json.load(file) if t["scene_id"] == scene})
    with open(os.path.join(dataset, "models", "names.json"), encoding="utf-8") as file:
        names = json.load(file)
    per_image = collections.defaultdict(collections.Counter)
    with open(results, encoding="utf-8") as file:
        for row in csv.DictReader(file):
            per_image[int(row["im_id"])][int(row["obj_id"])] += 1
    # An object counts as reported as often as the fullest image has it.
    reported = collections.Counter()
    for counts in per_image.values():
        reported |= counts
    with open(scores, encoding="utf-8") as file:
        score = json.load(file)["scenes"][str(scene)]

    def text(objects):
        return ", ".join("%s (%d)%s" % (names[str(o)], o, " x%d" % n if n > 1 else "")
                         for o, n in sorted(objects.items())) or "nothing"

    print("in the scene: " + text(wanted))
    print("recognised:   " + text(reported))
    print("missed: %s; reported but not there: %s" % (text(wanted - reported), text(reported - wanted)))
    print("R@10 %.3f" % score["R@10"])
    return 0 if reported == wanted and score["R@10"] == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
