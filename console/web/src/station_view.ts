// A station's cameras in three dimensions: where they are in the robot's base or their rig, and how surely.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { Box3, Group, Vector3 } from "three";
import type { Station, StationCamera } from "./gen/horopter/v1/station_pb";
import { Orbit } from "./orbit";
import { axes, cameraLines, ellipsoid, lights, matrixOf } from "./shapes";
import { shared } from "./style";
import { text } from "./strings";

const t = text.stations;

// Camera to what is drawn: the base where it is known of any, else the rig.
function placeOf(camera: StationCamera, inBase: boolean) {
  if (inBase) return camera.baseFromCamera && matrixOf(camera.baseFromCamera);
  return camera.cameraFromRig && matrixOf(camera.cameraFromRig).invert();
}

@customElement("horopter-station-view")
export class StationView extends LitElement {
  static styles = [shared, css`.view { width: 100%; max-width: 48rem; aspect-ratio: 16 / 9; border: 1px solid var(--line); border-radius: 8px; overflow: hidden; touch-action: none; background: var(--raised); } canvas { width: 100%; height: 100%; display: block; }`];
  @property({ attribute: false }) station?: Station;
  @state() private flat = false;
  private orbit = new Orbit();

  disconnectedCallback() {
    super.disconnectedCallback();
    this.orbit.detach();
  }

  private get inBase() {
    return !!this.station?.cameras.some((c) => c.baseFromCamera);
  }

  updated(changed: Map<string, unknown>) {
    const canvas = this.renderRoot.querySelector("canvas");
    if (!changed.has("station") || !this.station || !canvas) return;
    if (!this.orbit.attach(canvas)) {
      this.flat = true;
      return;
    }
    const { scene, center } = this.orbit;
    scene.clear();
    const places = this.station.cameras.map((c) => placeOf(c, this.inBase));
    const points = places.flatMap((m) => (m ? [new Vector3().setFromMatrixPosition(m)] : []));
    const size = Math.max(0.2, new Box3().setFromPoints([new Vector3(), ...points]).getSize(new Vector3()).length());
    scene.add(axes(0.25 * size), ...lights());
    const drawn = new Group();
    this.station.cameras.forEach((camera, i) => {
      const place = places[i];
      if (!place) return;
      const k = camera.calibration?.k ?? [];
      const [x, y] = k.length === 9 && k[0] > 0
        ? [camera.calibration!.imageWidthPx / 2 / k[0], camera.calibration!.imageHeightPx / 2 / k[4]]
        : [0.5, 0.375];
      const pyramid = cameraLines(x, y, 0.3 * size, camera.baseSource === 1 ? "#0072b2" : "#56b4e9");
      pyramid.applyMatrix4(place);
      drawn.add(pyramid);
      const sigma = this.inBase ? (camera.basePositionSigmaM ?? 0) : camera.translationSigmaM;
      const covariance = new Array(36).fill(0);
      for (const d of [21, 28, 35]) covariance[d] = sigma * sigma;
      drawn.add(ellipsoid(covariance, new Vector3().setFromMatrixPosition(place), 0.008 * size));
    });
    scene.add(drawn);
    new Box3().setFromPoints([new Vector3(), ...points]).getCenter(center);
    this.orbit.size = 1.3 * size;
    this.orbit.draw();
  }

  render() {
    if (!this.station?.cameras.some((c) => placeOf(c, this.inBase))) return nothing;
    if (this.flat) return html`<p class="quiet">${text.scene.noWebGl}</p>`;
    return html`<div class="view" tabindex="0" role="group" aria-label=${t.view}
        @keydown=${(e: KeyboardEvent) => this.orbit.onKey(e)} @pointerdown=${(e: PointerEvent) => this.orbit.onDown(e)}
        @pointermove=${(e: PointerEvent) => this.orbit.onMove(e)} @wheel=${(e: WheelEvent) => this.orbit.onWheel(e)}><canvas aria-hidden="true"></canvas></div>
      <p class="quiet">${text.parts.turn} ${this.inBase ? t.viewBase : t.viewRig}</p>`;
  }
}
