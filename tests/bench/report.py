#!/usr/bin/env python3
"""Writes docs/benchmarks.md, and the table of README.md, from the recorded runs of tests/bench/runs.

    report.py [--check] [--runs FOLDER]

--check writes nothing; not 0 when a page is not what the runs say, or a run is broken (CTest bench.report).
The same runs give the same bytes: intervals come from a seeded bootstrap.
"""
import argparse
import collections
import json
import os
import sys

import run_files
from run_files import average_recall, difference, interval, median, pooled, precision, quantile, recall, typical

BEGIN, END = "<!-- table: begin (tests/bench/report.py) -->", "<!-- table: end -->"
HERE = os.path.dirname(os.path.abspath(__file__))
SURE = 0.9
STATED = ((0.0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 0.99), (0.99, 1.01))

OWN = recall("own10")


def number(value, digits=2):
    return "-" if value is None else "%.*f" % (digits, value)


def with_interval(scenes, figure, digits=2):
    value, ends = figure(scenes), interval(scenes, figure)
    if value is None or ends is None:
        return number(value, digits)
    return "%s (%s - %s)" % (number(value, digits), number(ends[0], digits), number(ends[1], digits))


def signed(value, ends, digits=3):
    if value is None:
        return "-"
    text = "%+.*f" % (digits, value)
    return text if ends is None else "%s (%+.*f, %+.*f)" % (text, digits, ends[0], digits, ends[1])


def table(head, rows, left=1):
    """Markdown; the first `left` columns are words, the others figures."""
    lines = ["| %s |" % " | ".join(head), "|%s|" % "|".join(["---"] * left + ["---:"] * (len(head) - left))]
    return lines + ["| %s |" % " | ".join(str(c) for c in row) for row in rows] + [""]


class Runs:
    """The recorded runs and the words about their data sets."""

    def __init__(self, folder, datasets):
        self.all = run_files.read_all(folder)
        self.datasets = datasets
        for run in self.of("recognition", variants=None):
            if run["name"] not in datasets:
                raise run_files.BadRun("%s: datasets.json says nothing of %s" % (folder, run["name"]))

    def of(self, kind, variants=""):
        """Oldest first. variants: "" the defaults but for those that ablations are compared with, None: any."""
        return [r for r in self.all if r["kind"] == kind and
                (variants is None or (r.get("variants", "") == variants and not r.get("ablation")))]

    def newest(self, kind, variants=""):
        """By name, in the order of datasets.json; names that are not in it follow."""
        last = {r["name"]: r for r in self.of(kind, variants)}
        order = list(self.datasets)
        return sorted(last.values(), key=lambda r: (order.index(r["name"]) if r["name"] in order else len(order), r["name"]))

    def newest_of_peers(self):
        last = {(r["name"], r["peer"]): r for r in self.of("peer", variants=None)}
        return [last[k] for k in sorted(last)]

    def what(self, run):
        return self.datasets[run["name"]]

    def photographs(self):
        return [r for r in self.newest("recognition") if self.what(r)["source"] == "photograph"]


def joined(runs):
    """The scenes of several runs; a scene's number is then its run's name and number."""
    return [dict(s, scene=(r["name"], s["scene"])) for r in runs for s in r["scenes"]]


def tiers(run):
    names = sorted({s["tier"] for s in run["scenes"]})
    groups = [(name, [s for s in run["scenes"] if s["tier"] == name]) for name in names] if len(names) > 1 else []
    return groups + [("all", run["scenes"])]


def recognition_rows(runs):
    rows = []
    for run in runs:
        for tier, scenes in tiers(run):
            first = tier == tiers(run)[0][0]
            rows.append([run["name"] if first else "", run["commit"] if first else "", tier, len(scenes), sum(s["targets"] for s in scenes),
                         with_interval(scenes, average_recall), with_interval(scenes, OWN), with_interval(scenes, precision),
                         number(pooled("rel_mm")(scenes)), number(pooled("rel_deg")(scenes)), number(pooled("f_err")(scenes), 3)])
    return rows


