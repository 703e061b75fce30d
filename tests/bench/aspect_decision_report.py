#!/usr/bin/env python3
"""What the decision over the scores of aspects answers, right and wrong.

    aspect_decision_report.py WITH [WITH ...] [--without WITHOUT ...] [--least 0.6]

WITH and WITHOUT are what aspect_scene_report printed for data sets, with the scenes' parts and with --without-truth or
--leave-one-out. --least is AspectAcceptance::min_probability. Prints how many objects are answered, the wrong ones, right ones
that are left out, and how high the best parts of WITHOUT come.
"""
import argparse
import re

SCENE = re.compile(r"scene (\d+) \S+: (\d+) of (\d+) views")
OBJECT = re.compile(
    r"  object (\d+) score ([\d.]+) probability ([\d.]+) .*? px( WRONG)?,.*, surface (-?[\d.]+) of (\d+)(?:, (lies|level))?$"
)


def objects(paths):
    """(file and scene, part, score, probability, right, surface, pairs of views, lies or level) of each object."""
    for path in paths:
        scene = ""
        with open(path, encoding="utf-8") as lines:
            for line in lines:
                if found := SCENE.match(line):
                    scene = f"{path} {found[1]}, {found[2]} of {found[3]} views"
                elif o := OBJECT.match(line):
                    yield scene, int(o[1]), float(o[2]), float(o[3]), o[4] is None, float(o[5]), int(o[6]), o[7] or ""


def tell(thing):
    scene, part, score, probability, _, surface, pairs, how = thing
    print(f"  {scene}: object {part} score {score:.2f} probability {probability:.2f} surface {surface:.2f} of {pairs} {how}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="+")
    parser.add_argument("--without", nargs="+", default=[])
    parser.add_argument("--least", type=float, default=0.6)
    arguments = parser.parse_args()
    for title, paths in (("with their parts", arguments.paths), ("without", arguments.without)):
        found = list(objects(paths))
        answered = [o for o in found if o[3] >= arguments.least]
        wrong = [o for o in answered if not o[4]]
        print(f"{title}: {len(answered) - len(wrong)} right, {len(wrong)} wrong")
        for o in wrong:
            tell(o)
    left_out = [o for o in objects(arguments.paths) if o[4] and o[3] < arguments.least]
    print(f"right ones left out: {len(left_out)}")
    for o in left_out:
        tell(o)
    best = sorted((o for o in objects(arguments.without) if not o[4]), key=lambda o: -o[2])[:2]
    print("best wrong ones without:")
    for o in best:
        tell(o)


if __name__ == "__main__":
    main()
