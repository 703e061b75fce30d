// How the server is: load, limits, the catalog's check and backup.
import { html, css, LitElement, nothing } from "lit";
import { customElement, state } from "lit/decorators.js";
import { catalog, said, server } from "./api";
import { download, megabytes } from "./files";
import type { ServerInfo } from "./gen/horopter/v1/server_pb";
import { shared } from "./style";
import { text } from "./strings";

const t = text.health;
const EVERY_MS = 2000;

@customElement("horopter-health")
export class Health extends LitElement {
  static styles = [
    shared,
    css`
      .two { display: grid; grid-template-columns: repeat(auto-fit, minmax(22rem, 1fr)); gap: 0 2rem; }
      progress { width: 16rem; accent-color: var(--accent); }
    `,
  ];
  @state() private info?: ServerInfo;
  @state() private error = "";
  @state() private work = "";
  @state() private result = "";
  @state() private problems: string[] = [];
  private timer = 0;

  connectedCallback() {
    super.connectedCallback();
    this.look();
  }
  disconnectedCallback() {
    super.disconnectedCallback();
    clearTimeout(this.timer);
    this.timer = -1;
  }

  private async look() {
    try {
      this.info = await server.getServerInfo({});
      this.error = "";
    } catch (error) {
      this.error = said(error);
    }
    if (this.timer !== -1) this.timer = window.setTimeout(() => this.look(), EVERY_MS);
  }

  private async doing(what: () => Promise<void>) {
    this.result = "";
    this.problems = [];
    try {
      await what();
    } catch (error) {
      this.problems = [said(error)];
    }
    this.work = "";
  }

  private verify = () =>
    this.doing(async () => {
      this.work = t.verifying(0, 0);
      const found: string[] = [];
      let checked = 0;
      for await (const step of catalog.verifyCatalog({})) {
        found.push(...step.problems.map((p) => `${p.name} ${p.what}`));
        checked = step.objects;
        this.work = t.verifying(Math.round(100 * step.progress), step.objects);
      }
      this.problems = found;
      if (found.length === 0) this.result = t.sound(checked);
    });

  private backup = () =>
    this.doing(async () => {
      this.work = t.backing(0);
      const parts: Uint8Array<ArrayBuffer>[] = [];
      let bytes = 0;
      let sum = "";
      for await (const step of catalog.backupCatalog({})) {
        parts.push(step.chunk as Uint8Array<ArrayBuffer>);
        bytes += step.chunk.length;
        sum = step.sha256;
        this.work = t.backing(Math.round((100 * bytes) / Number(step.totalBytes)));
      }
      const whole = await new Blob(parts).arrayBuffer();
      // Browsers give crypto.subtle to loopback and https alone.
      const digest = crypto.subtle ? new Uint8Array(await crypto.subtle.digest("SHA-256", whole)) : undefined;
      const hex = digest && [...digest].map((b) => b.toString(16).padStart(2, "0")).join("");
      if (hex && hex !== sum) throw new Error(t.damaged);
      const name = `horopter-${new Date().toISOString().slice(0, 19).replace(/[:T]/g, "-")}.db`;
      download(name, [whole]);
      this.result = t.backed(name);
    });

  private rows(pairs: [string, string | number][]) {
    return html`<table><tbody>
      ${pairs.map(([name, value]) => html`<tr><th scope="row">${name}</th><td class="number">${value}</td></tr>`)}
    </tbody></table>`;
  }

  render() {
    const info = this.info;
    return html`
      <h1>${t.title}</h1>
      ${this.error ? html`<p class="error" role="alert">${this.error}</p>` : nothing}
      ${info
        ? html`<div class="two">
            <section>
              <h2>${text.title}</h2>
              ${this.rows([
                [t.version, info.version],
                [t.since, info.startTime ? new Date(Number(info.startTime.seconds) * 1000).toLocaleString() : "–"],
                [t.running, info.load?.running ?? 0],
                [t.waiting, info.load?.waiting ?? 0],
                [t.memory, `${megabytes(Number(info.load?.reservedBytes ?? 0))} / ${megabytes(Number(info.limits?.memoryBytes ?? 0))}`],
                [t.objects, info.objectCount],
                [t.pending, info.pendingObjectCount],
                [t.unusable, info.unusableObjectCount],
                [t.generation, String(info.catalogGeneration)],
              ])}
            </section>
            <section>
              <h2>${t.limits}</h2>
              ${this.rows([
                [t.images, info.limits?.maxImages ?? 0],
                [t.pixels, (Number(info.limits?.maxImagePixels ?? 0) / 1e6).toFixed(0) + " M"],
                [t.workers, info.limits?.workers ?? 0],
                [t.queue, info.limits?.queue ?? 0],
              ])}
              <h2>${t.catalog}</h2>
              <div class="row">
                <button ?disabled=${!!this.work} @click=${this.verify}>${t.verify}</button>
                <button ?disabled=${!!this.work} @click=${this.backup}>${t.backup}</button>
              </div>
              <div role="status">
                ${this.work ? html`<p>${this.work}</p>` : nothing}
                ${this.result ? html`<p class="good">${this.result}</p>` : nothing}
              </div>
              ${this.problems.length
                ? html`<div class="error" role="alert">${t.problems(this.problems.length)}${this.problems.map((p) => html`<br />${p}`)}</div>`
                : nothing}
            </section>
          </div>`
        : html`<p>${text.busy}</p>`}
    `;
  }
}
