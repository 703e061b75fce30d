#!/usr/bin/env python3
"""Peers that match templates, on the images of a data set in BOP layout, recorded as runs (runs/README.md):

- LINE-2D of OpenCV's contrib modules (rgbd): templates of gradient directions from renderings of the part all round;
- the same, its best 20 matches refined and ranked by chamfer matching: edges of the CAD against the distance transform of Canny's edges.

    template_peers.py DATASET SPLIT OUT_PREFIX --evaluator HOROPTER [--name NAME] [--scenes 1,2] [--revision REV] [--shared]

Both are told what Horopter is not: which parts are in an image and how often, the camera matrix K, and each part's distance from the camera. So the size
in the image is known and one scale of templates is enough. Nobody is told the lens. Writes OUT_PREFIX-line2d.json and OUT_PREFIX-chamfer.json.
Needs Debian's python3-opencv and python3-numpy.
"""
import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time

import cv2
import numpy as np

import run_files

DIAMETER_PX = 120.0    # of a part in its templates and in the image scaled to them
VIEWS, TURNS = 300, 24  # directions all round (6 degrees apart) and turns in the image plane: 7,200 templates a part
MATCHES = 20           # refined by chamfer matching
LEAST_SIMILARITY = 50.0
CREASE = math.cos(math.radians(30))
TRUNCATED_PX = 8.0     # at the scale of the templates
GIVEN = "K, distance, which parts are there"


def read_ply(path):
    """Vertices (n x 3) and triangles (m x 3) of an ASCII or binary little endian PLY of triangles."""
    with open(path, "rb") as file:
        data = file.read()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    head = data[:end].decode("ascii").split("\n")
    counts, properties, element = {}, {}, None
    for line in head:
        words = line.split()
        if words[:1] == ["element"]:
            element = words[1]
            counts[element], properties[element] = int(words[2]), []
        elif words[:1] == ["property"]:
            properties[element].append(words[1:])
    if "format ascii 1.0" in head:
        rows = data[end:].decode("ascii").split("\n")
        vertices = np.array([r.split()[:3] for r in rows[:counts["vertex"]]], float)
        faces = [[int(x) for x in r.split()] for r in rows[counts["vertex"]:counts["vertex"] + counts["face"]]]
    else:
        kinds = {"float": "<f4", "float32": "<f4", "double": "<f8", "uchar": "u1", "uint8": "u1", "int": "<i4", "int32": "<i4", "uint": "<u4"}
        kind = np.dtype([(p[-1], kinds[p[0]]) for p in properties["vertex"]])
        table = np.frombuffer(data, kind, counts["vertex"], end)
        vertices = np.stack([table["x"], table["y"], table["z"]], 1).astype(float)
        listed = next(p for p in properties["face"] if p[0] == "list")
        at, faces = end + counts["vertex"] * kind.itemsize, []
        extra = sum(np.dtype(kinds[p[0]]).itemsize for p in properties["face"] if p[0] != "list")
        for _ in range(counts["face"]):
            n = int(np.frombuffer(data, kinds[listed[1]], 1, at)[0])
            at += np.dtype(kinds[listed[1]]).itemsize
            faces.append([n] + list(np.frombuffer(data, kinds[listed[2]], n, at)))
            at += n * np.dtype(kinds[listed[2]]).itemsize + extra
    triangles = [(f[1], f[i], f[i + 1]) for f in faces for i in range(2, f[0])]
    return vertices, np.array(triangles, int)


def directions(count):
    """Evenly spread over the sphere."""
    k = np.arange(count) + 0.5
    z, a = 1 - 2 * k / count, math.pi * (1 + math.sqrt(5)) * k
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(a), r * np.sin(a), z], 1)


def looking(direction):
    """Rotation whose third row is the direction: a camera that looks along it."""
    up = np.array([0, 0, 1.0]) if abs(direction[2]) < 0.9 else np.array([0, 1.0, 0])
    x = np.cross(up, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction])


