// Parts that can be taken for one, and what tells them apart, side by side.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { idOf } from "./api";
import type { ListLookAlikesResponse, LookAlike, Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { modelOf } from "./models";
import { shared } from "./style";
import { text } from "./strings";
import "./part_view";

const t = text.parts;

@customElement("horopter-look-alikes")
export class LookAlikes extends LitElement {
  static styles = [shared, css`.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(14rem, 1fr)); gap: 0.75rem; }`];
  @property({ attribute: false }) model?: Part;
  @property({ attribute: false }) alike?: ListLookAlikesResponse;
  @state() private pair?: { alike: LookAlike; other: Part };

  willUpdate(changed: Map<string, unknown>) {
    if (changed.has("alike")) this.pair = undefined;
  }

  private async compare(alike: LookAlike) {
    const other = await modelOf(alike.name);
    this.pair = other && { alike, other };
  }

  render() {
    if (!this.alike) return nothing;
    const { lookAlikes } = this.alike;
    return html`<h2>${t.lookAlikes}</h2>${lookAlikes.length === 0
      ? html`<p class="quiet">${t.noLookAlikes}</p>`
      : html`<ul>${lookAlikes.map((a) => html`<li><a href="#/parts/${idOf(a.name)}">${idOf(a.name)}</a>: ${t.kinds[a.kind] ?? ""};
          ${t.differ((a.onlyInNamedM.length + a.onlyInOtherM.length) / 3)}
          <button aria-pressed=${this.pair?.alike === a} aria-label="${t.sideBySide}: ${idOf(a.name)}" @click=${() => this.compare(a)}>${t.sideBySide}</button></li>`)}</ul>`}
      ${this.pair && this.model
        ? html`<p class="quiet">${t.marked}</p><div class="pair">
            <section><h3>${idOf(this.model.name)}</h3><horopter-part-view .model=${this.model} .marks=${this.pair.alike.onlyInNamedM}></horopter-part-view></section>
            <section><h3>${idOf(this.pair.other.name)}</h3><horopter-part-view .model=${this.pair.other} .marks=${this.pair.alike.onlyInOtherM}></horopter-part-view></section></div>`
        : nothing}`;
  }
}
