#!/usr/bin/env python3
"""Do stations learn their cameras from images, and are they faster, right and on their guard with what they know?

    station_sequences.py BUILD SEQUENCE... [--catalog FILE] [--requests N] [--details FILE] [--no-alone]

SEQUENCE: folders that render_sequences wrote, one rig each (BOP layout: split val, and splits turned and zoomed where a camera was
changed). For each a horopterd of BUILD (build/release) starts with the sequence's objects enrolled (--catalog keeps them between runs)
and an empty station, and plays val in order. Each request is also asked without the station (--no-alone: not). What is changed is
asked with the state the station has then, so that nothing is learnt from it. Prints errors of the cameras after 10 requests and at the
end, how often 95 % intervals hold, what is found under the true cameras, the server's processor time against requests without a
station, changes that were noticed, false alarms, and answers that the station made worse. --details: one JSON line a request.
Needs Debian's python3-grpcio, python3-protobuf and python3-numpy.
"""
import argparse
import json
import os
import shutil
import sqlite3
import struct
import subprocess
import sys
import tempfile

import numpy as np

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
sys.path.insert(0, os.path.join(ROOT, "tests", "support"))
from mock_server import Mock  # noqa: E402

LEARNT_AFTER = 10    # requests after which a station counts as calibrated
HIT_PX = 10.0        # at 640 pixels of width
FALSE_PX = 50.0      # an estimate farther from every instance of its object is wrong
LEAST_VISIBLE = 0.3  # of an instance in an image, to be a target there
HEADER_BYTES = 24    # of server/base/checked_blob.h
# 95 % of chi square with 1, 2, 4 and 6 degrees of freedom.
CHI95 = {1: 3.841, 2: 5.991, 4: 9.488, 6: 12.592}


# ---------------------------------------------------------------------------------------------------------------- ground truth

def read_json(*path):
    with open(os.path.join(*path), encoding="utf-8") as file:
        return json.load(file)


def pose_of(rotation, translation_mm):
    pose = np.eye(4)
    pose[:3, :3] = np.reshape(rotation, (3, 3))
    pose[:3, 3] = np.array(translation_mm) / 1000.0
    return pose


def ply_vertices(path):
    """Vertices of a PLY file, metres."""
    with open(path, "rb") as file:
        head, binary, kinds = 0, False, []
        while True:
            words = file.readline().decode().split()
            if words[:1] == ["format"]:
                binary = words[1] != "ascii"
            if words[:2] == ["element", "vertex"]:
                head = int(words[2])
            if words[:1] == ["element"]:
                element = words[1]
            if words[:1] == ["property"] and element == "vertex":
                kinds.append((words[2], {"float": "<f4", "double": "<f8", "uchar": "u1"}[words[1]]))
            if words[:1] == ["end_header"]:
                break
        if binary:
            table = np.frombuffer(file.read(head * np.dtype(kinds).itemsize), np.dtype(kinds))
            return np.stack([table[k].astype(float) for k in "xyz"], 1) / 1000.0
        return np.array([file.readline().split()[:3] for _ in range(head)], float) / 1000.0


class Models:
    """Points and symmetries of the objects."""

    def __init__(self, folder):
        self.points, self.symmetries = {}, {}
        for key, info in read_json(folder, "models", "models_info.json").items():
            points = ply_vertices(os.path.join(folder, "models", "obj_%06d.ply" % int(key)))
            self.points[int(key)] = points
            self.symmetries[int(key)] = [np.eye(4)]
            for s in info.get("symmetries_discrete", []):
                s = np.array(s, float).reshape(4, 4)
                s[:3, 3] /= 1000.0
                self.symmetries[int(key)].append(s)

    def mspd(self, obj, estimate, truth, K):
        def project(pose):
            p = self.points[obj] @ pose[:3, :3].T + pose[:3, 3]
            p = p @ K.T
            return p[:, :2] / p[:, 2:]
        mine = project(estimate)
        return min(np.max(np.linalg.norm(mine - project(truth @ s), axis=1)) for s in self.symmetries[obj])


class Scene:
    def __init__(self, folder, split, scene):
        path = os.path.join(folder, split, "%06d" % scene)
        cameras, truth, info = (read_json(path, "scene_%s.json" % name) for name in ("camera", "gt", "gt_info"))
        self.meta = read_json(path, "scene_meta.json")
        self.ids = sorted(map(int, cameras))
        self.images = [os.path.join(path, "rgb", "%06d.png" % i) for i in self.ids]
        self.cameras = [cameras[str(i)] for i in self.ids]
        self.K = [np.reshape(c["cam_K"], (3, 3)) for c in self.cameras]
        self.poses = [pose_of(c["cam_R_w2c"], c["cam_t_w2c"]) for c in self.cameras]
        self.truth = [[(t["obj_id"], pose_of(t["cam_R_m2c"], t["cam_t_m2c"]), i["visib_fract"])
                       for t, i in zip(truth[str(k)], info[str(k)])] for k in self.ids]


