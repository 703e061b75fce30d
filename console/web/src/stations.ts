// Stations: what is known of fixed cameras, how surely, and what was noticed of them.
import { create, toJson } from "@bufbuild/protobuf";
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { Code, isCode, said, stations } from "./api";
import { parseCalibration, toRosYaml } from "./calibration_files";
import { download } from "./files";
import {
  CameraCalibrationSchema, StationEvent_Kind, StationSchema, type Station, type StationCamera, type StationEvent,
} from "./gen/horopter/v1/station_pb";
import { shared } from "./style";
import { text } from "./strings";
import "./station_report";
import "./station_view";

const t = text.stations;
const last = (name: string) => name.split("/").pop() ?? name;
const degrees = (rad: number) => ((180 / Math.PI) * rad).toFixed(3);
const ALARMS = [StationEvent_Kind.CAMERA_MOVED, StationEvent_Kind.LENS_CHANGED, StationEvent_Kind.CAMERAS_SWAPPED, StationEvent_Kind.BASE_MOVED];

export async function listStations(): Promise<Station[]> {
  const all: Station[] = [];
  let pageToken = "";
  do {
    const page = await stations.listStations({ pageSize: 1000, pageToken });
    all.push(...page.stations);
    pageToken = page.nextPageToken;
  } while (pageToken);
  return all;
}

@customElement("horopter-stations")
export class Stations extends LitElement {
  static styles = [shared, css`.alarm { color: var(--bad); font-weight: 600; } input[type="file"] { display: none; }`];
  @property() path = "";
  @state() private all?: Station[];
  @state() private station?: Station;
  @state() private newId = "";
  @state() private error = "";
  @state() private done = "";
  @state() private sure = "";
  private importing = "";

  willUpdate(changed: Map<string, unknown>) {
    if (changed.has("path")) this.load();
  }

