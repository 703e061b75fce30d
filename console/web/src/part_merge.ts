// Two people changed one part: what each made of it, and what is to be saved.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { entriesOf, merged, type Choice, type Edited, type Entry } from "./part_diff";
import { shared } from "./style";
import { text } from "./strings";

const t = text.parts.merge;

@customElement("horopter-part-merge")
export class PartMerge extends LitElement {
  static styles = [shared, css`fieldset { border: 0; padding: 0; margin: 0; display: flex; flex-wrap: wrap; gap: 0.75rem; } label { flex-direction: row; align-items: center; } input { min-height: 0; } td { overflow-wrap: anywhere; }`];
  @property({ attribute: false }) base?: Edited;
  @property({ attribute: false }) mine?: Edited;
  @property({ attribute: false }) theirs?: Edited;
  @property({ type: Boolean }) busy = false;
  @state() private entries: Entry[] = [];

  willUpdate(changed: Map<string, unknown>) {
    if (["base", "mine", "theirs"].some((k) => changed.has(k)) && this.base && this.mine && this.theirs) this.entries = entriesOf(this.base, this.mine, this.theirs);
  }

  // It is seen, wherever the change was made.
  updated(changed: Map<string, unknown>) {
    if (!changed.has("theirs")) return;
    const section = this.renderRoot.querySelector("section");
    section?.scrollIntoView({ block: "start" });
    section?.focus();
  }

  private choose(entry: Entry, choice: Choice) {
    this.entries = this.entries.map((e) => (e === entry ? { ...e, choice } : e));
  }

  private row(entry: Entry, i: number) {
    const what = `${text.parts.history.fields[entry.field]} ${entry.key}`.trim();
    const choices: Choice[] = entry.both ? ["theirs", "mine", "both"] : ["theirs", "mine"];
    return html`<tr><th scope="row">${what}</th><td>${entry.theirs || t.gone}</td><td>${entry.mine || t.gone}</td>
      <td><fieldset><legend class="hidden">${t.of(what)}</legend>${choices.map((c) => html`<label><input type="radio" name="entry${i}" .checked=${entry.choice === c} @change=${() => this.choose(entry, c)} />${t.choices[c]}</label>`)}</fieldset>
        ${entry.clash ? html`<span class="quiet">${t.clash}</span>` : nothing}</td></tr>`;
  }

  render() {
    if (!this.base || !this.mine || !this.theirs) return nothing;
    return html`<section class="error" tabindex="-1" aria-labelledby="merge"><div role="alert"><h2 id="merge">${text.parts.conflict}</h2><p>${t.why}</p></div>
      ${this.entries.length === 0
        ? html`<p>${t.alike}</p>`
        : html`<table><thead><tr><th scope="col">${t.what}</th><th scope="col">${text.parts.theirs}</th><th scope="col">${text.parts.yours}</th><th scope="col">${t.take}</th></tr></thead>
            <tbody>${this.entries.map((e, i) => this.row(e, i))}</tbody></table>`}
      <div class="row"><button class="main" ?disabled=${this.busy} @click=${() => this.dispatchEvent(new CustomEvent("merged", { detail: merged(this.mine!, this.theirs!, this.entries) }))}>${t.save}</button>
        <button @click=${() => this.dispatchEvent(new CustomEvent("dropped"))}>${text.parts.takeTheirs}</button></div></section>`;
  }
}
