// An answer in three dimensions: parts, cameras, plane, grasps, and how surely each is where it is.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { Box3, Color, GridHelper, Group, Mesh, MeshLambertMaterial, Object3D, Quaternion, Vector3 } from "three";
import type { RigidTransform } from "./gen/horopter/v1/types_pb";
import type { Camera, RecognizedObject } from "./gen/horopter/v1/recognition_pb";
import { Orbit } from "./orbit";
import type { Run } from "./run";
import { axes, cameraLines, edgeEnds, ellipsoid, gripperLines, lights, lines, matrixOf, placed, shaded, surfaceOf } from "./shapes";
import { shared } from "./style";
import { text } from "./strings";

const t = text.scene;
const COLORS = ["#9fb4c7", "#a6c9a0", "#d9b38c", "#c3a6cf", "#8fc7c7"];

@customElement("horopter-scene-view")
export class SceneView extends LitElement {
  static styles = [
    shared,
    css`
      .view { width: 100%; aspect-ratio: 16 / 9; max-height: 60vh; border: 1px solid var(--line); border-radius: 8px; overflow: hidden; touch-action: none; background: var(--raised); }
      canvas { width: 100%; height: 100%; display: block; }
    `,
  ];
  @property({ attribute: false }) run?: Run;
  @property({ type: Number }) chosen = -1;
  @state() private flat = false;
  private orbit = new Orbit();
  private parts: { mesh: Mesh; index: number }[] = [];

  disconnectedCallback() {
    super.disconnectedCallback();
    this.orbit.detach();
  }

  updated(changed: Map<string, unknown>) {
    if (changed.has("run")) this.build();
    else if (changed.has("chosen")) this.mark();
  }

  private build() {
    const canvas = this.renderRoot.querySelector("canvas");
    if (!this.run || !canvas) return;
    if (!this.orbit.attach(canvas)) {
      this.flat = true;
      return;
    }
    const { response } = this.run;
    const world = new Group();
    this.orbit.scene.clear();
    this.parts = [];
    // What is looked at; cameras are far away, and may be cut off.
    const inside = new Group();
    response.objects.forEach((object, i) => inside.add(...this.shapesOf(object, i)));
    world.add(inside);
    const box = new Box3().setFromObject(inside);
    const size = box.isEmpty() ? 0.3 : box.getSize(new Vector3()).length();
    response.cameras.forEach((camera, i) => world.add(...this.camera(camera, i, size)));
    this.upright(world, response.supportingPlaneInScene, box, size);
    if (response.baseFromScene) {
      const base = axes(0.5 * size);
      base.applyMatrix4(matrixOf(response.baseFromScene).invert());
      world.add(base);
    }
    this.orbit.scene.add(world, ...lights());
    world.updateMatrixWorld(true);
    new Box3().setFromObject(inside.children.length ? inside : world).getCenter(this.orbit.center);
    this.orbit.size = Math.max(size, 1e-3);
    this.mark();
  }

  private shapesOf(object: RecognizedObject, index: number): Object3D[] {
    const model = this.run!.models.get(object.object);
    const pose = object.sceneFromObject;
    if (!pose) return [];
    const shown: Object3D[] = [];
    const diameter = model?.diameterM || 0.05;
    if (model) {
      const open = object.alternativeObjects.length > 0;
      const mesh = placed(shaded(surfaceOf(model), COLORS[index % COLORS.length], open ? 0.45 : 1), pose);
      this.parts.push({ mesh, index });
      shown.push(mesh, placed(lines(edgeEnds(model), "#10222e"), pose));
    }
    for (const grasp of object.grasps.slice(0, 3)) {
      shown.push(placed(gripperLines(grasp.gripper, diameter), grasp.sceneFromGripper));
    }
    const p = pose.translationM;
    if (object.poseCovariance.length === 36 && p) {
      shown.push(ellipsoid(object.poseCovariance, new Vector3(p.x, p.y, p.z), 0.01 * diameter));
    }
    return shown;
  }

  private camera(camera: Camera, index: number, size: number): Object3D[] {
    if (!camera.recovered || !camera.cameraFromScene || camera.focalPx <= 0) return [];
    const half = (pixels: number) => pixels / 2 / camera.focalPx;
    const drawn = cameraLines(half(camera.imageWidthPx), half(camera.imageHeightPx), 0.25 * size, index === 0 ? "#0072b2" : "#56b4e9");
    drawn.applyMatrix4(matrixOf(camera.cameraFromScene).invert());
    return [drawn];
  }

  // The plane lies below; without one, up is against the cameras' line of sight.
  private upright(world: Group, plane: { normal?: { x: number; y: number; z: number }; offsetM: number } | undefined, box: Box3, size: number) {
    const n = plane?.normal;
    if (!n) {
      const first = this.run!.response.cameras.find((c) => c.cameraFromScene)?.cameraFromScene as RigidTransform | undefined;
      const up = first ? new Vector3(0, -1, -1).normalize().applyMatrix4(matrixOf(first).invert().setPosition(0, 0, 0)) : new Vector3(0, 0, 1);
      world.applyQuaternion(new Quaternion().setFromUnitVectors(up, new Vector3(0, 0, 1)));
      return;
    }
    const normal = new Vector3(n.x, n.y, n.z).normalize();
    const grid = new GridHelper(3 * size, 12, new Color("#767b85"), new Color("#767b85"));
    grid.applyQuaternion(new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), normal));
    const middle = box.isEmpty() ? new Vector3() : box.getCenter(new Vector3());
    grid.position.copy(middle.addScaledVector(normal, plane!.offsetM - normal.dot(middle)));
    world.add(grid);
    world.applyQuaternion(new Quaternion().setFromUnitVectors(normal, new Vector3(0, 0, 1)));
  }

  private mark() {
    for (const { mesh, index } of this.parts) {
      (mesh.material as MeshLambertMaterial).emissive.set(index === this.chosen ? "#5a4a00" : "#000");
    }
    this.orbit.draw();
  }

  private pick(event: PointerEvent) {
    const hit = this.orbit.onUp(event)?.intersectObjects(this.parts.map((p) => p.mesh))[0];
    const found = this.parts.find((p) => p.mesh === hit?.object);
    if (found) this.dispatchEvent(new CustomEvent("chosen", { detail: found.index }));
  }

  render() {
    if (!this.run) return nothing;
    if (this.flat) return html`<p class="quiet">${t.noWebGl}</p>`;
    return html`<div class="view" tabindex="0" role="group" aria-label=${t.label}
        @keydown=${(e: KeyboardEvent) => this.orbit.onKey(e)} @pointerdown=${(e: PointerEvent) => this.orbit.onDown(e)}
        @pointerup=${this.pick} @pointermove=${(e: PointerEvent) => this.orbit.onMove(e)} @wheel=${(e: WheelEvent) => this.orbit.onWheel(e)}>
        <canvas aria-hidden="true"></canvas></div>
      <p class="quiet">${text.parts.turn} ${t.legend}</p>`;
  }
}
