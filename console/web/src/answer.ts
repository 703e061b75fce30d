// One answer: the server's drawing over each photograph, parts with scores, what is open, why a part is (not) there.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { idOf } from "./api";
import type { Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { Completeness, type Explanation, type RecognizedObject } from "./gen/horopter/v1/recognition_pb";
import { shared } from "./style";
import { text } from "./strings";
import type { Run } from "./try";

const t = text.try;
const mm = (m: number, digits = 1) => (1000 * m).toFixed(digits);

// Where the part is, in the robot's base or else in the first camera that sees it, and the largest standard deviation.
function placeOf(object: RecognizedObject) {
  const seen = object.images.findIndex((i) => i.cameraFromObject);
  const based = object.baseFromObject;
  const c = based ? object.basePoseCovariance : (object.images[seen]?.poseCovariance ?? []);
  return {
    frame: based ? t.inBase : seen < 0 ? "" : t.inCamera(seen),
    p: (based ?? object.images[seen]?.cameraFromObject)?.translationM,
    sigma: c.length === 36 ? Math.sqrt(Math.max(c[21], c[28], c[35])) : undefined,
  };
}

@customElement("horopter-answer")
export class Answer extends LitElement {
  static styles = [
    shared,
    css`
      .images { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(26rem, 100%), 1fr)); gap: 0.75rem; }
      figure { margin: 0; }
      .layers { position: relative; }
      .layers img { width: 100%; display: block; border-radius: 6px; }
      .layers img + img { position: absolute; inset: 0; height: 100%; }
      figcaption { color: var(--quiet); font-size: 0.9rem; }
    `,
  ];
  @property({ attribute: false }) run?: Run;
  @property({ attribute: false }) parts?: Part[];
  @property({ type: Boolean }) busy = false;
  @state() private whyNot = "";

  render() {
    if (!this.run) return nothing;
    const { response, photos, drawings, number, seconds } = this.run;
    const found = response.objects.length;
    return html`
      <h3>${t.run_n(number)}: ${found ? t.found(found) : t.nothing} (${seconds.toFixed(1)} s)</h3>
      <div class="images">${photos.map((photo, i) => html`<figure>
        <div class="layers"><img src=${photo.url} alt=${t.photo(i)} />${drawings[i] ? html`<img class="drawing" src=${drawings[i]} alt="" />` : nothing}</div>
        <figcaption>${t.photo(i)} · ${t.focal}: ${response.cameras[i]?.recovered ? response.cameras[i].focalPx.toFixed(0) : t.notRecovered}</figcaption>
      </figure>`)}</div>
      ${found ? this.objects() : nothing}
      ${this.open()}
      ${response.explanation ? this.explanation(response.explanation) : nothing}
      ${this.question()}
      ${this.stages()}
    `;
  }

  private objects() {
    return html`<table>
      <thead><tr><th scope="col">${t.part}</th><th scope="col" class="number">${t.score}</th><th scope="col">${t.position}</th>
        <th scope="col" class="number">${t.sigma}</th><th scope="col" class="number">${t.grasps}</th><th scope="col">${t.alternatives}</th><th scope="col">${t.reason}</th></tr></thead>
      <tbody>${this.run!.response.objects.map((o) => {
        const { p, sigma, frame } = placeOf(o);
        return html`<tr><td><a href="#/parts/${idOf(o.object)}">${idOf(o.object)}</a></td><td class="number">${o.score.toFixed(2)}</td>
          <td>${p ? [p.x, p.y, p.z].map((v) => mm(v)).join(", ") : "–"} <span class="quiet">${frame}</span></td>
          <td class="number">${sigma === undefined ? "–" : mm(sigma)}</td>
          <td class="number">${o.grasps.length}</td>
          <td>${o.alternativeObjects.map((a) => (a === o.object ? t.itself : idOf(a))).join(", ")}</td>
          <td><button ?disabled=${this.busy} @click=${() => this.explain(idOf(o.object))}>${t.why}</button></td></tr>`;
      })}</tbody></table>`;
  }

  private open() {
    const { reasons, findings, completeness } = this.run!.response;
    return html`
      ${completeness === Completeness.TIME_LIMITED ? html`<p class="error">${t.timeLimited}</p>` : nothing}
      ${reasons.length ? html`<h4>${t.reasons}</h4><ul>${reasons.map((r) => html`<li>${text.reasons[r.kind] ?? ""} <span class="quiet">${r.detail}</span></li>`)}</ul>` : nothing}
      ${findings.length ? html`<h4>${t.findings}</h4><ul>${findings.map((f) => html`<li>${f.object ? idOf(f.object) + ": " : ""}${f.detail}</li>`)}</ul>` : nothing}
    `;
  }

  private explanation(e: Explanation) {
    const failed = e.failedTest !== 0;
    return html`<h4>${failed ? t.whyAbsent : t.whyThere} ${idOf(e.object)}</h4>
      <div class=${failed ? "error" : "good"}>
        ${failed ? (text.tests[e.failedTest] ?? "") : t.answered}
        ${failed && e.needed ? html` (${t.measured(e.value.toFixed(2), e.needed.toFixed(2))})` : nothing}
        ${e.otherObject ? html`<br />${t.hasItsPlace}${idOf(e.otherObject)}` : nothing}
        ${e.detail ? html`<br /><span class="quiet">${e.detail}</span>` : nothing}
      </div>
      <p class="quiet">${t.legend}</p>`;
  }

  private question() {
    return html`<div class="row"><label>${t.whyNot}
        <select @change=${(e: Event) => (this.whyNot = (e.target as HTMLSelectElement).value)}>
          <option value=""></option>${this.parts?.map((p) => html`<option>${idOf(p.name)}</option>`)}
        </select></label>
      <button ?disabled=${!this.whyNot || this.busy} @click=${() => this.explain(this.whyNot)}>${t.explain}</button></div>`;
  }

  private stages() {
    return html`<details><summary>${t.stages}</summary><table><tbody>${this.run!.response.stages.map((s) => html`<tr><th scope="row">${s.stage}</th>
      <td class="number">${(1000 * Number(s.elapsed?.seconds ?? 0) + (s.elapsed?.nanos ?? 0) / 1e6).toFixed(0)}</td></tr>`)}</tbody></table></details>`;
  }

  private explain(id: string) {
    this.dispatchEvent(new CustomEvent("explain", { detail: id }));
  }
}
