#!/usr/bin/env python3
"""Draws the sweeps of reconstruction_benchmark as one SVG (the thesis's figures 3.2 - 3.6).

    reconstruction_benchmark --benchmark_filter='Noise|Features|Cameras' --benchmark_format=json > FILE.json
    plot_reconstruction.py FILE.json OUT.svg

Three panels: median 3D error after the best collineation (mm, log scale) against noise, number of points, number of
cameras; one curve per method. Standard library only.
"""
import json
import sys

import log_panels

METHODS = ["depth decomposition", "algebraic distances", "geometric alternation", "full, bundle adjusted"]
COLOURS = ["#b5651d", "#8e44ad", "#2471a3", "#1e8449"]
PANELS = [("Noise", "noise, px", 0.01), ("Features", "points (and half as many lines)", 1.0), ("Cameras", "cameras", 1.0)]
LOW, HIGH = 0.08, 10.0  # mm


def read(path):
    """{panel: {method: [(x, error_mm)]}}; failures are left out."""
    curves = {}
    with open(path, encoding="utf-8") as file:
        runs = json.load(file)["benchmarks"]
    for run in runs:
        name, method, x = run["name"].split("/")[:3]
        if run["error_mm"] < 0:
            continue
        curves.setdefault(name, {}).setdefault(int(method), []).append((float(x), run["error_mm"]))
    return curves


def panel(index, title, scale, curves):
    scaled = [(COLOURS[method], [(x * scale, y) for x, y in sorted(points)]) for method, points in sorted(curves.items())]
    return log_panels.panel(index, title, scaled, (0.1, 0.2, 0.5, 1, 2, 5, 10), (LOW, HIGH))


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    curves = read(sys.argv[1])
    body = []
    for index, (name, title, scale) in enumerate(PANELS):
        if name in curves:
            body += panel(index, title, scale, curves[name])
    for method, name in enumerate(METHODS):
        x = log_panels.LEFT + 240 * method
        body.append(f'<rect x="{x}" y="10" width="14" height="6" fill="{COLOURS[method]}"/>')
        body.append(f'<text x="{x + 20}" y="18">{name}</text>')
    log_panels.write(sys.argv[2], len(PANELS), body, "3D error, mm (median)")


if __name__ == "__main__":
    main()
