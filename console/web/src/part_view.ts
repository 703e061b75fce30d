// One part in three dimensions: surface, sharp edges, grasps, symmetry axes. Without WebGL a drawing of the edges.
import { html, css, LitElement, svg, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { Box3, BufferAttribute, BufferGeometry, DoubleSide, Group, Mesh, MeshBasicMaterial, Raycaster, SphereGeometry, Vector3 } from "three";
import { TransformControls } from "three/addons/controls/TransformControls.js";
import type { Grasp, Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { poseOf, withPose } from "./grasp_draft";
import { gripperSolid, inTheWay, place } from "./gripper";
import { Orbit } from "./orbit";
import { edgeEnds, graspOf, lights, lines, shaded, surfaceOf } from "./shapes";
import { symmetryAxes } from "./resting";
import { shared } from "./style";
import { text } from "./strings";

export type Gizmo = "translate" | "rotate";
// What the mesh says of a draft: triangles that are in the gripper's way, and the width between open fingers (undefined: nothing).
export interface Checked { met: number; widthM?: number }

@customElement("horopter-part-view")
export class PartView extends LitElement {
  static styles = [
    shared,
    css`
      .view { width: 100%; aspect-ratio: 4 / 3; max-height: 60vh; border: 1px solid var(--line); border-radius: 8px; overflow: hidden; touch-action: none; background: var(--raised); }
      canvas, svg { width: 100%; height: 100%; display: block; }
      line { stroke: var(--text); vector-effect: non-scaling-stroke; }
    `,
  ];
  @property({ attribute: false }) model?: Part;
  // A grasp that is not saved yet, drawn beside the others.
  @property({ attribute: false }) draft?: Grasp;
  // By which it is moved or turned with the pointer.
  @property() gizmo: Gizmo = "translate";
  // x0 y0 z0 .., metres: what tells it from a look-alike.
  @property({ attribute: false }) marks: number[] = [];
  @property({ type: Boolean }) symmetries = false;
  @state() private flat = false;
  private surface?: Mesh;
  private drafted?: Group;
  private collision?: Mesh;
  private controls?: TransformControls;
  private orbit = new Orbit();

  disconnectedCallback() {
    super.disconnectedCallback();
    this.controls?.dispose();
    this.controls = undefined;
    this.orbit.detach();
  }

  updated(changed: Map<string, unknown>) {
    if (["model", "marks", "symmetries"].some((k) => changed.has(k)) && this.model) this.build(this.model);
    else if (changed.has("draft") || changed.has("gizmo")) this.drawDraft();
  }

  lookFrom(side: Vector3) {
    this.orbit.lookFrom(side);
    if (this.flat) this.requestUpdate();
  }

  private build(part: Part) {
    const canvas = this.renderRoot.querySelector("canvas");
    if (!canvas) return;
    if (!this.orbit.attach(canvas)) {
      this.flat = true;
      return;
    }
    const { scene, center } = this.orbit;
    scene.clear();
    this.surface = shaded(surfaceOf(part));
    const box = new Box3().setFromObject(this.surface);
    box.getCenter(center);
    const size = box.getSize(new Vector3()).length() || 1;
    this.orbit.size = size;
    scene.add(this.surface, lines(edgeEnds(part), "#10222e"), ...lights(), ...part.grasps.map((g) => graspOf(g, size)));
    for (let i = 0; i + 2 < this.marks.length; i += 3) {
      const mark = new Mesh(new SphereGeometry(0.02 * size, 12, 8), new MeshBasicMaterial({ color: "#d55e00" }));
      mark.position.set(this.marks[i], this.marks[i + 1], this.marks[i + 2]);
      scene.add(mark);
    }
    if (this.symmetries) {
      for (const { point, axis } of symmetryAxes(part)) {
        const ends = [-0.7, 0.7].flatMap((s) => point.clone().addScaledVector(axis, s * size).toArray());
        scene.add(lines(ends, "#cc79a7"));
      }
    }
    this.drafted = this.collision = undefined;
    this.drawDraft();
  }

  private drawDraft() {
    const { scene } = this.orbit;
    if (!this.surface) return;
    const drag = this.controls?.dragging;
    const met = this.draft ? inTheWay(this.surface.geometry.getAttribute("position").array, this.draft) : [];
    if (this.collision) scene.remove(this.collision);
    this.collision = met.length ? this.marked(met) : undefined;
    if (this.collision) scene.add(this.collision);
    // What the pointer holds is moved, not made anew.
    if (drag && this.drafted && this.draft) place(this.drafted, this.draft);
    else this.replaceDraft(met.length > 0);
    if (this.draft) this.dispatchEvent(new CustomEvent<Checked>("checked", { detail: { met: met.length, widthM: this.widthBetween(this.draft) } }));
    this.orbit.draw();
  }

  private replaceDraft(blocked: boolean) {
    const { scene } = this.orbit;
    this.controls?.detach();
    if (this.drafted) scene.remove(this.drafted);
    this.drafted = this.draft && gripperSolid(this.draft, blocked ? "#d55e00" : "#0072b2");
    if (!this.drafted) return;
    scene.add(this.drafted);
    const controls = this.gizmoOf();
    if (!scene.children.includes(controls.getHelper())) scene.add(controls.getHelper());
    controls.setMode(this.gizmo);
    controls.attach(this.drafted);
  }

  private gizmoOf(): TransformControls {
    if (this.controls) return this.controls;
    const controls = new TransformControls(this.orbit.camera, this.renderRoot.querySelector("canvas"));
    controls.setSpace("local");
    controls.addEventListener("change", () => this.orbit.draw());
    controls.addEventListener("objectChange", () => {
      if (!this.drafted || !this.draft) return;
      this.dispatchEvent(new CustomEvent("moved", { detail: withPose(this.draft, this.drafted.position.clone(), this.drafted.quaternion) }));
    });
    // Colour and width are those of where it was let go.
    controls.addEventListener("mouseUp", () => queueMicrotask(() => this.drawDraft()));
    this.controls = controls;
    return controls;
  }

  // Triangles of the surface, seen through everything.
  private marked(triangles: number[]): Mesh {
    const all = this.surface!.geometry.getAttribute("position").array;
    const corners = new Float32Array(9 * triangles.length);
    triangles.forEach((t, i) => corners.set(all.slice(9 * t, 9 * t + 9), 9 * i));
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(corners, 3));
    const mesh = new Mesh(geometry, new MeshBasicMaterial({ color: "#d55e00", side: DoubleSide, transparent: true, opacity: 0.55, depthTest: false }));
    mesh.renderOrder = 2;
    return mesh;
  }

  // Of the part between open fingers, along the closing direction.
  private widthBetween(grasp: Grasp): number | undefined {
    if (grasp.gripper.case !== "parallelJaw") return undefined;
    const { position, rotation } = poseOf(grasp);
    const x = new Vector3(1, 0, 0).applyQuaternion(rotation);
    const half = grasp.gripper.value.jawOpeningM / 2;
    const hits = [-1, 1].map((s) => new Raycaster(position.clone().addScaledVector(x, s * half), x.clone().multiplyScalar(-s), 0, 2 * half).intersectObject(this.surface!)[0]?.distance);
    return hits[0] === undefined || hits[1] === undefined ? undefined : Math.max(0, 2 * half - hits[0] - hits[1]);
  }

  // A click, not a drag: the point of the surface there, its outward normal and how thick the part is below it.
  private pick(event: PointerEvent) {
    const ray = this.orbit.onUp(event);
    const hit = this.surface && ray?.intersectObject(this.surface)[0];
    if (!hit?.face) return;
    const size = this.orbit.size;
    const normal = hit.face.normal.clone();
    if (normal.dot(ray!.ray.direction) > 0) normal.negate();
    const inside = new Raycaster(hit.point.clone().addScaledVector(normal, -1e-4 * size), normal.clone().negate());
    const thickness = (inside.intersectObject(this.surface!)[0]?.distance ?? 0) + 1e-4 * size;
    const approach = this.shortestWayIn(hit.point.clone().addScaledVector(normal, -thickness / 2), normal);
    this.dispatchEvent(new CustomEvent("picked", { detail: { point: hit.point, normal, thickness, approach } }));
  }

  // Across the normal, where the least of the part is in the way of a palm.
  private shortestWayIn(origin: Vector3, normal: Vector3): Vector3 {
    const first = Math.abs(normal.z) < 0.9 ? new Vector3(0, 0, -1) : new Vector3(1, 0, 0);
    first.addScaledVector(normal, -first.dot(normal)).normalize();
    let best = first;
    let least = Infinity;
    for (let i = 0; i < 24; ++i) {
      const into = first.clone().applyAxisAngle(normal, (i * Math.PI) / 12);
      const out = new Raycaster(origin, into.clone().negate()).intersectObject(this.surface!).pop()?.distance ?? 0;
      if (out < least - 1e-6) [best, least] = [into, out];
    }
    return best;
  }

  // Orthographic, from where the camera is.
  private drawing(part: Part) {
    const ends = edgeEnds(part);
    const { azimuth, height } = this.orbit;
    const [sa, ca, sh, ch] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(height), Math.cos(height)];
    const points: [number, number][] = [];
    for (let i = 0; i + 2 < ends.length; i += 3) {
      const [x, y, z] = ends.slice(i, i + 3);
      points.push([-sa * x + ca * y, -(-sh * ca * x - sh * sa * y + ch * z)]);
    }
    const xs = points.map((p) => p[0]);
    const ys = points.map((p) => p[1]);
    const min = (v: number[]) => v.reduce((a, b) => Math.min(a, b), Infinity);
    const max = (v: number[]) => v.reduce((a, b) => Math.max(a, b), -Infinity);
    const margin = 0.05 * (part.diameterM || 1);
    const box = [min(xs) - margin, min(ys) - margin, max(xs) - min(xs) + 2 * margin, max(ys) - min(ys) + 2 * margin];
    return html`<svg viewBox=${box.join(" ")} role="img" aria-label=${text.parts.view(part.name)}>
      ${points.filter((_, i) => i % 2 === 0).map((a, i) => svg`<line x1=${a[0]} y1=${a[1]} x2=${points[2 * i + 1][0]} y2=${points[2 * i + 1][1]} />`)}
    </svg>`;
  }

  private turned(did: boolean) {
    if (did && this.flat) this.requestUpdate();
  }

  render() {
    const part = this.model;
    if (!part) return nothing;
    return html`
      ${this.flat ? html`<p class="quiet">${text.parts.noWebGl}</p>` : nothing}
      <div class="view" tabindex="0" role="group" aria-label=${text.parts.view(part.name)} @keydown=${(e: KeyboardEvent) => this.turned(this.orbit.onKey(e))}
        @pointerdown=${(e: PointerEvent) => { if (!this.controls?.dragging) this.orbit.onDown(e); }} @pointerup=${this.pick}
        @pointermove=${(e: PointerEvent) => { if (!this.controls?.dragging) this.turned(this.orbit.onMove(e)); }} @wheel=${(e: WheelEvent) => { this.orbit.onWheel(e); this.turned(true); }}>
        ${this.flat ? this.drawing(part) : html`<canvas aria-hidden="true"></canvas>`}
      </div>
      <p class="quiet">${text.parts.turn}</p>
    `;
  }
}
