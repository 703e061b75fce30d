// What recognition looks for of a part: the server's own view templates as thumbnails.
import { html, css, LitElement, nothing, svg } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { Vector3 } from "three";
import { catalog, Code, isCode, said } from "./api";
import { ViewTemplate_EdgeKind as Kind, type ListViewTemplatesResponse, type Object$ as Part, type ViewTemplate } from "./gen/horopter/v1/catalog_pb";
import { quaternionOf } from "./shapes";
import { shared } from "./style";
import { text } from "./strings";

const t = text.parts.templates;
const PAGE = 12;
const MARGIN_PX = 6;
const KINDS = [Kind.SILHOUETTE, Kind.OCCLUSION, Kind.CREASE];

// A stroke along the edge at each of its points, as long as they lie apart.
export function strokes(view: ViewTemplate, kind: Kind, lengthPx: number): string {
  const half = lengthPx / 2;
  const path: string[] = [];
  view.kinds.forEach((k, i) => {
    if (k !== kind) return;
    const [u, v] = [view.pointsPx[2 * i], view.pointsPx[2 * i + 1]];
    const [du, dv] = [half * Math.cos(view.directionsRad[i]), half * Math.sin(view.directionsRad[i])];
    path.push(`M${(u - du).toFixed(1)} ${(v - dv).toFixed(1)}L${(u + du).toFixed(1)} ${(v + dv).toFixed(1)}`);
  });
  return path.join("");
}

// Where the camera stands, seen from the part.
export function directionOf(view: ViewTemplate): Vector3 {
  return new Vector3(0, 0, -1).applyQuaternion(quaternionOf(view.cameraFromObject!).invert());
}

@customElement("horopter-view-templates")
export class ViewTemplates extends LitElement {
  static styles = [
    shared,
    css`
      ul { display: flex; flex-wrap: wrap; gap: 0.5rem; list-style: none; padding: 0; margin: 0.5rem 0; }
      li button { padding: 0; line-height: 0; border-radius: 6px; }
      svg { width: 7.5rem; height: 7.5rem; }
      path { fill: none; stroke: var(--text); stroke-width: 2.5; stroke-linecap: round; }
      .k2 { stroke: var(--accent); } .k3 { stroke: var(--quiet); stroke-width: 1.5; }
      span svg { width: 1.5rem; height: 0.8rem; margin-right: 0.3rem; }
    `,
  ];
  @property({ attribute: false }) model?: Part;
  @state() private page?: ListViewTemplatesResponse;
  @state() private views: ViewTemplate[] = [];
  @state() private busy = false;
  @state() private error = "";

  willUpdate(changed: Map<string, unknown>) {
    if (!changed.has("model") || !this.model) return;
    const before = changed.get("model") as Part | undefined;
    if (before?.etag === this.model.etag) return;
    this.page = undefined;
    this.views = [];
    this.more();
  }

  private async more() {
    const { name } = this.model!;
    this.busy = true;
    this.error = "";
    try {
      const page = await catalog.listViewTemplates({ name, pageSize: PAGE, pageToken: this.page?.nextPageToken ?? "" });
      if (name !== this.model?.name) return;
      this.page = page;
      this.views = [...this.views, ...page.templates];
    } catch (error) {
      this.error = isCode(error, Code.FailedPrecondition) ? t.none : isCode(error, Code.Unimplemented) ? t.old : said(error);
    } finally {
      this.busy = false;
    }
  }

  // The part of the image in which there is something, the same for all.
  private box() {
    let [low, high] = [Infinity, 0];
    for (const view of this.views) for (const x of view.pointsPx) [low, high] = [Math.min(low, x), Math.max(high, x)];
    const size = high - low + 2 * MARGIN_PX;
    return `${low - MARGIN_PX} ${low - MARGIN_PX} ${size} ${size}`;
  }

  private thumbnail(view: ViewTemplate, i: number, box: string) {
    return html`<li><button aria-label=${t.from(i + 1)} title=${t.look} @click=${() => this.dispatchEvent(new CustomEvent("look", { detail: directionOf(view) }))}>
      <svg viewBox=${box} role="img" aria-label=${t.view(i + 1, view.kinds.length)}>${KINDS.map((k) => svg`<path class="k${k}" d=${strokes(view, k, 6)} />`)}</svg></button></li>`;
  }

  render() {
    if (!this.model) return nothing;
    const box = this.views.length ? this.box() : "";
    return html`<h2>${t.title}</h2>
      ${this.error ? html`<p class="quiet" role="alert">${this.error}</p>` : html`<p class="quiet">${t.why(this.views.length, this.page?.totalSize ?? 0)}
        ${KINDS.map((k) => html` <span><svg viewBox="0 0 24 12" aria-hidden="true"><path class="k${k}" d="M2 6H22" /></svg>${t.kinds[k]}</span>`)}</p>`}
      <ul>${this.views.map((view, i) => this.thumbnail(view, i, box))}</ul>
      ${this.page?.nextPageToken ? html`<p><button ?disabled=${this.busy} @click=${this.more}>${text.parts.more}</button></p>` : nothing}`;
  }
}
