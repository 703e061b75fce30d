// Grasps of a part: placed by a click on a face, moved and turned with the pointer, by keys or by numbers.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import type { Grasp, Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { draftGrasp, fitted, poseOf, turned, withPose, type Axis, type Kind, type Picked } from "./grasp_draft";
import type { Checked, Gizmo } from "./part_view";
import { shared } from "./style";
import { text } from "./strings";

const t = text.parts;
const mm = (m: number) => (1000 * m).toFixed(1);
const AXES: Axis[] = ["x", "y", "z"];
const STEP_RAD = Math.PI / 12;
const WIDTH_TOLERANCE = 0.05;  // of the opening: horopter's own check of grasps

export interface Draft { grasp?: Grasp; gizmo: Gizmo }

@customElement("horopter-grasp-editor")
export class GraspEditor extends LitElement {
  static styles = [shared, css`input[type="number"] { width: 6.5rem; } fieldset { border: 1px solid var(--line); border-radius: 6px; padding: 0.25rem 0.75rem 0.5rem; } legend { color: var(--quiet); } fieldset .row { margin: 0; }`];
  @property({ attribute: false }) model?: Part;
  // Of the part's view: where a face was clicked, and what it says of the draft.
  @property({ attribute: false }) picked?: Picked;
  @property({ attribute: false }) checked?: Checked;
  @state() private kind?: Kind;  // a click on a face makes one of these
  @state() private draft?: Grasp;
  @state() private replaces = "";  // name of the enrolled grasp that is changed
  @state() private gizmo: Gizmo = "translate";

  willUpdate(changed: Map<string, unknown>) {
    if (changed.has("model")) this.stop();
    if (changed.has("picked") && this.picked && this.kind && this.model) {
      const name = this.draft?.name || this.freeName(this.kind);
      const radius = this.draft?.gripper.case === "suction" ? this.draft.gripper.value.cupRadiusM : 0.01;
      this.show(draftGrasp(this.kind, this.picked, name, radius));
    }
  }

  private freeName(kind: Kind) {
    const taken = new Set(this.model!.grasps.map((g) => g.name));
    for (let i = this.model!.grasps.length + 1; ; ++i) if (!taken.has(`${kind}_${i}`)) return `${kind}_${i}`;
  }

  // What the part's view draws.
  show(grasp?: Grasp) {
    this.draft = grasp;
    this.dispatchEvent(new CustomEvent<Draft>("drafted", { detail: { grasp, gizmo: this.gizmo } }));
  }

  private stop() {
    this.kind = undefined;
    this.replaces = "";
    if (this.draft) this.show(undefined);
  }

  private start(kind: Kind) {
    this.stop();
    this.kind = kind;
  }

  private edit(grasp: Grasp) {
    this.kind = undefined;
    this.replaces = grasp.name;
    this.show(grasp);
  }

  private choose(gizmo: Gizmo) {
    this.gizmo = gizmo;
    this.show(this.draft);
  }

  private moveTo(axis: Axis, millimetres: number) {
    const { position, rotation } = poseOf(this.draft!);
    if (!Number.isFinite(millimetres)) return;
    position[axis] = millimetres / 1000;
    this.show(withPose(this.draft!, position, rotation));
  }

  private resize(cupRadiusM: number) {
    if (cupRadiusM > 0) this.show({ ...this.draft!, gripper: { case: "suction", value: { ...(this.draft!.gripper.value as { cupRadiusM: number }), cupRadiusM } as never } });
  }

  private save(grasps: Grasp[]) {
    this.dispatchEvent(new CustomEvent("save", { detail: grasps }));
  }

  private get nameIsTaken() {
    return this.draft!.name !== this.replaces && this.model!.grasps.some((g) => g.name === this.draft!.name);
  }

  private saveDraft() {
    const { grasps } = this.model!;
    const own = this.draft!;
    this.save(this.replaces ? grasps.map((g) => (g.name === this.replaces ? own : g)) : [...grasps, own]);
  }

  private number(label: string, value: string, take: (v: number) => void, least?: string) {
    return html`<label>${label}<input type="number" step="0.5" min=${least ?? nothing} .value=${value} @change=${(e: Event) => take((e.target as HTMLInputElement).valueAsNumber)} /></label>`;
  }

