#!/usr/bin/env python3
"""What re-processed images cost: a dataset is asked as it is and once per distortion, by a running server.

    robustness_sweep.py DATASET SPLIT OUT --program build/release/client/horopter [--server HOST:PORT]
                        [--scenes 1,2] [--distortions noise,blur] [--seed 1] [--keep]

DATASET: a folder in BOP layout whose objects are enrolled in the server. OUT: a folder; per distortion it gets the answers and,
with --keep, the images. Prints one line a distortion (AR, R@10, own10, precision, error of the focal lengths, seconds a set, what fell) and writes
them to OUT/table.md. The cameras of the ground truth follow what is done to the images. The same seed gives the same images.
Needs Debian's python3-opencv and python3-numpy.
"""
import argparse
import json
import math
import os
import shutil
import subprocess
import sys
import zlib

import cv2
import numpy as np

# Of what the images show, AR may fall by this much under any distortion; precision stays at this.
MOST_AR_LOST, LEAST_PRECISION = 0.08, 0.99


class View:
    """An image with its entries of scene_camera.json, scene_gt.json and scene_gt_info.json."""

    def __init__(self, image, camera, truth, info):
        self.image, self.camera, self.truth, self.info = image, dict(camera), truth, info
        self.suffix = ".png"

    def map_camera(self, scale, dx=0.0, dy=0.0):
        """u' = scale (u + 0.5) - 0.5 - dx, and v alike."""
        k = list(self.camera["cam_K"])
        k[0], k[1], k[4] = k[0] * scale, k[1] * scale, k[4] * scale
        k[2], k[5] = scale * (k[2] + 0.5) - 0.5 - dx, scale * (k[5] + 0.5) - 0.5 - dy
        self.camera["cam_K"] = k

    def project(self, point):
        """Pixels of a point of the camera's frame, without the lens."""
        x = np.array(self.camera["cam_K"]).reshape(3, 3) @ np.array(point)
        return x[:2] / x[2]


