// Photographs in, an answer with its drawing and its reasons out.
import { create, toBinary } from "@bufbuild/protobuf";
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { idOf, recognition, said, type Session } from "./api";
import { bytesOf, download, encodeRecording, megabytes } from "./files";
import type { Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import {
  OverlayOptions_Format, Priority, RecognizeSceneRequestSchema, RecognizeSceneResponseSchema, type RecognizeSceneRequest,
  type RecognizeSceneResponse,
} from "./gen/horopter/v1/recognition_pb";
import { listParts } from "./parts";
import type { Station } from "./gen/horopter/v1/station_pb";
import { listStations } from "./stations";
import { shared } from "./style";
import { text } from "./strings";
import "./answer";

const t = text.try;
const MOST_IMAGES = 32;

interface Photo { name: string; bytes: Uint8Array; url: string }
export interface Run {
  number: number;
  photos: Photo[];
  request: RecognizeSceneRequest;
  response: RecognizeSceneResponse;
  seconds: number;
  drawings: string[];  // of the server, object URLs
}

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
  private abort?: AbortController;

  updated(changed: Map<string, unknown>) {
    if (changed.has("shown") && this.shown) listStations().then((all) => (this.stations = all), () => undefined);
    if (changed.has("shown") && this.shown) listParts().then((p) => (this.parts = p), (e) => (this.error = said(e)));
    const video = this.renderRoot.querySelector("video");
    if (video && video.srcObject !== this.stream) video.srcObject = this.stream ?? null;
  }

  private async take(files?: FileList | null) {
    this.over = false;
    this.error = "";
    const most = this.session?.max_body_bytes ?? 1e8;
    let total = this.photos.reduce((sum, p) => sum + p.bytes.length, 0);
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
  async ask(photos: Photo[], candidates: string[], explain = "") {
    this.error = "";
    const cameras = this.station?.cameras.map((c) => c.name.split("/").pop()!) ?? [];
    if (this.station && cameras.length < photos.length) {
      this.error = t.tooFewCameras(cameras.length);
      return;
    }
    this.began = this.now = Date.now();
    const ticking = setInterval(() => (this.now = Date.now()), 500);
    this.abort = new AbortController();
    const request = create(RecognizeSceneRequestSchema, {
      images: photos.map((p, i) => ({ source: { case: "content" as const, value: p.bytes }, cameraId: cameras[i] ?? "" })),
      candidateObjects: candidates.map((id) => `objects/${id}`),
      priority: Priority.BATCH,
      overlay: { format: OverlayOptions_Format.SVG },
      station: this.station?.name ?? "",
      stationReadOnly: !!this.station,
      explainObject: explain ? `objects/${explain}` : "",
    });
    try {
      const response = await recognition.recognizeScene(request, { signal: this.abort.signal });
      const drawings = response.overlays.map((o) => URL.createObjectURL(new Blob([o.content as BlobPart], { type: "image/svg+xml" })));
      const run = { number: this.runs.length + 1, photos, request, response, seconds: (Date.now() - this.began) / 1000, drawings };
      this.runs = [...this.runs, run];
      this.left = run.number;
      this.dispatchEvent(new CustomEvent("ran", { detail: run }));
    } catch (error) {
      if (!this.abort.signal.aborted) this.error = said(error);
    }
    clearInterval(ticking);
    this.began = 0;
  }

  private save(run: Run) {
    const about = {
      request_id: run.response.requestId, time: Date.now() / 1000, server_version: this.session?.version ?? "", settings: "",
      code: "OK", message: "", catalog_generation: Number(run.response.catalogGeneration),
    };
    download(`${run.response.requestId || "request"}.horec`,
      encodeRecording(about, toBinary(RecognizeSceneRequestSchema, run.request), toBinary(RecognizeSceneResponseSchema, run.response)));
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
      <button class="main" ?disabled=${this.photos.length === 0 || this.began > 0} @click=${() => this.ask(this.photos, this.candidates)}>${t.run}</button>
      ${this.began ? html`<button @click=${() => this.abort?.abort()}>${t.stop}</button>` : nothing}
      ${this.photos.length ? html`<button @click=${() => (this.photos = [])}>${t.clear}</button>` : nothing}
    </div>
    ${this.station ? html`<p class="quiet">${t.stationHint(this.station.cameras.map((c) => c.name.split("/").pop()).join(", "))}</p>` : nothing}`;
  }

  private answers() {
    if (this.runs.length === 0) return nothing;
    const choose = (label: string, value: number, set: (n: number) => void, none: boolean) => html`<label>${label}
      <select @change=${(e: Event) => set(Number((e.target as HTMLSelectElement).value))}>
        ${none ? html`<option value="0" ?selected=${value === 0}>${t.nothingToCompare}</option>` : nothing}
        ${this.runs.map((r) => html`<option value=${r.number} ?selected=${value === r.number}>${t.run_n(r.number)}</option>`)}
      </select></label>`;
    const both = [this.left, this.right].map((n) => this.runs[n - 1]).filter(Boolean);
    return html`
      <h2>${t.answer}</h2>
      <div class="row">
        ${this.runs.length > 1 ? html`${choose(t.runs, this.left, (n) => (this.left = n), false)}${choose(t.compare, this.right, (n) => (this.right = n), true)}` : nothing}
        <button title=${t.saveHint} @click=${() => this.save(this.runs[this.left - 1])}>${t.save}</button>
      </div>
      <div class="sides">${both.map((run) => html`<horopter-answer .run=${run} .parts=${this.parts} .busy=${this.began > 0}
        @explain=${(e: CustomEvent<string>) => this.ask(run.photos, run.request.candidateObjects.map(idOf), e.detail)}></horopter-answer>`)}</div>
    `;
  }
}
