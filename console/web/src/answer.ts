// One answer: photographs with the parts over them, the scene, scores, what is open, why a part is (not) there.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { idOf } from "./api";
import type { Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { Completeness, type Explanation } from "./gen/horopter/v1/recognition_pb";
import { placeOf } from "./object_panel";
import type { Run } from "./run";
import { shared } from "./style";
import { text } from "./strings";
import "./object_panel";
import "./picture";
import "./scene_view";

const t = text.try;
const mm = (m: number, digits = 1) => (1000 * m).toFixed(digits);

@customElement("horopter-answer")
export class Answer extends LitElement {
  static styles = [
    shared,
    css`
      .images { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(26rem, 100%), 1fr)); gap: 0.75rem; }
      tr.chosen td { background: var(--raised); }
      td button { min-height: 0; padding: 0.1rem 0.5rem; }
    `,
  ];
  @property({ attribute: false }) run?: Run;
  @property({ attribute: false }) parts?: Part[];
  @property({ type: Boolean }) busy = false;
  @property({ type: Boolean }) canAsk = true;
  // Of "nothing found": what was nearest to an answer.
  @property({ attribute: false }) refused?: Explanation[];
  @property({ attribute: false }) refusing = "";
  @state() private whyNot = "";
  @state() private chosen = -1;
  @state() private inSpace = false;

  willUpdate(changed: Map<string, unknown>) {
    if (changed.has("run")) this.chosen = -1;
  }

  render() {
    if (!this.run) return nothing;
    const { response, photos, title, seconds } = this.run;
    const found = response.objects.length;
    const choose = (e: CustomEvent<number>) => (this.chosen = e.detail);
    return html`
      <h3>${title}: ${found ? t.found(found) : t.nothing} (${seconds.toFixed(1)} s)</h3>
      <div class="images">${photos.map((_, i) => html`<horopter-picture .run=${this.run} .index=${i} .chosen=${this.chosen} @chosen=${choose}></horopter-picture>`)}</div>
      ${response.explanation ? html`<p class="quiet">${t.legend}</p>` : nothing}
      ${found ? html`${this.objects()}
        <horopter-object-panel .object=${response.objects[this.chosen]} .busy=${this.busy} .canAsk=${this.canAsk}
          @explain=${(e: CustomEvent<string>) => this.explain(e.detail)}></horopter-object-panel>
        <details @toggle=${(e: Event) => (this.inSpace = (e.target as HTMLDetailsElement).open)}><summary>${text.scene.title}</summary>
          ${this.inSpace ? html`<horopter-scene-view .run=${this.run} .chosen=${this.chosen} @chosen=${choose}></horopter-scene-view>` : nothing}</details>`
        : this.nothingFound()}
      ${this.open()}
      ${response.explanation ? this.explanation(response.explanation) : nothing}
      ${this.canAsk ? this.question() : nothing}
      ${this.stages()}
    `;
  }

  private objects() {
    return html`<table>
      <thead><tr><th scope="col">${t.part}</th><th scope="col" class="number">${t.score}</th><th scope="col">${t.position}</th>
        <th scope="col" class="number">${t.sigma}</th><th scope="col" class="number">${t.grasps}</th><th scope="col">${t.alternatives}</th></tr></thead>
      <tbody>${this.run!.response.objects.map((o, i) => {
        const { p, sigma, frame } = placeOf(o);
        return html`<tr class=${i === this.chosen ? "chosen" : ""}>
          <td><button aria-pressed=${i === this.chosen} @click=${() => (this.chosen = i)}>${idOf(o.object)}</button></td><td class="number">${o.score.toFixed(2)}</td>
          <td>${p ? [p.x, p.y, p.z].map((v) => mm(v)).join(", ") : "–"} <span class="quiet">${frame}</span></td>
          <td class="number">${sigma === undefined ? "–" : mm(sigma)}</td>
          <td class="number">${o.grasps.length}</td>
          <td>${o.alternativeObjects.map((a) => (a === o.object ? t.itself : idOf(a))).join(", ")}</td></tr>`;
      })}</tbody></table>`;
  }

  private nothingFound() {
    return html`
      ${this.canAsk ? html`<p><button class="main" ?disabled=${this.busy} @click=${() => this.dispatchEvent(new CustomEvent("why-nothing"))}>${t.whyNothing}</button>
        <span role="status" class="quiet">${this.refusing}</span></p>` : nothing}
      ${this.refused?.length
        ? html`<table><caption class="hidden">${t.whyNothing}</caption><thead><tr><th scope="col">${t.part}</th><th scope="col">${t.refusedBy}</th><th scope="col" class="number">${t.measuredOf}</th><th scope="col">${t.detail}</th></tr></thead>
          <tbody>${this.refused.map((e) => html`<tr><td><button @click=${() => this.explain(idOf(e.object))} ?disabled=${this.busy}>${idOf(e.object)}</button></td>
            <td>${e.failedTest === 0 ? t.answered : (text.tests[e.failedTest] ?? "")}</td>
            <td class="number">${e.needed ? `${e.value.toFixed(2)} / ${e.needed.toFixed(2)}` : "–"}</td><td class="quiet">${e.detail}</td></tr>`)}</tbody></table>`
        : nothing}`;
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
      </div>`;
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