def about_z(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def towards(ray):
    """Rotation that takes the optical axis to a ray, without a turn about it."""
    ray = ray / np.linalg.norm(ray)
    axis = np.cross([0, 0, 1.0], ray)
    sine = np.linalg.norm(axis)
    return np.eye(3) if sine < 1e-12 else cv2.Rodrigues(axis / sine * math.atan2(sine, ray[2]))[0]


class Part:
    """A mesh about the centre of its box, its edges, and its templates."""

    def __init__(self, folder, obj_id):
        vertices, self.triangles = read_ply(os.path.join(folder, "models", "obj_%06d.ply" % obj_id))
        self.centre = (vertices.min(0) + vertices.max(0)) / 2
        self.vertices = vertices - self.centre
        self.diameter = 2 * np.linalg.norm(self.vertices, axis=1).max()
        corners = self.vertices[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1)
        keep = length > 1e-12
        self.triangles, self.normals = self.triangles[keep], normals[keep] / length[keep][:, None]
        self._edges()
        self.detector = cv2.linemod.getDefaultLINE()
        self.templates = []  # rotation, middle of the part in the template, corner of its box of features
        self._templates()

    def _edges(self):
        """Points along edges of the mesh with the normals of both sides and whether the edge is a crease."""
        welded = np.unique(np.round(self.vertices / self.diameter, 6), axis=0, return_inverse=True)[1].reshape(-1)
        sides = {}
        for number, triangle in enumerate(self.triangles):
            for i in range(3):
                a, b = triangle[i], triangle[(i + 1) % 3]
                sides.setdefault(tuple(sorted((welded[a], welded[b]))), []).append((number, a, b))
        points, first, second, crease = [], [], [], []
        step = self.diameter / 60
        for faces in sides.values():
            n = self.normals[faces[0][0]], self.normals[faces[-1][0]]
            _, a, b = faces[0]
            a, b = self.vertices[a], self.vertices[b]
            sharp = len(faces) != 2 or n[0] @ n[1] < CREASE
            for k in range(max(1, round(np.linalg.norm(b - a) / step))) if sharp else (0,):
                count = max(1, round(np.linalg.norm(b - a) / step)) if sharp else 1
                points.append(a + (b - a) * (k + 0.5) / count)
                first.append(n[0])
                second.append(n[1])
                crease.append(sharp)
        self.points, self.first, self.second = np.array(points), np.array(first), np.array(second)
        self.crease = np.array(crease)

    def _templates(self):
        size = int(DIAMETER_PX * 1.5)
        middle = (size - 1) / 2
        for direction in directions(VIEWS):
            rotation = looking(direction)
            image, mask = self._rendered(rotation, size, middle)
            for turn in range(TURNS):
                angle = 2 * math.pi * turn / TURNS
                c, s = math.cos(angle), math.sin(angle)
                warp = np.array([[c, -s, middle - c * middle + s * middle], [s, c, middle - s * middle - c * middle]])
                turned = cv2.warpAffine(image, warp, (size, size))
                masked = cv2.warpAffine(mask, warp, (size, size), flags=cv2.INTER_NEAREST)
                number, box = self.detector.addTemplate([cv2.cvtColor(turned, cv2.COLOR_GRAY2BGR)], "part", masked)
                if number >= 0:
                    self.templates.append((about_z(angle) @ rotation, middle, box))

    def _rendered(self, rotation, size, middle):
        """Faces from back to front, lit from the camera, seen from five diameters; with its mask."""
        seen = self.vertices @ rotation.T
        far = 5 * self.diameter
        pixels = seen[:, :2] * (DIAMETER_PX / self.diameter) * far / (seen[:, 2:] + far) + middle
        facing = -(self.normals @ rotation.T)[:, 2]
        order = np.argsort(-seen[self.triangles][:, :, 2].mean(1))
        order = order[facing[order] > 0]
        image, mask = np.zeros((size, size), np.uint8), np.zeros((size, size), np.uint8)
        fixed = np.round(pixels * 16).astype(np.int32)
        for number in order:
            corners = fixed[self.triangles[number]]
            cv2.fillConvexPoly(image, corners, int(50 + 190 * facing[number]), cv2.LINE_8, 4)
            cv2.fillConvexPoly(mask, corners, 255, cv2.LINE_8, 4)
        return cv2.GaussianBlur(image, (3, 3), 0.7), cv2.dilate(mask, np.ones((3, 3), np.uint8))


def matches(part, image, k, depth):
    """Best first: similarity, rotation, position of the part's middle; k is of the scaled image."""
    threshold, found = 80.0, []
    while not found and threshold >= LEAST_SIMILARITY:
        found = part.detector.match([image], threshold, ["part"])[0]
        threshold -= 10.0
    out = []
    for m in found[:400]:
        rotation, middle, box = part.templates[m.template_id]
        u, v = m.x - box[0] + middle, m.y - box[1] + middle
        ray = np.linalg.solve(k, [u, v, 1.0])
        out.append((m.similarity, towards(ray) @ rotation, ray * depth, (u, v)))
    return out


def distinct(found, apart):
    """At most so near in the image: each only if nothing better lies there."""
    kept = []
    for m in found:
        if all(math.hypot(m[3][0] - o[3][0], m[3][1] - o[3][1]) > apart for o in kept):
            kept.append(m)
    return kept


class Chamfer:
    """Mean truncated distance of a part's edges to the image's."""

    def __init__(self, grey):
        edges = cv2.Canny(cv2.GaussianBlur(grey, (5, 5), 1.0), 30, 90)
        self.distance = np.minimum(cv2.distanceTransform(255 - edges, cv2.DIST_L2, 5), TRUNCATED_PX).astype(np.float32)

    def residuals(self, part, k, rotation, t, chosen):
        seen = part.points[chosen] @ rotation.T + t
        pixels = (seen[:, :2] / seen[:, 2:]) @ k[:2, :2].T + k[:2, 2]
        values = cv2.remap(self.distance, pixels[:, :1].astype(np.float32), pixels[:, 1:].astype(np.float32), cv2.INTER_LINEAR,
                           borderMode=cv2.BORDER_CONSTANT, borderValue=TRUNCATED_PX)
        return values[:, 0].astype(float)

    @staticmethod
    def visible(part, rotation, t):
        """Creases with a face towards the camera, and edges between a face towards it and one away."""
        rays = part.points @ rotation.T + t
        a = np.einsum("ij,ij->i", part.first @ rotation.T, rays) < 0
        b = np.einsum("ij,ij->i", part.second @ rotation.T, rays) < 0
        return np.flatnonzero((part.crease & (a | b)) | (a ^ b))

    def refined(self, part, k, rotation, t):
        """Levenberg-Marquardt over rotation and position across the ray; the distance is given."""
        damping, scale = 1e-2, t[2] / k[0, 0]  # a step of one unit is about a pixel
        chosen = self.visible(part, rotation, t)
        if len(chosen) < 8:
            return TRUNCATED_PX, rotation, t
        r = self.residuals(part, k, rotation, t, chosen)
        def moved(step):
            turn = cv2.Rodrigues(step[:3] * scale / (part.diameter / 2))[0]
            return turn @ rotation, t + np.array([step[3], step[4], 0.0]) * scale
        for _ in range(15):
            jacobian = np.stack([(self.residuals(part, k, *moved(0.5 * e), chosen) - self.residuals(part, k, *moved(-0.5 * e), chosen))
                                 for e in np.eye(5)], 1)
            hessian, gradient = jacobian.T @ jacobian, jacobian.T @ r
            step = -np.linalg.solve(hessian + (damping * np.trace(hessian) / 5 + 1e-9) * np.eye(5), gradient)
            after, position = moved(np.clip(step, -6, 6))
            now = self.visible(part, after, position)
            if len(now) < 8:
                break
            new = self.residuals(part, k, after, position, now)
            if new.mean() < r.mean():
                rotation, t, chosen, r, damping = after, position, now, new, damping / 3
            else:
                damping *= 4
                if damping > 1e3:
                    break
        return r.mean(), rotation, t


def scene_rows(folder, scene, parts):
    """Rows of both peers for a scene, and their processor seconds."""
    def load(name):
        with open(os.path.join(folder, name), encoding="utf-8") as file:
            return json.load(file)
    camera, truth, visible = load("scene_camera.json"), load("scene_gt.json"), load("scene_gt_info.json")
    rows, seconds = ([], []), [0.0, 0.0]
    for key, instances in truth.items():
        files = [os.path.join(folder, sub, "%06d.%s" % (int(key), ext)) for sub in ("rgb", "gray") for ext in ("png", "jpg", "jpeg", "tif", "pgm")]
        image = cv2.imread(next(f for f in files if os.path.exists(f)), cv2.IMREAD_COLOR)
        k = np.array(camera[key]["cam_K"], float).reshape(3, 3)
        shown = [i for i, v in zip(instances, visible[key]) if v["visib_fract"] >= 0.1]
        for obj_id in sorted({i["obj_id"] for i in shown}):
            part = parts[obj_id]
            same = [i for i in shown if i["obj_id"] == obj_id]
            middles = [np.array(i["cam_R_m2c"]).reshape(3, 3) @ part.centre + np.array(i["cam_t_m2c"]) for i in same]
            depth = float(np.mean([m[2] for m in middles]))  # of several: their mean, as a cell would know it
            start = time.process_time()
            scale = DIAMETER_PX / (k[0, 0] * part.diameter / depth)
            scaled = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
            # OpenCV 4.6's LINE-2D reads aligned blocks of 16 of its grids of 5 and 16 px and dies where they do not fill them.
            bottom, right = (-n % 320 for n in scaled.shape[:2])
            scaled = cv2.copyMakeBorder(scaled, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
            small = np.diag([scale, scale, 1.0]) @ k
            small[:2, 2] += 0.5 * (scale - 1)
            found = distinct(matches(part, scaled, small, depth), 3.0)
            seconds[0] += time.process_time() - start
            for m in distinct(found, DIAMETER_PX / 2)[:len(same)]:
                rows[0].append((key, obj_id, m[0] / 100, m[1], m[2] - m[1] @ part.centre))
            chamfer = Chamfer(cv2.cvtColor(scaled, cv2.COLOR_BGR2GRAY))
            refined = []
            for m in found[:MATCHES * len(same)]:
                cost, rotation, t = chamfer.refined(part, small, m[1], m[2])
                pixel = small @ (t / t[2])
                refined.append((cost, rotation, t, (pixel[0], pixel[1])))
            refined.sort(key=lambda m: m[0])
            seconds[1] += time.process_time() - start
            for m in distinct(refined, DIAMETER_PX / 2)[:len(same)]:
                rows[1].append((key, obj_id, 1 - m[0] / TRUNCATED_PX, m[1], m[2] - m[1] @ part.centre))
    print("scene %d: %.1f, %.1f s" % (scene, *seconds), flush=True)
    return rows, seconds


def evaluated(arguments, scenes, rows):
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "results.csv")
        with open(path, "w", encoding="utf-8") as file:
            file.write("scene_id,im_id,obj_id,score,R,t,time\n")
            for scene, (key, obj_id, score, rotation, t) in rows:
                file.write("%d,%s,%d,%.4f,%s,%s,-1\n" % (scene, key, obj_id, score, " ".join("%.9f" % x for x in rotation.ravel()),
                                                        " ".join("%.6f" % x for x in t)))
        done = subprocess.run([arguments.evaluator, "--json", "dataset", "evaluate", arguments.dataset, arguments.split, path,
                               "--scenes", ",".join(map(str, scenes))], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)["scenes"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("dataset", "split", "out"):
        parser.add_argument(name)
    parser.add_argument("--evaluator", required=True, help="the horopter program")
    parser.add_argument("--name")
    parser.add_argument("--scenes")
    parser.add_argument("--revision", default="HEAD")
    parser.add_argument("--shared", action="store_true")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    name = arguments.name or os.path.basename(os.path.normpath(arguments.dataset))
    root = os.path.join(arguments.dataset, arguments.split)
    scenes = sorted(int(n) for n in os.listdir(root) if n.isdigit())
    if arguments.scenes:
        scenes = [s for s in scenes if s in {int(x) for x in arguments.scenes.split(",")}]
    load, start = os.getloadavg()[0], time.process_time()
    needed = set()
    for scene in scenes:
        with open(os.path.join(root, "%06d" % scene, "scene_gt.json"), encoding="utf-8") as file:
            needed |= {i["obj_id"] for instances in json.load(file).values() for i in instances}
    parts = {}
    for obj_id in sorted(needed):
        parts[obj_id] = Part(arguments.dataset, obj_id)
        print("part %d: %d templates" % (obj_id, len(parts[obj_id].templates)), flush=True)
    learnt = time.process_time() - start
    rows, seconds = ([], []), {}
    for scene in scenes:
        both, seconds[scene] = scene_rows(os.path.join(root, "%06d" % scene), scene, parts)
        for peer in (0, 1):
            rows[peer].extend((scene, row) for row in both[peer])
    for peer, (key, title) in enumerate((("line2d", "LINE-2D"), ("chamfer", "LINE-2D and chamfer matching"))):
        scores = evaluated(arguments, scenes, rows[peer])
        body = {"peer": title, "given": GIVEN, "split": arguments.split, "note": "%d views and %d turns a part; templates made in %.0f processor s for %d parts" %
                (VIEWS, TURNS, learnt, len(parts)), "scenes": []}
        for scene in scenes:
            of = scores[str(scene)]
            body["scenes"].append({"scene": scene, "tier": of["tier"], "targets": of["targets"], "cpu_seconds": round(seconds[scene][peer], 2),
                                   **{k: round((of[v] or 0.0) * of["targets"], 4) for k, v in (("mspd", "MSPD"), ("mssd", "MSSD"), ("r10", "R10"), ("own10", "own10"))}})
        run_files.write("%s-%s.json" % (arguments.out, key), "peer", name, arguments.revision,
                        "tests/bench/template_peers.py $HOROPTER_DATA/%s %s" % (name, arguments.split), run_files.machine(arguments.shared, load), len(scenes), body)


if __name__ == "__main__":
    sys.exit(main())
