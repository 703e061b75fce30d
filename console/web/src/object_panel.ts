// One part of an answer: where it is, how sure that is, what it may be instead and what would decide.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { catalog, idOf } from "./api";
import type { LookAlike } from "./gen/horopter/v1/catalog_pb";
import { ObjectAlternative_Kind, type RecognizedObject } from "./gen/horopter/v1/recognition_pb";
import { shared } from "./style";
import { text } from "./strings";

const t = text.try;
const mm = (m: number, digits = 1) => (1000 * m).toFixed(digits);

// Where the part is, in the robot's base or else in the first camera that sees it, and the largest standard deviation.
export function placeOf(object: RecognizedObject) {
  const seen = object.images.findIndex((i) => i.cameraFromObject);
  const based = object.baseFromObject;
  const c = based ? object.basePoseCovariance : (object.images[seen]?.poseCovariance ?? []);
  return {
    frame: based ? t.inBase : seen < 0 ? "" : t.inCamera(seen),
    p: (based ?? object.images[seen]?.cameraFromObject)?.translationM,
    sigma: c.length === 36 ? Math.sqrt(Math.max(c[21], c[28], c[35])) : undefined,
  };
}

@customElement("horopter-object-panel")
export class ObjectPanel extends LitElement {
  static styles = [shared, css`section { border-left: 4px solid var(--accent); padding: 0.25rem 1rem; margin: 0.75rem 0; } dl { display: grid; grid-template-columns: max-content 1fr; gap: 0.2rem 1rem; margin: 0.5rem 0; } dt { color: var(--quiet); } dd { margin: 0; }`];
  @property({ attribute: false }) object?: RecognizedObject;
  @property({ type: Boolean }) busy = false;
  @property({ type: Boolean }) canAsk = true;
  @state() private alike: LookAlike[] = [];

  willUpdate(changed: Map<string, unknown>) {
    if (!changed.has("object") || !this.object) return;
    this.alike = [];
    const asked = this.object;
    if (asked.alternativeObjects.every((a) => a === asked.object)) return;
    catalog.listLookAlikes({ name: asked.object }).then(
      (found) => { if (this.object === asked) this.alike = found.lookAlikes; },
      () => undefined,
    );
  }

  // What a further photograph would have to show.
  private deciding(name: string): string {
    if (name === this.object!.object) return t.decideItself;
    const pair = this.alike.find((a) => a.name === name);
    const corners = pair ? (pair.onlyInNamedM.length + pair.onlyInOtherM.length) / 3 : 0;
    return corners ? t.decideCorners(corners) : t.decideView;
  }

  // Likely enough to be worth a thought, beyond those that the answer names.
  private leftOpen() {
    const told = this.object!.alternatives.filter((a) => a.probability >= 0.02);
    if (!told.length) return nothing;
    return html`<h4>${t.leftOpen}</h4><ul>${told.map((a) => {
      const camera = a.sceneFromCamera?.translationM;
      return html`<li>${t.alternativeKind(ObjectAlternative_Kind[a.kind] ?? "")} ${idOf(a.object)}: ${a.probability.toFixed(2)}${
        camera ? `. ${t.imageFrom([camera.x, camera.y, camera.z].map((v) => mm(v)).join(", "))}` : ""}</li>`;
    })}</ul>`;
  }

  render() {
    const o = this.object;
    if (!o) return nothing;
    const { p, sigma, frame } = placeOf(o);
    return html`<section aria-label=${idOf(o.object)}>
      <h3><a href="#/parts/${idOf(o.object)}">${idOf(o.object)}</a></h3>
      <dl>
        <dt>${t.score}</dt><dd>${o.score.toFixed(3)}</dd>
        <dt>${t.position}</dt><dd>${p ? [p.x, p.y, p.z].map((v) => mm(v)).join(", ") : "–"} ${frame}${sigma === undefined ? "" : ` ± ${mm(sigma, 2)} mm`}</dd>
        <dt>${t.supportIn}</dt><dd>${o.images.map((i) => (i.score === undefined ? "–" : i.score.toFixed(2))).join(", ")}</dd>
        <dt>${t.grasps}</dt><dd>${o.grasps.length
          ? o.grasps.slice(0, 5).map((g) => html`${g.name} (${t.success(g.success.toFixed(2))}) `)
          : t.noGrasp(o.graspCounts?.belowPlane ?? 0, o.graspCounts?.blocked ?? 0, o.graspCounts?.unsure ?? 0, (o.graspCounts?.tooNarrow ?? 0) + (o.graspCounts?.otherGripper ?? 0))}</dd>
      </dl>
      ${o.alternativeObjects.length
        ? html`<h4>${t.alternatives}</h4><ul>${o.alternativeObjects.map((a) => html`<li>${a === o.object ? t.itself : html`<a href="#/parts/${idOf(a)}">${idOf(a)}</a>`}. ${this.deciding(a)}</li>`)}</ul>`
        : html`<p class="quiet">${t.toldFromAll}</p>`}
      ${this.leftOpen()}
      ${this.canAsk ? html`<button ?disabled=${this.busy} @click=${() => this.dispatchEvent(new CustomEvent("explain", { detail: idOf(o.object) }))}>${t.why}</button>` : nothing}
    </section>`;
  }
}