RECOGNITION_HEAD = ["data set", "commit", "tier", "scenes", "targets", "AR", "own10", "precision", "mm", "degrees", "focal error"]


def recognition(runs):
    newest = runs.newest("recognition")
    groups = (("Renders that were looked at while this was built", [r for r in newest if runs.what(r)["source"] == "render" and runs.what(r)["seen"]]),
              ("Renders that nothing was built on", [r for r in newest if runs.what(r)["source"] == "render" and not runs.what(r)["seen"]]),
              ("Photographs, all looked at", runs.photographs()))
    lines = ["## Recognition", "",
             "All parts of a set enrolled, images only, nothing said of the cameras; one request a scene. In brackets the 95 % interval, by drawing",
             "scenes with replacement. Tiers of renders: T1 one part (small-dev: 8 - 12 % of the width), T2 several (5 - 8 %; a tray), T3 clutter,",
             "hidden and stacked parts (3 - 5 %; a heap).", "",
             "- *AR*: average recall as BOP defines it, the mean over errors in pixels (MSPD) and in space (MSSD), under the true cameras. *own10*: share of",
             "  the visible (image, part) pairs that the answer shows within 10 px (at 640 px width), seen through the answer's own camera.",
             "- *precision*: share of the answered pairs within 50 px of such a part. *mm*, *degrees*: median error of one part's pose relative to another's.", ""]
    for title, group in groups:
        lines += ["### " + title, ""]
        if not group:
            lines += ["No run is recorded.", ""]
            continue
        lines += ["- %s: %s; %d parts enrolled" % (r["name"], runs.what(r)["what"], r["objects"]) for r in group] + [""]
        rows = recognition_rows(group)
        if group is groups[2][1] and len(group) > 1:
            scenes = joined(group)
            rows.append(["**together**", "", "all", len(scenes), sum(s["targets"] for s in scenes), with_interval(scenes, average_recall),
                         with_interval(scenes, OWN), with_interval(scenes, precision), number(pooled("rel_mm")(scenes)),
                         number(pooled("rel_deg")(scenes)), number(pooled("f_err")(scenes), 3)])
        lines += table(RECOGNITION_HEAD, rows, 3)
    return lines


def changes(runs):
    rows = []
    for new in runs.newest("recognition"):
        old = next(r for r in runs.of("recognition") if r["name"] == new["name"])
        if old["commit"] == new["commit"]:
            continue
        cpu = typical("cpu_seconds")
        rows.append([new["name"], "%s - %s" % (old["commit"], new["commit"]), len(new["scenes"])] +
                    [signed(*difference(old["scenes"], new["scenes"], f)) for f in (average_recall, OWN, precision)] +
                    ["%s - %s" % (number(cpu(old["scenes"]), 1), number(cpu(new["scenes"]), 1))])
    lines = ["## What changed", "", "From the first recorded run to the newest, the same scenes drawn for both.", ""]
    if not rows:
        return lines + ["No set has been recorded at two commits.", ""]
    return lines + table(["data set", "commits", "scenes", "AR", "own10", "precision", "processor s, median"], rows, 2)


def reliability(runs):
    lines = ["## Reliability", "",
             "What the answers' scores state, and how often such (image, part) pairs are right: within 50 px, and within 10 px by the answer's own camera.", ""]
    groups = collections.OrderedDict()
    for run in runs.newest("recognition"):
        groups.setdefault(runs.what(run)["source"] + "s", []).extend(e for s in run["scenes"] for e in s["estimates"])
    rows = []
    for source, estimates in groups.items():
        for low, high in STATED:
            of = [e for e in estimates if low <= e[0] < high]
            if of:
                rows.append([source, "%.2f - %.2f" % (low, min(high, 1.0)), len(of), number(sum(e[0] for e in of) / len(of)),
                             number(sum(e[1] for e in of) / len(of)), number(sum(e[2] for e in of) / len(of))])
    return lines + (table(["images", "score", "answers", "mean stated", "right", "right to 10 px"], rows, 2) if rows else ["No run is recorded.", ""])