def judge(scene, answer, models, width):
    """Per target (image, object) whether it is hit, and how many objects of the answer are wrong."""
    hits, errors = {}, {}
    wrong = set()
    for v, targets in enumerate(scene.truth):
        for obj, truth, visible in targets:
            if visible >= LEAST_VISIBLE:
                hits[(v, obj)], errors[(v, obj)] = False, None
        if not answer.cameras[v].recovered:
            continue
        for k, found in enumerate(answer.objects):
            obj = int(found.object_id.rsplit("_", 1)[1])
            estimate = answer.cameras[v].camera_from_scene @ found.scene_from_object
            error = min([models.mspd(obj, estimate, truth, scene.K[v]) for o, truth, _ in targets if o == obj], default=1e9)
            if (v, obj) in hits:
                errors[(v, obj)] = error if errors[(v, obj)] is None else min(error, errors[(v, obj)])
                hits[(v, obj)] = bool(errors[(v, obj)] < HIT_PX * width / 640.0)
            if error > FALSE_PX * width / 640.0:
                wrong.add(k)
    return hits, errors, len(wrong)


# ------------------------------------------------------------------------------------------------------------------- the station

class State:
    """server/vision/geometry/station_blob.h"""

    def __init__(self, blob):
        self.blob, self.at = blob, HEADER_BYTES
        self.requests, count = self.take("<qI")
        self.cameras = {}
        for index in range(count):
            (length,) = self.take("<B")
            name = blob[self.at:self.at + length].decode()
            self.at += length
            flags, width, height, focal, cx, cy, k1 = self.take("<Bii4d")
            R, t = np.reshape(self.take("<9d"), (3, 3)), np.array(self.take("<3d"))
            (requests,) = self.take("<q")
            self.cameras[name] = dict(index=index, posed=bool(flags & 4), width=width, focal=focal, center=np.array([cx, cy]), k1=k1,
                                      R=R, t=t, requests=requests)
        n = 10 * count
        self.P = np.zeros((n, n))
        rows, columns = np.tril_indices(n)
        self.P[rows, columns] = self.take("<%dd" % len(rows))
        self.P += np.tril(self.P, -1).T

    def take(self, kind):
        out = struct.unpack_from(kind, self.blob, self.at)
        self.at += struct.calcsize(kind)
        return out


def stored_state(catalog, station):
    with sqlite3.connect("file:%s?mode=ro" % catalog, uri=True, timeout=30) as database:
        return database.execute("SELECT state FROM station WHERE station_id = ?", (station,)).fetchone()[0]


def rotation_vector(R):
    cosine = np.clip((np.trace(R) - 1) / 2, -1, 1)
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.linalg.norm(axis) / 2
    return axis / 2 if sine < 1e-9 else axis / (2 * sine) * np.arctan2(sine, cosine)


def check_state(state, scene, out):
    """Errors of the station's cameras, and whether 95 % ellipsoids hold the truth."""
    names = list(state.cameras)
    frame = next((n for n in names if state.cameras[n]["posed"] and state.P[10 * state.cameras[n]["index"]][
        10 * state.cameras[n]["index"]] == 0.0), None)
    for v, camera in enumerate(scene.cameras):
        has = state.cameras["camera%d" % (v + 1)]
        at = 10 * has["index"]
        K = scene.K[v]
        d = np.array([np.log(has["focal"] / K[0, 0]), *(has["center"] - K[:2, 2]), has["k1"] - camera["cam_dist"][0]])
        out["focal"].append(abs(d[0]))
        out["center"].append(float(np.linalg.norm(d[1:3])))
        lens = state.P[at + 6:at + 10, at + 6:at + 10]
        for what, part, size in (("focal length", slice(0, 1), 1), ("principal point", slice(1, 3), 2), ("lens", slice(0, 4), 4)):
            x = d[part]
            out["held"].setdefault(what, []).append(bool(x @ np.linalg.solve(lens[part, part], x) <= CHI95[size]))
        if frame is None or has is state.cameras[frame] or not has["posed"]:
            continue
        f = int(frame[len("camera"):]) - 1
        truth = scene.poses[v] @ np.linalg.inv(scene.poses[f])
        off = np.concatenate([rotation_vector(has["R"] @ truth[:3, :3].T), has["t"] - truth[:3, 3]])
        P = state.P[at:at + 6, at:at + 6]
        out["held"].setdefault("place", []).append(bool(off @ np.linalg.solve(P, off) <= CHI95[6]))


