// The gripper as boxes in its own frame (z: approach), and what of the part is in their way. Sizes are the server's defaults.
import { Box3, BoxGeometry, Group, Matrix4, Mesh, MeshLambertMaterial, Triangle, Vector3 } from "three";
import type { Grasp } from "./gen/horopter/v1/catalog_pb";
import { matrixOf } from "./shapes";

const FINGER_M = { length: 0.06, width: 0.014, thickness: 0.008 };
const PALM_M = 0.015;
const HOLDER_M = 0.06;
const APPROACH_M = 0.06;  // straight way to the grasp
const TOUCH_M = 0.0005;   // that a cup is pressed onto the part
const MOST_TRIANGLES = 400_000;  // of a larger part every so many are looked at

const box = (x0: number, x1: number, y: number, z0: number, z1: number) => new Box3(new Vector3(x0, -y, z0), new Vector3(x1, y, z1));

export function boxesOf(gripper: Grasp["gripper"]): Box3[] {
  if (gripper.case === "parallelJaw") {
    const inner = gripper.value.jawOpeningM / 2;
    const outer = inner + FINGER_M.thickness;
    const y = FINGER_M.width / 2;
    return [box(inner, outer, y, -FINGER_M.length, 0), box(-outer, -inner, y, -FINGER_M.length, 0), box(-outer, outer, y, -FINGER_M.length - PALM_M, -FINGER_M.length)];
  }
  if (gripper.case === "suction") {
    const r = gripper.value.cupRadiusM;
    return [box(-r, r, r, -HOLDER_M, -TOUCH_M)];
  }
  return [];
}

// What the boxes pass through on their straight way.
const swept = (boxes: Box3[]) => boxes.map((b) => new Box3(new Vector3(b.min.x, b.min.y, b.min.z - APPROACH_M), b.max));

// Triangles (x0 y0 z0 x1 .. of each, metres, object frame) that the gripper meets on its way: numbers, each once.
export function inTheWay(triangles: ArrayLike<number>, grasp: Grasp): number[] {
  if (!grasp.objectFromGripper) return [];
  const boxes = swept(boxesOf(grasp.gripper));
  const gripperFromObject = matrixOf(grasp.objectFromGripper).invert();
  const all = boxes.reduce((sum, b) => sum.union(b), new Box3());
  const triangle = new Triangle();
  const bounds = new Box3();
  const met: number[] = [];
  const count = triangles.length / 9;
  const step = Math.max(1, Math.ceil(count / MOST_TRIANGLES));
  for (let i = 0; i < count; i += step) {
    const corners = [triangle.a, triangle.b, triangle.c];
    corners.forEach((c, k) => c.set(triangles[9 * i + 3 * k], triangles[9 * i + 3 * k + 1], triangles[9 * i + 3 * k + 2]).applyMatrix4(gripperFromObject));
    bounds.setFromPoints(corners);
    if (bounds.intersectsBox(all) && boxes.some((b) => b.intersectsTriangle(triangle))) met.push(i);
  }
  return met;
}

// In the object's frame.
export function gripperSolid(grasp: Grasp, color: string): Group {
  const group = new Group();
  const size = new Vector3();
  for (const b of boxesOf(grasp.gripper)) {
    b.getSize(size);
    const mesh = new Mesh(new BoxGeometry(size.x, size.y, size.z), new MeshLambertMaterial({ color, transparent: true, opacity: 0.75 }));
    b.getCenter(mesh.position);
    group.add(mesh);
  }
  return place(group, grasp);
}

export function place(group: Group, grasp: Grasp): Group {
  (grasp.objectFromGripper ? matrixOf(grasp.objectFromGripper) : new Matrix4()).decompose(group.position, group.quaternion, group.scale);
  return group;
}
