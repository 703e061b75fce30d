// One part in three dimensions: surface, sharp edges, grasps. Without WebGL a drawing of the edges.
import { html, css, LitElement, svg, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import {
  AmbientLight, BufferAttribute, BufferGeometry, DirectionalLight, DoubleSide, Group, LineBasicMaterial, LineSegments, Mesh,
  MeshLambertMaterial, PerspectiveCamera, Quaternion, Raycaster, Scene, Vector2, Vector3, WebGLRenderer,
} from "three";
import type { Grasp, Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { text } from "./strings";
import { shared } from "./style";

const STEP_RAD = 0.2;

// Ends of the edges' pieces, metres, one after the other.
export function edgeEnds(part: Part): number[] {
  const ends: number[] = [];
  for (const edge of part.edges) {
    const line = edge.polylineM;
    for (let i = 3; i + 2 < line.length; i += 3) ends.push(...line.slice(i - 3, i + 3));
  }
  return ends;
}

function lines(ends: number[], color: string) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(ends), 3));
  return new LineSegments(geometry, new LineBasicMaterial({ color }));
}

// Fingers or the cup as lines in the gripper's frame, whose z points to the part.
function gripper(grasp: Grasp, size: number, color = "#d55e00"): Group {
  const group = new Group();
  const ends: number[] = [];
  const add = (a: number[], b: number[]) => ends.push(...a, ...b);
  const back = -0.35 * size;
  if (grasp.gripper.case === "suction") {
    const r = grasp.gripper.value.cupRadiusM;
    for (let i = 0; i < 24; ++i) {
      const a = (i * Math.PI) / 12;
      const b = ((i + 1) * Math.PI) / 12;
      add([r * Math.cos(a), r * Math.sin(a), 0], [r * Math.cos(b), r * Math.sin(b), 0]);
    }
    add([0, 0, 0], [0, 0, back]);
  } else if (grasp.gripper.case === "parallelJaw") {
    const x = 0.5 * grasp.gripper.value.jawOpeningM;
    add([-x, 0, 0], [-x, 0, back / 2]);
    add([x, 0, 0], [x, 0, back / 2]);
    add([-x, 0, back / 2], [x, 0, back / 2]);
    add([0, 0, back / 2], [0, 0, back]);
  }
  const drawn = lines(ends, color);
  drawn.material.depthTest = false;  // seen through the part
  drawn.renderOrder = 1;
  group.add(drawn);
  const pose = grasp.objectFromGripper;
  if (pose?.rotation) group.quaternion.copy(new Quaternion(pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.rotation.w));
  if (pose?.translationM) group.position.set(pose.translationM.x, pose.translationM.y, pose.translationM.z);
  return group;
}

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
  @state() private flat = false;
  private renderer?: WebGLRenderer;
  private surface?: Mesh;
  private drafted?: Group;
  private pressed?: { x: number; y: number };
  private scene = new Scene();
  private camera = new PerspectiveCamera(35, 4 / 3, 0.001, 100);
  private center = new Vector3();
  private size = 1;
  private azimuth = 0.8;
  private height = 0.6;
  private distance = 2.2;
  private watcher = new ResizeObserver(() => this.draw());

  disconnectedCallback() {
    super.disconnectedCallback();
    this.watcher.disconnect();
    this.renderer?.dispose();
    this.renderer = undefined;
  }

  updated(changed: Map<string, unknown>) {
    if (changed.has("model") && this.model) this.build(this.model);
    else if (changed.has("draft")) this.drawDraft();
  }

  private build(part: Part) {
    const canvas = this.renderRoot.querySelector("canvas");
    if (!canvas) return;
    try {
      this.renderer ??= new WebGLRenderer({ canvas, antialias: true, alpha: true });
    } catch {
      this.flat = true;
      return;
    }
    this.scene.clear();
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(part.mesh?.verticesM ?? []), 3));
    geometry.setIndex(new BufferAttribute(new Uint32Array(part.mesh?.triangles ?? []), 1));
    const faceted = geometry.toNonIndexed();
    faceted.computeVertexNormals();
    faceted.computeBoundingBox();
    faceted.boundingBox!.getCenter(this.center);
    this.size = faceted.boundingBox!.getSize(new Vector3()).length() || 1;
    const surface = new MeshLambertMaterial({ color: "#9fb4c7", side: DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
    this.surface = new Mesh(faceted, surface);
    this.scene.add(this.surface, lines(edgeEnds(part), "#10222e"), new AmbientLight("#fff", 1.2));
    const light = new DirectionalLight("#fff", 2);
    light.position.set(1, 2, 3);
    this.scene.add(light, ...part.grasps.map((g) => gripper(g, this.size)));
    this.watcher.observe(canvas);
    this.draw();
  }

  private drawDraft() {
    if (this.drafted) this.scene.remove(this.drafted);
    this.drafted = this.draft && gripper(this.draft, this.size, "#cc79a7");
    if (this.drafted) this.scene.add(this.drafted);
    this.dispatchEvent(new CustomEvent("blocked", { detail: !!this.draft && this.isBlocked(this.draft) }));
    this.draw();
  }

  // A click, not a drag: the point of the surface there, its outward normal and how thick the part is below it.
  private pick(event: PointerEvent) {
    const from = this.pressed;
    this.pressed = undefined;
    if (!this.surface || !from || Math.hypot(event.clientX - from.x, event.clientY - from.y) > 4) return;
    const box = (event.currentTarget as Element).getBoundingClientRect();
    const at = new Vector2((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
    const ray = new Raycaster();
    this.camera.updateMatrixWorld();
    ray.setFromCamera(at, this.camera);
    const hit = ray.intersectObject(this.surface)[0];
    if (!hit?.face) return;
    const normal = hit.face.normal.clone();
    if (normal.dot(ray.ray.direction) > 0) normal.negate();
    const inside = new Raycaster(hit.point.clone().addScaledVector(normal, -1e-4 * this.size), normal.clone().negate());
    const thickness = (inside.intersectObject(this.surface)[0]?.distance ?? 0) + 1e-4 * this.size;
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
    const turn = new Quaternion(pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.rotation.w);
    const back = new Vector3(0, 0, -1).applyQuaternion(turn);
    const origin = new Vector3(pose.translationM.x, pose.translationM.y, pose.translationM.z);
    const half = grasp.gripper.case === "parallelJaw" ? grasp.gripper.value.jawOpeningM / 2 : 0;
    const starts = half
      ? [-half, half].map((x) => origin.clone().add(new Vector3(x, 0, 0).applyQuaternion(turn)))
      : [origin.clone().addScaledVector(back, 1e-4 * this.size)];
    return starts.some((start) => new Raycaster(start, back).intersectObject(this.surface!).length > 0);
  }

  private draw() {
    const canvas = this.renderer?.domElement;
    if (!canvas || !this.renderer || canvas.clientWidth === 0) return;
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this.renderer.setSize(canvas.clientWidth, canvas.clientHeight, false);
    this.camera.aspect = canvas.clientWidth / canvas.clientHeight;
    this.camera.near = 0.01 * this.size;
    this.camera.far = 100 * this.size;
    const away = this.distance * this.size;
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(
      this.center.x + away * Math.cos(this.height) * Math.cos(this.azimuth),
      this.center.y + away * Math.cos(this.height) * Math.sin(this.azimuth),
      this.center.z + away * Math.sin(this.height),
    );
    this.camera.lookAt(this.center);
    this.camera.updateProjectionMatrix();
    this.renderer.render(this.scene, this.camera);
  }

  private turn(azimuth: number, height: number, zoom = 1) {
    this.azimuth += azimuth;
    this.height = Math.max(-1.5, Math.min(1.5, this.height + height));
    this.distance = Math.max(0.5, Math.min(20, this.distance * zoom));
    this.draw();
    if (this.flat) this.requestUpdate();
  }

  private onKey(event: KeyboardEvent) {
    const turns: Record<string, [number, number, number]> = {
      ArrowLeft: [-STEP_RAD, 0, 1], ArrowRight: [STEP_RAD, 0, 1], ArrowUp: [0, STEP_RAD, 1], ArrowDown: [0, -STEP_RAD, 1],
      "+": [0, 0, 0.85], "-": [0, 0, 1.18],
    };
    const found = turns[event.key];
    if (!found) return;
    event.preventDefault();
    this.turn(...found);
  }

  // Orthographic, from where the camera is.
  private drawing(part: Part) {
    const ends = edgeEnds(part);
    const [sa, ca, sh, ch] = [Math.sin(this.azimuth), Math.cos(this.azimuth), Math.sin(this.height), Math.cos(this.height)];
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

  render() {
    const part = this.model;
    if (!part) return nothing;
    return html`
      ${this.flat ? html`<p class="quiet">${text.parts.noWebGl}</p>` : nothing}
      <div class="view" tabindex="0" role="group" aria-label=${text.parts.view(part.name)} @keydown=${this.onKey}
        @pointerdown=${(e: PointerEvent) => { (e.currentTarget as Element).setPointerCapture(e.pointerId); this.pressed = { x: e.clientX, y: e.clientY }; }}
        @pointerup=${this.pick}
        @pointermove=${(e: PointerEvent) => e.buttons && this.turn(-0.01 * e.movementX, 0.01 * e.movementY)}
        @wheel=${(e: WheelEvent) => { e.preventDefault(); this.turn(0, 0, e.deltaY > 0 ? 1.1 : 0.9); }}>
        ${this.flat ? this.drawing(part) : html`<canvas aria-hidden="true"></canvas>`}
      </div>
      <p class="quiet">${text.parts.turn}</p>
    `;
  }
}
