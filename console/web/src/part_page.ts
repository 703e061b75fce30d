// One part: its geometry, grasps, look-alikes, history; what is changed is saved while nobody else has changed it.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { catalog, Code, isCode, said } from "./api";
import { ObjectView, type Grasp, type ListLookAlikesResponse, type Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import type { Picked } from "./grasp_draft";
import type { Draft, GraspEditor } from "./grasp_editor";
import { shared } from "./style";
import { text } from "./strings";
import { forgetModel } from "./models";
import type { Edited } from "./part_diff";
import type { Checked, PartView } from "./part_view";
import "./grasp_editor";
import "./look_alikes";
import "./part_history";
import "./part_labels";
import "./part_merge";
import "./part_view";
import "./thumbnails";
import "./view_templates";
import type { Vector3 } from "three";
import { symmetryAxes } from "./resting";

const t = text.parts;
const mm = (m: number) => (1000 * m).toFixed(1);

@customElement("horopter-part-page")
export class PartPage extends LitElement {
  static styles = [shared, css`.two { display: grid; grid-template-columns: minmax(20rem, 3fr) minmax(18rem, 2fr); gap: 0 2rem; } .two > section:first-child { position: sticky; top: 0; align-self: start; background: var(--ground); } @media (max-width: 800px) { .two { grid-template-columns: 1fr; } .two > section:first-child { position: static; } }`];
  @property() partId = "";
  @property({ type: Boolean }) history = false;
  @state() private model?: Part;
  @state() private alike?: ListLookAlikesResponse;
  @state() private name = "";
  @state() private mine?: Edited;  // that could not be saved, as the part is `theirs` by now
  @state() private theirs?: Part;
  @state() private saving = false;
  @state() private error = "";
  @state() private done = "";
  @state() private sure = false;
  @state() private picked?: Picked;
  @state() private checked?: Checked;
  @state() private draft: Draft = { gizmo: "translate" };
  @state() private axes = false;

  willUpdate(changed: Map<string, unknown>) {
    if (changed.has("partId")) this.load();
  }

  private async load() {
    this.model = this.alike = this.mine = this.theirs = this.picked = this.checked = undefined;
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

  // While nobody else has changed the part; else both are shown.
  private async save(change: Partial<Edited>, etag = this.model!.etag) {
    this.error = this.done = "";
    this.saving = true;
    const name = `objects/${this.partId}`;
    const { displayName, labels, grasps } = this.model!;
    const paths = Object.entries({ displayName: "display_name", labels: "labels", grasps: "grasps" }).filter(([k]) => k in change).map(([, path]) => path);
    try {
      await catalog.updateObject({ object: { name, ...change }, updateMask: { paths }, ifMatch: etag });
      this.dispatchEvent(new CustomEvent("changed"));
      await this.load();
      this.done = t.saved;
    } catch (error) {
      try {
        if (!isCode(error, Code.Aborted)) throw error;
        this.theirs = await catalog.getObject({ name, view: ObjectView.BASIC });
        this.mine = { displayName, labels, grasps, ...change };
      } catch (failed) {
        this.error = said(failed);
      }
    }
    this.saving = false;
  }

  private lookFrom(side: Vector3) {
    const view = this.renderRoot.querySelector<PartView>("horopter-part-view");
    view?.lookFrom(side);
    view?.scrollIntoView({ block: "nearest" });
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
    return html`
      <p><a href="#/parts">← ${t.back}</a></p>
      <h1>${this.partId}</h1>
      <nav class="row" aria-label=${t.sections}>
        <a class="button" href="#/parts/${this.partId}" aria-current=${this.history ? nothing : "page"}>${t.present}</a>
        <a class="button" href="#/parts/${this.partId}/history" aria-current=${this.history ? "page" : nothing}>${t.history.title}</a></nav>
      ${this.history ? html`<horopter-part-history .partId=${this.partId} @changed=${this.restored}></horopter-part-history>` : this.present()}`;
  }

  private restored() {
    this.dispatchEvent(new CustomEvent("changed"));
    this.load();
  }

  private present() {
    const part = this.model;
    return html`
      ${this.error ? html`<p class="error" role="alert">${this.error}</p>` : nothing}
      ${this.mine && this.theirs && part
        ? html`<horopter-part-merge .base=${part} .mine=${this.mine} .theirs=${this.theirs} .busy=${this.saving}
            @merged=${(e: CustomEvent<Edited>) => this.save(e.detail, this.theirs!.etag)} @dropped=${this.load}></horopter-part-merge>`
        : nothing}
      ${part
        ? html`<div class="two"><section>
            <horopter-part-view .model=${part} .draft=${this.draft.grasp} .gizmo=${this.draft.gizmo} .symmetries=${this.axes}
              @picked=${(e: CustomEvent<Picked>) => (this.picked = e.detail)} @checked=${(e: CustomEvent<Checked>) => (this.checked = e.detail)}
              @moved=${(e: CustomEvent<Grasp>) => this.renderRoot.querySelector<GraspEditor>("horopter-grasp-editor")?.show(e.detail)}></horopter-part-view>
            ${this.symmetry(part)}</section>
            <section>${this.edit(part)}
              <horopter-grasp-editor .model=${part} .picked=${this.picked} .checked=${this.checked}
                @drafted=${(e: CustomEvent<Draft>) => (this.draft = e.detail)} @save=${(e: CustomEvent<Grasp[]>) => this.save({ grasps: e.detail })}></horopter-grasp-editor>
              <horopter-part-labels .model=${part} @edited=${(e: CustomEvent<Record<string, string>>) => this.save({ labels: e.detail })}></horopter-part-labels>
              ${this.details(part)}<horopter-look-alikes .model=${part} .alike=${this.alike}></horopter-look-alikes>${this.removal()}</section></div>
            <horopter-view-templates .model=${part} @look=${(e: CustomEvent<Vector3>) => this.lookFrom(e.detail)}></horopter-view-templates>
            <horopter-thumbnails .model=${part}></horopter-thumbnails>`
        : this.error ? nothing : html`<p>${t.loading}</p>`}
    `;
  }

  private edit(part: Part) {
    return html`
      <div class="row">
        <label>${t.name}<input maxlength="200" .value=${this.name} @input=${(e: Event) => (this.name = (e.target as HTMLInputElement).value)} /></label>
        <button ?disabled=${this.name === part.displayName} @click=${() => this.save({ displayName: this.name })}>${t.save}</button>
        <span role="status" class="quiet">${this.done}</span>
      </div>
    `;
  }

  private symmetry(part: Part) {
    const found = symmetryAxes(part);
    if (found.length === 0) return nothing;
    return html`<button aria-pressed=${this.axes} @click=${() => (this.axes = !this.axes)}>${t.axes} (${found.map((a) => t.axis(a.fold)).join(", ")})</button>`;
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

  private removal() {
    return this.sure
      ? html`<div class="error" role="alert">${t.sure(this.partId)}
          <div class="row"><button @click=${this.erase}>${t.remove}</button><button @click=${() => (this.sure = false)}>${text.cancel}</button></div></div>`
      : html`<p><button @click=${() => (this.sure = true)}>${t.remove}</button></p>`;
  }
}
