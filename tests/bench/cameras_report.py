#!/usr/bin/env python3
"""Cameras before any part is known, over data sets in BOP layout: ours, and COLMAP's where it is installed; writes a table, and a run for
runs/ (form: runs/README.md, kind cameras).

    cameras_report.py [--programs FOLDER] [--methods Horopter,COLMAP,incremental,projective] [--every N] [--out FILE --name NAME] [--note TEXT] [--shared] [--keep FOLDER] [SET/SPLIT ..]

SET/SPLIT   folders of splits; default: all of the folder HOROPTER_DATA
--programs  build folder with cameras_report in it (default: build/release)
--methods   default: Horopter, and COLMAP where there is a program of that name, which is told where there is none; incremental and
            projective are the two ways to reconstruct from the texture's tracks, without matching and what else there is (seconds too)
--every     of each split only every N-th scene
--out       the run; --name its name in the tables
--keep      folder for COLMAP's cameras, which are read from there when it has them
--shared    other work runs on this machine
--revision  of the programs (default: HEAD)

COLMAP is told no intrinsics, only that one camera took all images. Seconds are of the processor, all threads.
"""
import argparse
import glob
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile

import run_files

LEAST_MODEL = 3  # images; COLMAP gives none below
SECONDS = 900    # of the wall, a scene's steps each
WAYS = ("incremental", "projective")  # to reconstruct from texture


def scenes_of(split, every):
    names = sorted(n for n in os.listdir(split) if n.isdigit() and os.path.isdir(os.path.join(split, n)))
    return [int(n) for n in names][::every]


def images_of(folder):
    for sub in ("rgb", "gray", "grey"):
        names = sorted(glob.glob(os.path.join(folder, sub, "*")))
        if names:
            return names
    return []


def used_by_children():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def rotation(w, x, y, z):
    return [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
            2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]


def lines_of(path):
    with open(path, encoding="utf-8") as file:
        return [line.rstrip("\n") for line in file if not line.startswith("#")]


def read_model(folder):
    """Cameras of a COLMAP model in text, by image name. COLMAP counts pixels from the corner of the first one."""
    cameras = {}
    for line in lines_of(os.path.join(folder, "cameras.txt")):
        words = line.split()
        if words:
            assert words[1] == "SIMPLE_RADIAL", line
            cameras[words[0]] = [float(w) for w in words[4:8]]
    images = {}
    for line in lines_of(os.path.join(folder, "images.txt"))[::2]:  # every second line lists points
        words = line.split()
        if len(words) < 10:
            continue
        f, cx, cy, k = cameras[words[8]]
        images[words[9]] = {"focal_px": f, "cx": cx - 0.5, "cy": cy - 0.5, "k1": k, "R": rotation(*map(float, words[1:5])),
                            "t": [float(w) for w in words[5:8]]}
    return images


def colmap_scene(images, work):
    """{"seconds", "reason", "images"}: the model with the most images."""
    environment = dict(os.environ, QT_QPA_PLATFORM="offscreen")
    database, chosen = os.path.join(work, "database.db"), os.path.join(work, "images")
    os.makedirs(chosen)
    for path in images:
        os.symlink(os.path.abspath(path), os.path.join(chosen, os.path.basename(path)))
    steps = [["feature_extractor", "--image_path", chosen, "--ImageReader.single_camera", "1", "--ImageReader.camera_model", "SIMPLE_RADIAL",
              "--SiftExtraction.use_gpu", "0", "--SiftExtraction.num_threads", "2"],
             ["exhaustive_matcher", "--SiftMatching.use_gpu", "0", "--SiftMatching.num_threads", "2"],
             ["mapper", "--image_path", chosen, "--output_path", work, "--Mapper.init_min_num_inliers", "30", "--Mapper.abs_pose_min_num_inliers", "15",
              "--Mapper.min_model_size", str(LEAST_MODEL), "--Mapper.num_threads", "2"]]
    begin, reason = used_by_children(), ""
    for step in steps:
        try:
            done = subprocess.run(["colmap", step[0], "--database_path", database] + step[1:], env=environment, capture_output=True, text=True,
                                  timeout=SECONDS, check=False)
        except subprocess.TimeoutExpired:
            reason = "%s: more than %d s" % (step[0], SECONDS)
            break
        if done.returncode != 0:
            # The mapper fails when it finds no pair to begin with.
            reason = "no model" if step[0] == "mapper" else "%s: exit code %d" % (step[0], done.returncode)
            break
    seconds = used_by_children() - begin
    best = {}
    for folder in sorted(glob.glob(os.path.join(work, "[0-9]*"))):
        subprocess.run(["colmap", "model_converter", "--input_path", folder, "--output_path", folder, "--output_type", "TXT"], env=environment,
                       capture_output=True, timeout=SECONDS, check=True)
        model = read_model(folder)
        if len(model) > len(best):
            best = model
    return {"seconds": seconds, "reason": reason if best or reason else "no model", "images": best}


def colmap(split, scenes):
    given = {"scenes": {}}
    for scene in scenes:
        with tempfile.TemporaryDirectory() as work:
            given["scenes"][str(scene)] = colmap_scene(images_of(os.path.join(split, "%06d" % scene)), work)
    return given


def colmap_kept(split, scenes, folder):
    """The same, kept in a file of the folder, and read from it when it is there."""
    if folder is None:
        return colmap(split, scenes)
    path = os.path.join(folder, "colmap-%s.json" % name_of(split).replace("/", "-"))
    if not os.path.isfile(path):
        given = colmap(split, scenes)
        os.makedirs(folder, exist_ok=True)
        with open(path + ".part", "w", encoding="utf-8") as file:
            json.dump(given, file)
        os.replace(path + ".part", path)
    with open(path, encoding="utf-8") as file:
        return json.load(file)


