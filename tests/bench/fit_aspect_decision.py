#!/usr/bin/env python3
"""Fits the decision over what aspects find (kCueWeights, server/vision/recognition/interpretation/learnt_cue_weights.h).

    aspect_scene_report DATASET SPLIT --out OUT --least 0.25 --on-ground --as-needed --all-trials --cues FILE
    fit_aspect_decision.py FILE...

FILE: one a data set; those of one set of parts (fewer images, other tables) are named NAME.csv, NAME-2.csv and so on. Logistic
regression on the cues of decision_cues.h, with a weak Gaussian prior on the weights in deviations of their cues. Right parts
against such that are not in the scene; parts of the scene in a wrong turn are left out: whether it is turned is asked elsewhere.
What several trials of a scene repeat counts as the root of their number. Weights of a sign that makes no sense are 0. Prints what
the decision answers of each set when it was fitted to the others, beside what the reports' probability answers, how far its
probabilities hold, and the weights. Needs Debian's python3-numpy.
"""
import argparse
import collections
import csv
import math
import os
import re
import sys

import numpy as np

# What a larger value can mean: for (+1), against (-1).
SIGNS = {"precision": 1, "score": 1, "log_support": 1, "surface_seen": 1, "ground": 1, "lies": 1, "level": 1, "missing": -1, "one": -1,
         "first": -1, "first_other": 1, "first_ground": 1}
PRIOR_PRECISION = 1.0


def read(paths):
    rows = []
    for path in paths:
        family = re.sub(r"-\d+$", "", os.path.splitext(os.path.basename(path))[0])
        with open(path, newline="") as file:
            for row in csv.DictReader(file):
                if any(row.get(c) in (None, "") for c in SIGNS):
                    continue  # cut off
                rows.append((family, path, row))
    return rows


class Samples:
    def __init__(self, rows):
        self.names = list(SIGNS)
        self.x = np.array([[float(r[c]) for c in self.names] for _, _, r in rows])
        self.right = np.array([float(r["right"]) for _, _, r in rows])
        self.there = np.array([float(r["in_scene"]) for _, _, r in rows])
        self.stated = np.array([float(r["probability"]) for _, _, r in rows])
        self.family = np.array([f for f, _, _ in rows])
        key = [(p, r["scene"], r["object"], r["right"]) for _, p, r in rows]
        count = collections.Counter(key)
        turned = (self.right == 0) & (self.there == 1)
        self.weight = np.array([1 / math.sqrt(count[k]) for k in key]) * np.where(turned, 0.0, 1.0)


def fit(x, y, w):
    """Weights and constant (last)."""
    mean, deviation = x.mean(0), x.std(0) + 1e-9
    z = np.c_[(x - mean) / deviation, np.ones(len(x))]
    prior = np.eye(z.shape[1]) * PRIOR_PRECISION
    prior[-1, -1] = 1e-6
    b = np.zeros(z.shape[1])
    for _ in range(60):
        p = 1 / (1 + np.exp(-np.clip(z @ b, -30, 30)))
        step = np.linalg.solve((z * (w * p * (1 - p))[:, None]).T @ z + prior, z.T @ (w * (y - p)) - prior @ b)
        b += step
        if np.abs(step).max() < 1e-9:
            break
    weights = b[:-1] / deviation
    return np.append(weights, b[-1] - weights @ mean)


def fit_signed(s, rows, columns):
    """fit() on some columns without those whose weight has the wrong sign: all weights, 0 where left out."""
    columns = list(columns)
    while True:
        b = fit(s.x[np.ix_(rows, columns)], s.right[rows], s.weight[rows])
        wrong = [(b[i] * SIGNS[s.names[c]] * s.x[rows, c].std(), c) for i, c in enumerate(columns)]
        worst = min(wrong)
        if worst[0] >= 0:
            break
        columns.remove(worst[1])
    out = np.zeros(len(s.names) + 1)
    out[columns], out[-1] = b[:-1], b[-1]
    return out


def probability(s, b, rows):
    return 1 / (1 + np.exp(-np.clip(s.x[rows] @ b[:-1] + b[-1], -30, 30)))


def held_out(s, columns):
    out = np.zeros(len(s.right))
    for family in sorted(set(s.family)):
        out[s.family == family] = probability(s, fit_signed(s, s.family != family, columns), s.family == family)
    return out


def loss(s, p):
    p = np.clip(p, 1e-3, 1 - 1e-3)
    return -(s.weight * (s.right * np.log(p) + (1 - s.right) * np.log(1 - p))).sum() / s.weight.sum()


def say_answers(s, title, p, least, rows):
    a = rows & (p >= least)
    wrong = a & (s.right == 0)
    print("  %-22s right %4d of %4d, turned %3d, not there %3d" % (
        title, (a & (s.right == 1)).sum(), (rows & (s.right == 1)).sum(), (wrong & (s.there == 1)).sum(),
        (wrong & (s.there == 0)).sum()))


def say_reliability(s, p):
    edges = [0, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0001]
    for low, high in zip(edges, edges[1:]):
        a = (s.weight > 0) & (p >= low) & (p < high)
        if a.any():
            print("  %.2f - %.2f: %4d objects, stated %.3f, right %.3f" % (low, min(high, 1), a.sum(), p[a].mean(), s.right[a].mean()))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+")
    parser.add_argument("--least", type=float, default=0.7, help="AspectAcceptance::min_fitted_probability")
    arguments = parser.parse_args()
    s = Samples(read(arguments.files))
    if len(set(s.family)) < 2 or len(set(s.right)) < 2:
        sys.exit("right and wrong objects of two sets of parts or more are needed")
    columns = list(range(len(s.names)))
    p = held_out(s, columns)
    for family in [*sorted(set(s.family)), None]:
        rows = np.ones(len(p), bool) if family is None else s.family == family
        print("held out: %s" % (family or "all"))
        say_answers(s, "as the report says", s.stated, arguments.least, rows)
        for least in sorted({0.6, arguments.least, 0.8, 0.9}):
            say_answers(s, "fitted, from %.2f" % least, p, least, rows)
    print("probabilities, held out (loss %.4f):" % loss(s, p))
    say_reliability(s, p)
    b = fit_signed(s, np.ones(len(p), bool), columns)
    print("kCueConstant %.2f" % b[-1])
    for name, weight in zip(s.names, b):
        print("    %6.2f,  // %s" % (weight, name))


if __name__ == "__main__":
    main()
