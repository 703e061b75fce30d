// Photographs in, an answer with its drawing and its reasons out.
import { create, toBinary } from "@bufbuild/protobuf";
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { idOf, recognition, said, type Session } from "./api";
import { bytesOf, download, encodeRecording, megabytes } from "./files";
import { keptRuns, keepRun, forgetRuns } from "./kept_runs";
import { modelsOf } from "./models";
import { whyNothing } from "./refused";
import type { Photo, Run } from "./run";
import type { Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import {
  OverlayOptions_Format, Priority, RecognizeSceneRequestSchema, RecognizeSceneResponseSchema, type Explanation,
  type RecognizeSceneRequest, type RecognizeSceneResponse,
} from "./gen/horopter/v1/recognition_pb";
import { listParts } from "./parts";
import type { Station } from "./gen/horopter/v1/station_pb";
import { listStations } from "./stations";
import { shared } from "./style";
import { text } from "./strings";
import "./answer";

const t = text.try;
const MOST_IMAGES = 32;

@customElement("horopter-try")
export class Try extends LitElement {
  static styles = [
    shared,
    css`
      :host([hidden]) { display: none; }
      .photos { display: flex; flex-wrap: wrap; gap: 0.5rem; margin: 0.75rem 0; padding: 0; list-style: none; }
      .photos li { position: relative; }
      .photos img { height: 6rem; display: block; border-radius: 6px; }
      .photos button { position: absolute; top: 0.2rem; right: 0.2rem; min-height: 0; padding: 0 0.4rem; }
      input[type="file"] { display: none; }
      .sides { display: grid; grid-template-columns: repeat(auto-fit, minmax(28rem, 1fr)); gap: 1.5rem; }
      video { max-width: 20rem; border-radius: 6px; display: block; }
      select[multiple] { min-width: 14rem; height: 6.5rem; }
    `,
  ];
  @property({ attribute: false }) session?: Session;
  @property({ type: Boolean }) shown = false;
  @state() private photos: Photo[] = [];
  @state() private parts?: Part[];
  @state() private candidates: string[] = [];
  @state() private stations: Station[] = [];
  @state() private station?: Station;
  @state() private began = 0;
  @state() private now = 0;
  @state() private error = "";
  @state() private over = false;
  @state() private runs: Run[] = [];
  @state() private left = 0;
  @state() private right = 0;
  @state() private stream?: MediaStream;
  @state() private refused: Record<string, Explanation[]> = {};
  @state() private refusing = "";
  private abort?: AbortController;

  updated(changed: Map<string, unknown>) {
    if (changed.has("shown") && this.shown) listStations().then((all) => (this.stations = all), () => undefined);
    if (changed.has("shown") && this.shown) listParts().then((p) => (this.parts = p), (e) => (this.error = said(e)));
    const video = this.renderRoot.querySelector("video");
    if (video && video.srcObject !== this.stream) video.srcObject = this.stream ?? null;
  }

  connectedCallback() {
    super.connectedCallback();
    window.addEventListener("beforeunload", this.hold);
    if (this.runs.length === 0) this.restore();
  }
  disconnectedCallback() {
    super.disconnectedCallback();
    window.removeEventListener("beforeunload", this.hold);
  }
  // A reload while the server works is asked about first.
  private hold = (event: BeforeUnloadEvent) => {
    if (this.began) event.preventDefault();
  };

  // Runs from before a reload.
  private async restore() {
    for (const kept of await keptRuns()) await this.add(kept.request, kept.response, kept.seconds, kept.names, false);
  }

  private async take(files?: FileList | null) {
    this.over = false;
    this.error = "";
    const most = this.session?.max_body_bytes ?? 1e8;
    let total = this.photos.reduce((sum, p) => sum + p.bytes!.length, 0);
    for (const file of files ?? []) {
      if (this.photos.length >= MOST_IMAGES) {
        this.error = t.tooMany;
        return;
      }
      if (total + file.size > most) {
        this.error = text.tooLarge(file.name, megabytes(file.size), megabytes(most));
        return;
      }
      total += file.size;
      this.photos = [...this.photos, { name: file.name, bytes: await bytesOf(file), url: URL.createObjectURL(file) }];
    }
  }

  private async openCamera() {
    try {
      this.stream = await navigator.mediaDevices.getUserMedia({ video: { width: { ideal: 1920 }, facingMode: "environment" } });
    } catch (error) {
      this.error = t.noCamera + (error as Error).message;
    }
  }

  private closeCamera() {
    this.stream?.getTracks().forEach((track) => track.stop());
    this.stream = undefined;
  }

  private snap() {
    const video = this.renderRoot.querySelector("video")!;
    const canvas = document.createElement("canvas");
    canvas.width = video.videoWidth;
    canvas.height = video.videoHeight;
    canvas.getContext("2d")!.drawImage(video, 0, 0);
    canvas.toBlob(async (blob) => {
      if (!blob) return;
      const name = t.photo(this.photos.length);
      this.photos = [...this.photos, { name, bytes: await bytesOf(blob), url: URL.createObjectURL(blob) }];
    }, "image/png");
  }

  // Asks; with a part to explain also why it is, or is not, there.
  async ask(request: RecognizeSceneRequest, names: string[]) {
    this.error = "";
    this.began = this.now = Date.now();
    const ticking = setInterval(() => (this.now = Date.now()), 500);
    this.abort = new AbortController();
    try {
      const response = await recognition.recognizeScene(request, { signal: this.abort.signal });
      await this.add(request, response, (Date.now() - this.began) / 1000, names, true);
    } catch (error) {
      if (!this.abort.signal.aborted) this.error = said(error);
    }
    clearInterval(ticking);
    this.began = 0;
  }

  private async add(request: RecognizeSceneRequest, response: RecognizeSceneResponse, seconds: number, names: string[], keep: boolean) {
    const models = await modelsOf(response.objects.map((o) => o.object));
    const photos = request.images.map((image, i) => ({
      name: names[i] ?? "", camera: image.cameraId,
      url: image.source.case === "content" ? URL.createObjectURL(new Blob([image.source.value as BlobPart])) : "",
    }));
    const drawings = response.overlays.map((o) => URL.createObjectURL(new Blob([o.content as BlobPart], { type: "image/svg+xml" })));
    const run = { title: t.run_n(this.runs.length + 1), photos, request, response, seconds, drawings, models };
    this.runs = [...this.runs, run];
    this.left = this.runs.length;
    this.dispatchEvent(new CustomEvent("ran", { detail: run }));
    if (keep) await keepRun({ request, response, seconds, names });
  }

  // What is chosen on this page as a request; undefined where the station has fewer cameras.
  private request(): RecognizeSceneRequest | undefined {
    const known = this.station?.cameras.map((c) => c.name.split("/").pop()!) ?? [];
    if (this.station && known.length < this.photos.length) {
      this.error = t.tooFewCameras(known.length);
      return undefined;
    }
    return create(RecognizeSceneRequestSchema, {
      images: this.photos.map((p, i) => ({
        source: { case: "content" as const, value: p.bytes! },
        cameraId: p.camera || (known[i] ?? ""),
        cameraHint: p.focalPx ? { focalPx: p.focalPx } : undefined,
      })),
      candidateObjects: this.candidates.map((id) => `objects/${id}`),
      priority: Priority.BATCH,
      overlay: { format: OverlayOptions_Format.SVG },
      station: this.station?.name ?? "",
      stationReadOnly: !!this.station,
    });
  }

  private recognise() {
    const request = this.request();
    if (request) this.ask(request, this.photos.map((p) => p.name));
  }

  private explain(run: Run, id: string) {
    this.ask(create(RecognizeSceneRequestSchema, { ...run.request!, explainObject: `objects/${id}` }), run.photos.map((p) => p.name));
  }

  // Of each part the best hypothesis and the test that refused it.
  private async why(run: Run) {
    const asked = run.request!.candidateObjects;
    const names = asked.length ? asked : (this.parts ?? []).map((p) => p.name);
    this.began = this.now = Date.now();
    this.abort = new AbortController();
    this.error = "";
    this.refusing = t.refusing(names.length);
    try {
      await whyNothing(run.request!, run.request!.images, names, this.abort.signal, (found, left) => {
        this.refused = { ...this.refused, [run.title]: found };
        this.refusing = t.refusing(left);
      });
    } catch (error) {
      if (!this.abort.signal.aborted) this.error = said(error);
    }
    this.began = 0;
    this.refusing = "";
  }

  private save(request: RecognizeSceneRequest, response?: RecognizeSceneResponse) {
    const about = {
      request_id: response?.requestId ?? "", time: Date.now() / 1000, server_version: this.session?.version ?? "", settings: "",
      code: "OK", message: "", catalog_generation: Number(response?.catalogGeneration ?? 0),
    };
    download(`${response?.requestId || "request"}.horec`, encodeRecording(about, toBinary(RecognizeSceneRequestSchema, request),
      response ? toBinary(RecognizeSceneResponseSchema, response) : new Uint8Array()));
  }

  render() {
    return html`
      <h1>${t.title}</h1>
      <div class="drop ${this.over ? "over" : ""}"
        @dragover=${(e: DragEvent) => { e.preventDefault(); this.over = true; }}
        @dragleave=${() => (this.over = false)}
        @drop=${(e: DragEvent) => { e.preventDefault(); this.take(e.dataTransfer?.files); }}>
        <p>${t.drop}<br /><span class="quiet">${t.intro}</span></p>
        <button @click=${() => this.renderRoot.querySelector<HTMLInputElement>("#photos")!.click()}>${t.choose}</button>
        <button @click=${this.openCamera}>${t.camera}</button>
        <input id="photos" type="file" multiple accept="image/*,.heic" aria-label=${t.choose}
          @change=${(e: Event) => { const f = e.target as HTMLInputElement; this.take(f.files).then(() => (f.value = "")); }} />
      </div>
      ${this.stream
        ? html`<div class="row"><video autoplay muted playsinline aria-label=${t.camera}></video>
            <button class="main" @click=${this.snap}>${t.snap}</button><button @click=${this.closeCamera}>${text.close}</button></div>`
        : nothing}
      ${this.photos.length
        ? html`<ul class="photos">${this.photos.map((p, i) => html`<li><img src=${p.url} alt=${p.name} />
            <button aria-label=${t.remove(p.name)} @click=${() => (this.photos = this.photos.filter((_, k) => k !== i))}>×</button></li>`)}</ul>`
        : nothing}
      ${this.controls()}
      ${this.error ? html`<p class="error" role="alert">${this.error}</p>` : nothing}
      <div role="status">${this.began ? html`<p>${t.running(Math.round((this.now - this.began) / 1000))}</p>` : nothing}</div>
      ${this.answers()}
    `;
  }

  private controls() {
    if (this.parts?.length === 0) return html`<p>${t.noParts} <a href="#/parts">${text.nav.parts}</a></p>`;
    return html`<div class="row">
      <label>${t.candidates}
        <select multiple @change=${(e: Event) => (this.candidates = [...(e.target as HTMLSelectElement).selectedOptions].map((o) => o.value).filter(Boolean))}>
          <option value="" ?selected=${this.candidates.length === 0}>${t.allParts}</option>
          ${this.parts?.map((p) => html`<option value=${idOf(p.name)}>${idOf(p.name)}</option>`)}
        </select></label>
      ${this.stations.length
        ? html`<label>${t.station}
            <select @change=${(e: Event) => (this.station = this.stations.find((s) => s.name === (e.target as HTMLSelectElement).value))}>
              <option value="">${t.noStation}</option>
              ${this.stations.map((s) => html`<option value=${s.name}>${s.name.split("/")[1]}</option>`)}
            </select></label>`
        : nothing}
      <button class="main" ?disabled=${this.photos.length === 0 || this.began > 0} @click=${this.recognise}>${t.run}</button>
      ${this.began ? html`<button @click=${() => this.abort?.abort()}>${t.stop}</button>` : nothing}
      ${this.photos.length
        ? html`<button @click=${() => (this.photos = [])}>${t.clear}</button>
            <button title=${t.saveHint} @click=${() => { const r = this.request(); if (r) this.save(r); }}>${t.saveRequest}</button>`
        : nothing}
    </div>
    ${this.hints()}
    ${this.station ? html`<p class="quiet">${t.stationHint(this.station.cameras.map((c) => c.name.split("/").pop()).join(", "))}</p>` : nothing}`;
  }

  // What is known of the cameras.
  private hints() {
    if (this.photos.length === 0) return nothing;
    const set = (photo: Photo, change: Partial<Photo>) => (this.photos = this.photos.map((p) => (p === photo ? { ...p, ...change } : p)));
    const known = this.station?.cameras.map((c) => c.name.split("/").pop()!) ?? [];
    return html`<details><summary>${t.hints}</summary><p class="quiet">${t.hintsWhy}</p><table>
      <thead><tr><th scope="col">${t.photograph}</th><th scope="col">${t.cameraName}</th><th scope="col">${t.focal}</th></tr></thead>
      <tbody>${this.photos.map((p, i) => html`<tr><td>${p.name}</td>
        <td><input aria-label=${`${t.cameraName} ${i + 1}`} pattern="[a-z0-9_\\-]{1,63}" list="cameras" placeholder=${known[i] ?? ""} .value=${p.camera ?? ""}
          @change=${(e: Event) => set(p, { camera: (e.target as HTMLInputElement).value.trim() })} /></td>
        <td><input aria-label=${`${t.focal} ${i + 1}`} type="number" min="1" step="any" .value=${p.focalPx ? String(p.focalPx) : ""}
          @change=${(e: Event) => set(p, { focalPx: Number((e.target as HTMLInputElement).value) || undefined })} /></td></tr>`)}</tbody></table>
      <datalist id="cameras">${known.map((k) => html`<option value=${k}></option>`)}</datalist></details>`;
  }

  private answers() {
    if (this.runs.length === 0) return nothing;
    const choose = (label: string, value: number, set: (n: number) => void, none: boolean) => html`<label>${label}
      <select @change=${(e: Event) => set(Number((e.target as HTMLSelectElement).value))}>
        ${none ? html`<option value="0" ?selected=${value === 0}>${t.nothingToCompare}</option>` : nothing}
        ${this.runs.map((r, i) => html`<option value=${i + 1} ?selected=${value === i + 1}>${r.title}</option>`)}
      </select></label>`;
    const both = [this.left, this.right].map((n) => this.runs[n - 1]).filter(Boolean);
    return html`
      <h2>${t.answer}</h2>
      <div class="row">
        ${this.runs.length > 1 ? html`${choose(t.runs, this.left, (n) => (this.left = n), false)}${choose(t.compare, this.right, (n) => (this.right = n), true)}` : nothing}
        <button title=${t.saveHint} @click=${() => this.save(this.runs[this.left - 1].request!, this.runs[this.left - 1].response)}>${t.save}</button>
        <button @click=${() => { this.runs = []; this.left = this.right = 0; forgetRuns(); }}>${t.forget}</button>
      </div>
      <div class="sides">${both.map((run) => html`<horopter-answer .run=${run} .parts=${this.parts} .busy=${this.began > 0}
        .refused=${this.refused[run.title]} .refusing=${this.refusing} @why-nothing=${() => this.why(run)}
        @explain=${(e: CustomEvent<string>) => this.explain(run, e.detail)}></horopter-answer>`)}</div>
    `;
  }
}