  private widthOf(draft: Grasp) {
    if (draft.gripper.case !== "parallelJaw") return nothing;
    const { gripWidthM, jawOpeningM } = draft.gripper.value;
    if (!this.checked) return nothing;  // no WebGL
    const width = this.checked.widthM;
    if (width === undefined) return html`<p class="error" role="alert">${t.nothingBetween}</p>`;
    const off = Math.abs(width - gripWidthM) > WIDTH_TOLERANCE * jawOpeningM;
    return html`<p>${t.between(mm(width))} ${off ? html`<button @click=${() => this.show(fitted(draft, width))}>${t.fit(mm(width))}</button>` : nothing}</p>`;
  }

  private panel(draft: Grasp) {
    const { position } = poseOf(draft);
    return html`
      <div class="row">
        <label>${t.graspName}<input maxlength="63" required .value=${draft.name} @input=${(e: Event) => this.show({ ...draft, name: (e.target as HTMLInputElement).value })} /></label>
        ${draft.gripper.case === "suction" ? this.number(t.cupRadius, mm(draft.gripper.value.cupRadiusM), (v) => this.resize(v / 1000), "0.5") : nothing}
        <button aria-pressed=${this.gizmo === "translate"} @click=${() => this.choose("translate")}>${t.gizmoMove}</button>
        <button aria-pressed=${this.gizmo === "rotate"} @click=${() => this.choose("rotate")}>${t.gizmoTurn}</button>
      </div>
      <div class="row">
        <fieldset><legend>${t.position}</legend><div class="row">${AXES.map((a) => this.number(a, mm(position[a]), (v) => this.moveTo(a, v)))}</div></fieldset>
        <fieldset><legend>${t.turnWhy}</legend><div class="row">${AXES.map((a) => html`<button aria-label=${t.turnAbout(a)} @click=${() => this.show(turned(draft, a, STEP_RAD))}>${a} +15°</button>`)}</div></fieldset>
      </div>
      <p class="quiet">${t.gizmoWhy}</p>
      ${this.checked?.met ? html`<p class="error" role="alert">${t.blocked}</p>` : nothing}
      ${this.widthOf(draft)}
      ${this.nameIsTaken ? html`<p class="error" role="alert">${t.nameTaken}</p>` : nothing}
      <div class="row">
        <button class="main" ?disabled=${!draft.name || this.nameIsTaken} @click=${this.saveDraft}>${t.saveGrasp}</button>
        <button @click=${this.stop}>${text.cancel}</button>
      </div>`;
  }

  private row(grasp: Grasp) {
    const g = grasp.gripper;
    return html`<tr><td>${grasp.name}</td>
      <td>${g.case === "suction" ? t.cup(mm(g.value.cupRadiusM)) : g.case === "parallelJaw" ? t.jaw(mm(g.value.jawOpeningM)) : "–"}</td>
      <td class="number">${(grasp.quality ?? 1).toFixed(2)}</td>
      <td><button aria-label=${t.editGrasp(grasp.name)} @click=${() => this.edit(grasp)}>${t.edit}</button>
        <button aria-label=${t.removeGrasp(grasp.name)} @click=${() => this.save(this.model!.grasps.filter((o) => o !== grasp))}>×</button></td></tr>`;
  }

  render() {
    const part = this.model;
    if (!part) return nothing;
    return html`<h2>${t.grasps}</h2>
      ${part.grasps.length === 0
        ? html`<p class="quiet">${t.noGrasps}</p>`
        : html`<table><thead><tr><th scope="col">${t.name}</th><th scope="col">${t.gripper}</th><th scope="col" class="number">${t.quality}</th><th scope="col">${t.change}</th></tr></thead>
            <tbody>${part.grasps.map((g) => this.row(g))}</tbody></table>`}
      <h3>${this.replaces ? t.editGrasp(this.replaces) : t.newGrasp}</h3>
      ${this.replaces ? nothing : html`<div class="row">
        <button aria-pressed=${this.kind === "jaw"} @click=${() => this.start("jaw")}>${t.twoFingers}</button>
        <button aria-pressed=${this.kind === "cup"} @click=${() => this.start("cup")}>${t.suctionCup}</button>
        ${this.kind && !this.draft ? html`<span role="status">${t.clickFace}</span>` : nothing}</div>`}
      ${this.draft ? this.panel(this.draft) : nothing}`;
  }
}