def measure(program, split, scenes, method, given):
    """The rows of one split, by cameras_report."""
    dataset, name = os.path.split(os.path.normpath(split))
    with tempfile.TemporaryDirectory() as work:
        out, given_file = os.path.join(work, "out.json"), os.path.join(work, "given.json")
        command = [program, dataset, name] + [str(s) for s in scenes] + ["--json", out]
        if given is not None:
            with open(given_file, "w", encoding="utf-8") as file:
                json.dump(given, file)
            command += ["--given", given_file]
        elif method in WAYS:
            command += ["--texture-by", method]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        with open(out, encoding="utf-8") as file:
            return json.load(file)["scenes"]


def text(value, scale=1.0, digits=2):
    return "-" if value is None else "%.*f" % (digits, scale * value)


def name_of(split):
    """real-dev/tools/test: the last folders, where a folder of sets is named -dev or -train the set's own name is enough."""
    parts = os.path.normpath(split).split(os.sep)
    return "/".join(parts[-3:] if len(parts) > 2 and parts[-3].endswith("-dev") else parts[-2:])


def print_table(rows):
    print("%-28s %5s %-9s %8s %8s %8s %8s %8s %7s  %s" %
          ("set", "scene", "method", "images", "deg", "max", "f %", "max", "s", "reason"))
    for r in rows:
        print("%-28s %5d %-9s %3d of %d%s %8s %8s %8s %8s %7s  %s" %
              (r["set"], r["scene"], r["method"], r["registered"], r["images"], " " if r["trusted"] else "?", text(r["rotation_deg"]),
               text(r["rotation_max_deg"]), text(r["focal_error"], 100, 1), text(r["focal_error_max"], 100, 1), text(r["seconds"]), r["reason"]))
    for method in sorted({r["method"] for r in rows}):
        mine = [r for r in rows if r["method"] == method]
        right = [r for r in mine if r["registered"] == r["images"] and r["rotation_deg"] is not None and r["rotation_deg"] <= 2 and r["focal_error"] <= 0.1]
        wrong = [r for r in mine if r["trusted"] and r["registered"] and r["rotation_deg"] is not None and r["rotation_deg"] > 5]
        sigmas = [s for r in mine if r["trusted"] for s in r["focal_sigmas"]]
        print("%s: %d of %d scenes with all images, rotations to 2 degrees and focal lengths to 10 %%; %d wrong (said with trust, more than 5 degrees off); "
              "s median %s; focal lengths within two stated deviations: %s" %
              (method, len(right), len(mine), len(wrong), text(statistics.median(r["seconds"] for r in mine)),
               "%d of %d" % (sum(s <= 2 for s in sigmas), len(sigmas)) if sigmas else "none are stated"))


def default_splits():
    data = os.environ.get("HOROPTER_DATA")
    if not data:
        sys.exit("cameras_report.py: name splits, or set HOROPTER_DATA")
    found = sorted(p for pattern in ("*/*/*/scene_camera.json", "*/*/*/*/scene_camera.json") for p in glob.glob(os.path.join(data, pattern)))
    return sorted({os.path.dirname(os.path.dirname(p)) for p in found})


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("splits", nargs="*")
    parser.add_argument("--programs", default="build/release")
    parser.add_argument("--methods", default="Horopter,COLMAP")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--out")
    parser.add_argument("--name", default="cameras")
    parser.add_argument("--note", default="")
    parser.add_argument("--revision", default="HEAD")
    parser.add_argument("--keep")
    parser.add_argument("--shared", action="store_true")
    arguments = parser.parse_args()
    methods = arguments.methods.split(",")
    if set(methods) - {"Horopter", "COLMAP", *WAYS}:
        sys.exit("cameras_report.py: methods are Horopter, COLMAP, %s" % ", ".join(WAYS))
    if "COLMAP" in methods and not shutil.which("colmap") and not arguments.keep:
        print("cameras_report.py: COLMAP is not installed (Debian's package colmap) and left out", file=sys.stderr)
        methods.remove("COLMAP")
    program = next((p for p in (os.path.join(arguments.programs, sub, "cameras_report") for sub in ("", "bin", "tests/bench")) if os.path.isfile(p)), None)
    if program is None:
        sys.exit("cameras_report.py: no cameras_report in %s" % arguments.programs)
    load, rows = os.getloadavg()[0], []
    for split in arguments.splits or default_splits():
        scenes = scenes_of(split, arguments.every)
        for method in methods:
            given = colmap_kept(split, scenes, arguments.keep) if method == "COLMAP" else None
            rows += [{"set": name_of(split), "method": method, **row} for row in measure(program, split, scenes, method, given)]
            print("%s: %s" % (method, name_of(split)), file=sys.stderr, flush=True)
    print_table(rows)
    if arguments.out:
        body = {"scenes": rows, **({"note": arguments.note} if arguments.note else {})}
        run_files.write(arguments.out, "cameras", arguments.name, arguments.revision, command_of(arguments, methods),
                        run_files.machine(arguments.shared, load), len({(r["set"], r["scene"]) for r in rows}), body)


def command_of(arguments, methods):
    """As it was called, without where the data are on this machine."""
    splits = " ".join("$HOROPTER_DATA/" + name_of(s) for s in arguments.splits)
    return "tests/bench/cameras_report.py --methods %s%s%s" % (",".join(methods), " --every %d" % arguments.every if arguments.every > 1 else "",
                                                               " " + splits if splits else "")


if __name__ == "__main__":
    main()
