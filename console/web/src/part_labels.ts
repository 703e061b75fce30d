// What people tag a part with. Whoever holds the part saves it.
import { html, LitElement } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import type { Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { shared } from "./style";
import { text } from "./strings";

const t = text.parts;

@customElement("horopter-part-labels")
export class PartLabels extends LitElement {
  static styles = shared;
  @property({ attribute: false }) model?: Part;
  @state() private key = "";
  @state() private value = "";

  willUpdate(changed: Map<string, unknown>) {
    if (changed.has("model")) this.key = this.value = "";
  }

  private save(labels: Record<string, string>) {
    this.dispatchEvent(new CustomEvent("edited", { detail: labels }));
  }

  private add = (event: SubmitEvent) => {
    event.preventDefault();
    this.save({ ...this.model!.labels, [this.key]: this.value });
  };

  private take(key: string) {
    const left = { ...this.model!.labels };
    delete left[key];
    this.save(left);
  }

  render() {
    const labels = Object.entries(this.model?.labels ?? {}).sort();
    return html`<h2>${t.labels}</h2>
      ${labels.length ? html`<table><tbody>${labels.map(([k, v]) => html`<tr><th scope="row">${k}</th><td>${v}</td>
        <td><button aria-label=${t.removeLabel(k)} @click=${() => this.take(k)}>×</button></td></tr>`)}</tbody></table>` : ""}
      <form class="row" @submit=${this.add}>
        <label>${t.label}<input required maxlength="63" pattern="[a-z0-9_.\\/\\-]+" .value=${this.key} @input=${(e: Event) => (this.key = (e.target as HTMLInputElement).value)} /></label>
        <label>${t.value}<input maxlength="200" .value=${this.value} @input=${(e: Event) => (this.value = (e.target as HTMLInputElement).value)} /></label>
        <button>${t.addLabel}</button>
      </form>`;
  }
}