def separation(answers):
    """How likely a right answer states more than a wrong one (area under the ROC); None without both."""
    right, wrong = [a[0] for a in answers if a[1]], [a[0] for a in answers if not a[1]]
    if not right or not wrong:
        return None
    return sum((r > w) + 0.5 * (r == w) for r in right for w in wrong) / (len(right) * len(wrong))


def decision(runs):
    lines = ["## Against parts that are not there", "",
             "The same images asked of several catalogs: the set's own parts; all but the scene's; mirror images and copies stretched by a tenth of its parts, or with a hole moved or filled; the",
             "parts of another set. Right is within 10 px by the answer's own cameras in every image; of all catalogs but the first nothing can be, though",
             "the mirror image of a part that is its own is the part. *sure*: stated .9 and more without an alternative. *separation*: how likely a right answer of the set states more than a wrong one of any catalog.", ""]
    rows = []
    for run in runs.newest("decision"):
        every = [a for s in run["scenes"] for a in s["answers"]]
        catalogs = list(dict.fromkeys(s["catalog"] for s in run["scenes"]))
        for catalog in catalogs:
            scenes = [s for s in run["scenes"] if s["catalog"] == catalog]
            answers = [a for s in scenes for a in s["answers"]]
            sure = [a for a in answers if a[0] >= SURE and a[2] == 0]
            first = catalog == catalogs[0]
            rows.append([run["name"] if first else "", run["commit"] if first else "", catalog, len(scenes), len(answers), sum(a[1] for a in answers),
                         len(sure), sum(1 for a in sure if not a[1]), number(separation(every), 3) if first else ""])
    head = ["data set", "commit", "catalog", "scenes", "answers", "right", "sure", "sure and wrong", "separation"]
    return lines + (table(head, rows, 3) + ["![Reliability and ROC](images/decision.svg)", ""] if rows else ["No run is recorded.", ""])


def decision_curves(runs):
    """Two drawings by source: what is stated and how often it is right; right answers kept against wrong ones let through."""
    groups = collections.OrderedDict()
    for run in runs.newest("decision"):
        source = runs.datasets.get(run["name"], {}).get("source", "render") + "s"
        groups.setdefault(source, []).extend(a for s in run["scenes"] for a in s["answers"])
    size, gap, colours = 240, 60, ("#0072b2", "#d55e00", "#009e73")
    def at(panel, x, y):
        return "%.1f,%.1f" % (gap + panel * (size + gap) + size * x, 20 + size * (1 - y))
    out = ['<svg xmlns="http://www.w3.org/2000/svg" width="%d" height="%d" font-family="sans-serif" font-size="12">' % (2 * size + 3 * gap, size + 80),
           '<rect width="100%" height="100%" fill="white"/>']
    for panel, (x, y) in enumerate((("stated", "right"), ("wrong answers let through", "right answers kept"))):
        left = gap + panel * (size + gap)
        out.append('<rect x="%d" y="20" width="%d" height="%d" fill="none" stroke="#888"/>' % (left, size, size))
        out.append('<polyline points="%s %s" stroke="#ccc" fill="none"/>' % (at(panel, 0, 0), at(panel, 1, 1)))
        out.append('<text x="%d" y="%d" text-anchor="middle">%s</text>' % (left + size / 2, size + 40, x))
        out.append('<text x="%d" y="%d" text-anchor="middle" transform="rotate(-90 %d %d)">%s</text>' % (left - 12, 20 + size / 2, left - 12, 20 + size / 2, y))
    for k, (source, answers) in enumerate(groups.items()):
        colour = colours[k % len(colours)]
        bins = [[a for a in answers if low <= a[0] < high] for low, high in STATED]
        stated = [(sum(a[0] for a in b) / len(b), sum(a[1] for a in b) / len(b)) for b in bins if b]
        lines = [(0, stated)]
        right, wrong = sum(a[1] for a in answers), sum(1 - a[1] for a in answers)
        if right and wrong:
            ordered = sorted({a[0] for a in answers}, reverse=True)
            lines.append((1, [(0, 0)] + [(sum(1 - a[1] for a in answers if a[0] >= t) / wrong, sum(a[1] for a in answers if a[0] >= t) / right) for t in ordered]))
        for panel, points in lines:
            out.append('<polyline points="%s" stroke="%s" stroke-width="2" fill="none"/>' % (" ".join(at(panel, x, y) for x, y in points), colour))
        out.append('<text x="%d" y="%d" fill="%s">%s: %d answers</text>' % (gap + k * (size + gap), size + 64, colour, source, len(answers)))
    return "\n".join(out + ["</svg>"]) + "\n"


