#!/usr/bin/env python3
"""Says whether the results of one scene are right: every target found, in every image within 10 px, and nothing else.

    demo_verdict.py DATASET SCENE RESULTS.csv SCORES.json       exit 0 right, 1 wrong

Pixels are counted twice: under the true cameras (R@10 of SCORES.json), as benchmarks do, and under the cameras of the answer
itself (RESULTS.cameras.json): where the answer says the part is in the image, against where it is. A robot that looks through the
recovered cameras needs the second; an answer whose principal point is off can be wrong by the first and right by the second.
Either is enough; both are printed.
"""
import collections
import csv
import json
import os
import sys

LIMIT_PX = 10.0  # at an image width of 640
VISIBLE = 0.3    # less of an instance in an image: no target there


def load(*path):
    with open(os.path.join(*path), encoding="utf-8") as file:
        return json.load(file)


def transformed(rotation, t, point):
    return [sum(rotation[3 * r + c] * point[c] for c in range(3)) + t[r] for r in range(3)]


def projected(camera, point):
    k = camera["cam_K"]
    x, y = point[0] / point[2], point[1] / point[2]
    distortion = camera.get("cam_dist") or [0.0]
    bend = 1.0 + distortion[0] * (x * x + y * y)
    return k[0] * x * bend + k[2], k[4] * y * bend + k[5]


def corners(info):
    return [[info["min_" + a] + (info["size_" + a] if bit >> i & 1 else 0.0) for i, a in enumerate("xyz")]
            for bit in range(8)]


def symmetries(info):
    turns = [([1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0])]
    for m in info.get("symmetries_discrete", []):
        turns.append((m[0:3] + m[4:7] + m[8:11], [m[3], m[7], m[11]]))
    return turns


def distance_px(info, true_camera, truth, own_camera, estimate):
    """Largest distance of the projected corners of the part's box, over its symmetries the smallest."""
    best = float("inf")
    for turn in symmetries(info):
        worst = 0.0
        for corner in corners(info):
            there = transformed(truth["cam_R_m2c"], truth["cam_t_m2c"], transformed(turn[0], turn[1], corner))
            here = transformed(estimate[0], estimate[1], corner)
            if there[2] <= 0.0 or here[2] <= 0.0:
                worst = float("inf")
                break
            a, b = projected(true_camera, there), projected(own_camera, here)
            worst = max(worst, ((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2) ** 0.5)
        best = min(best, worst)
    return best


def recall_under_own_cameras(dataset, scene, results, estimates):
    """Share of the visible instances, over all images, that an estimate of theirs meets within the limit; None without cameras."""
    own_path = os.path.splitext(results)[0] + ".cameras.json"
    if not os.path.exists(own_path):
        return None
    own = load(own_path).get(str(scene), {})
    folder = os.path.join(dataset, "val", "%06d" % scene)
    infos = load(dataset, "models", "models_info.json")
    cameras, truth = load(folder, "scene_camera.json"), load(folder, "scene_gt.json")
    visible = load(folder, "scene_gt_info.json")
    targets = met = 0
    for image, instances in truth.items():
        scale = 640.0 / (2.0 * cameras[image]["cam_K"][2])  # the width, near enough
        unused = list(estimates.get(int(image), []))
        for number, instance in enumerate(instances):
            if visible[image][number]["visib_fract"] < VISIBLE:
                continue
            targets += 1
            if image not in own:
                continue
            found = [(distance_px(infos[str(instance["obj_id"])], cameras[image], instance, own[image], e[1]), k)
                     for k, e in enumerate(unused) if e[0] == instance["obj_id"]]
            if found and min(found)[0] * scale <= LIMIT_PX:
                met += 1
                unused.pop(min(found)[1])
    return met / targets if targets else None


def main():
    dataset, scene, results, scores = sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4]
    wanted = collections.Counter({t["obj_id"]: t["inst_count"] for t in load(dataset, "val_targets_multiview_bop25.json")
                                  if t["scene_id"] == scene})
    names = load(dataset, "models", "names.json")
    per_image = collections.defaultdict(collections.Counter)
    estimates = collections.defaultdict(list)
    with open(results, encoding="utf-8") as file:
        for row in csv.DictReader(file):
            per_image[int(row["im_id"])][int(row["obj_id"])] += 1
            pose = [float(n) for n in row["R"].split()], [float(n) for n in row["t"].split()]
            estimates[int(row["im_id"])].append((int(row["obj_id"]), pose))
    # An object counts as reported as often as the fullest image has it.
    reported = collections.Counter()
    for counts in per_image.values():
        reported |= counts
    score = load(scores)["scenes"][str(scene)]
    own = recall_under_own_cameras(dataset, scene, results, estimates)

    def text(objects):
        return ", ".join("%s (%d)%s" % (names[str(o)], o, " x%d" % n if n > 1 else "")
                         for o, n in sorted(objects.items())) or "nothing"

    def number(recall):
        return "not known" if recall is None else "%.3f" % recall

    print("in the scene: " + text(wanted))
    print("recognised:   " + text(reported))
    print("missed: %s; reported but not there: %s" % (text(wanted - reported), text(reported - wanted)))
    print("within 10 px: %s under the true cameras, %s under the answer's own" % (number(score["R@10"]), number(own)))
    return 0 if reported == wanted and 1 in (score["R@10"], own) else 1


if __name__ == "__main__":
    sys.exit(main())
