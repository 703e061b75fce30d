#!/usr/bin/env python3
"""Objects that a decision over the scores of aspects would answer, right and wrong.

    aspect_decision_report.py WITH [WITH ...] --without WITHOUT [WITHOUT ...] [--even 0.475] [--lying 0.335] [--accompanied 0.52] [--companion 0.47]
                              [--companion-lying 0.42]

WITH and WITHOUT are what aspect_scene_report printed for data sets, with the scenes' parts and with --without-truth. The options
are those of AspectAcceptance (--companion 9: no part bears another out); its conditions on focal lengths are left out. Prints
the numbers of objects answered and how high the two best parts of scenes without truth come.
"""
import argparse
import math
import re

SCENE = re.compile(r"scene (\d+) \S+: (\d+) of (\d+) views")
OBJECT = re.compile(r"  object (\d+) score ([\d.]+) .*? px( WRONG)?,.*?(, lies)?$")
ALONE, IN_ONE_VIEW, SURE, MISSING_MORE, WEIGHT, LEAST = 0.53, 0.58, 0.546, 0.16, 25.0, 0.6
COMPANY_PARTS, COMPANY_LYING = 3, 0.38


def scenes(paths):
    """(views linked, views, [(part, score, right, lies on a plane)]) of each scene, best first."""
    found = []
    for path in paths:
        with open(path, encoding="utf-8") as lines:
            for line in lines:
                if scene := SCENE.match(line):
                    found.append((int(scene[2]), int(scene[3]), []))
                elif thing := OBJECT.match(line):
                    found[-1][2].append((int(thing[1]), float(thing[2]), thing[3] is None, thing[4] is not None))
    return found


def answered(linked, views, objects, arguments):
    unseen = MISSING_MORE * (1.0 - linked / views)
    alone = (IN_ONE_VIEW if linked < 2 else ALONE) + unseen
    borne_out = (linked >= 3 and objects[0][1] >= arguments.accompanied
                 and any(o[1] >= (arguments.companion_lying if o[3] else arguments.companion) and o[0] != objects[0][0]
                         for o in objects[1:]))
    lying = {part for part, score, _, lies in objects if lies and score >= COMPANY_LYING}
    borne_out = borne_out or (linked >= 3 and len(lying) >= COMPANY_PARTS)
    for part, score, right, lies in objects:
        again = any(o[0] == part and o[1] > score for o in objects)
        beside = linked > 1 and objects[0][1] >= SURE + alone - ALONE and score < objects[0][1]
        even = (arguments.lying if lies else arguments.even) if not again and (beside or borne_out) else alone
        if 1.0 / (1.0 + math.exp(-WEIGHT * (score - even))) >= LEAST:
            yield right


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="+")
    parser.add_argument("--without", nargs="+", default=[])
    parser.add_argument("--even", type=float, default=0.475)
    parser.add_argument("--lying", type=float, default=0.335)
    parser.add_argument("--accompanied", type=float, default=0.52)
    parser.add_argument("--companion", type=float, default=0.47)
    parser.add_argument("--companion-lying", type=float, default=0.42)
    arguments = parser.parse_args()
    right = [r for s in scenes(arguments.paths) if s[2] for r in answered(*s, arguments)]
    others = scenes(arguments.without)
    wrong = sum(1 for s in others if s[2] for _ in answered(*s, arguments))
    print("%d right, %d wrong; without truth %d wrong" % (sum(right), len(right) - sum(right), wrong))
    linked = [s for s in others if s[0] >= 3]
    pairs = sorted((min(s[2][0][1], s[2][1][1]), s[2][0][1], s[2][1][1]) for s in linked if len(s[2]) > 1)
    print("%d scenes without truth, %d of three views and more, %d with a second part" % (len(others), len(linked), len(pairs)))
    for _, best, second in pairs[-3:]:
        print("  %.3f and %.3f" % (best, second))


if __name__ == "__main__":
    main()
