// What parts, grippers, cameras and uncertainties look like in three dimensions.
import {
  AmbientLight, BufferAttribute, BufferGeometry, DirectionalLight, DoubleSide, Group, LineBasicMaterial, LineSegments, Matrix4, Mesh,
  MeshBasicMaterial, MeshLambertMaterial, Object3D, Quaternion, SphereGeometry, Vector3,
} from "three";
import type { Grasp, Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import type { RigidTransform } from "./gen/horopter/v1/types_pb";

// Ends of the edges' pieces, metres, one after the other.
export function edgeEnds(part: Part): number[] {
  const ends: number[] = [];
  for (const edge of part.edges) {
    const line = edge.polylineM;
    for (let i = 3; i + 2 < line.length; i += 3) ends.push(...line.slice(i - 3, i + 3));
  }
  return ends;
}

export function lines(ends: number[], color: string) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(ends), 3));
  return new LineSegments(geometry, new LineBasicMaterial({ color }));
}

export function surfaceOf(part: Part): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(part.mesh?.verticesM ?? []), 3));
  geometry.setIndex(new BufferAttribute(new Uint32Array(part.mesh?.triangles ?? []), 1));
  const faceted = geometry.toNonIndexed();
  faceted.computeVertexNormals();
  return faceted;
}

export function shaded(geometry: BufferGeometry, color = "#9fb4c7", opacity = 1) {
  return new Mesh(geometry, new MeshLambertMaterial({
    color, side: DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1, transparent: opacity < 1, opacity,
    depthWrite: opacity === 1,
  }));
}

export function lights(): Object3D[] {
  const light = new DirectionalLight("#fff", 2);
  light.position.set(1, 2, 3);
  return [new AmbientLight("#fff", 1.2), light];
}

export function quaternionOf(pose: RigidTransform) {
  const r = pose.rotation;
  return r ? new Quaternion(r.x, r.y, r.z, r.w) : new Quaternion();
}

export function matrixOf(pose: RigidTransform): Matrix4 {
  const t = pose.translationM;
  return new Matrix4().compose(new Vector3(t?.x ?? 0, t?.y ?? 0, t?.z ?? 0), quaternionOf(pose), new Vector3(1, 1, 1));
}

export function placed<T extends Object3D>(object: T, pose?: RigidTransform): T {
  if (pose) object.applyMatrix4(matrixOf(pose));
  return object;
}

// Fingers or the cup as lines in the gripper's frame, whose z points to the part; size: of the part.
export function gripperLines(gripper: Grasp["gripper"], size: number, color = "#d55e00") {
  const ends: number[] = [];
  const add = (a: number[], b: number[]) => ends.push(...a, ...b);
  const back = -0.35 * size;
  if (gripper.case === "suction") {
    const r = gripper.value.cupRadiusM;
    for (let i = 0; i < 24; ++i) {
      const a = (i * Math.PI) / 12;
      const b = ((i + 1) * Math.PI) / 12;
      add([r * Math.cos(a), r * Math.sin(a), 0], [r * Math.cos(b), r * Math.sin(b), 0]);
    }
    add([0, 0, 0], [0, 0, back]);
  } else if (gripper.case === "parallelJaw") {
    const x = 0.5 * gripper.value.jawOpeningM;
    add([-x, 0, 0], [-x, 0, back / 2]);
    add([x, 0, 0], [x, 0, back / 2]);
    add([-x, 0, back / 2], [x, 0, back / 2]);
    add([0, 0, back / 2], [0, 0, back]);
  }
  const drawn = lines(ends, color);
  drawn.material.depthTest = false;  // seen through the part
  drawn.renderOrder = 1;
  return drawn;
}

export function graspOf(grasp: Grasp, size: number, color?: string): Group {
  const group = new Group();
  group.add(gripperLines(grasp.gripper, size, color));
  return placed(group, grasp.objectFromGripper);
}

// A pyramid whose base is the image, `deep` in front of the camera; half: tangents of half the angles of view.
export function cameraLines(halfX: number, halfY: number, deep: number, color: string) {
  const c = [[-halfX, -halfY], [halfX, -halfY], [halfX, halfY], [-halfX, halfY]].map(([x, y]) => [deep * x, deep * y, deep]);
  const ends: number[] = [];
  for (let i = 0; i < 4; ++i) ends.push(0, 0, 0, ...c[i], ...c[i], ...c[(i + 1) % 4]);
  // Up.
  ends.push(...c[0], 0, 1.4 * c[0][1], deep, 0, 1.4 * c[0][1], deep, ...c[1]);
  return lines(ends, color);
}

export function axes(size: number): Group {
  const group = new Group();
  group.add(lines([0, 0, 0, size, 0, 0], "#d55e00"), lines([0, 0, 0, 0, size, 0], "#009e73"), lines([0, 0, 0, 0, 0, size], "#0072b2"));
  return group;
}

// Axes of a symmetric 3 x 3 matrix, row-major, scaled by the roots of its eigenvalues: Jacobi's rotations.
export function ellipsoidAxes(m: number[]): Matrix4 {
  const a = [m.slice(0, 3), m.slice(3, 6), m.slice(6, 9)];
  const v = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  for (let round = 0; round < 12; ++round) {
    for (const [p, q] of [[0, 1], [0, 2], [1, 2]]) {
      if (Math.abs(a[p][q]) < 1e-18) continue;
      const angle = 0.5 * Math.atan2(2 * a[p][q], a[q][q] - a[p][p]);
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      for (const rows of [a, v]) {
        for (let k = 0; k < 3; ++k) [rows[k][p], rows[k][q]] = [c * rows[k][p] - s * rows[k][q], s * rows[k][p] + c * rows[k][q]];
      }
      for (let k = 0; k < 3; ++k) [a[p][k], a[q][k]] = [c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]];
    }
  }
  const scale = [0, 1, 2].map((i) => Math.sqrt(Math.max(a[i][i], 0)));
  const columns = [0, 1, 2].map((i) => new Vector3(v[0][i], v[1][i], v[2][i]).multiplyScalar(scale[i]));
  return new Matrix4().makeBasis(columns[0], columns[1], columns[2]);
}

// Where the part's origin is but for one time in a hundred (3.4 standard deviations); covariance: 6 x 6 of a pose.
export function ellipsoid(covariance: number[], at: Vector3, leastM: number): Mesh {
  const position = [21, 22, 23, 27, 28, 29, 33, 34, 35].map((i) => covariance[i]);
  const least = (leastM / 3.4) ** 2;
  for (const i of [0, 4, 8]) position[i] = Math.max(position[i], least);
  const mesh = new Mesh(new SphereGeometry(3.4, 24, 16), new MeshBasicMaterial({ color: "#cc79a7", transparent: true, opacity: 0.45, depthWrite: false }));
  mesh.applyMatrix4(ellipsoidAxes(position).setPosition(at));
  mesh.renderOrder = 2;
  return mesh;
}
