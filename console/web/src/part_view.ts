// One part in three dimensions: surface, sharp edges, grasps, symmetry axes. Without WebGL a drawing of the edges.
import { html, css, LitElement, svg, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { Box3, Group, Mesh, MeshBasicMaterial, Raycaster, SphereGeometry, Vector3 } from "three";
import type { Grasp, Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { Orbit } from "./orbit";
import { edgeEnds, graspOf, lights, lines, quaternionOf, shaded, surfaceOf } from "./shapes";
import { symmetryAxes } from "./resting";
import { shared } from "./style";
import { text } from "./strings";

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
  // x0 y0 z0 .., metres: what tells it from a look-alike.
  @property({ attribute: false }) marks: number[] = [];
  @property({ type: Boolean }) symmetries = false;
  @state() private flat = false;
  private surface?: Mesh;
  private drafted?: Group;
  private orbit = new Orbit();

  disconnectedCallback() {
    super.disconnectedCallback();
    this.orbit.detach();
  }

  updated(changed: Map<string, unknown>) {
    if (["model", "marks", "symmetries"].some((k) => changed.has(k)) && this.model) this.build(this.model);
    else if (changed.has("draft")) this.drawDraft();
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
    this.orbit.draw();
  }

  private drawDraft() {
    const { scene, size } = this.orbit;
    if (this.drafted) scene.remove(this.drafted);
    this.drafted = this.draft && graspOf(this.draft, size, "#cc79a7");
    if (this.drafted) scene.add(this.drafted);
    this.dispatchEvent(new CustomEvent("blocked", { detail: !!this.draft && this.isBlocked(this.draft) }));
    this.orbit.draw();
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

  // Whether a finger's tip or the cup meets the part on its straight way to the grasp.
  private isBlocked(grasp: Grasp): boolean {
    const pose = grasp.objectFromGripper;
    if (!this.surface || !pose?.rotation || !pose.translationM) return false;
    const turn = quaternionOf(pose);
    const back = new Vector3(0, 0, -1).applyQuaternion(turn);
    const origin = new Vector3(pose.translationM.x, pose.translationM.y, pose.translationM.z);
    const half = grasp.gripper.case === "parallelJaw" ? grasp.gripper.value.jawOpeningM / 2 : 0;
    const starts = half
      ? [-half, half].map((x) => origin.clone().add(new Vector3(x, 0, 0).applyQuaternion(turn)))
      : [origin.clone().addScaledVector(back, 1e-4 * this.orbit.size)];
    return starts.some((start) => new Raycaster(start, back).intersectObject(this.surface!).length > 0);
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
        @pointerdown=${(e: PointerEvent) => this.orbit.onDown(e)} @pointerup=${this.pick}
        @pointermove=${(e: PointerEvent) => this.turned(this.orbit.onMove(e))} @wheel=${(e: WheelEvent) => { this.orbit.onWheel(e); this.turned(true); }}>
        ${this.flat ? this.drawing(part) : html`<canvas aria-hidden="true"></canvas>`}
      </div>
      <p class="quiet">${text.parts.turn}</p>
    `;
  }
}
