// A photograph with the parts of an answer over it; a click, or Enter, chooses one.
import { html, css, LitElement, nothing, svg } from "lit";
import { customElement, property } from "lit/decorators.js";
import { idOf } from "./api";
import { ExplainedEdge_State } from "./gen/horopter/v1/recognition_pb";
import { edgePath, hullOf } from "./project";
import type { Run } from "./run";
import { shared } from "./style";
import { text } from "./strings";

const t = text.try;
const STATES: Record<number, string> = {
  [ExplainedEdge_State.SUPPORTED]: "supported", [ExplainedEdge_State.UNSUPPORTED]: "unsupported", [ExplainedEdge_State.HIDDEN]: "hidden-edge",
};

@customElement("horopter-picture")
export class Picture extends LitElement {
  static styles = [
    shared,
    css`
      figure { margin: 0; }
      .layers { position: relative; background: var(--raised); border-radius: 6px; overflow: hidden; }
      .layers > img { width: 100%; display: block; }
      .layers > img + img, svg { position: absolute; inset: 0; width: 100%; height: 100%; }
      figcaption { color: var(--quiet); font-size: 0.9rem; }
      path { fill: none; stroke: #e69f00; stroke-width: 2; vector-effect: non-scaling-stroke; }
      path.ambiguous { stroke-dasharray: 6 4; }
      polyline { fill: none; stroke-width: 3; vector-effect: non-scaling-stroke; }
      .supported { stroke: #009e73; }
      .unsupported { stroke: #d55e00; stroke-dasharray: 7 4; }
      .hidden-edge { stroke: #56b4e9; stroke-dasharray: 2 4; }
      rect { fill: none; stroke: #00c8ff; stroke-width: 2; vector-effect: non-scaling-stroke; pointer-events: none; }
      polygon { fill: transparent; stroke: transparent; stroke-width: 3; vector-effect: non-scaling-stroke; cursor: pointer; outline: none; }
      polygon:hover { fill: rgb(255 255 255 / 12%); }
      polygon:focus-visible { stroke: #fff; outline: none; }
      polygon.chosen { stroke: #f0e442; }
      .nothing { position: absolute; inset: auto 0 0 0; margin: 0.5rem; }
      .empty { display: grid; place-items: center; aspect-ratio: 4 / 3; color: var(--quiet); }
    `,
  ];
  @property({ attribute: false }) run?: Run;
  @property({ type: Number }) index = 0;
  @property({ type: Number }) chosen = -1;

  private choose(index: number) {
    this.dispatchEvent(new CustomEvent("chosen", { detail: index }));
  }

  // Names over areas, on the smallest last so that it can be clicked.
  private areas() {
    const { response, models } = this.run!;
    const camera = response.cameras[this.index];
    if (!camera?.recovered) return [];
    return response.objects
      .map((object, i) => {
        const pose = object.images[this.index]?.cameraFromObject;
        const model = models.get(object.object);
        if (!pose || !model) return undefined;
        const hull = hullOf(model, camera, pose);
        const xs = hull.map((p) => p[0]);
        const ys = hull.map((p) => p[1]);
        const size = hull.length ? (Math.max(...xs) - Math.min(...xs)) * (Math.max(...ys) - Math.min(...ys)) : 0;
        return { object, i, hull, size, path: edgePath(model, camera, pose) };
      })
      .filter((a) => a !== undefined && a.hull.length > 2)
      .sort((a, b) => b!.size - a!.size) as { object: (typeof response.objects)[number]; i: number; hull: [number, number][]; size: number; path: string }[];
  }

  render() {
    if (!this.run) return nothing;
    const { response, photos, drawings } = this.run;
    const camera = response.cameras[this.index];
    const photo = photos[this.index];
    const [width, height] = [camera?.imageWidthPx || 1, camera?.imageHeightPx || 1];
    const areas = this.areas();
    const drawing = drawings[this.index];
    const explained = response.explanation?.images[this.index];
    return html`<figure>
      <div class="layers">
        ${photo?.url ? html`<img src=${photo.url} alt=${photo.name || t.photo(this.index)} />` : html`<div class="empty">${t.noPicture}</div>`}
        ${drawing ? html`<img class="drawing" src=${drawing} alt="" />` : nothing}
        <svg viewBox="0 0 ${width} ${height}" preserveAspectRatio="none" role="group" aria-label=${t.partsIn(this.index)}>
          ${drawing ? nothing : areas.map((a) => svg`<path class=${a.object.alternativeObjects.length ? "ambiguous" : ""} d=${a.path} />`)}
          ${drawing ? nothing : camera?.regions.map((r) => svg`<rect x=${r.xPx} y=${r.yPx} width=${r.widthPx} height=${r.heightPx} />`)}
          ${drawing ? nothing : explained?.edges.map((e) => svg`<polyline class=${STATES[e.state] ?? ""} points=${e.pointsPx.join(" ")} />`)}
          ${areas.map((a) => svg`<polygon class=${a.i === this.chosen ? "chosen" : ""} tabindex="0" role="button"
            aria-pressed=${a.i === this.chosen} aria-label=${t.chooseIn(idOf(a.object.object), a.object.score.toFixed(2))}
            points=${a.hull.map((p) => p.map((v) => v.toFixed(1)).join(",")).join(" ")}
            @click=${() => this.choose(a.i)}
            @keydown=${(e: KeyboardEvent) => { if (e.key === "Enter" || e.key === " ") { e.preventDefault(); this.choose(a.i); } }}></polygon>`)}
        </svg>
      </div>
      <figcaption>${photo?.camera || t.photo(this.index)} · ${t.focal}: ${camera?.recovered ? camera.focalPx.toFixed(0) : t.notRecovered}</figcaption>
    </figure>`;
  }
}