def ablation(runs):
    lines = ["## Ablation", "", "Variants of the methods against the defaults of the same commit and scenes: what is lost (-) or gained (+) without them.", ""]
    rows = []
    for run in (r for r in runs.of("recognition", variants=None) if r.get("variants")):
        default = [r for r in runs.of("recognition", variants=None)
                   if not r.get("variants") and r["name"] == run["name"] and r["commit"] == run["commit"]]
        if not default:
            continue
        cpu = typical("cpu_seconds")
        scenes = {s["scene"] for s in run["scenes"]}
        same = [s for s in default[-1]["scenes"] if s["scene"] in scenes]
        rows.append([run["variants"], run["name"], run["commit"], len(same)] +
                    [signed(*difference(same, run["scenes"], f)) for f in (average_recall, OWN, precision)] +
                    ["%s - %s" % (number(cpu(same), 1), number(cpu(run["scenes"]), 1))])
    if not rows:
        return lines + ["No run with variants is recorded.", ""]
    return lines + table(["variant", "data set", "commit", "scenes", "AR", "own10", "precision", "processor s, default - variant"], rows, 3)


def peers(runs):
    lines = ["## Beside template matching", "",
             "Peers run on the same images. They are told what we are not, so their figures are not to be had without a calibrated camera and a measured",
             "distance; they answer single images, and are asked only for parts that are there, so nothing can be wrong but a pose.", ""]
    rows = []
    for run in runs.newest_of_peers():
        ours = next((r for r in reversed(runs.of("recognition")) if r["name"] == run["name"]), None)
        scenes = {s["scene"] for s in run["scenes"]}
        same = [s for s in ours["scenes"] if s["scene"] in scenes] if ours else []
        if same and not any(row[0] == run["name"] and row[1] == "Horopter" for row in rows):
            rows.append([run["name"], "Horopter", "images alone, all %d parts of the catalog" % ours["objects"], len(same),
                         sum(s["targets"] for s in same), with_interval(same, OWN), with_interval(same, recall("r10")),
                         number(typical("cpu_seconds")(same), 1)])
        rows.append([run["name"], run["peer"], run["given"], len(run["scenes"]), sum(s["targets"] for s in run["scenes"]),
                     with_interval(run["scenes"], OWN), with_interval(run["scenes"], recall("r10")), number(typical("cpu_seconds")(run["scenes"]), 1)])
    if not rows:
        return lines + ["No run is recorded.", ""]
    return lines + table(["data set", "method", "is told", "scenes", "targets", "own10", "10 px by true cameras", "processor s a scene, median"], rows, 3)