  private get stationId() {
    return this.path.match(/^#\/stations\/([a-z0-9_-]+)$/)?.[1] ?? "";
  }

  private async load() {
    this.error = this.sure = "";
    this.station = undefined;
    await this.doing(async () => {
      if (this.stationId) this.station = await stations.getStation({ name: `stations/${this.stationId}` });
      else this.all = await listStations();
    });
  }

  private async doing(what: () => Promise<void>) {
    this.error = this.done = "";
    try {
      await what();
    } catch (error) {
      this.error = isCode(error, Code.Aborted) ? t.changed : said(error);
    }
  }

  private make = (event: SubmitEvent) => {
    event.preventDefault();
    return this.doing(async () => {
      await stations.updateStation({ station: create(StationSchema, { name: `stations/${this.newId}` }), allowMissing: true });
      location.hash = `#/stations/${this.newId}`;
    });
  };

  private reset(name: string) {
    return this.doing(async () => {
      this.station = await stations.resetStation({ name, ifMatch: this.station!.etag, keepBase: true });
      this.sure = "";
      this.done = t.wasReset;
    });
  }

  private save(camera: StationCamera, ros: boolean) {
    return this.doing(async () => {
      const calibration = await stations.exportCalibration({ name: camera.name });
      const name = `${this.stationId}-${last(camera.name)}`;
      if (ros) return download(`${name}.yaml`, [toRosYaml(name, calibration)], "application/yaml");
      return download(`${name}.json`, [JSON.stringify(toJson(CameraCalibrationSchema, calibration), null, 1)], "application/json");
    });
  }

  private async take(field: HTMLInputElement) {
    const file = field.files?.[0];
    if (!file) return;
    await this.doing(async () => {
      const calibration = parseCalibration(file.name, await file.text());
      this.station = await stations.importCalibration({ name: this.importing, calibration, ifMatch: this.station!.etag });
      this.done = t.imported;
    });
    field.value = "";
  }

  render() {
    return html`
      ${this.stationId ? html`<p><a href="#/stations">← ${t.back}</a></p><h1>${this.stationId}</h1>` : html`<h1>${t.title}</h1><p class="quiet">${t.intro}</p>`}
      ${this.error ? html`<p class="error" role="alert">${this.error}</p>` : nothing}
      <div role="status">${this.done ? html`<p class="good">${this.done}</p>` : nothing}</div>
      ${this.stationId ? (this.station ? this.one(this.station) : nothing) : this.list()}
    `;
  }

  private list() {
    return html`
      <form class="row" @submit=${this.make}>
        <label>${t.newId} (${text.parts.idHint})
          <input required pattern="[a-z0-9_\\-]{1,63}" .value=${this.newId} @input=${(e: Event) => (this.newId = (e.target as HTMLInputElement).value)} /></label>
        <button>${t.make}</button>
      </form>
      ${this.all?.length === 0 ? html`<p>${t.none}</p>` : nothing}
      ${this.all?.length
        ? html`<table><thead><tr><th scope="col">${t.station}</th><th scope="col" class="number">${t.cameras}</th><th scope="col" class="number">${t.requests}</th></tr></thead>
            <tbody>${this.all.map((s) => html`<tr><td><a href="#/stations/${last(s.name)}">${last(s.name)}</a> ${s.displayName}</td>
              <td class="number">${s.cameras.length}</td><td class="number">${String(s.requestCount)}</td></tr>`)}</tbody></table>`
        : nothing}
    `;
  }

  private one(station: Station) {
    return html`
      <h2>${t.cameras}</h2>
      ${station.cameras.length ? this.cameras(station.cameras) : html`<p class="quiet">${t.noCameras}</p>`}
      <input id="calibration" type="file" accept=".json,.yaml,.yml" aria-label=${t.import} @change=${(e: Event) => this.take(e.target as HTMLInputElement)} />
      <horopter-station-view .station=${station}></horopter-station-view>
      <horopter-station-report .station=${station}></horopter-station-report>
      <h2>${t.events}</h2>
      ${station.events.length ? html`<table><tbody>${station.events.map((e) => this.event(e))}</tbody></table>` : html`<p class="quiet">${t.noEvents}</p>`}
      ${this.sure
        ? html`<div class="error" role="alert">${t.sure(last(this.sure))}
            <div class="row"><button @click=${() => this.reset(this.sure)}>${t.reset}</button><button @click=${() => (this.sure = "")}>${text.cancel}</button></div></div>`
        : html`<p><button @click=${() => (this.sure = station.name)}>${t.reset}</button></p>`}
    `;
  }

  private cameras(cameras: StationCamera[]) {
    return html`<table>
      <thead><tr><th scope="col">${t.camera}</th><th scope="col" class="number">${t.requests}</th><th scope="col" class="number">${t.focal}</th>
        <th scope="col" class="number">${t.place}</th><th scope="col">${t.base}</th><th scope="col">${t.calibration}</th></tr></thead>
      <tbody>${cameras.map((c) => {
        const known = c.calibration?.focalLogSigma !== undefined && c.calibration.k.length === 9;
        return html`<tr><td>${last(c.name)}</td><td class="number">${String(c.requestCount)}</td>
          <td class="number">${known ? `${c.calibration!.k[0].toFixed(1)} ± ${(100 * c.calibration!.focalLogSigma!).toFixed(2)} %` : "–"}</td>
          <td class="number">${c.cameraFromRig && c.rotationSigmaRad === 0 ? t.rig : c.cameraFromRig ? `± ${degrees(c.rotationSigmaRad)}°, ± ${(1000 * c.translationSigmaM).toFixed(2)} mm` : "–"}</td>
          <td>${t.bases[c.baseSource] ?? ""}${c.basePositionSigmaM !== undefined ? ` ± ${(1000 * c.basePositionSigmaM).toFixed(1)} mm` : ""}</td>
          <td><button ?disabled=${!known} @click=${() => this.save(c, false)}>${t.export}</button>
            <button ?disabled=${!known} @click=${() => this.save(c, true)}>${t.exportRos}</button>
            <button @click=${() => { this.importing = c.name; this.renderRoot.querySelector<HTMLInputElement>("#calibration")!.click(); }}>${t.import}</button></td></tr>`;
      })}</tbody></table>`;
  }

  private event(e: StationEvent) {
    const when = e.time ? new Date(1000 * Number(e.time.seconds)).toLocaleString() : "";
    return html`<tr><td>${when}</td><td class=${ALARMS.includes(e.kind) ? "alarm" : ""}>${t.kinds[e.kind] ?? ""}</td>
      <td>${e.cameras.map(last).join(", ")}</td><td>${e.detail}</td></tr>`;
  }
}
