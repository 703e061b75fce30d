#!/usr/bin/env python3
"""Fits the decision over parts found under known cameras (kCameraCueWeights, learnt_cue_weights.h).

    camera_search_report DATASET SPLIT > own-NAME.txt
    camera_search_report DATASET SPLIT --catalog OTHER > other-NAME-OTHER.txt
    fit_camera_decision.py FILE...

Logistic regression on the "placed" lines, with a weak Gaussian prior on the weights in deviations of their cues: placements right
within 10 px in all images against those of parts that are not in the scene or more than 30 px off. Prints what is answered of each
source when the fit has not seen it, and the weights; `company` is not fitted. Needs Debian's python3-numpy.
"""
import os
import re
import sys

import numpy as np

NAMES = ["precision", "score", "least_precision", "log_support", "log_shown", "missing", "lies", "ground"]
SIGNS = np.array([1, 1, 1, 1, 1, -1, 1, 1])
PRIOR_PRECISION = 1.0
NEEDED = 0.7
OFF_PX, FAR_PX = 10.0, 30.0
SUPPORT_OFFSET_PX = 50.0
CHANCE_GROUND, MOST_GROUND = 0.2, 0.4


def read(path):
    source = re.sub(r"^(own|other)-", "", os.path.splitext(os.path.basename(path))[0]).split("-")[0]
    views = 0
    for line in open(path, encoding="utf-8"):
        found = re.match(r"\s+(\d+) of (\d+) views", line)
        if found:
            views = int(found.group(2))
        if not line.startswith("  placed,"):
            continue
        c = line.strip().split(",")
        score, precision, least, support, shown, registered, lies, ground = (float(x) for x in c[5:13])
        worst = float(c[15])
        cues = [precision, score, least, np.log(support + SUPPORT_OFFSET_PX), np.log(max(1.0, shown)), 1 - registered / max(1, views), lies, min(ground, MOST_GROUND) - CHANCE_GROUND]
        yield source, line, cues, worst


def fit(x, y):
    mean, deviation = x.mean(0), x.std(0) + 1e-9
    use = np.ones(x.shape[1], bool)
    while True:
        z = np.c_[(x - mean) / deviation * use, np.ones(len(x))]
        prior = np.eye(z.shape[1]) * PRIOR_PRECISION
        prior[-1, -1] = 0
        w = np.zeros(z.shape[1])
        for _ in range(100):
            p = 1 / (1 + np.exp(-z @ w))
            w += np.linalg.solve(z.T @ (z * (p * (1 - p))[:, None]) + prior + 1e-9 * np.eye(len(w)), z.T @ (y - p) - prior @ w)
        bad = use & (np.sign(w[:-1]) == -SIGNS)
        if not bad.any():
            break
        use &= ~bad
    weights = w[:-1] / deviation * use
    return np.r_[weights, w[-1] - weights @ mean]


def main():
    rows = [r for path in sys.argv[1:] for r in read(path)]
    rows = [r for r in rows if r[3] < OFF_PX or r[3] > FAR_PX]
    x = np.array([r[2] for r in rows])
    y = np.array([1.0 if r[3] < OFF_PX else 0.0 for r in rows])
    sources = np.array([r[0] for r in rows])
    print(f"{len(y)} placements, {int(y.sum())} right")
    held_out = np.zeros(len(y))
    for s in sorted(set(sources)):
        w = fit(x[sources != s], y[sources != s])
        held_out[sources == s] = 1 / (1 + np.exp(-(x[sources == s] @ w[:-1] + w[-1])))
    for s in sorted(set(sources)):
        of = sources == s
        print(f"{s}: right {int((of & (y == 1)).sum())}, of them answered {int((of & (y == 1) & (held_out > NEEDED)).sum())}; "
              f"wrong {int((of & (y == 0)).sum())}, answered {int((of & (y == 0) & (held_out > NEEDED)).sum())}")
    for i in np.argsort(-held_out):
        if (held_out[i] > NEEDED) != (y[i] == 1):
            print(f"  {held_out[i]:.2f} {rows[i][1].strip()[:150]}")
    w = fit(x, y)
    for name, value in zip(NAMES + ["constant"], w):
        print(f"{value:8.2f}  {name}")


if __name__ == "__main__":
    main()
