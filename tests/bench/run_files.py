"""Recorded runs: reading and writing them, and what is made of the scenes in them. The form is described in runs/README.md."""
import datetime
import json
import math
import os
import random
import subprocess

FORMAT = "horopter-run/1"
KINDS = ("recognition", "peer", "cameras", "program", "decision")
HEAD = ("format", "kind", "name", "commit", "order", "command", "date", "machine", "n")
ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))

DRAWS = 1000  # of scenes with replacement: an interval's ends are then good to a tenth of its width
SEED = 55


class BadRun(Exception):
    """A file that is not a recorded run; the message names file and fault."""


def machine(shared, load_before):
    cpu = "unknown"
    with open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            if line.startswith("model name"):
                cpu = line.split(":", 1)[1].strip()
                break
    return {"cpu": cpu, "cores": os.cpu_count(), "shared": shared, "load": [round(load_before, 1), round(os.getloadavg()[0], 1)]}


def commit_of(revision):
    """Short name, number of commits up to it, whether the tree differs from it (asked of HEAD alone)."""
    def git(*arguments):
        return subprocess.run(("git", "-C", ROOT) + arguments, capture_output=True, text=True, check=True).stdout.strip()
    return {"commit": git("rev-parse", "--short=7", revision), "order": int(git("rev-list", "--count", revision)),
            "dirty": revision == "HEAD" and bool(git("status", "--porcelain", "--untracked-files=no"))}


def write(path, kind, name, revision, command, machine_, n, body):
    run = {"format": FORMAT, "kind": kind, "name": name, **commit_of(revision), "command": command,
           "date": datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ"), "machine": machine_, "n": n, **body}
    if not run["dirty"]:
        del run["dirty"]
    check(run, path)
    temporary = path + ".part"
    with open(temporary, "w", encoding="utf-8") as file:
        file.write(dumps(run))
    os.replace(temporary, path)


def dumps(run):
    """One line a key of the head and one a scene or figure, so that a difference of two files can be read."""
    lines = []
    for key, value in run.items():
        if key in ("scenes", "figures"):
            rows = ",\n  ".join(json.dumps(row, allow_nan=False) for row in value)
            lines.append('"%s": [\n  %s]' % (key, rows))
        else:
            lines.append("%s: %s" % (json.dumps(key), json.dumps(value, allow_nan=False)))
    return "{" + ",\n ".join(lines) + "}\n"


def check(run, path):
    def fail(why):
        raise BadRun("%s: %s" % (path, why))
    if not isinstance(run, dict) or run.get("format") != FORMAT:
        fail("is no %s" % FORMAT)
    for key in HEAD:
        if key not in run:
            fail("has no %s" % key)
    if run["kind"] not in KINDS:
        fail("unknown kind %r" % run["kind"])
    rows = run.get("figures" if run["kind"] == "program" else "scenes")
    if not isinstance(rows, list):
        fail("has no list of scenes or figures")
    needed = {"recognition": ("scene", "tier", "targets", "mspd", "mssd", "r10", "own10", "estimates"), "peer": ("scene", "targets", "own10"),
              "cameras": ("set", "scene", "images", "method", "registered"),
              "decision": ("scene", "catalog", "answers"), "program": ("what", "value")}[run["kind"]]
    for row in rows:
        for key in needed:
            if key not in row:
                fail("an entry has no %s" % key)
    return run


def read(path):
    try:
        with open(path, encoding="utf-8") as file:
            run = json.load(file)
    except (OSError, ValueError) as error:
        raise BadRun("%s: %s" % (path, error)) from error
    return check(run, path)


def read_all(folder):
    """All runs of a folder, newest commit last; of one commit the newest date last."""
    names = sorted(n for n in os.listdir(folder) if n.endswith(".json"))
    return sorted((read(os.path.join(folder, n)) for n in names), key=lambda r: (r["order"], r["date"]))


def median(values):
    return quantile(values, 0.5)


def quantile(values, share):
    """Linear between the two nearest; None of nothing."""
    values = sorted(v for v in values if v is not None)
    if not values:
        return None
    at = share * (len(values) - 1)
    low = math.floor(at)
    high = min(low + 1, len(values) - 1)
    return values[low] + (at - low) * (values[high] - values[low])


# Figures of a list of scenes; None where there is nothing to average.

def recall(key):
    def of(scenes):
        targets = sum(s["targets"] for s in scenes)
        return sum(s[key] for s in scenes) / targets if targets else None
    return of


def average_recall(scenes):
    targets = sum(s["targets"] for s in scenes)
    return sum(s["mspd"] + s["mssd"] for s in scenes) / (2 * targets) if targets else None


def precision(scenes):
    right = [e[1] for s in scenes for e in s["estimates"]]
    return sum(right) / len(right) if right else None


def pooled(key):
    return lambda scenes: median([v for s in scenes for v in s[key]])


def typical(key, share=0.5):
    return lambda scenes: quantile([s.get(key) for s in scenes], share)


def interval(scenes, figure, draws=DRAWS):
    """Ends of the 95 % interval of a figure by drawing scenes with replacement; None with less than three scenes."""
    if len(scenes) < 3:
        return None
    rng = random.Random(SEED)
    values = []
    for _ in range(draws):
        value = figure([scenes[rng.randrange(len(scenes))] for _ in scenes])
        if value is not None:
            values.append(value)
    if not values:
        return None
    return quantile(values, 0.025), quantile(values, 0.975)


def difference(before, after, figure, draws=DRAWS):
    """after - before of the scenes that both have, and its 95 % interval: the same draw of scenes for both."""
    ours = {s["scene"]: s for s in after}
    pairs = [(s, ours[s["scene"]]) for s in before if s["scene"] in ours]
    def of(drawn):
        a, b = figure([p[0] for p in drawn]), figure([p[1] for p in drawn])
        return None if a is None or b is None else b - a
    value = of(pairs) if pairs else None
    return value, interval(pairs, of, draws)