def cameras(runs):
    lines = ["## Cameras before any part is known", "",
             "Right: all images registered, rotations within 3 degrees and focal lengths within 10 % (medians of a scene). COLMAP is Debian's, with one",
             "unknown focal length for all images, which is more than we are told where images differ. *incremental* (Euclidean, one camera or several: what is",
             "used) and *projective* (then self-calibrated) are the two ways to reconstruct from the texture's tracks, alone and without the time of matching.",
             "`tests/bench/cameras_report.py` measures them all; COLMAP is left out, and that is said, where it is not installed.", ""]
    rows = []
    for run in runs.newest("cameras"):
        groups = collections.OrderedDict()
        for scene in run["scenes"]:
            groups.setdefault((scene["set"], scene["method"]), []).append(scene)
        for (name, method), scenes in groups.items():
            def right(s):
                return (s["registered"] == s["images"] and s.get("rotation_deg") is not None and s["rotation_deg"] <= 3 and
                        s.get("focal_error") is not None and abs(s["focal_error"]) <= 0.1)
            focal = [abs(s["focal_error"]) for s in scenes if s.get("focal_error") is not None]
            rows.append([name, method, run["commit"], "%d of %d" % (sum(map(right, scenes)), len(scenes)),
                         "%d of %d" % (sum(s["registered"] for s in scenes), sum(s["images"] for s in scenes)), number(median(focal), 3),
                         number(median([s.get("rotation_deg") for s in scenes])), number(median([s.get("seconds") for s in scenes]), 1)])
    if not rows:
        return lines + ["No run is recorded.", ""]
    return lines + table(["data set", "method", "commit", "scenes right", "images registered", "focal error, median", "degrees, median", "s, median"], rows, 3)


def speed(runs):
    lines = ["## Speed", "",
             "Processor seconds of the server for one request (all threads), and over OpenCV's SIFT of the same images on one core in the same run; wall",
             "seconds only where nothing else ran on the machine. Memory: the server's peak over the whole run.", ""]
    rows = []
    for run in runs.newest("recognition"):
        for tier, scenes in tiers(run):
            first = tier == tiers(run)[0][0]
            ratios = [s["cpu_seconds"] / s["sift_cpu_seconds"] for s in scenes if s.get("sift_cpu_seconds")]
            wall = [None if run["machine"]["shared"] else s["seconds"] for s in scenes]
            rows.append([run["name"] if first else "", run["commit"] if first else "", tier, len(scenes)] +
                        [number(typical("cpu_seconds", q)(scenes), 1) for q in (0.5, 0.95)] +
                        [number(quantile(ratios, q), 0) for q in (0.5, 0.95)] + [number(quantile(wall, q), 1) for q in (0.5, 0.95)] +
                        ["%d" % run["peak_memory_mb"] if tier == "all" else ""])
    head = ["data set", "commit", "tier", "scenes", "p50", "p95", "over SIFT, p50", "p95", "wall s, p50", "p95", "memory, MB"]
    return lines + (table(head, rows, 3) if rows else ["No run is recorded.", ""])


def programs(runs):
    lines = []
    for run in runs.newest("program"):
        lines += ["## " + run["name"].capitalize(), "", "`%s` at %s%s." % (run["command"], run["commit"], ", machine shared" if run["machine"]["shared"] else ""), ""]
        if run.get("note"):
            lines += [run["note"], ""]
        lines += table(["what", "value", "unit"], [[f["what"], f["value"], f.get("unit", "")] for f in run["figures"]])
    return lines


def recorded(runs):
    rows = [["%s%s" % (r["name"], " (%s)" % r["peer"] if r["kind"] == "peer" else " (%s)" % r["variants"] if r.get("variants") else ""), r["kind"],
             r["commit"] + (" with changes" if r.get("dirty") else ""), r["date"][:10], r["n"], r["machine"]["cpu"], "yes" if r["machine"]["shared"] else "no",
             "`%s`" % r["command"]] for r in runs.all]
    return ["## Every recorded run", ""] + table(["name", "kind", "commit", "date", "n", "machine", "shared", "command"], rows, 8)


