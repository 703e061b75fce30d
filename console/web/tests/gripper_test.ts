// Laws of grasps that are moved by hand, of what is in the gripper's way, and of the server's view templates.
import assert from "node:assert/strict";
import { create } from "@bufbuild/protobuf";
import { Quaternion, Vector3 } from "three";
import { GraspSchema, ViewTemplateSchema, ViewTemplate_EdgeKind as Kind, type Grasp } from "../src/gen/horopter/v1/catalog_pb";
import { draftGrasp, fitted, poseOf, turned, withPose } from "../src/grasp_draft";
import { boxesOf, inTheWay } from "../src/gripper";
import { directionOf, strokes } from "../src/view_templates";

const near = (a: number, b: number, within = 1e-9) => assert.ok(Math.abs(a - b) <= within, `${a} is not ${b}`);

// The 12 triangles of a box about the origin; half sizes in metres.
function box(x: number, y: number, z: number): number[] {
  const corner = (i: number) => [i & 1 ? x : -x, i & 2 ? y : -y, i & 4 ? z : -z];
  const quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
  return quads.flatMap(([a, b, c, d]) => [a, b, c, a, c, d].flatMap(corner));
}
const jaw = (jawOpeningM: number, at = new Vector3(), q = new Quaternion()): Grasp =>
  withPose(create(GraspSchema, { name: "g", gripper: { case: "parallelJaw", value: { jawOpeningM, gripWidthM: jawOpeningM } } }), at, q);
const cup = (cupRadiusM: number, at: Vector3, q = new Quaternion()): Grasp =>
  withPose(create(GraspSchema, { name: "c", gripper: { case: "suction", value: { cupRadiusM } } }), at, q);

// Fingers beside a block do not meet it, whichever way it is approached; closer ones do, and so does the palm where the block is long.
const block = box(0.01, 0.02, 0.01);
const about = (axis: "x" | "y" | "z", angle: number) => new Quaternion().setFromAxisAngle(new Vector3(axis === "x" ? 1 : 0, axis === "y" ? 1 : 0, axis === "z" ? 1 : 0), angle);
for (const angle of [0, Math.PI / 3, Math.PI, 4]) assert.deepEqual(inTheWay(block, jaw(0.03, new Vector3(), about("x", angle))), []);
assert.ok(inTheWay(block, jaw(0.019)).length > 0, "fingers within the block");
assert.ok(inTheWay(box(0.01, 0.02, 0.1), jaw(0.03)).length > 0, "the palm, of a block that is longer than the fingers");
assert.ok(inTheWay(block, jaw(0.019, new Vector3(0, 0, 0.1))).length > 0, "what is in the way before the grasp");
assert.deepEqual(inTheWay(block, jaw(0.019, new Vector3(0, 0, -0.1))), []);
// The same scene turned and moved as a whole is the same.
{
  const [q, t] = [new Quaternion(0.3, -0.2, 0.6, 0.7).normalize(), new Vector3(0.1, -0.3, 0.2)];
  const moved: number[] = [];
  for (let i = 0; i < block.length; i += 3) moved.push(...new Vector3(...block.slice(i, i + 3)).applyQuaternion(q).add(t).toArray());
  const there = (g: Grasp) => withPose(g, poseOf(g).position.applyQuaternion(q).add(t), q.clone().multiply(poseOf(g).rotation));
  for (const g of [jaw(0.03), jaw(0.019), jaw(0.03, new Vector3(0.004, 0, 0)), cup(0.005, new Vector3(0, 0, -0.01))]) {
    assert.equal(inTheWay(moved, there(g)).length > 0, inTheWay(block, g).length > 0);
  }
}
// A cup on a face touches it and is not in its own way; from inside it is.
assert.deepEqual(inTheWay(block, cup(0.005, new Vector3(0, 0, -0.01))), []);
assert.ok(inTheWay(block, cup(0.005, new Vector3(0, 0, 0.01))).length > 0);
assert.deepEqual(boxesOf({ case: undefined }), []);

// Four right angles about an axis are none; where it waits before goes with each move.
for (const axis of ["x", "y", "z"] as const) {
  let g = jaw(0.03, new Vector3(1, 2, 3), new Quaternion(0.1, 0.2, 0.3, 0.9).normalize());
  const before = poseOf(g).rotation;
  for (let i = 0; i < 24; ++i) g = turned(g, axis, Math.PI / 12);
  near(Math.abs(before.dot(poseOf(g).rotation)), 1);
  assert.ok(poseOf(g).position.equals(new Vector3(1, 2, 3)));
}
// About the gripper's own axis, not the part's.
{
  const g = turned(jaw(0.03, new Vector3(), about("x", Math.PI / 2)), "z", Math.PI / 2);
  const x = new Vector3(1, 0, 0).applyQuaternion(poseOf(g).rotation);
  near(x.dot(new Vector3(0, 0, 1)), 1, 1e-9);
}
{
  const fit = fitted(jaw(0.1), 0.02).gripper;
  assert.ok(fit.case === "parallelJaw" && fit.value.gripWidthM === 0.02 && fit.value.jawOpeningM > 0.02 && fit.value.jawOpeningM < 0.1);
  const g = cup(0.005, new Vector3());
  assert.equal(fitted(g, 0.02), g);
}
// A click gives a rotation, its fingers on both sides of the face.
{
  const g = draftGrasp("jaw", { point: new Vector3(0.01, 0, 0), normal: new Vector3(1, 0, 0), thickness: 0.02, approach: new Vector3(0, 0, -1) }, "a", 0.01);
  near(poseOf(g).position.length(), 0);
  near(poseOf(g).rotation.length(), 1);
  assert.deepEqual(inTheWay(block, g), []);
}

// A stroke lies on its point along its direction; each kind has its own.
{
  const view = create(ViewTemplateSchema, { pointsPx: [10, 20, 30, 40], directionsRad: [0, Math.PI / 2], kinds: [Kind.SILHOUETTE, Kind.CREASE] });
  assert.equal(strokes(view, Kind.SILHOUETTE, 4), "M8.0 20.0L12.0 20.0");
  assert.equal(strokes(view, Kind.CREASE, 4), "M30.0 38.0L30.0 42.0");
  assert.equal(strokes(view, Kind.OCCLUSION, 4), "");
  // A camera that looks along the part's x stands at -x.
  const looks = new Quaternion().setFromUnitVectors(new Vector3(1, 0, 0), new Vector3(0, 0, 1));
  const from = directionOf(create(ViewTemplateSchema, { cameraFromObject: { rotation: { w: looks.w, x: looks.x, y: looks.y, z: looks.z } } }));
  near(from.dot(new Vector3(-1, 0, 0)), 1);
}

console.log("grippers: all laws hold");