# -------------------------------------------------------------------------------------------------------------------- the server

class Server:
    def __init__(self, build, catalog):
        self.mock = Mock(os.path.join(build, "bin", "horopterd"), "--db", catalog, "--listen", "127.0.0.1:0")
        self.address, self.catalog = self.mock.address, catalog

    def seconds(self):
        with open("/proc/%d/stat" % self.mock.process.pid, encoding="ascii") as file:
            return int(file.read().rsplit(")", 1)[1].split()[11]) / os.sysconf("SC_CLK_TCK")

    def stop(self):
        self.mock.stop()


def enroll(build, sequence, catalog):
    server = Server(build, catalog)
    try:
        subprocess.run([os.path.join(build, "client", "horopter"), "--server", server.address, "dataset", "enroll", sequence],
                       check=True, stdout=subprocess.DEVNULL)
    finally:
        server.mock.process.terminate()
        server.mock.process.wait()
        server.stop()


class Asked:
    """An answer with what it cost and is worth."""

    def __init__(self, server, client, requests, scene, models, station=None, state=None):
        from horopter import types
        names = ["camera%d" % (i + 1) for i in range(len(scene.images))]
        request = requests.recognize_request(scene.images, None, None, None, station=station,
                                             station_cameras=names if station else None)
        if state is not None:
            request.station_state = state
        before = server.seconds()
        message = client._recognition.RecognizeScene(request, timeout=600)
        self.seconds = server.seconds() - before
        self.answer = types.Scene.from_proto(message)
        self.hits, self.errors, self.wrong = judge(scene, self.answer, models, 2 * scene.K[0][0, 2] + 1)
        self.report = self.answer.station
        self.distance = (message.station.distance_squared, message.station.distance_limit)

    def found(self):
        return sum(self.hits.values())

    def worse_than(self, other):
        return self.found() < other.found() or self.wrong > other.wrong

    def line(self):
        out = dict(found=self.found(), targets=len(self.hits), wrong=self.wrong, seconds=round(self.seconds, 2),
                   outcome=self.answer.outcome, objects=[o.object_id for o in self.answer.objects],
                   errors=[None if e is None else round(float(min(e, 1e6)), 1) for e in self.errors.values()],
                   steps={k: round(v, 2) for k, v in self.answer.stage_seconds.items()})
        if self.report:
            out.update(prior_used=self.report.prior_used, learnt=self.report.learnt, findings=[f.detail for f in self.report.findings],
                       distance=[round(d, 1) for d in self.distance])
        return out


# ------------------------------------------------------------------------------------------------------------------- the figures

class Figures:
    def __init__(self):
        self.cameras = {when: dict(focal=[], center=[], held={}) for when in ("after %d requests" % LEARNT_AFTER, "at the end")}
        self.requests = self.alarms = self.worse = self.compared = 0
        self.single = [0, 0, 0, 0]  # hits, targets of one part in a known station; the same without it
        self.several = [0, 0, 0, 0]
        self.wrong = [0, 0]
        self.seconds = []  # (first, later) of a station and the same without it
        self.ratios = []
        self.changes = {}

    def print(self):
        for when, c in self.cameras.items():
            if not c["focal"]:
                continue
            focal, center = 100 * np.array(c["focal"]), np.array(c["center"])
            print("%s: focal length, median, 90 %%: %.2f, %.2f %%; principal point %.1f, %.1f px; 95 %% ellipsoids hold: %s" % (
                when, np.median(focal), np.quantile(focal, 0.9), np.median(center), np.quantile(center, 0.9),
                ", ".join("%s %d of %d" % (w, sum(h), len(h)) for w, h in c["held"].items())))
        for name, s in (("one part", self.single), ("several parts", self.several)):
            if s[1]:
                print("%s, after %d requests: R@10 %.3f (%d of %d); without the station %d of %d" % (
                    name, LEARNT_AFTER, s[0] / s[1], s[0], s[1], s[2], s[3]))
        print("wrong objects: %d with, %d without the station" % tuple(self.wrong))
        print("false alarms: %d in %d requests" % (self.alarms, self.requests))
        print("worse with the station than without: %d of %d" % (self.worse, self.compared))
        if self.ratios:
            print("processor time of a request over the same without the station, after %d requests: median %.2f; over the station's "
                  "first: %.2f" % (LEARNT_AFTER, np.median(self.ratios), np.median(self.seconds)))
        for what, c in self.changes.items():
            print("%s: noticed %d of %d answered, rightly named %d (alone %d); prior used in spite of it %d, of these worse than without "
                  "%d" % (what, c["noticed"], c["answered"], c["named"], c["alone"], c["used"], c["worse"]))


