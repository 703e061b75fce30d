#!/usr/bin/env python3
"""Records one run of recognition over a data set in BOP layout: starts a server of its own, enrols all parts, asks scene after scene from its
images alone, scores the answers and writes them to a file of tests/bench/runs (form: runs/README.md).

    record.py DATASET SPLIT OUT.json [--name NAME] [--programs FOLDER] [--evaluator FILE] [--revision REV] [--scenes 1,2]
              [--min-visib 0.3] [--variants NAME=VALUE,..] [--ablation] [--cropped] [--shared] [--note TEXT] [--keep FOLDER]
              [--catalog FILE]

--name       in the tables (default: the folder's name)
--programs   build folder, or a folder with horopterd and horopter in it (default: build/release)
--evaluator  another horopter that scores (default: the same); scores depend on the answers alone
--revision   of the programs (default: HEAD)
--ablation   what variants of the same commit and scenes are compared with; no figure of the set
--shared     other work runs on this machine: the tables then show no wall times
--catalog    the set's parts as an earlier run with the same option enrolled them here (default: enrolled for this run alone)
--keep       a folder for results.csv, cameras and the server's log; a run that was broken off goes on there with the same command

Every call has an hour, so that a busy machine makes no answer TIME_LIMITED. Not 0 when a call fails for want of a server.
"""
import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time

import run_files

CALL_SECONDS = 3600


def program(folder, name):
    for path in (os.path.join(folder, name), os.path.join(folder, "bin", name), os.path.join(folder, "client", name)):
        if os.path.isfile(path) and os.access(path, os.X_OK):
            return path
    sys.exit("record.py: no %s in %s" % (name, folder))


class Server:
    """horopterd with a catalog file, made if there is none, ended with the `with` block."""

    def __init__(self, path, catalog, kept, variants):
        self.log = os.path.join(kept, "server.log")
        command = [path, "--db", catalog, "--listen", "127.0.0.1:0"]
        if variants:
            command.append("--allow-variants")
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)  # pylint: disable=consider-using-with
        self.address = self._address()

    def _address(self):
        for _ in range(600):
            with open(self.log, encoding="utf-8", errors="replace") as log:
                found = re.search(r"listening on (\S+)", log.read())
            if found:
                return found.group(1)
            if self.process.poll() is not None:
                break
            time.sleep(0.1)
        self.process.kill()
        with open(self.log, encoding="utf-8", errors="replace") as log:
            sys.exit("record.py: the server did not come up:\n" + log.read())

    def cpu_seconds(self):
        with open("/proc/%d/stat" % self.process.pid, encoding="utf-8") as stat:
            fields = stat.read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def peak_memory_mb(self):
        with open("/proc/%d/status" % self.process.pid, encoding="utf-8") as status:
            return round(int(re.search(r"VmHWM:\s+(\d+) kB", status.read()).group(1)) / 1024)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.terminate()
        try:
            self.process.wait(60)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def sift_cpu_seconds(folder):
    """Of the images of a scene on one core; None without OpenCV's Python."""
    try:
        import cv2  # pylint: disable=import-outside-toplevel
    except ImportError:
        return None
    cv2.setNumThreads(1)
    total = 0.0
    for sub in ("rgb", "gray"):
        images = os.path.join(folder, sub)
        for name in sorted(os.listdir(images)) if os.path.isdir(images) else ():
            image = cv2.imread(os.path.join(images, name), cv2.IMREAD_GRAYSCALE)
            if image is None:
                continue
            start = time.process_time()
            cv2.SIFT_create().detectAndCompute(image, None)
            total += time.process_time() - start
    return round(total, 4)


def csv_of(folder, scene):
    return os.path.join(folder, "%06d.csv" % scene)


def ask(horopter, server, arguments, scene, folder):
    """One scene: its row without scores; the files of its answer go to the folder."""
    csv = csv_of(folder, scene)
    command = [horopter, "--server", server.address, "--timeout", str(CALL_SECONDS), "--json"]
    if arguments.variants:
        command += ["--variants", arguments.variants]
    command += ["dataset", "recognize", arguments.dataset, arguments.split, "--scenes", str(scene), "--targets", "none", "--out", csv]
    if arguments.cropped:
        command.append("--cropped")
    cpu = server.cpu_seconds()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    cpu = server.cpu_seconds() - cpu
    row = {"scene": scene}
    for line in done.stdout.splitlines():
        answer = json.loads(line)
        if answer.get("scene") == scene:
            row.update(seconds=round(answer["seconds"], 3), cpu_seconds=round(cpu, 2), state=answer.get("state", "FAILED"))
            if "error" in answer:
                row["error"] = answer["error"]
    if "seconds" not in row:
        sys.exit("record.py: scene %d: %s" % (scene, done.stderr.strip() or done.stdout.strip()))
    return row


