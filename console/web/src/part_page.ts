// One part: its geometry, grasps, look-alikes; its name is changed by etag.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { catalog, Code, isCode, said } from "./api";
import { ObjectView, type ListLookAlikesResponse, type Grasp, type Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { draftGrasp, type Kind, type Picked } from "./grasp_draft";
import { shared } from "./style";
import { text } from "./strings";
import { forgetModel } from "./models";
import "./look_alikes";
import "./part_labels";
import "./part_view";
import "./thumbnails";
import { symmetryAxes } from "./resting";

const t = text.parts;
const mm = (m: number) => (1000 * m).toFixed(1);

@customElement("horopter-part-page")
export class PartPage extends LitElement {
  static styles = [shared, css`.two { display: grid; grid-template-columns: minmax(20rem, 3fr) minmax(18rem, 2fr); gap: 0 2rem; } @media (max-width: 800px) { .two { grid-template-columns: 1fr; } }`];
  @property() partId = "";
  @state() private model?: Part;
  @state() private alike?: ListLookAlikesResponse;
  @state() private name = "";
  @state() private theirs?: Part;
  @state() private error = "";
  @state() private done = "";
  @state() private sure = false;
  @state() private kind?: Kind;
  @state() private picked?: Picked;
  @state() private turned = 0;
  @state() private blocked = false;
  @state() private graspName = "";
  @state() private radiusMm = 10;
  @state() private axes = false;
  private draft?: Grasp;

  willUpdate(changed: Map<string, unknown>) {
    if (changed.has("partId")) this.load();
    if (["kind", "picked", "turned", "graspName", "radiusMm"].some((k) => changed.has(k))) this.draft = this.makeDraft();
  }

  private async load() {
    this.model = this.alike = this.theirs = this.kind = this.picked = undefined;
    this.error = this.done = "";
    const name = `objects/${this.partId}`;
    forgetModel(name);
    try {
      this.model = await catalog.getObject({ name, view: ObjectView.GEOMETRY });
      this.name = this.model.displayName;
      this.alike = await catalog.listLookAlikes({ name });
    } catch (error) {
      this.error = said(error);
    }
  }

  private async save(ifMatch: string) {
    this.error = this.done = "";
    const name = `objects/${this.partId}`;
    try {
      const saved = await catalog.updateObject({
        object: { name, displayName: this.name },
        updateMask: { paths: ["display_name"] },
        ifMatch,
      });
      this.model!.etag = saved.etag;
      this.model!.displayName = saved.displayName;
      this.theirs = undefined;
      this.done = t.saved;
      this.dispatchEvent(new CustomEvent("changed"));
    } catch (error) {
      if (isCode(error, Code.Aborted)) this.theirs = await catalog.getObject({ name, view: ObjectView.BASIC });
      else this.error = said(error);
    }
  }

  private makeDraft(): Grasp | undefined {
    if (!this.kind || !this.picked) return undefined;
    return draftGrasp(this.kind, this.picked, this.turned, this.graspName, this.radiusMm / 1000);
  }

  // All grasps of the part, while nobody else has changed it.
  private async saveGrasps(grasps: Grasp[]) {
    this.error = "";
    try {
      await catalog.updateObject({
        object: { name: `objects/${this.partId}`, grasps },
        updateMask: { paths: ["grasps"] },
        ifMatch: this.model!.etag,
      });
      this.dispatchEvent(new CustomEvent("changed"));
      await this.load();
    } catch (error) {
      this.error = isCode(error, Code.Aborted) ? `${t.conflict} ${t.again}` : said(error);
    }
  }

  private async erase() {
    try {
      await catalog.deleteObject({ name: `objects/${this.partId}`, ifMatch: this.model!.etag });
      this.dispatchEvent(new CustomEvent("changed"));
      location.hash = "#/parts";
    } catch (error) {
      this.sure = false;
      this.error = isCode(error, Code.Aborted) ? t.conflict : said(error);
    }
  }

  render() {
    const part = this.model;
    return html`
      <p><a href="#/parts">← ${t.back}</a></p>
      <h1>${this.partId}</h1>
      ${this.error ? html`<p class="error" role="alert">${this.error}</p>` : nothing}
      ${part
        ? html`<div class="two"><section><horopter-part-view .model=${part} .draft=${this.draft} .symmetries=${this.axes}
            @picked=${(e: CustomEvent<Picked>) => { if (this.kind) this.picked = e.detail; }}
            @blocked=${(e: CustomEvent<boolean>) => (this.blocked = e.detail)}></horopter-part-view>${this.symmetry(part)}${this.placing(part)}<horopter-thumbnails .model=${part}></horopter-thumbnails></section>
            <section>${this.edit(part)}<horopter-part-labels .model=${part} @saved=${(e: CustomEvent<Part>) => this.labelled(e.detail)}></horopter-part-labels>${this.details(part)}${this.grasps(part)}<horopter-look-alikes .model=${part} .alike=${this.alike}></horopter-look-alikes>${this.removal()}</section></div>`
        : this.error ? nothing : html`<p>${t.loading}</p>`}
    `;
  }

  private edit(part: Part) {
    return html`
      <div class="row">
        <label>${t.name}<input maxlength="200" .value=${this.name} @input=${(e: Event) => (this.name = (e.target as HTMLInputElement).value)} /></label>
        <button ?disabled=${this.name === part.displayName} @click=${() => this.save(part.etag)}>${t.save}</button>
        <span role="status" class="quiet">${this.done}</span>
      </div>
      ${this.theirs
        ? html`<div class="error" role="alert">${t.conflict}
            <table><tbody><tr><th scope="row">${t.theirs}</th><td>${this.theirs.displayName}</td></tr><tr><th scope="row">${t.yours}</th><td>${this.name}</td></tr></tbody></table>
            <div class="row"><button @click=${() => this.save(this.theirs!.etag)}>${t.keepYours}</button>
              <button @click=${this.load}>${t.takeTheirs}</button></div></div>`
        : nothing}
    `;
  }

  private symmetry(part: Part) {
    const found = symmetryAxes(part);
    if (found.length === 0) return nothing;
    return html`<button aria-pressed=${this.axes} @click=${() => (this.axes = !this.axes)}>${t.axes} (${found.map((a) => t.axis(a.fold)).join(", ")})</button>`;
  }

  private labelled(saved: Part) {
    this.model!.etag = saved.etag;
    this.model!.labels = saved.labels;
    this.dispatchEvent(new CustomEvent("changed"));
    this.requestUpdate();
  }

  private details(part: Part) {
    const rows: [string, string | number][] = [
      [t.size, mm(part.diameterM)],
      [t.edges, part.edgeCount],
      [t.triangles, part.triangleCount],
      [t.symmetries, part.objectFromSymmetricObject.length],
      [t.file, part.source?.fileName ? `${part.source.fileName} ${part.source.unit ? `(${part.source.unit})` : ""}` : "–"],
      [t.state, t.states[part.recognitionStatus?.state ?? 0]],
    ];
    return html`<h2>${t.details}</h2><table><tbody>${rows.map(([name, value]) => html`<tr><th scope="row">${name}</th><td>${value}</td></tr>`)}</tbody></table>`;
  }

  private placing(part: Part) {
    const start = (kind: Kind) => {
      this.kind = kind;
      this.picked = undefined;
      this.turned = 0;
      this.graspName = `${kind}_${part.grasps.length + 1}`;
    };
    return html`<h2>${t.newGrasp}</h2>
      <div class="row">
        <button aria-pressed=${this.kind === "jaw"} @click=${() => start("jaw")}>${t.twoFingers}</button>
        <button aria-pressed=${this.kind === "cup"} @click=${() => start("cup")}>${t.suctionCup}</button>
        ${this.kind && !this.picked ? html`<span role="status">${t.clickFace}</span>` : nothing}
      </div>
      ${this.kind && this.picked
        ? html`<div class="row">
            <label>${t.graspName}<input maxlength="63" required .value=${this.graspName} @input=${(e: Event) => (this.graspName = (e.target as HTMLInputElement).value)} /></label>
            ${this.kind === "cup"
              ? html`<label>${t.cupRadius}<input type="number" min="1" max="500" .value=${String(this.radiusMm)} @input=${(e: Event) => (this.radiusMm = Number((e.target as HTMLInputElement).value) || 10)} /></label>`
              : html`<span class="quiet">${t.between(mm(this.picked.thickness))}</span>`}
            <button @click=${() => (this.turned += Math.PI / 12)}>${t.turnBy}</button>
            <button class="main" ?disabled=${!this.graspName} @click=${() => this.saveGrasps([...part.grasps, this.draft!])}>${t.saveGrasp}</button>
            <button @click=${() => { this.kind = this.picked = undefined; }}>${text.cancel}</button>
          </div>
          ${this.blocked ? html`<p class="error" role="alert">${t.blocked}</p>` : nothing}`
        : nothing}`;
  }

  private grasps(part: Part) {
    if (part.grasps.length === 0) return html`<h2>${t.grasps}</h2><p class="quiet">${t.noGrasps}</p>`;
    return html`<h2>${t.grasps}</h2><table>
      <thead><tr><th scope="col">${t.name}</th><th scope="col">${t.grasps}</th><th scope="col" class="number">${t.quality}</th><th scope="col">${t.remove_}</th></tr></thead>
      <tbody>${part.grasps.map((g) => html`<tr><td>${g.name}</td>
        <td>${g.gripper.case === "suction" ? t.cup(mm(g.gripper.value.cupRadiusM)) : g.gripper.case === "parallelJaw" ? t.jaw(mm(g.gripper.value.jawOpeningM)) : "–"}</td>
        <td class="number">${(g.quality ?? 1).toFixed(2)}</td>
        <td><button aria-label=${t.removeGrasp(g.name)} @click=${() => this.saveGrasps(part.grasps.filter((o) => o !== g))}>×</button></td></tr>`)}</tbody></table>`;
  }

  private removal() {
    return this.sure
      ? html`<div class="error" role="alert">${t.sure(this.partId)}
          <div class="row"><button @click=${this.erase}>${t.remove}</button><button @click=${() => (this.sure = false)}>${text.cancel}</button></div></div>`
      : html`<p><button @click=${() => (this.sure = true)}>${t.remove}</button></p>`;
  }
}
