// The catalog: enrol by dropping a file, list, search.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { catalog, idOf, said, type Session } from "./api";
import { bytesOf, megabytes } from "./files";
import { ObjectView, type Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import { shared } from "./style";
import { text } from "./strings";
import "./part_page";

const t = text.parts;
const MOST_FILE_BYTES = 128 * 1024 * 1024;  // ImportObjectRequest.content
const SHOWN_AT_ONCE = 50;
const WITHOUT_UNIT = /\.(stl|ply|obj)$/i;

export const idFrom = (name: string) =>
  name.replace(/\.(step|stp|iges|igs|stl|ply|obj|glb|3mf|cao|json)(\.gz|z)?$/i, "").toLowerCase().replace(/[^a-z0-9_-]+/g, "-").replace(/^-+|-+$/g, "").slice(0, 63);

// All of the catalog without geometry.
export async function listParts(): Promise<Part[]> {
  const all: Part[] = [];
  let pageToken = "";
  do {
    const page = await catalog.listObjects({ pageSize: 1000, pageToken, view: ObjectView.BASIC });
    all.push(...page.objects);
    pageToken = page.nextPageToken;
  } while (pageToken);
  return all;
}

@customElement("horopter-parts")
export class Parts extends LitElement {
  static styles = [shared, css`form { display: contents; } .drop input[type="file"] { display: none; }`];
  @property({ attribute: false }) session?: Session;
  @property() path = "";
  @state() private parts?: Part[];
  @state() private search = "";
  @state() private shown = SHOWN_AT_ONCE;
  @state() private file?: File;
  @state() private partId = "";
  @state() private unit = "mm";
  @state() private began = 0;
  @state() private now = 0;
  @state() private over = false;
  @state() private error = "";
  @state() private done = "";
  @state() private warnings: string[] = [];
  private abort?: AbortController;

  connectedCallback() {
    super.connectedCallback();
    this.load();
    window.addEventListener("beforeunload", this.hold);
  }
  disconnectedCallback() {
    super.disconnectedCallback();
    window.removeEventListener("beforeunload", this.hold);
  }
  // A reload in mid-upload is asked about first.
  private hold = (event: BeforeUnloadEvent) => {
    if (this.began) event.preventDefault();
  };

  // Back from a part: others may have changed the list.
  willUpdate(changed: Map<string, unknown>) {
    if (changed.get("path") !== undefined && this.path === "#/parts") this.load();
  }

  private async load() {
    try {
      this.parts = await listParts();
    } catch (error) {
      this.error = said(error);
    }
  }

  private take(files?: FileList | null) {
    const file = files?.[0];
    this.over = false;
    this.error = this.done = "";
    this.warnings = [];
    if (!file) return;
    const most = Math.min(MOST_FILE_BYTES, this.session?.max_body_bytes ?? MOST_FILE_BYTES);
    if (file.size > most) {
      this.error = text.tooLarge(file.name, megabytes(file.size), megabytes(most));
      return;
    }
    this.file = file;
    this.partId = idFrom(file.name);
  }

  private async enrol(event: SubmitEvent) {
    event.preventDefault();
    const file = this.file!;
    this.error = this.done = "";
    this.began = this.now = Date.now();
    const ticking = setInterval(() => (this.now = Date.now()), 500);
    this.abort = new AbortController();
    try {
      const made = await catalog.importObject(
        {
          objectId: this.partId,
          fileName: file.name,
          content: await bytesOf(file),
          unit: WITHOUT_UNIT.test(file.name) ? this.unit : "",
        },
        { signal: this.abort.signal },
      );
      this.done = t.enrolled(this.partId);
      this.warnings = made.warnings;
      this.file = undefined;
      await this.load();
    } catch (error) {
      if (!this.abort.signal.aborted) this.error = `${t.refused}: ${said(error)}`;
    }
    clearInterval(ticking);
    this.began = 0;
  }

  render() {
    const [, id, history] = this.path.match(/^#\/parts\/([a-z0-9_-]{1,63})(\/history)?$/) ?? [];
    if (id) return html`<horopter-part-page .partId=${id} .history=${!!history} @changed=${this.load}></horopter-part-page>`;
    return html`
      <h1>${t.title}</h1>
      ${this.dropZone()}
      ${this.error ? html`<p class="error" role="alert">${this.error}</p>` : nothing}
      <div role="status">
        ${this.began ? html`<p>${t.enrolling(this.file?.name ?? "", Math.round((this.now - this.began) / 1000))}</p>` : nothing}
        ${this.done ? html`<p class="good">${this.done}${this.warnings.map((w) => html`<br />${w}`)}</p>` : nothing}
      </div>
      ${this.list()}
    `;
  }

  private dropZone() {
    return html`
      <div class="drop ${this.over ? "over" : ""}"
        @dragover=${(e: DragEvent) => { e.preventDefault(); this.over = true; }}
        @dragleave=${() => (this.over = false)}
        @drop=${(e: DragEvent) => { e.preventDefault(); this.take(e.dataTransfer?.files); }}>
        <p>${t.drop}<br /><span class="quiet">${t.formats}</span></p>
        <button @click=${() => this.renderRoot.querySelector<HTMLInputElement>("#file")!.click()}>${t.choose}</button>
        <input id="file" type="file" aria-label=${t.choose} accept=".step,.stp,.gz,.stpz,.iges,.igs,.stl,.ply,.obj,.glb,.3mf,.cao,.json"
          @change=${(e: Event) => { const field = e.target as HTMLInputElement; this.take(field.files); field.value = ""; }} />
      </div>
      ${this.file
        ? html`<form @submit=${this.enrol}><div class="row">
            <strong>${this.file.name}</strong><span class="quiet">${megabytes(this.file.size)}</span>
            <label>${t.id} (${t.idHint})
              <input required pattern="[a-z0-9_\\-]{1,63}" .value=${this.partId} @input=${(e: Event) => (this.partId = (e.target as HTMLInputElement).value)} /></label>
            ${WITHOUT_UNIT.test(this.file.name)
              ? html`<label>${t.unit}: ${t.unitWhy}
                  <select @change=${(e: Event) => (this.unit = (e.target as HTMLSelectElement).value)}>
                    ${["mm", "cm", "m", "in", "ft", "um"].map((u) => html`<option ?selected=${u === this.unit}>${u}</option>`)}
                  </select></label>`
              : nothing}
            <button class="main" ?disabled=${this.began > 0}>${t.enrol}</button>
            <button type="button" @click=${() => { this.abort?.abort(); this.file = undefined; }}>${text.cancel}</button>
          </div></form>`
        : nothing}
    `;
  }

  private list() {
    if (!this.parts) return html`<p>${text.busy}</p>`;
    const words = this.search.toLowerCase().split(/\s+/).filter(Boolean);
    const found = this.parts.filter((p) => {
      const all = `${idOf(p.name)} ${p.displayName} ${Object.entries(p.labels).flat().join(" ")}`.toLowerCase();
      return words.every((word) => all.includes(word));
    });
    const rows = found.slice(0, this.shown);
    return html`
      <div class="row">
        <label>${t.search}<input type="search" .value=${this.search} @input=${(e: Event) => { this.search = (e.target as HTMLInputElement).value; this.shown = SHOWN_AT_ONCE; }} /></label>
        <span class="quiet" role="status">${t.count(rows.length, this.parts.length)}</span>
      </div>
      ${rows.length === 0
        ? html`<p>${this.parts.length ? t.noMatch : t.none}</p>`
        : html`<table>
            <thead><tr><th scope="col">${t.id}</th><th scope="col">${t.name}</th><th scope="col" class="number">${t.size}</th>
              <th scope="col" class="number">${t.edges}</th><th scope="col" class="number">${t.graspCount}</th><th scope="col">${t.state}</th></tr></thead>
            <tbody>${rows.map((p) => html`<tr>
              <td><a href="#/parts/${idOf(p.name)}">${idOf(p.name)}</a></td><td>${p.displayName}</td>
              <td class="number">${(1000 * p.diameterM).toFixed(1)}</td><td class="number">${p.edgeCount}</td>
              <td class="number">${p.grasps.length}</td>
              <td>${t.states[p.recognitionStatus?.state ?? 0]} ${p.recognitionStatus?.reason ?? ""}</td></tr>`)}</tbody>
          </table>`}
      ${found.length > rows.length ? html`<p><button @click=${() => (this.shown += 200)}>${t.more}</button></p>` : nothing}
    `;
  }
}
