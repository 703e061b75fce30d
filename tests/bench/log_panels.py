"""Panels with logarithmic axes side by side in one SVG, for the scripts that draw the benchmarks. Standard library only."""
import math

WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 380, 340, 60, 50, 40


def panel(index, title, curves, ticks, limits):
    """Elements of the panel at a place; curves: [(colour, [(x, y)])] by x, ordinates are kept within the limits (low, high)."""
    left = index * WIDTH + LEFT
    right, bottom = (index + 1) * WIDTH - 15, HEIGHT - BOTTOM
    xs = sorted({x for _, points in curves for x, _ in points})
    first, last = math.log(min(xs)), math.log(max(xs))
    low, high = limits

    def at(x, y):
        share = (math.log(x) - first) / (last - first)
        level = (math.log(min(max(y, low), high)) - math.log(low)) / (math.log(high) - math.log(low))
        return left + share * (right - left), bottom - level * (bottom - TOP)

    out = [f'<rect x="{left}" y="{TOP}" width="{right - left}" height="{bottom - TOP}" fill="none" stroke="#888"/>']
    for tick in ticks:
        y = at(xs[0], tick)[1]
        out.append(f'<line x1="{left}" y1="{y:.1f}" x2="{right}" y2="{y:.1f}" stroke="#ddd"/>')
        out.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for x in xs:
        out.append(f'<text x="{at(x, low)[0]:.1f}" y="{bottom + 16}" text-anchor="middle">{x:g}</text>')
    out.append(f'<text x="{(left + right) / 2}" y="{bottom + 36}" text-anchor="middle">{title}</text>')
    for colour, points in curves:
        places = [at(x, y) for x, y in points]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        out.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>')
        out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{colour}"/>' for x, y in places]
    return out


def write(path, panels, body, ordinate):
    """So many panels' elements, with what the ordinate is."""
    body = body + [f'<text x="14" y="{HEIGHT / 2}" transform="rotate(-90 14 {HEIGHT / 2})" text-anchor="middle">'
                   f"{ordinate}</text>"]
    with open(path, "w", encoding="utf-8") as file:
        file.write(f'<svg xmlns="http://www.w3.org/2000/svg" width="{panels * WIDTH}" height="{HEIGHT}" '
                   'font-family="sans-serif" font-size="12"><rect width="100%" height="100%" fill="white"/>'
                   + "\n".join(body) + "</svg>\n")
