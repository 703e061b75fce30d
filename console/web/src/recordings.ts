// What the server keeps of requests on its disk, to be saved.
import { html, LitElement, nothing } from "lit";
import { customElement, state } from "lit/decorators.js";
import { answers, Code, isCode, said } from "./api";
import { download, megabytes } from "./files";
import type { Recording } from "./gen/horopter/v1/answers_pb";
import { shared } from "./style";
import { text } from "./strings";

const t = text.health;

@customElement("horopter-recordings")
export class Recordings extends LitElement {
  static styles = shared;
  @state() private all: Recording[] = [];
  @state() private next = "";
  @state() private says: string = text.busy;
  @state() private work = "";

  connectedCallback() {
    super.connectedCallback();
    this.more();
  }

  private more = async () => {
    try {
      const page = await answers.listRecordings({ pageSize: 20, pageToken: this.next });
      this.all = [...this.all, ...page.recordings];
      this.next = page.nextPageToken;
      this.says = this.all.length ? "" : t.noRecordings;
    } catch (error) {
      this.says = isCode(error, Code.PermissionDenied) ? text.live.mayNot : said(error);
    }
  };

  private async save(recording: Recording) {
    const parts: Uint8Array[] = [];
    let bytes = 0;
    try {
      for await (const step of answers.getRecording({ name: recording.name })) {
        parts.push(step.chunk);
        bytes += step.chunk.length;
        this.work = t.backing(Math.round((100 * bytes) / Number(step.totalBytes)));
      }
      download(`${recording.name.split("/")[1]}.horec`, parts as BlobPart[]);
      this.work = "";
    } catch (error) {
      this.work = said(error);
    }
  }

  render() {
    return html`<h2>${t.recordings}</h2>
      ${this.says ? html`<p class="quiet">${this.says}</p>` : nothing}
      ${this.all.length
        ? html`<table><thead><tr><th scope="col">${t.time}</th><th scope="col">${t.request}</th><th scope="col" class="number">${t.size}</th><th scope="col">${t.save}</th></tr></thead>
            <tbody>${this.all.map((r) => html`<tr><td>${r.time ? new Date(1000 * Number(r.time.seconds)).toLocaleString() : ""}</td><td>${r.requestId}</td>
              <td class="number">${megabytes(Number(r.sizeBytes))}</td>
              <td><button aria-label=${t.saveRecording(r.requestId)} @click=${() => this.save(r)}>${t.save}</button></td></tr>`)}</tbody></table>`
        : nothing}
      ${this.next ? html`<button @click=${this.more}>${text.parts.more}</button>` : nothing}
      <p role="status" class="quiet">${this.work}</p>`;
  }
}
