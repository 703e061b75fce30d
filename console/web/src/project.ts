// From parts to pixels: the camera of an answer, as recognition.proto has it.
import { Vector3 } from "three";
import type { Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import type { Camera } from "./gen/horopter/v1/recognition_pb";
import type { RigidTransform } from "./gen/horopter/v1/types_pb";
import { edgeEnds, matrixOf } from "./shapes";

export type Point = [number, number];

// Pixel of a point in the camera's frame; undefined behind the camera or far outside of where the lens is known.
export function pixelOf(camera: Camera, p: Vector3): Point | undefined {
  if (p.z <= 1e-6) return undefined;
  const [x, y] = [p.x / p.z, p.y / p.z];
  const r2 = x * x + y * y;
  if (r2 > 9) return undefined;
  const radial = 1 + camera.k1 * r2 + camera.k2 * r2 * r2;
  const dx = x * radial + 2 * camera.p1 * x * y + camera.p2 * (r2 + 2 * x * x);
  const dy = y * radial + camera.p1 * (r2 + 2 * y * y) + 2 * camera.p2 * x * y;
  return [camera.focalPx * dx + camera.principalPointXPx, camera.focalPx * dy + camera.principalPointYPx];
}

const text = (p: Point) => `${p[0].toFixed(1)} ${p[1].toFixed(1)}`;

// The edges of a part as a path of SVG, in pixels.
export function edgePath(part: Part, camera: Camera, cameraFromObject: RigidTransform): string {
  const matrix = matrixOf(cameraFromObject);
  const ends = edgeEnds(part);
  const pieces: string[] = [];
  for (let i = 0; i + 5 < ends.length; i += 6) {
    const a = pixelOf(camera, new Vector3(ends[i], ends[i + 1], ends[i + 2]).applyMatrix4(matrix));
    const b = pixelOf(camera, new Vector3(ends[i + 3], ends[i + 4], ends[i + 5]).applyMatrix4(matrix));
    if (a && b) pieces.push(`M${text(a)}L${text(b)}`);
  }
  return pieces.join("");
}

// The hull of all that a part covers, in pixels: where a click means it. Andrew's monotone chain.
export function hullOf(part: Part, camera: Camera, cameraFromObject: RigidTransform): Point[] {
  const matrix = matrixOf(cameraFromObject);
  const vertices = part.mesh?.verticesM ?? [];
  const stride = 3 * Math.max(1, Math.floor(vertices.length / 3 / 2000));
  const points: Point[] = [];
  for (let i = 0; i + 2 < vertices.length; i += stride) {
    const p = pixelOf(camera, new Vector3(vertices[i], vertices[i + 1], vertices[i + 2]).applyMatrix4(matrix));
    if (p) points.push(p);
  }
  points.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (sorted: Point[]) => {
    const chain: Point[] = [];
    for (const p of sorted) {
      while (chain.length > 1) {
        const [a, b] = chain.slice(-2);
        if ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0) break;
        chain.pop();
      }
      chain.push(p);
    }
    return chain.slice(0, -1);
  };
  return points.length < 3 ? [] : [...half(points), ...half([...points].reverse())];
}
