// What a part was before its changes: who changed what, and going back to it.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { timestampDate } from "@bufbuild/protobuf/wkt";
import { catalog, Code, isCode, said } from "./api";
import { ObjectView, type Object$ as Part, type ObjectVersion } from "./gen/horopter/v1/catalog_pb";
import { allDifferences, type Difference } from "./part_diff";
import { shared } from "./style";
import { text } from "./strings";
import "./part_view";

const t = text.parts.history;
const KEPT = 20;  // former versions, ListObjectVersions

export function differenceWords(d: Difference) {
  const what = `${t.fields[d.field]}${d.key ? ` ${d.key}` : ""}`;
  return html`<li><strong>${what}</strong> ${t.how[d.how]}${d.how === "changed" ? html`: ${d.before || "–"} → ${d.after || "–"}` : d.after || d.before ? html`: ${d.after || d.before}` : nothing}</li>`;
}

@customElement("horopter-part-history")
export class PartHistory extends LitElement {
  static styles = [shared, css`ul { margin: 0; padding-left: 1.1rem; } td { overflow-wrap: anywhere; }`];
  @property() partId = "";
  @state() private versions?: ObjectVersion[];
  @state() private shown?: Part;
  @state() private sure?: bigint;
  @state() private error = "";
  @state() private done = "";

  willUpdate(changed: Map<string, unknown>) {
    if (changed.has("partId")) this.load();
  }

  private get name() {
    return `objects/${this.partId}`;
  }

  private async load() {
    this.versions = this.shown = this.sure = undefined;
    this.error = "";
    try {
      this.versions = (await catalog.listObjectVersions({ name: this.name })).versions;
    } catch (error) {
      this.error = isCode(error, Code.PermissionDenied) ? t.mayNot : said(error);
    }
  }

  private async look(revision: bigint) {
    try {
      this.shown = await catalog.getObject({ name: this.name, view: ObjectView.GEOMETRY, revision });
    } catch (error) {
      this.error = said(error);
    }
  }

  private async restore(revision: bigint) {
    this.done = "";
    try {
      await catalog.restoreObject({ name: this.name, revision, ifMatch: this.versions![0].object!.etag });
      await this.load();
      this.done = t.restored(String(revision));
      this.dispatchEvent(new CustomEvent("changed"));
    } catch (error) {
      const changed = isCode(error, Code.Aborted);
      if (changed) await this.load();
      this.error = changed ? t.changedSince : said(error);
    }
  }

  private row(version: ObjectVersion, i: number) {
    const before = this.versions![i + 1]?.object;
    const { revision, updateTime } = version.object!;
    const found = before ? allDifferences(before, version.object!, version.changedFields?.paths ?? []) : [];
    return html`<tr><td class="number">${revision}</td><td>${updateTime ? timestampDate(updateTime).toLocaleString() : ""}</td><td>${version.changedBy || "–"}</td>
      <td>${before ? html`<ul>${found.map(differenceWords)}</ul>` : this.versions!.length > KEPT ? t.forgotten : t.first}</td>
      <td>${i === 0 ? t.now : html`<button aria-label=${t.look(String(revision))} @click=${() => this.look(revision)}>${t.show}</button>
        <button aria-label=${t.back(String(revision))} @click=${() => (this.sure = revision)}>${t.restore}</button>`}</td></tr>`;
  }

  render() {
    return html`
      ${this.error ? html`<p class="error" role="alert">${this.error}</p>` : nothing}
      <p role="status" class=${this.done ? "good" : "hidden"}>${this.done}</p>
      ${this.sure !== undefined
        ? html`<div class="error" role="alert">${t.sure(String(this.sure))}
            <div class="row"><button class="main" @click=${() => this.restore(this.sure!)}>${t.restore}</button><button @click=${() => (this.sure = undefined)}>${text.cancel}</button></div></div>`
        : nothing}
      ${this.shown
        ? html`<h2>${t.asItWas(String(this.shown.revision))}</h2><horopter-part-view .model=${this.shown}></horopter-part-view>
            <p><button @click=${() => (this.shown = undefined)}>${text.close}</button></p>`
        : nothing}
      ${this.versions
        ? html`<p class="quiet">${t.why}</p><table><thead><tr><th scope="col" class="number">${t.revision}</th><th scope="col">${t.since}</th><th scope="col">${t.by}</th>
            <th scope="col">${t.what}</th><th scope="col">${t.todo}</th></tr></thead><tbody>${this.versions.map((v, i) => this.row(v, i))}</tbody></table>`
        : this.error ? nothing : html`<p>${text.busy}</p>`}
    `;
  }
}
