// How the server is: load, limits, the catalog's check and backup.
import { html, css, LitElement, nothing } from "lit";
import { customElement, state } from "lit/decorators.js";
import { catalog, said } from "./api";
import { watch, type Feed } from "./feed";
import { look } from "./poll";
import { download, megabytes } from "./files";
import type { ServerInfo } from "./gen/horopter/v1/server_pb";
import { shared } from "./style";
import { text } from "./strings";
import "./chart";
import "./recordings";
import type { Series } from "./chart";

const t = text.health;
const EVERY_MS = 2000;
const MOST_SAMPLES = 900;

interface Sample { time: number; running: number; waiting: number; megabytes: number }

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
  @state() private samples: Sample[] = [];
  @state() private feed?: Feed;
  private stops: (() => void)[] = [];

  connectedCallback() {
    super.connectedCallback();
    this.stops = [look(EVERY_MS, (looked) => this.took(looked.info, looked.error)), watch((feed) => (this.feed = feed))];
  }
  disconnectedCallback() {
    super.disconnectedCallback();
    this.stops.forEach((stop) => stop());
  }

  private took(info: ServerInfo | undefined, error: string) {
    this.info = info;
    this.error = error;
    if (error || !info?.load) return;
    const { running, waiting, reservedBytes } = info.load;
    const sample = { time: Date.now() / 1000, running, waiting, megabytes: Number(reservedBytes) / 1e6 };
    this.samples = [...this.samples, sample].slice(-MOST_SAMPLES);
  }

  // Of the answers that are held, the oldest first: each stage's time, and all of it.
  private latency() {
    const answers = [...(this.feed?.answers ?? [])].reverse().filter((a) => a.response);
    const seconds = (d?: { seconds: bigint; nanos: number }) => Number(d?.seconds ?? 0) + (d?.nanos ?? 0) / 1e9;
    const stages = new Set(answers.flatMap((a) => a.response!.stages.map((s) => s.stage)));
    const series: Series[] = [{ label: t.total, values: answers.map((a) => seconds(a.elapsed)) }];
    for (const stage of stages) {
      series.push({ label: stage, values: answers.map((a) => { const s = a.response!.stages.find((x) => x.stage === stage); return s ? seconds(s.elapsed) : null; }) });
    }
    return { times: answers.map((a) => Number(a.answerTime?.seconds ?? 0)), series };
  }

  private charts() {
    const latency = this.latency();
    const times = this.samples.map((s) => s.time);
    const load: Series[] = [{ label: t.running, values: this.samples.map((s) => s.running) }, { label: t.waiting, values: this.samples.map((s) => s.waiting) }];
    return html`<h2>${t.load}</h2><div class="two">
      ${times.length > 1
        ? html`<horopter-chart .label=${`${t.running}, ${t.waiting}`} .times=${times} .series=${load}></horopter-chart>
          <horopter-chart .label=${`${t.memory}, MB`} .times=${times} .series=${[{ label: "MB", values: this.samples.map((s) => s.megabytes) }]}></horopter-chart>`
        : nothing}
      ${latency.times.length > 1 ? html`<horopter-chart .label=${t.latency} .times=${latency.times} .series=${latency.series}></horopter-chart>` : nothing}</div>`;
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
                ...(this.feed?.connected ? [[t.refused, this.feed.refused] as [string, number]] : []),
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
          </div>${this.charts()}<horopter-recordings></horopter-recordings>`
        : html`<p>${text.busy}</p>`}
    `;
  }
}
