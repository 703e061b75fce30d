#!/usr/bin/env python3
"""Refits the learnt constants of recognition (server/vision/recognition/learnt_constants.h).

    recognition_report DATASET SPLIT --trials all,none --accept-all --csv FILE
    fit_decision.py scene FILE...
    recognition_report DATASET SPLIT --trials all,one --accept-all --csv FILE
    fit_decision.py object FILE...

Logistic regression (Newton, a weak Gaussian prior of deviation 100 on every weight): of scenes, whether any part of
them was enrolled, on the sums over their objects of what exceeds chance; of objects, whether the object is right.
"""
import csv
import math
import sys

CHANCE = 0.55  # kChanceSupport
PRIOR_PRECISION = 1e-4


def solve(a, b):
    """a x = b by elimination with pivots; a is small, square and regular."""
    n = len(b)
    rows = [list(a[i]) + [b[i]] for i in range(n)]
    for i in range(n):
        pivot = max(range(i, n), key=lambda r: abs(rows[r][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for r in range(i + 1, n):
            factor = rows[r][i] / rows[i][i]
            rows[r] = [x - factor * y for x, y in zip(rows[r], rows[i])]
    x = [0.0] * n
    for i in reversed(range(n)):
        x[i] = (rows[i][n] - sum(rows[i][k] * x[k] for k in range(i + 1, n))) / rows[i][i]
    return x


def fit(samples):
    """samples: (features, outcome). Weights, the constant last."""
    n = len(samples[0][0]) + 1
    weights = [0.0] * n
    for _ in range(50):
        gradient = [-PRIOR_PRECISION * w for w in weights]
        hessian = [[PRIOR_PRECISION if i == k else 0.0 for k in range(n)] for i in range(n)]
        for features, outcome in samples:
            x = list(features) + [1.0]
            odds = max(-30.0, min(30.0, sum(w * v for w, v in zip(weights, x))))
            p = 1.0 / (1.0 + math.exp(-odds))
            for i in range(n):
                gradient[i] += (outcome - p) * x[i]
                for k in range(n):
                    hessian[i][k] += p * (1.0 - p) * x[i] * x[k]
        step = solve(hessian, gradient)
        weights = [w + s for w, s in zip(weights, step)]
        if max(abs(s) for s in step) < 1e-9:
            break
    return weights


def main():
    if len(sys.argv) < 3 or sys.argv[1] not in ("scene", "object"):
        sys.exit(__doc__)
    samples = []
    for path in sys.argv[2:]:
        scenes = {}
        with open(path, newline="") as file:
            for row in csv.DictReader(file):
                features = [float(row["support"]) - CHANCE, float(row["sharpness"]) - CHANCE]
                if sys.argv[1] == "object":
                    samples.append((features, float(row["right"])))
                    continue
                sums = scenes.setdefault((row["scene"], row["trial"]), [0.0, 0.0])
                sums[0] += features[0]
                sums[1] += features[1]
        samples += [(sums, 1.0 if trial == "all" else 0.0) for (_, trial), sums in scenes.items()]
    outcomes = {outcome for _, outcome in samples}
    if len(outcomes) < 2:
        sys.exit("both outcomes are needed, got %d rows of %s" % (len(samples), sorted(outcomes)))
    support, sharpness, constant = fit(samples)
    print("%s: %d samples; support %.1f, sharpness %.1f, constant %.1f"
          % (sys.argv[1], len(samples), support, sharpness, constant))


if __name__ == "__main__":
    main()