def play_changes(server, client, requests, sequence, scene_id, models, state, figures, write):
    for split, kind in (("turned", "CAMERA_MOVED"), ("zoomed", "LENS_CHANGED")):
        if not os.path.isdir(os.path.join(sequence, split, "%06d" % scene_id)):
            continue
        scene = Scene(sequence, split, scene_id)
        changed = "camera%d" % (scene.meta["changed_camera"] + 1)
        asked = Asked(server, client, requests, scene, models, "cell", state)
        # Only an answer under a prior that is wrong now can be worse for it.
        alone = Asked(server, client, requests, scene, models) if asked.report.prior_used else None
        c = figures.changes.setdefault(split, dict(answered=0, noticed=0, named=0, alone=0, used=0, worse=0))
        write(scene_id, split, asked, alone, changed=changed)
        if not asked.answer.objects:
            continue
        c["answered"] += 1
        findings = asked.report.findings
        c["noticed"] += bool(findings)
        right = [f for f in findings if f.kind == kind and changed in f.cameras]
        c["named"] += bool(right)
        c["alone"] += bool(right) and len(findings) == 1 and len(right[0].cameras) == 1
        c["used"] += asked.report.prior_used
        c["worse"] += bool(alone) and asked.worse_than(alone)


def play(arguments, sequence, figures):
    import horopter
    from horopter import _requests
    models = Models(sequence)
    scenes = sorted(map(int, os.listdir(os.path.join(sequence, "val"))))[:arguments.requests]
    name = os.path.basename(os.path.normpath(sequence))
    details = open(arguments.details, "a", encoding="utf-8") if arguments.details else None

    def write(scene_id, split, asked, alone, **more):
        if details:
            details.write(json.dumps(dict(sequence=name, scene=scene_id, split=split, station=asked.line(),
                                          alone=alone.line() if alone else None, **more)) + "\n")
            details.flush()

    with tempfile.TemporaryDirectory() as folder:
        catalog = os.path.join(folder, "catalog.db")
        if arguments.catalog and os.path.exists(arguments.catalog):
            shutil.copy(arguments.catalog, catalog)
        else:
            enroll(arguments.build, sequence, catalog)
            if arguments.catalog:
                shutil.copy(catalog, arguments.catalog)
        server = Server(arguments.build, catalog)
        client = horopter.Client(server.address)
        subprocess.run([os.path.join(arguments.build, "client", "horopter"), "--server", server.address, "station", "set", "cell"],
                       check=True, stdout=subprocess.DEVNULL)
        try:
            first = None
            for number, scene_id in enumerate(scenes):
                scene = Scene(sequence, "val", scene_id)
                if number >= LEARNT_AFTER:
                    play_changes(server, client, _requests, sequence, scene_id, models, stored_state(catalog, "cell"), figures, write)
                alone = None if arguments.no_alone else Asked(server, client, _requests, scene, models)
                asked = Asked(server, client, _requests, scene, models, "cell")
                write(scene_id, "val", asked, alone)
                count(number, scene, asked, alone, figures)
                first = first or asked.seconds
                if number >= LEARNT_AFTER:
                    figures.seconds.append(asked.seconds / first)
                if number in (LEARNT_AFTER - 1, len(scenes) - 1):
                    check_state(State(stored_state(catalog, "cell")), scene,
                                figures.cameras["after %d requests" % LEARNT_AFTER if number == LEARNT_AFTER - 1 else "at the end"])
        finally:
            server.stop()


def count(number, scene, asked, alone, figures):
    figures.requests += 1
    figures.alarms += bool(asked.report.findings)
    figures.wrong[0] += asked.wrong
    known = number >= LEARNT_AFTER
    row = figures.single if scene.meta["num_parts"] == 1 else figures.several
    if known:
        row[0] += asked.found()
        row[1] += len(asked.hits)
    if alone is None:
        return
    figures.wrong[1] += alone.wrong
    figures.compared += 1
    figures.worse += asked.worse_than(alone)
    if known:
        row[2] += alone.found()
        row[3] += len(alone.hits)
        figures.ratios.append(asked.seconds / max(0.01, alone.seconds))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build")
    parser.add_argument("sequences", nargs="+")
    parser.add_argument("--catalog")
    parser.add_argument("--requests", type=int)
    parser.add_argument("--details")
    parser.add_argument("--no-alone", action="store_true")
    arguments = parser.parse_args()
    sys.path.insert(0, os.path.join(arguments.build, "client", "python"))
    figures = Figures()
    for sequence in arguments.sequences:
        try:
            play(arguments, sequence, figures)
        except KeyboardInterrupt:  # what has been played so far
            figures.print()
            return
        print("== up to %s" % sequence, flush=True)
        figures.print()
        sys.stdout.flush()


if __name__ == "__main__":
    main()
