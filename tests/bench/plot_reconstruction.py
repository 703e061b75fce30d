#!/usr/bin/env python3
"""Draws the sweeps of reconstruction_benchmark as one SVG (the thesis's figures 3.2 - 3.6).

    reconstruction_benchmark --benchmark_filter='Noise|Features|Cameras' --benchmark_format=json > FILE.json
    plot_reconstruction.py FILE.json OUT.svg

Three panels: median 3D error after the best collineation (mm, log scale) against noise, number of points, number of
cameras; one curve per method. Standard library only.
"""
import json
import math
import sys

METHODS = ["depth decomposition", "algebraic distances", "geometric alternation", "full, bundle adjusted"]
COLOURS = ["#b5651d", "#8e44ad", "#2471a3", "#1e8449"]
PANELS = [("Noise", "noise, px", 0.01), ("Features", "points (and half as many lines)", 1.0), ("Cameras", "cameras", 1.0)]
WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 380, 340, 60, 50, 40
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
    left = index * WIDTH + LEFT
    right, bottom = (index + 1) * WIDTH - 15, HEIGHT - BOTTOM
    xs = sorted({x * scale for points in curves.values() for x, _ in points})
    low, high = math.log(min(xs)), math.log(max(xs))

    def at(x, y):
        share = (math.log(x) - low) / (high - low)
        level = (math.log(min(max(y, LOW), HIGH)) - math.log(LOW)) / (math.log(HIGH) - math.log(LOW))
        return left + share * (right - left), bottom - level * (bottom - TOP)

    out = [f'<rect x="{left}" y="{TOP}" width="{right - left}" height="{bottom - TOP}" fill="none" stroke="#888"/>']
    for tick in (0.1, 0.2, 0.5, 1, 2, 5, 10):
        y = at(xs[0], tick)[1]
        out.append(f'<line x1="{left}" y1="{y:.1f}" x2="{right}" y2="{y:.1f}" stroke="#ddd"/>')
        out.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for x in xs:
        out.append(f'<text x="{at(x, 1)[0]:.1f}" y="{bottom + 16}" text-anchor="middle">{x:g}</text>')
    out.append(f'<text x="{(left + right) / 2}" y="{bottom + 36}" text-anchor="middle">{title}</text>')
    for method, points in sorted(curves.items()):
        places = [at(x * scale, y) for x, y in sorted(points)]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        out.append(f'<polyline points="{line}" fill="none" stroke="{COLOURS[method]}" stroke-width="2"/>')
        out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{COLOURS[method]}"/>' for x, y in places]
    return out


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    curves = read(sys.argv[1])
    body = []
    for index, (name, title, scale) in enumerate(PANELS):
        if name in curves:
            body += panel(index, title, scale, curves[name])
    for method, name in enumerate(METHODS):
        x = LEFT + 240 * method
        body.append(f'<rect x="{x}" y="10" width="14" height="6" fill="{COLOURS[method]}"/>')
        body.append(f'<text x="{x + 20}" y="18">{name}</text>')
    body.append(f'<text x="14" y="{HEIGHT / 2}" transform="rotate(-90 14 {HEIGHT / 2})" text-anchor="middle">'
                "3D error, mm (median)</text>")
    with open(sys.argv[2], "w", encoding="utf-8") as file:
        file.write(f'<svg xmlns="http://www.w3.org/2000/svg" width="{3 * WIDTH}" height="{HEIGHT}" '
                   'font-family="sans-serif" font-size="12"><rect width="100%" height="100%" fill="white"/>'
                   + "\n".join(body) + "</svg>\n")


if __name__ == "__main__":
    main()
