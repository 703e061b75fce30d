// How a part lies on a plane by itself, and the axes of its symmetric rotations; of its mesh alone.
import { Quaternion, Vector3 } from "three";
import { ConvexHull } from "three/examples/jsm/math/ConvexHull.js";
import type { Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { quaternionOf } from "./shapes";

const SAME_DIRECTION = 0.9995;  // cosine
const MOST_POSES = 6;

export interface RestingPose {
  down: Vector3;  // outward normal of the face that it lies on, in the object's frame
  share: number;  // of the directions in which it may be dropped: the solid angle of that face, as seen from the centre of mass
}

// Weighted by the signed volume of the tetrahedra to the origin: a closed mesh of one density.
function centreOfMass(part: Part): Vector3 {
  const v = part.mesh?.verticesM ?? [];
  const triangles = part.mesh?.triangles ?? [];
  const corner = (i: number) => new Vector3(v[3 * i], v[3 * i + 1], v[3 * i + 2]);
  const sum = new Vector3();
  let volume = 0;
  for (let i = 0; i + 2 < triangles.length; i += 3) {
    const [a, b, c] = [corner(triangles[i]), corner(triangles[i + 1]), corner(triangles[i + 2])];
    const six = a.dot(b.clone().cross(c));
    volume += six;
    sum.add(a.add(b).add(c).multiplyScalar(six / 4));
  }
  return Math.abs(volume) > 1e-15 ? sum.divideScalar(volume) : sum.set(0, 0, 0);
}

function solidAngle(a: Vector3, b: Vector3, c: Vector3): number {
  const [la, lb, lc] = [a.length(), b.length(), c.length()];
  const above = Math.abs(a.dot(b.clone().cross(c)));
  return 2 * Math.atan2(above, la * lb * lc + a.dot(b) * lc + a.dot(c) * lb + b.dot(c) * la);
}

// The most probable first. Of parts with very many corners a sample of them is taken.
export function restingPoses(part: Part): RestingPose[] {
  const v = part.mesh?.verticesM ?? [];
  const stride = 3 * Math.max(1, Math.floor(v.length / 3 / 4000));
  const points: Vector3[] = [];
  for (let i = 0; i + 2 < v.length; i += stride) points.push(new Vector3(v[i], v[i + 1], v[i + 2]));
  if (points.length < 4) return [];
  const centre = centreOfMass(part);
  const faces: { normal: Vector3; angle: number; stable: boolean }[] = [];
  for (const face of new ConvexHull().setFromPoints(points).faces) {
    const corners: Vector3[] = [];
    let edge = face.edge;
    do {
      corners.push(edge.head().point.clone().sub(centre));
      edge = edge.next;
    } while (edge !== face.edge);
    let angle = 0;
    for (let i = 1; i + 1 < corners.length; ++i) angle += solidAngle(corners[0], corners[i], corners[i + 1]);
    // The centre of mass is above the face.
    const foot = face.normal.clone().multiplyScalar(corners[0].dot(face.normal));
    const above = corners.every((c, i) => corners[(i + 1) % corners.length].clone().sub(c).cross(foot.clone().sub(c)).dot(face.normal) >= -1e-12);
    const same = faces.find((f) => f.normal.dot(face.normal) > SAME_DIRECTION);
    if (same) {
      same.angle += angle;
      same.stable ||= above;
    } else {
      faces.push({ normal: face.normal.clone(), angle, stable: above });
    }
  }
  return faces
    .filter((f) => f.stable)
    .sort((a, b) => b.angle - a.angle)
    .slice(0, MOST_POSES)
    .map((f) => ({ down: f.normal, share: f.angle / (4 * Math.PI) }));
}

// Each axis once; `fold`: rotations about it, the identity too.
export function symmetryAxes(part: Part): { point: Vector3; axis: Vector3; fold: number }[] {
  const found: { point: Vector3; axis: Vector3; fold: number }[] = [];
  for (const pose of part.objectFromSymmetricObject) {
    const q = quaternionOf(pose);
    const axis = new Vector3(q.x, q.y, q.z);
    if (axis.length() < 1e-6) continue;
    axis.normalize();
    const same = found.find((f) => Math.abs(f.axis.dot(axis)) > SAME_DIRECTION);
    if (same) {
      ++same.fold;
      continue;
    }
    found.push({ point: fixedPoint(q, new Vector3(pose.translationM?.x ?? 0, pose.translationM?.y ?? 0, pose.translationM?.z ?? 0), axis), axis, fold: 2 });
  }
  return found;
}

// The point of the axis of x -> R x + t that is nearest to the origin.
function fixedPoint(q: Quaternion, t: Vector3, axis: Vector3): Vector3 {
  const across = t.clone().addScaledVector(axis, -t.dot(axis));
  const half = Math.atan2(Math.hypot(q.x, q.y, q.z), q.w);
  const turn = new Vector3(q.x, q.y, q.z).dot(axis) < 0 ? -half : half;
  // (I - R)^-1 across the axis: half of it, and half of it turned by a right angle over tan(angle / 2).
  return across.clone().multiplyScalar(0.5).addScaledVector(axis.clone().cross(across), 0.5 / Math.tan(turn));
}
