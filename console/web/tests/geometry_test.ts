// Laws of what the page computes by itself; run by console/test.sh.
import assert from "node:assert";
import { create } from "@bufbuild/protobuf";
import { Quaternion, Vector3 } from "three";
import { parseCalibration, toRosYaml } from "../src/calibration_files";
import { ObjectSchema } from "../src/gen/horopter/v1/catalog_pb";
import { CameraSchema, ExplanationSchema } from "../src/gen/horopter/v1/recognition_pb";
import { hullOf, pixelOf } from "../src/project";
import { nearestFirst } from "../src/refused";
import { restingPoses, symmetryAxes } from "../src/resting";
import { ellipsoidAxes } from "../src/shapes";

const near = (a: number, b: number, within = 1e-9) => assert.ok(Math.abs(a - b) <= within, `${a} is not ${b}`);

function box(x: number, y: number, z: number, at = new Vector3()) {
  const verticesM: number[] = [];
  for (let i = 0; i < 8; ++i) verticesM.push(at.x + (i & 1 ? x : -x), at.y + (i & 2 ? y : -y), at.z + (i & 4 ? z : -z));
  const quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
  return { verticesM, triangles: quads.flatMap(([a, b, c, d]) => [a, b, c, a, c, d]) };
}

// A A' is the matrix, whatever its axes.
for (const m of [[4, 0, 0, 0, 9, 0, 0, 0, 1], [5, 2, -1, 2, 6, 3, -1, 3, 7], [1, 1, 1, 1, 1, 1, 1, 1, 1], [0, 0, 0, 0, 0, 0, 0, 0, 0]]) {
  const e = ellipsoidAxes(m).elements;
  for (let r = 0; r < 3; ++r) {
    for (let c = 0; c < 3; ++c) near([0, 4, 8].reduce((s, k) => s + e[k + r] * e[k + c], 0), m[3 * r + c], 1e-6);
  }
}

// A box lies on six faces, likeliest on the largest; the shares of all directions are 1. Where its origin is says nothing.
for (const at of [new Vector3(), new Vector3(1, 2, 3)]) {
  const poses = restingPoses(create(ObjectSchema, { mesh: box(0.05, 0.03, 0.01, at) }));
  assert.equal(poses.length, 6);
  near(poses.reduce((s, p) => s + p.share, 0), 1, 1e-6);
  near(Math.abs(poses[0].down.z), 1, 1e-6);
  near(Math.abs(poses[5].down.x), 1, 1e-6);
}
assert.deepEqual(restingPoses(create(ObjectSchema, {})), []);

// Points of an axis stay where they are.
const axis = new Vector3(1, 2, -1).normalize();
const through = new Vector3(0.1, -0.2, 0.3);
const symmetric = [1, 2].map((k) => {
  const q = new Quaternion().setFromAxisAngle(axis, (k * 2 * Math.PI) / 3);
  const t = through.clone().sub(through.clone().applyQuaternion(q));
  return { rotation: { w: q.w, x: q.x, y: q.y, z: q.z }, translationM: { x: t.x, y: t.y, z: t.z } };
});
const [found, ...others] = symmetryAxes(create(ObjectSchema, { objectFromSymmetricObject: symmetric }));
assert.equal(others.length, 0);
assert.equal(found.fold, 3);
near(Math.abs(found.axis.dot(axis)), 1, 1e-9);
near(through.clone().sub(found.point).cross(axis).length(), 0, 1e-9);

// Pixels: the principal point, the lens, behind the camera; a hull holds the part's corners.
const camera = create(CameraSchema, { focalPx: 800, principalPointXPx: 320, principalPointYPx: 240, k1: -0.1, imageWidthPx: 640, imageHeightPx: 480 });
assert.deepEqual(pixelOf(camera, new Vector3(0, 0, 2)), [320, 240]);
near(pixelOf(camera, new Vector3(1, 0, 2))![0], 320 + 800 * 0.5 * (1 - 0.1 * 0.25));
assert.equal(pixelOf(camera, new Vector3(0, 0, -1)), undefined);
const part = create(ObjectSchema, { mesh: box(0.05, 0.05, 0.05) });
const hull = hullOf(part, camera, { $typeName: "horopter.v1.RigidTransform", translationM: { $typeName: "horopter.v1.Vector3", x: 0, y: 0, z: 1 } } as never);
assert.equal(hull.length, 4);  // the nearer face hides the other

// Nearest to an answer first.
const explained = (failedTest: number, value: number, needed: number) => create(ExplanationSchema, { failedTest, value, needed });
const sorted = [explained(2, 0, 0), explained(5, 0.2, 0.5), explained(5, 0.4, 0.5), explained(0, 0.9, 0)].sort(nearestFirst);
assert.deepEqual(sorted.map((e) => [e.failedTest, e.value]), [[0, 0.9], [5, 0.4], [5, 0.2], [2, 0]]);

// Calibrations: there and back, as ROS writes them, and what is none.
const yaml = "image_width: 640\nimage_height: 480\ncamera_name: left\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [ 800.5, 0.,  320.,\n          0., 800.5, 240.,\n"
  + "          0., 0., 1.]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.1, 0, 0, 0, 0]\n";
for (const content of [yaml, yaml.replace(/\n/g, "\r\n"), toRosYaml("left", parseCalibration("a.yaml", yaml))]) {
  const read = parseCalibration("a.yaml", content);
  assert.deepEqual([read.imageWidthPx, read.imageHeightPx, read.k[0], read.k[5], read.d[0]], [640, 480, 800.5, 240, -0.1]);
}
for (const bad of ["", "camera_matrix: 3", yaml.replace("800.5, 0.", "x, 0."), yaml.replace("plumb_bob", "equidistant")]) {
  assert.throws(() => parseCalibration("a.yml", bad), /./);
}
console.log("geometry: all laws hold");
