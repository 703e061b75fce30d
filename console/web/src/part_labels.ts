// What people tag a part with; changed while nobody else has changed the part.
import { html, LitElement } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { catalog, Code, isCode, said } from "./api";
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
  @state() private error = "";

  private async save(labels: Record<string, string>) {
    this.error = "";
    const { name, etag } = this.model!;
    try {
      const saved = await catalog.updateObject({ object: { name, labels }, updateMask: { paths: ["labels"] }, ifMatch: etag });
      this.key = this.value = "";
      this.dispatchEvent(new CustomEvent("saved", { detail: saved }));
      this.requestUpdate();
    } catch (error) {
      this.error = isCode(error, Code.Aborted) ? `${t.conflict} ${t.again}` : said(error);
    }
  }

  private add = (event: SubmitEvent) => {
    event.preventDefault();
    return this.save({ ...this.model!.labels, [this.key]: this.value });
  };

  private take(key: string) {
    const left = { ...this.model!.labels };
    delete left[key];
    return this.save(left);
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
      </form>
      ${this.error ? html`<p class="error" role="alert">${this.error}</p>` : ""}`;
  }
}
