#!/usr/bin/env python3
"""How the processor time of a request grows: draws files of request_speed as one SVG and prints the exponents.

    request_speed SERVER DATASET SPLIT --images 3 --pid PID --csv i3.csv ..
    plot_growth.py OUT.svg "images" 2=i2.csv 3=i3.csv 5=i5.csv -- "width, px" 640=w640.csv 1280=w1280.csv

    plot_growth.py OUT.svg .. -- "segments an image" segments=all.csv

A panel for each group: its title, then the abscissa and the file of each run. Ordinate: mean processor seconds of a request of
the scenes that all files of the group hold. Exponent: slope of the line of least squares in logarithms. A column of the file
instead of a number: the scenes of one run, in four groups by what they have of it. Standard library only.
"""
import csv
import math
import sys

import log_panels

LIMITS = (0.5, 50.0)  # s


def read(path):
    """{scene: mean processor seconds}"""
    seconds = {}
    with open(path, encoding="utf-8") as file:
        for row in csv.DictReader(file):
            seconds.setdefault(int(row["scene"]), []).append(float(row["cpu_s"]))
    return {scene: sum(values) / len(values) for scene, values in seconds.items()}


def by_column(column, path):
    """[(geometric mean of the column, mean seconds)] of four groups of scenes."""
    with open(path, encoding="utf-8") as file:
        rows = sorted((float(row[column]), float(row["cpu_s"])) for row in csv.DictReader(file))
    out = []
    for k in range(4):
        part = rows[k * len(rows) // 4:(k + 1) * len(rows) // 4]
        if not part:
            sys.exit(f"{path}: fewer than four scenes")
        out.append((round(math.exp(sum(math.log(max(x, 1.0)) for x, _ in part) / len(part))),
                    sum(y for _, y in part) / len(part)))
    return out


def groups(arguments):
    """[(title, [(x, mean seconds)])]"""
    out, rest = [], list(arguments)
    while rest:
        end = rest.index("--") if "--" in rest else len(rest)
        title, runs = rest[0], [run.split("=", 1) for run in rest[1:end]]
        if not runs or any(len(run) != 2 for run in runs):
            sys.exit(__doc__)
        if len(runs) == 1:
            out.append((title, by_column(*runs[0])))
        else:
            out.append((title, means(sorted((float(x), read(path)) for x, path in runs))))
        rest = rest[end + 1:]
    return out


def means(runs):
    """[(x, mean seconds)] of the scenes that all runs hold."""
    common = set.intersection(*(set(scenes) for _, scenes in runs))
    if not common:
        sys.exit("the files of a group have no scene in common")
    return [(x, sum(scenes[s] for s in common) / len(common)) for x, scenes in runs]


def exponent(points):
    logs = [(math.log(x), math.log(max(y, 1e-3))) for x, y in points]
    mx, my = (sum(v[k] for v in logs) / len(logs) for k in (0, 1))
    return sum((x - mx) * (y - my) for x, y in logs) / sum((x - mx) ** 2 for x, _ in logs)


def panel(index, title, points):
    out = log_panels.panel(index, title, [("#2471a3", points)], (0.5, 1, 2, 5, 10, 20, 50), LIMITS)
    middle = index * log_panels.WIDTH + (log_panels.LEFT + log_panels.WIDTH - 15) / 2
    out.append(f'<text x="{middle}" y="{log_panels.TOP - 12}" text-anchor="middle">exponent {exponent(points):.2f}</text>')
    return out


def main():
    if len(sys.argv) < 5:
        sys.exit(__doc__)
    body = []
    found = groups(sys.argv[2:])
    for index, (title, points) in enumerate(found):
        print(f"{title}: exponent {exponent(points):.2f}; " + ", ".join(f"{x:g}: {y:.2f} s" for x, y in points))
        body += panel(index, title, points)
    log_panels.write(sys.argv[1], len(found), body, "processor seconds of a request (mean)")


if __name__ == "__main__":
    main()
