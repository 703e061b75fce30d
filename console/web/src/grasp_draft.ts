// A grasp from a click on a face: gripper frame z = approach, of two fingers x = closing direction, as in catalog.proto.
import { create } from "@bufbuild/protobuf";
import { Matrix4, Quaternion, Vector3 } from "three";
import { GraspSchema, type Grasp } from "./gen/horopter/v1/catalog_pb";

// approach: across the normal, for two fingers.
export interface Picked { point: Vector3; normal: Vector3; thickness: number; approach: Vector3 }
export type Kind = "jaw" | "cup";

const CLEARANCE_M = 0.01;  // that the open fingers leave, both together

// turn: of the approach about the normal, radians. A cup's turn changes nothing but its frame.
export function draftGrasp(kind: Kind, picked: Picked, turn: number, name: string, cupRadiusM: number): Grasp {
  const { point, normal, thickness, approach } = picked;
  const z = normal.clone().negate();
  const origin = point.clone();
  let x = Math.abs(normal.z) < 0.9 ? new Vector3(0, 0, 1) : new Vector3(1, 0, 0);
  x.addScaledVector(normal, -x.dot(normal)).normalize();
  if (kind === "jaw") {
    // The fingers close along the normal.
    origin.addScaledVector(normal, -thickness / 2);
    z.copy(approach).applyAxisAngle(normal, turn);
    x = normal.clone();
  } else {
    x.applyAxisAngle(normal, turn);
  }
  const y = new Vector3().crossVectors(z, x);
  const q = new Quaternion().setFromRotationMatrix(new Matrix4().makeBasis(x, y, z));
  return create(GraspSchema, {
    name,
    objectFromGripper: {
      rotation: { w: q.w, x: q.x, y: q.y, z: q.z },
      translationM: { x: origin.x, y: origin.y, z: origin.z },
    },
    gripper: kind === "jaw"
      ? { case: "parallelJaw", value: { jawOpeningM: thickness + CLEARANCE_M, gripWidthM: thickness } }
      : { case: "suction", value: { cupRadiusM } },
  });
}