def benchmarks(runs):
    lines = ["# Benchmarks", "", "Made by [tests/bench/report.py](../tests/bench/report.py) from [tests/bench/runs](../tests/bench/runs); not to be edited. How figures came",
             "about, what was tried and not kept: [history](history/README.md).", ""]
    for part in (recognition, changes, reliability, decision, ablation, peers, cameras, speed, programs, recorded):
        lines += part(runs)
    return "\n".join(lines).rstrip() + "\n"


def short(value, scenes, figure):
    ends = interval(scenes, figure)
    return number(value) if ends is None else "%s (%s - %s)" % (number(value), number(ends[0]), number(ends[1]))


def readme_row(name, what, parts, scenes):
    return [name, what, parts, short(OWN(scenes), scenes, OWN), short(precision(scenes), scenes, precision), number(pooled("rel_mm")(scenes)),
            number(pooled("rel_deg")(scenes)), number(typical("cpu_seconds")(scenes), 1)]


def readme_table(runs):
    rows = []
    main = [r for r in runs.newest("recognition") if runs.what(r).get("main")]
    for run in sorted(main, key=lambda r: runs.what(r)["seen"]):  # the unseen ones first
        kind = "%ss, %s" % (runs.what(run)["source"], "seen" if runs.what(run)["seen"] else "**unseen**")
        rows.append(readme_row(run["name"], "%s (%s)" % (runs.what(run)["what"], kind), run["objects"], run["scenes"]))
    photographs = runs.photographs()
    if photographs:
        rows.append(readme_row("real-dev", "**photographs**: %d sets, each enrolled alone (seen)" % len(photographs),
                               "%d - %d" % (min(r["objects"] for r in photographs), max(r["objects"] for r in photographs)), joined(photographs)))
    if not rows:
        return ("No run is recorded yet ([CONTRIBUTING](CONTRIBUTING.md) says how one is made); figures noted by hand until this version are in\n"
                "[docs/history/results.md](docs/history/results.md).")
    return "\n".join(table(["data set", "what it is", "parts", "recall", "precision", "mm", "degrees", "seconds"], rows, 2)).rstrip()


def with_table(page, new):
    if page.count(BEGIN) != 1 or page.count(END) != 1 or page.index(BEGIN) > page.index(END):
        raise run_files.BadRun("README.md: needs one pair of the marks %s and %s" % (BEGIN, END))
    return page[:page.index(BEGIN) + len(BEGIN)] + "\n" + new + "\n" + page[page.index(END):]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--runs", default=os.path.join(HERE, "runs"))
    parser.add_argument("--root", default=run_files.ROOT, help="folder with README.md and docs/")
    arguments = parser.parse_args()
    try:
        with open(os.path.join(HERE, "datasets.json"), encoding="utf-8") as file:
            runs = Runs(arguments.runs, json.load(file))
        readme = os.path.join(arguments.root, "README.md")
        with open(readme, encoding="utf-8") as file:
            pages = {readme: with_table(file.read(), readme_table(runs))}
        pages[os.path.join(arguments.root, "docs", "benchmarks.md")] = benchmarks(runs)
        if runs.of("decision"):
            pages[os.path.join(arguments.root, "docs", "images", "decision.svg")] = decision_curves(runs)
    except run_files.BadRun as error:
        sys.exit("report.py: %s" % error)
    stale = []
    for path, text in pages.items():
        try:
            with open(path, encoding="utf-8") as file:
                if file.read() == text:
                    continue
        except FileNotFoundError:
            pass
        if arguments.check:
            stale.append(os.path.relpath(path, arguments.root))
        else:
            os.makedirs(os.path.dirname(path), exist_ok=True)
            with open(path, "w", encoding="utf-8") as file:
                file.write(text)
    if stale:
        sys.exit("report.py: not what the runs say: %s; run tests/bench/report.py" % ", ".join(stale))


if __name__ == "__main__":
    main()