def merge(csvs, out):
    """The scenes' files as one, as `dataset recognize` writes it."""
    rows, cameras = [], {}
    for csv in csvs:
        with open(csv, encoding="utf-8") as file:
            header, *body = file.read().splitlines()
        rows += body
        path = os.path.splitext(csv)[0] + ".cameras.json"
        if os.path.exists(path):
            with open(path, encoding="utf-8") as file:
                cameras.update(json.load(file))
    with open(out, "w", encoding="utf-8") as file:
        file.write("\n".join([header] + rows) + "\n")
    with open(os.path.splitext(out)[0] + ".cameras.json", "w", encoding="utf-8") as file:
        json.dump(cameras, file)


def scored(row, scores):
    """Adds a scene's scores, as sums over its targets."""
    def total(key):
        value = scores[key]
        return 0.0 if value is None else round(value * scores["targets"], 4)
    row.update(tier=scores["tier"], targets=scores["targets"], mspd=total("MSPD"), mssd=total("MSSD"), r10=total("R10"), own10=total("own10"))
    row["estimates"] = [[round(e["score"], 4), int(e["right"]), int(e["own_px"] is not None and e["own_px"] < 10)] for e in scores["estimates"]]
    for key, values in (("rel_mm", "rel_mm_values"), ("rel_deg", "rel_deg_values"), ("f_err", "f_err_values")):
        row[key] = [round(v, 5) for v in scores[values]]
    return row


class Rows:
    """What has been asked so far, a line a scene; in a kept folder also what a run before this one asked."""

    def __init__(self, folder, arguments):
        self.path = os.path.join(folder, "rows.jsonl")
        head = {"set": os.path.realpath(arguments.dataset), "split": arguments.split, "commit": run_files.commit_of(arguments.revision)["commit"],
                "variants": arguments.variants, "cropped": arguments.cropped}
        self.rows = {}
        if os.path.exists(self.path):
            with open(self.path, encoding="utf-8") as file:
                first, *rest = [json.loads(line) for line in file]
            if first != head:
                sys.exit("record.py: %s is of another run: %s" % (folder, first))
            self.rows = {row["scene"]: row for row in rest}
        else:
            self._append(head)

    def add(self, row):
        self.rows[row["scene"]] = row
        self._append(row)

    def _append(self, value):
        with open(self.path, "a", encoding="utf-8") as file:
            file.write(json.dumps(value) + "\n")


def listed(arguments):
    root = os.path.join(arguments.dataset, arguments.split)
    try:
        scenes = sorted(int(name) for name in os.listdir(root) if name.isdigit())
    except OSError as error:
        sys.exit("record.py: %s" % error)
    if arguments.scenes:
        wanted = {int(s) for s in arguments.scenes.split(",")}
        scenes = [s for s in scenes if s in wanted]
    if not scenes:
        sys.exit("record.py: no scenes in %s" % root)
    return scenes


def enrol(horopter, server, dataset):
    """All parts of the set; what is refused is missed in every scene, which no figure would tell."""
    cpu = server.cpu_seconds()
    done = subprocess.run([horopter, "--server", server.address, "--timeout", str(CALL_SECONDS), "dataset", "enroll", dataset],
                          capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):
        sys.exit("record.py: enrolment: " + done.stderr.strip())
    refused = re.findall(r"^.*\bnot enrolled: .*$", done.stdout + done.stderr, re.M) if done.returncode == 3 else []
    if refused:
        print("record.py: the figures are without parts that were refused:\n" + "\n".join(refused), file=sys.stderr, flush=True)
    return {"cpu_seconds": round(server.cpu_seconds() - cpu, 1), "refused": refused}


