// What a camera sees of a part that lies on a plane: small pictures, made by one renderer.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { Box3, Group, PerspectiveCamera, Quaternion, Scene, Vector3, WebGLRenderer } from "three";
import type { Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { restingPoses, type RestingPose } from "./resting";
import { edgeEnds, lights, lines, shaded, surfaceOf } from "./shapes";
import { shared } from "./style";
import { text } from "./strings";

const t = text.parts;
const WIDTH = 200;
const HEIGHT = 150;
const UP = new Vector3(0, 0, 1);

function pictures(part: Part, poses: RestingPose[]): string[] {
  const renderer = new WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
  renderer.setSize(WIDTH, HEIGHT, false);
  const camera = new PerspectiveCamera(35, WIDTH / HEIGHT, 0.001, 1000);
  camera.up.copy(UP);
  const taken = poses.map(({ down }) => {
    const scene = new Scene();
    const lying = new Group();
    lying.add(shaded(surfaceOf(part)), lines(edgeEnds(part), "#10222e"));
    lying.applyQuaternion(new Quaternion().setFromUnitVectors(down, UP.clone().negate()));
    scene.add(lying, ...lights());
    const box = new Box3().setFromObject(lying);
    const centre = box.getCenter(new Vector3());
    const away = 1.9 * (box.getSize(new Vector3()).length() || 1);
    camera.near = 0.01 * away;
    camera.far = 10 * away;
    camera.position.set(centre.x + 0.6 * away, centre.y + 0.35 * away, centre.z + 0.7 * away);
    camera.lookAt(centre);
    camera.updateProjectionMatrix();
    renderer.render(scene, camera);
    return renderer.domElement.toDataURL("image/png");
  });
  renderer.dispose();
  renderer.forceContextLoss();
  return taken;
}

@customElement("horopter-thumbnails")
export class Thumbnails extends LitElement {
  static styles = [shared, css`ul { display: flex; flex-wrap: wrap; gap: 0.5rem; list-style: none; padding: 0; margin: 0.5rem 0; } figure { margin: 0; } img { border: 1px solid var(--line); border-radius: 6px; background: var(--raised); width: 11rem; } figcaption { color: var(--quiet); font-size: 0.85rem; }`];
  @property({ attribute: false }) model?: Part;
  @state() private poses: RestingPose[] = [];
  @state() private urls: string[] = [];

  willUpdate(changed: Map<string, unknown>) {
    if (!changed.has("model") || !this.model) return;
    this.poses = restingPoses(this.model);
    try {
      this.urls = pictures(this.model, this.poses);
    } catch {
      this.urls = [];  // no WebGL
    }
  }

  render() {
    if (this.poses.length === 0) return nothing;
    return html`<h2>${t.resting}</h2><p class="quiet">${t.restingWhy}</p><ul>${this.poses.map((pose, i) => html`<li><figure>
      ${this.urls[i] ? html`<img src=${this.urls[i]} alt=${t.restingPose(i + 1)} />` : nothing}
      <figcaption>${t.restingPose(i + 1)}: ${t.restingShare(Math.round(100 * pose.share))}</figcaption></figure></li>`)}</ul>`;
  }
}
