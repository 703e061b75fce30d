// What others are answered, as it comes, and why each answer is what it is.
import { html, css, LitElement, nothing } from "lit";
import { customElement, state } from "lit/decorators.js";
import { answers, Code, idOf, isCode, recognition, said } from "./api";
import { watch, type Feed } from "./feed";
import type { WatchedAnswer } from "./gen/horopter/v1/answers_pb";
import type { Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import type { Explanation, RecognizeSceneResponse, SceneImage } from "./gen/horopter/v1/recognition_pb";
import { modelsOf } from "./models";
import { listParts } from "./parts";
import { explaining, whyNothing } from "./refused";
import type { Run } from "./run";
import { shared } from "./style";
import { text } from "./strings";
import "./answer";

const t = text.live;
const secondsOf = (d?: { seconds: bigint; nanos: number }) => Number(d?.seconds ?? 0) + (d?.nanos ?? 0) / 1e9;

@customElement("horopter-live")
export class Live extends LitElement {
  static styles = [
    shared,
    css`
      .two { display: grid; grid-template-columns: minmax(18rem, 24rem) 1fr; gap: 0 1.5rem; }
      @media (max-width: 900px) { .two { grid-template-columns: 1fr; } }
      ol { list-style: none; padding: 0; margin: 0; max-height: 75vh; overflow: auto; }
      li button { width: 100%; text-align: left; margin-bottom: 0.3rem; }
      li button.failed { border-left: 5px solid var(--bad); }
      li button.found { border-left: 5px solid var(--good); }
      .follow { flex-direction: row; align-items: center; }
      .follow input { min-height: 0; }
    `,
  ];
  @state() private feed?: Feed;
  @state() private shown?: WatchedAnswer;
  @state() private run?: Run;
  @state() private follow = true;
  @state() private parts?: Part[];
  @state() private busy = false;
  @state() private error = "";
  @state() private refused?: Explanation[];
  @state() private refusing = "";
  private stop?: () => void;
  private abort?: AbortController;
  private urls: string[] = [];

  connectedCallback() {
    super.connectedCallback();
    listParts().then((p) => (this.parts = p), () => undefined);
    this.stop = watch((feed) => {
      this.feed = feed;
      const last = feed.answers[0];
      // What is asked here for reasons is an answer, too: it does not take the place of what it explains.
      if (this.follow && !this.busy && last && last !== this.shown && !last.request?.explainObject) this.show(last);
    });
  }

  disconnectedCallback() {
    super.disconnectedCallback();
    this.stop?.();
    this.abort?.abort();
    this.urls.forEach((url) => URL.revokeObjectURL(url));
    this.urls = [];
  }

  private async show(answer: WatchedAnswer) {
    this.shown = answer;
    this.error = "";
    this.refused = undefined;
    this.refusing = "";
    if (!answer.response) {
      this.run = undefined;
      return;
    }
    const run = await this.runOf(answer, answer.response, t.answer(String(answer.number)), secondsOf(answer.elapsed));
    if (this.shown === answer) this.run = run;
  }

  private async runOf(answer: WatchedAnswer, response: RecognizeSceneResponse, title: string, seconds: number): Promise<Run> {
    const names = response.objects.map((o) => o.object);
    if (response.explanation) names.push(response.explanation.object);
    const models = await modelsOf(names);
    this.urls.forEach((url) => URL.revokeObjectURL(url));
    this.urls = answer.previews.map((p) => (p.jpeg.length ? URL.createObjectURL(new Blob([p.jpeg as BlobPart], { type: "image/jpeg" })) : ""));
    const photos = response.cameras.map((c, i) => ({ name: "", url: this.urls[i] ?? "", camera: c.cameraId }));
    return { title, photos, request: answer.request, response, seconds, drawings: [], models };
  }

  // Asks with the images as they came; the server holds the last of them.
  private async asking(what: (answer: WatchedAnswer, images: SceneImage[], signal: AbortSignal) => Promise<void>) {
    const shown = this.shown!;
    this.busy = true;
    this.error = "";
    this.abort = new AbortController();
    try {
      const whole = await answers.getAnswer({ number: shown.number });
      if (whole.images.length === 0 || !shown.request) this.error = t.gone;
      else await what(shown, whole.images, this.abort.signal);
    } catch (error) {
      const failed = said(error);
      if (!this.abort.signal.aborted) this.error = isCode(error, Code.NotFound) ? t.gone : failed;
    }
    this.busy = false;
    this.refusing = "";
  }

  private explain(id: string) {
    return this.asking(async (answer, images, signal) => {
      const began = Date.now();
      const response = await recognition.recognizeScene(explaining(answer.request!, images, `objects/${id}`), { signal });
      this.run = await this.runOf(answer, response, t.again(String(answer.number)), (Date.now() - began) / 1000);
    });
  }

  private whyNothing() {
    return this.asking(async (answer, images, signal) => {
      const asked = answer.request!.candidateObjects;
      const names = asked.length ? asked : (this.parts ?? []).map((p) => p.name);
      this.refusing = text.try.refusing(names.length);
      await whyNothing(answer.request!, images, names, signal, (found, left) => {
        this.refused = found;
        this.refusing = text.try.refusing(left);
      });
    });
  }

  render() {
    const feed = this.feed;
    return html`
      <h1>${t.title}</h1>
      ${feed?.error ? html`<p class="error" role="alert">${feed.error}</p>` : nothing}
      <div class="row">
        <label class="follow"><input type="checkbox" .checked=${this.follow} @change=${(e: Event) => this.following((e.target as HTMLInputElement).checked)} />${t.follow}</label>
        <span role="status" class="quiet">${feed?.connected ? t.connected : text.busy}
          ${feed?.lost ? t.lost(feed.lost) : ""} ${feed?.refused ? t.refused(feed.refused) : ""}</span>
      </div>
      <div class="two">
        <ol aria-label=${t.list}>${feed?.answers.map((a) => html`<li>${this.row(a)}</li>`)}</ol>
        <div>${this.detail()}</div>
      </div>
      ${feed?.connected && feed.answers.length === 0 ? html`<p>${t.none}</p>` : nothing}
    `;
  }

  private following(on: boolean) {
    this.follow = on;
    const newest = this.feed?.answers[0];
    if (on && newest) this.show(newest);
  }

  private row(a: WatchedAnswer) {
    const objects = a.response?.objects ?? [];
    const when = a.answerTime ? new Date(1000 * Number(a.answerTime.seconds)).toLocaleTimeString() : "";
    const what = a.code
      ? t.failed(Code[a.code] ?? String(a.code))
      : objects.length ? objects.map((o) => `${idOf(o.object)} ${o.score.toFixed(2)}`).join(", ") : (text.reasons[a.response?.reasons[0]?.kind ?? 1] ?? text.try.nothing);
    return html`<button class=${a.code || objects.length === 0 ? "failed" : "found"} aria-pressed=${a === this.shown}
      @click=${() => { this.follow = false; this.show(a); }}>
      <strong>${when}</strong> <span class="quiet">${a.caller} ${a.request?.station ? idOf(a.request.station).replace("stations/", "") : ""} ${secondsOf(a.elapsed).toFixed(1)} s</span><br />${what}</button>`;
  }

  private detail() {
    const a = this.shown;
    if (!a) return nothing;
    return html`
      <h2>${text.try.answer}</h2>
      ${this.error ? html`<p class="error" role="alert">${this.error}</p>` : nothing}
      <div role="status">${this.busy ? html`<p>${t.asking} <button @click=${() => this.abort?.abort()}>${text.try.stop}</button></p>` : nothing}</div>
      ${a.code ? html`<p class="error">${t.failed(Code[a.code] ?? String(a.code))}: ${a.message}</p>` : nothing}
      ${this.run
        ? html`<horopter-answer .run=${this.run} .parts=${this.parts} .busy=${this.busy} .canAsk=${!a.imagesLeftOut} .refused=${this.refused} .refusing=${this.refusing}
            @explain=${(e: CustomEvent<string>) => this.explain(e.detail)} @why-nothing=${this.whyNothing}></horopter-answer>
          ${a.imagesLeftOut ? html`<p class="quiet">${t.gone}</p>` : nothing}`
        : nothing}
      <p class="quiet">${t.requestId(a.requestId)}</p>`;
  }
}