def run(arguments, folder, kept):
    """kept: where results and log stay; folder: where the catalog does not."""
    horopter = program(arguments.programs, "horopter")
    scenes = listed(arguments)
    load = os.getloadavg()[0]
    catalog = arguments.catalog or os.path.join(folder, "catalog.db")
    known_parts = os.path.exists(catalog)
    with Server(program(arguments.programs, "horopterd"), catalog, kept, arguments.variants) as server:
        enrolment = {"cpu_seconds": None, "refused": []} if known_parts else enrol(horopter, server, arguments.dataset)
        listing = subprocess.run([horopter, "--server", server.address, "--json", "object", "list"], capture_output=True, text=True, check=True)
        objects = len(json.loads(listing.stdout)["objects"])
        if objects == 0:
            sys.exit("record.py: nothing is enrolled")
        known = Rows(kept, arguments)
        for scene in scenes:
            if scene in known.rows:
                continue
            row = ask(horopter, server, arguments, scene, kept)
            scene_folder = os.path.join(arguments.dataset, arguments.split, "%06d" % scene)
            row["images"] = sum(len(files) for name, _, files in os.walk(scene_folder) if os.path.basename(name) in ("rgb", "gray"))
            row["sift_cpu_seconds"] = sift_cpu_seconds(scene_folder)
            row["peak_memory_mb"] = server.peak_memory_mb()
            known.add(row)
            print("scene %d: %s, %.1f s, %.1f s of processor" % (scene, row["state"], row["seconds"], row["cpu_seconds"]), flush=True)
    results = os.path.join(kept, "results.csv")
    rows = [known.rows[scene] for scene in scenes]
    memory = max(row.pop("peak_memory_mb") for row in rows)
    merge([csv_of(kept, scene) for scene in scenes], results)
    evaluated = subprocess.run([arguments.evaluator or horopter, "--json", "dataset", "evaluate", arguments.dataset, arguments.split, results,
                                "--min-visib", str(arguments.min_visib), "--scenes", ",".join(map(str, scenes))],
                               capture_output=True, text=True, check=False)
    if evaluated.returncode:
        sys.exit("record.py: evaluation: " + evaluated.stderr.strip())
    scores = json.loads(evaluated.stdout)["scenes"]
    body = {"split": arguments.split, "objects": objects, "min_visib": arguments.min_visib, "variants": arguments.variants,
            "peak_memory_mb": memory, "enrol_cpu_seconds": enrolment["cpu_seconds"],
            "scenes": [scored(row, scores[str(row["scene"])]) for row in rows]}
    if arguments.ablation:
        body["ablation"] = True
    notes = [arguments.note] if arguments.note else []
    if enrolment["refused"]:
        notes.append("%d parts were not enrolled and count as missed" % len(enrolment["refused"]))
    if notes:
        body["note"] = "; ".join(notes)
    return body, load


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset")
    parser.add_argument("split")
    parser.add_argument("out")
    parser.add_argument("--name")
    parser.add_argument("--programs", default=os.path.join(run_files.ROOT, "build", "release"))
    parser.add_argument("--evaluator")
    parser.add_argument("--revision", default="HEAD")
    parser.add_argument("--scenes")
    parser.add_argument("--min-visib", type=float, default=0.3)
    parser.add_argument("--variants", default="")
    parser.add_argument("--ablation", action="store_true")
    parser.add_argument("--cropped", action="store_true")
    parser.add_argument("--shared", action="store_true")
    parser.add_argument("--note")
    parser.add_argument("--keep")
    parser.add_argument("--catalog")
    arguments = parser.parse_args()
    name = arguments.name or os.path.basename(os.path.normpath(arguments.dataset))
    # What the reader can repeat: where the data lies here and where the answer went is nobody's business.
    shown = "tests/bench/record.py $HOROPTER_DATA/%s %s" % (name, arguments.split)
    for option in ("scenes", "variants"):
        if getattr(arguments, option):
            shown += " --%s %s" % (option, getattr(arguments, option))
    if arguments.min_visib != 0.3:
        shown += " --min-visib %g" % arguments.min_visib
    for flag in ("ablation", "cropped"):
        if getattr(arguments, flag):
            shown += " --" + flag
    if arguments.keep:
        os.makedirs(arguments.keep, exist_ok=True)
    if arguments.catalog:
        os.makedirs(os.path.dirname(os.path.abspath(arguments.catalog)), exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        body, load = run(arguments, folder, arguments.keep or folder)
    run_files.write(arguments.out, "recognition", name, arguments.revision, shown, run_files.machine(arguments.shared, load),
                    len(body["scenes"]), body)
    print(arguments.out)


if __name__ == "__main__":
    main()
