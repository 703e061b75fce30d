// Lines over time (uPlot), with a table of the last values for who cannot see them.
import { html, css, LitElement, unsafeCSS } from "lit";
import { customElement, property } from "lit/decorators.js";
import uPlot from "uplot";
import uplotStyle from "uplot/dist/uPlot.min.css?inline";
import { shared } from "./style";

// Okabe and Ito's, told apart by dashes as well.
const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#8c510a"];
const DASHES = [[], [8, 4], [2, 3], [12, 3, 2, 3], [5, 5], [1, 2], [10, 2], [4, 2, 1, 2]];

export interface Series { label: string; values: (number | null)[] }

@customElement("horopter-chart")
export class Chart extends LitElement {
  static styles = [unsafeCSS(uplotStyle), shared, css`.plot { width: 100%; min-height: 12rem; } .u-legend { color: var(--text); font-size: 0.85rem; } figure { margin: 0.5rem 0; } figcaption { color: var(--quiet); }`];
  @property() label = "";
  @property({ attribute: false }) times: number[] = [];  // seconds since 1970
  @property({ attribute: false }) series: Series[] = [];
  private plot?: uPlot;
  private drawn = "";
  private watcher = new ResizeObserver(() => this.plot?.setSize(this.extent()));

  disconnectedCallback() {
    super.disconnectedCallback();
    this.watcher.disconnect();
    this.plot?.destroy();
    this.plot = undefined;
    this.drawn = "";
  }

  private extent() {
    return { width: this.renderRoot.querySelector(".plot")?.clientWidth || 400, height: 180 };
  }

  updated() {
    const place = this.renderRoot.querySelector<HTMLElement>(".plot")!;
    const data = [this.times, ...this.series.map((s) => s.values)] as uPlot.AlignedData;
    const labels = this.series.map((s) => s.label).join("\n");
    if (this.plot && labels === this.drawn) return this.plot.setData(data);
    this.plot?.destroy();
    const ink = getComputedStyle(this).getPropertyValue("--text");
    const axis = { stroke: ink, grid: { stroke: "rgb(128 128 128 / 30%)" }, ticks: { stroke: ink } };
    this.plot = new uPlot({
      ...this.extent(),
      series: [{}, ...this.series.map((s, i) => ({ label: s.label, stroke: COLORS[i % COLORS.length], dash: DASHES[i % DASHES.length], width: 2 }))],
      axes: [axis, axis],
      scales: { y: { range: (_, low, high) => [Math.min(0, low ?? 0), (high || 1) * 1.1] } },
    }, data, place);
    this.drawn = labels;
    this.watcher.observe(place);
    return undefined;
  }

  render() {
    return html`<figure><figcaption>${this.label}</figcaption><div class="plot" role="img" aria-label=${`${this.label}: ${this.series
      .map((s) => `${s.label} ${s.values.filter((v) => v !== null).slice(-1)[0]?.toFixed(1) ?? "–"}`).join(", ")}`}></div></figure>`;
  }
}
