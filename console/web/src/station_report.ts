// The check of a station's cameras: what is known of each, how well its last images fitted, and a verdict; to be printed.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { watch, type Feed } from "./feed";
import { CameraBasis_Source } from "./gen/horopter/v1/recognition_pb";
import type { Station, StationCamera } from "./gen/horopter/v1/station_pb";
import { shared } from "./style";
import { text } from "./strings";
import "./chart";
import type { Series } from "./chart";

const t = text.stations;
const last = (name: string) => name.split("/").pop() ?? name;
const GOOD_FOCAL_SIGMA = 0.01;
// Root mean square of an image's residuals: edges of parts are found to a pixel where lens and place are right.
const GOOD_RMS_PX = 1.5;
const GOOD_BASE_SIGMA_M = 0.005;

interface Residuals { times: number[]; byCamera: Map<string, (number | null)[]> }

// Of the answers that are held and name the station, the oldest first.
export function residualsOf(feed: Feed | undefined, station: string): Residuals {
  const answers = [...(feed?.answers ?? [])].reverse().filter((a) => a.request?.station === station && a.response);
  const byCamera = new Map<string, (number | null)[]>();
  answers.forEach((answer, row) => {
    for (const camera of answer.response!.cameras) {
      const measured = camera.bases.filter((b) => b.matches > 0 && b.source !== CameraBasis_Source.STATION);
      const sum = measured.reduce((s, b) => s + b.matches * b.rmsPx * b.rmsPx, 0);
      const count = measured.reduce((s, b) => s + b.matches, 0);
      if (!byCamera.has(camera.cameraId)) byCamera.set(camera.cameraId, answers.map(() => null));
      if (count) byCamera.get(camera.cameraId)![row] = Math.sqrt(sum / count);
    }
  });
  return { times: answers.map((a) => Number(a.answerTime?.seconds ?? 0)), byCamera };
}

const middle = (values: (number | null)[]) => {
  const sorted = values.filter((v) => v !== null).sort((a, b) => a! - b!) as number[];
  return sorted.length ? sorted[Math.floor(sorted.length / 2)] : undefined;
};

// What to do next about a camera; empty: nothing.
export function wantingOf(c: StationCamera, rmsPx?: number): string[] {
  const id = last(c.name);
  const wanting: string[] = [];
  const sigma = c.calibration?.focalLogSigma;
  if (sigma === undefined) wanting.push(t.unknown(id));
  else if (sigma > GOOD_FOCAL_SIGMA) wanting.push(t.vague(id, (100 * sigma).toFixed(1)));
  if (c.baseSource === 0) wanting.push(t.noBase(id));
  else if ((c.basePositionSigmaM ?? 0) > GOOD_BASE_SIGMA_M) wanting.push(t.vagueBase(id, (1000 * c.basePositionSigmaM!).toFixed(1)));
  if (rmsPx !== undefined && rmsPx > GOOD_RMS_PX) wanting.push(t.badFit(id, rmsPx.toFixed(2)));
  return wanting;
}

@customElement("horopter-station-report")
export class StationReport extends LitElement {
  static styles = [shared, css`@media print { button { display: none; } }`];
  @property({ attribute: false }) station?: Station;
  @state() private feed?: Feed;
  private stop?: () => void;

  connectedCallback() {
    super.connectedCallback();
    this.stop = watch((feed) => (this.feed = feed));
  }
  disconnectedCallback() {
    super.disconnectedCallback();
    this.stop?.();
  }

  render() {
    const station = this.station;
    if (!station || station.cameras.length === 0) return nothing;
    const { times, byCamera } = residualsOf(this.feed, station.name);
    const wanting = station.cameras.flatMap((c) => wantingOf(c, middle(byCamera.get(last(c.name)) ?? [])));
    const series: Series[] = [...byCamera].map(([label, values]) => ({ label, values }));
    return html`<h2>${t.verdict}</h2>
      ${wanting.length ? html`<ul>${wanting.map((w) => html`<li>${w}</li>`)}</ul>` : html`<p class="good">${t.good}</p>`}
      <table><thead><tr><th scope="col">${t.camera}</th><th scope="col" class="number">${t.residual}</th><th scope="col" class="number">${t.answersSeen}</th></tr></thead>
        <tbody>${station.cameras.map((c) => {
          const values = byCamera.get(last(c.name)) ?? [];
          const rms = middle(values);
          return html`<tr><td>${last(c.name)}</td><td class="number">${rms === undefined ? "–" : `${rms.toFixed(2)} px`}</td>
            <td class="number">${values.filter((v) => v !== null).length}</td></tr>`;
        })}</tbody></table>
      <p class="quiet">${this.feed?.error || t.residualWhy}</p>
      ${times.length > 1 ? html`<horopter-chart .label=${t.residual} .times=${times} .series=${series}></horopter-chart>` : nothing}
      <p><button @click=${() => window.print()}>${t.print}</button></p>`;
  }
}