def resize(view, scale):
    height, width = view.image.shape[:2]
    size = (round(width * scale), round(height * scale))
    view.image = cv2.resize(view.image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    view.map_camera(scale)
    return view


def noise(views, rng):
    """Of a dim sensor: 2 grey levels in the dark to 9 in the light, and single colours."""
    for v in views:
        image = v.image.astype(np.float32)
        v.image = np.clip(image + rng.normal(size=image.shape) * np.sqrt(4 + image / 255 * 77), 0, 255).astype(np.uint8)
    return views


def blur(views, rng):
    """Out of focus: a disc of 1.5 - 2.5 px radius, another in every image."""
    for v in views:
        radius = rng.uniform(1.5, 2.5)
        y, x = np.mgrid[-3:4, -3:4]
        kernel = np.clip(radius + 0.5 - np.hypot(x, y), 0, 1)
        v.image = cv2.filter2D(v.image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
    return views


def motion(views, rng):
    """Smeared over 4 px in one direction."""
    for v in views:
        angle, t = rng.uniform(0, math.pi), np.linspace(-2, 2, 41)
        kernel = np.zeros((7, 7), np.float32)
        for s in t:
            x, y = 3 + s * math.cos(angle), 3 + s * math.sin(angle)
            for i in (math.floor(y), math.floor(y) + 1):
                for j in (math.floor(x), math.floor(x) + 1):
                    kernel[i, j] += max(0, 1 - abs(y - i)) * max(0, 1 - abs(x - j))
        v.image = cv2.filter2D(v.image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
    return views


def exposure(views, rng):
    """By turns 1.3 stops under and 0.9 over, saturated, with a sensor's noise in the dark ones."""
    for i, v in enumerate(views):
        light = (v.image.astype(np.float32) / 255) ** 2.2 * 2 ** (-1.3 if i % 2 == 0 else 0.9)
        light += rng.normal(size=light.shape) * np.sqrt(1e-6 + light * 2e-4)
        v.image = (np.clip(light, 0, 1) ** (1 / 2.2) * 255 + 0.5).astype(np.uint8)
    return views


def white_balance(views, rng):
    """Gains of red and blue of 0.75 - 1.33, another pair in every image."""
    for v in views:
        gains = np.exp(rng.uniform(-0.285, 0.285, 3)) * np.array([1, 0, 1]) + np.array([0, 1, 0])
        light = (v.image.astype(np.float32) / 255) ** 2.2 * gains
        v.image = (np.clip(light, 0, 1) ** (1 / 2.2) * 255 + 0.5).astype(np.uint8)
    return views


def jpeg60(views, rng):
    for v in views:
        v.suffix = ".jpg"
    return views


def sharpened(views, rng):
    """An unsharp mask as telephones apply it: 1.5 times the difference to a Gaussian of 1.5 px, with its halos."""
    for v in views:
        image = v.image.astype(np.float32)
        v.image = np.clip(image + 1.5 * (image - cv2.GaussianBlur(image, (0, 0), 1.5)), 0, 255).astype(np.uint8)
    return views


def bayer(views, rng):
    """A mosaic of red, green, green, blue, put together again bilinearly."""
    for v in views:
        height, width = v.image.shape[0] // 2 * 2, v.image.shape[1] // 2 * 2
        mosaic = np.zeros((height, width), np.uint8)
        for (i, j), c in (((0, 0), 2), ((0, 1), 1), ((1, 0), 1), ((1, 1), 0)):
            mosaic[i::2, j::2] = v.image[i:height:2, j:width:2, c]
        v.image[:height, :width] = cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2BGR)
    return views


def lens(views, rng):
    """One lens for all images of a scene: k1 -0.2 - 0, k2 0 - 0.3, p1 and p2 up to 0.003 in size."""
    k1, k2, p1, p2 = rng.uniform(-0.2, 0), rng.uniform(0, 0.3), rng.uniform(-0.003, 0.003), rng.uniform(-0.003, 0.003)
    for v in views:
        height, width = v.image.shape[:2]
        camera = np.array(v.camera["cam_K"]).reshape(3, 3)
        y, x = np.mgrid[0:height, 0:width].astype(np.float64)
        pixels = np.stack([x.ravel(), y.ravel()], axis=1)[:, None]
        source = cv2.undistortPoints(pixels, camera, np.array([k1, k2, p1, p2]), P=camera).reshape(height, width, 2)
        source = source.astype(np.float32)
        v.image = cv2.remap(v.image, source[..., 0], source[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        v.camera["cam_dist"] = [k1, k2, p1, p2]
    return views


def half(views, rng):
    return [resize(v, 0.5) for v in views]


def double(views, rng):
    return [resize(v, 2.0) for v in views]


def crop60(views, rng):
    """Windows of 60 % of both sides about what the scene is of, not about the principal point."""
    for v in views:
        height, width = v.image.shape[:2]
        w, h = round(0.6 * width), round(0.6 * height)
        middle = np.mean([v.project(g["cam_t_m2c"]) for g in v.truth] or [(width / 2, height / 2)], axis=0)
        x = int(np.clip(middle[0] - w / 2 + rng.uniform(-10, 10), 0, width - w))
        y = int(np.clip(middle[1] - h / 2 + rng.uniform(-10, 10), 0, height - h))
        v.image = v.image[y:y + h, x:x + w].copy()
        v.map_camera(1.0, x, y)
    return views


def grey(views, rng):
    for v in views:
        v.image = cv2.cvtColor(v.image, cv2.COLOR_BGR2GRAY)
    return views


def portrait(views, rng):
    """Every image turned by a quarter, as of a camera that is held upright: the truth turns with it."""
    for v in views:
        height = v.image.shape[0]
        v.image = cv2.rotate(v.image, cv2.ROTATE_90_CLOCKWISE)
        k = list(v.camera["cam_K"])
        k[0], k[4], k[2], k[5] = k[4], k[0], height - 1 - k[5], k[2]
        v.camera["cam_K"] = k
        turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], float)  # x' = -y, y' = x
        for pose, r, t in [(v.camera, "cam_R_w2c", "cam_t_w2c")] + [(g, "cam_R_m2c", "cam_t_m2c") for g in v.truth]:
            if r not in pose:
                continue
            pose[r] = (turn @ np.array(pose[r]).reshape(3, 3)).ravel().tolist()
            pose[t] = (turn @ np.array(pose[t])).tolist()
    return views


def three(views, rng):
    at = sorted({0, len(views) // 2, len(views) - 1})
    return [views[i] for i in at]


def shuffled(views, rng):
    return [views[i] for i in rng.permutation(len(views))]


DISTORTIONS = {f.__name__: f for f in (noise, blur, motion, exposure, white_balance, jpeg60, sharpened, bayer, lens, half, double, crop60, grey,
                                       portrait, three, shuffled)}
CUT_OUTS = ["crop60"]  # what the requests say
FOREIGN = "foreign"  # one image of another scene is added
NAMES = ["as_is", *DISTORTIONS, FOREIGN]


def read_json(path):
    with open(path) as file:
        return json.load(file)


def write_json(path, value):
    with open(path, "w") as file:
        json.dump(value, file)


def read_scene(folder):
    cameras, truth, info = (read_json(os.path.join(folder, "scene_%s.json" % n)) for n in ("camera", "gt", "gt_info"))
    views = []
    for key in sorted(cameras, key=int):
        name = next(n for n in sorted(os.listdir(os.path.join(folder, "rgb"))) if int(os.path.splitext(n)[0]) == int(key))
        image = cv2.imread(os.path.join(folder, "rgb", name), cv2.IMREAD_COLOR)
        views.append(View(image, cameras[key], truth.get(key, []), info.get(key, [])))
    return views


def write_scene(views, folder, meta):
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(os.path.join(folder, "rgb"))
    for i, v in enumerate(views):
        path = os.path.join(folder, "rgb", "%06d%s" % (i, v.suffix))
        if not cv2.imwrite(path, v.image, [cv2.IMWRITE_JPEG_QUALITY, 60]):
            sys.exit("cannot write " + path)
    for name, of in (("camera", lambda v: v.camera), ("gt", lambda v: v.truth), ("gt_info", lambda v: v.info)):
        write_json(os.path.join(folder, "scene_%s.json" % name), {str(i): of(v) for i, v in enumerate(views)})
    if meta is not None:
        write_json(os.path.join(folder, "scene_meta.json"), meta)


def reprocess(arguments, name, scenes, folder):
    split = os.path.join(arguments.dataset, arguments.split)
    os.makedirs(os.path.join(folder, arguments.split), exist_ok=True)
    for part in ("models", "cad"):
        link = os.path.join(folder, part)
        if os.path.exists(os.path.join(arguments.dataset, part)) and not os.path.lexists(link):
            os.symlink(os.path.abspath(os.path.join(arguments.dataset, part)), link)
    everything = sorted(int(s) for s in os.listdir(split) if s.isdigit())
    for scene in scenes:
        path = os.path.join(split, "%06d" % scene)
        views = read_scene(path)
        rng = np.random.default_rng([arguments.seed, scene, zlib.crc32(name.encode())])
        if name in DISTORTIONS:
            views = DISTORTIONS[name](views, rng)
        elif name == FOREIGN:
            other = read_scene(os.path.join(split, "%06d" % rng.choice([s for s in everything if s != scene])))
            stranger = other[len(other) // 2]
            # Nothing of it is in the scene that was asked for: whatever is answered there is wrong.
            stranger.truth, stranger.info = [], []
            views.insert(int(rng.integers(0, len(views) + 1)), stranger)
        meta = os.path.join(path, "scene_meta.json")
        write_scene(views, os.path.join(folder, arguments.split, "%06d" % scene),
                    read_json(meta) if os.path.exists(meta) else None)


def run(command):
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode != 0:
        sys.exit("%s\n%s%s" % (" ".join(command), done.stdout, done.stderr))
    return done.stdout


def ask(arguments, name, scenes, folder):
    """The scores of all scenes together, and of each alone."""
    server = ["--server", arguments.server] if arguments.server else []
    out = os.path.join(arguments.out, name + ".csv")
    chosen = ["--scenes", ",".join(map(str, scenes))]
    dataset = [folder, arguments.split]
    cropped = ["--cropped"] if name in CUT_OUTS else []
    run([arguments.program, *server, "dataset", "recognize", *dataset, "--out", out, *chosen, *cropped])
    alone = {}
    for scene in scenes:
        alone[scene] = scores_of(run([arguments.program, "--json", "dataset", "evaluate", *dataset, out, "--scenes",
                                      str(scene)]))
    return scores_of(run([arguments.program, "--json", "dataset", "evaluate", *dataset, out, *chosen])), alone


def scores_of(text):
    # What cannot be averaged (no answer) is null.
    return {name: value or 0.0 for name, value in json.loads(text)["tiers"]["ALL"].items()}


def table_line(name, scores, base):
    fell = []
    if name != "as_is" and scores["AR"] < base["AR"] - MOST_AR_LOST:
        fell.append("AR by %.3f" % (base["AR"] - scores["AR"]))
    if scores["AR"] > 0 and scores["precision"] < LEAST_PRECISION:
        fell.append("precision")
    return "| %s | %.3f | %.3f | %.3f | %.3f | %.3f | %.1f | %s |" % (name, scores["AR"], scores["R10"], scores["own10"], scores["precision"],
                                                             scores["f_err"], scores["s_per_set"], ", ".join(fell))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset")
    parser.add_argument("split")
    parser.add_argument("out")
    parser.add_argument("--program", required=True, help="the client, horopter")
    parser.add_argument("--server", help="HOST:PORT (default: the client's)")
    parser.add_argument("--scenes", help="e.g. 1,2 (default: all)")
    parser.add_argument("--distortions", default=",".join(NAMES), help="of %(default)s")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", action="store_true", help="keep the images")
    parser.add_argument("--only-write", action="store_true", help="write the images and ask nobody")
    arguments = parser.parse_args()
    split = os.path.join(arguments.dataset, arguments.split)
    scenes = [int(s) for s in (arguments.scenes.split(",") if arguments.scenes else os.listdir(split)) if str(s).isdigit()]
    names = arguments.distortions.split(",")
    unknown = [n for n in names if n not in NAMES]
    if unknown:
        sys.exit("unknown distortion: " + ", ".join(unknown))
    os.makedirs(arguments.out, exist_ok=True)
    table, base, details = [], None, {}
    header = ["| distortion | AR | R@10 | own10 | precision | f-err | s/set | fell |", "|---|---|---|---|---|---|---|---|"]
    print("\n".join(header), flush=True)
    for name in names:
        folder = os.path.join(arguments.out, name)
        reprocess(arguments, name, sorted(scenes), folder)
        if arguments.only_write:
            continue
        scores, details[name] = ask(arguments, name, sorted(scenes), folder)
        base = base or scores
        table.append(table_line(name, scores, base))
        print(table[-1], flush=True)
        if not arguments.keep:
            shutil.rmtree(folder)
        with open(os.path.join(arguments.out, "table.md"), "w") as file:
            file.write("\n".join(header + table) + "\n")
        write_json(os.path.join(arguments.out, "scenes.json"), details)
    return 0


if __name__ == "__main__":
    sys.exit(main())
