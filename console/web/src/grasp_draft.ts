// A grasp from a click on a face: gripper frame z = approach, of two fingers x = closing direction, as in catalog.proto.
import { create } from "@bufbuild/protobuf";
import { Matrix4, Quaternion, Vector3 } from "three";
import { GraspSchema, type Grasp } from "./gen/horopter/v1/catalog_pb";
import { RigidTransformSchema } from "./gen/horopter/v1/types_pb";
import { quaternionOf } from "./shapes";

// approach: across the normal, for two fingers.
export interface Picked { point: Vector3; normal: Vector3; thickness: number; approach: Vector3 }
export type Kind = "jaw" | "cup";

const CLEARANCE_M = 0.01;  // that the open fingers leave, both together

export function draftGrasp(kind: Kind, picked: Picked, name: string, cupRadiusM: number): Grasp {
  const { point, normal, thickness, approach } = picked;
  const z = normal.clone().negate();
  const origin = point.clone();
  let x = Math.abs(normal.z) < 0.9 ? new Vector3(0, 0, 1) : new Vector3(1, 0, 0);
  x.addScaledVector(normal, -x.dot(normal)).normalize();
  if (kind === "jaw") {
    // The fingers close along the normal.
    origin.addScaledVector(normal, -thickness / 2);
    z.copy(approach);
    x = normal.clone();
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

export type Axis = "x" | "y" | "z";

function posed(grasp: Grasp, position: Vector3, q: Quaternion): Grasp {
  return { ...grasp, objectFromGripper: create(RigidTransformSchema, {
    rotation: { w: q.w, x: q.x, y: q.y, z: q.z },
    translationM: { x: position.x, y: position.y, z: position.z },
  }), objectFromPregrasp: undefined };
}

// The same gripper elsewhere; where it waits before is no longer known.
export const withPose = (grasp: Grasp, position: Vector3, rotation: Quaternion): Grasp => posed(grasp, position, rotation.clone().normalize());

// About an axis of the gripper.
export function turned(grasp: Grasp, axis: Axis, radians: number): Grasp {
  const { position, rotation } = poseOf(grasp);
  const about = new Vector3(axis === "x" ? 1 : 0, axis === "y" ? 1 : 0, axis === "z" ? 1 : 0);
  return withPose(grasp, position, rotation.multiply(new Quaternion().setFromAxisAngle(about, radians)));
}

export function poseOf(grasp: Grasp): { position: Vector3; rotation: Quaternion } {
  const t = grasp.objectFromGripper?.translationM;
  return { position: new Vector3(t?.x ?? 0, t?.y ?? 0, t?.z ?? 0), rotation: grasp.objectFromGripper ? quaternionOf(grasp.objectFromGripper) : new Quaternion() };
}

// The jaws as wide as the part is between them, and open a little wider.
export function fitted(grasp: Grasp, widthM: number): Grasp {
  if (grasp.gripper.case !== "parallelJaw") return grasp;
  return { ...grasp, gripper: { case: "parallelJaw", value: { ...grasp.gripper.value, gripWidthM: widthM, jawOpeningM: widthM + CLEARANCE_M } } };
}
