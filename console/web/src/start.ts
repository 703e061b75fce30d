// The way from nothing to a grasp in the robot's base: how far it is gone, and what to do next.
import { html, css, LitElement, nothing } from "lit";
import { customElement, property, state } from "lit/decorators.js";
import { look } from "./poll";
import type { Station } from "./gen/horopter/v1/station_pb";
import type { ServerInfo } from "./gen/horopter/v1/server_pb";
import { listStations } from "./stations";
import { shared } from "./style";
import { text } from "./strings";
import type { Run } from "./run";

const t = text.start;
const EVERY_MS = 3000;

interface Step { title: string; done: boolean; says: string[]; link?: string; label?: string }

@customElement("horopter-start")
export class Start extends LitElement {
  static styles = [
    shared,
    css`
      ol { list-style: none; padding: 0; max-width: 60rem; }
      li.step { border-left: 4px solid var(--line); padding: 0.25rem 1rem 0.75rem; margin: 0.75rem 0; }
      li.done { border-color: var(--good); }
      h2 { margin: 0.25rem 0; }
      ul { margin: 0.25rem 0; }
    `,
  ];
  // The last answer on the page Try.
  @property({ attribute: false }) run?: Run;
  @state() private info?: ServerInfo;
  @state() private stations: Station[] = [];
  @state() private error = "";
  private stop?: () => void;

  connectedCallback() {
    super.connectedCallback();
    const also = async () => { this.stations = await listStations(); };
    this.stop = look(EVERY_MS, ({ info, error }) => { this.info = info; this.error = error; }, also);
  }
  disconnectedCallback() {
    super.disconnectedCallback();
    this.stop?.();
  }

  private steps(): Step[] {
    const info = this.info;
    const answer = this.run?.response;
    const found = (answer?.objects.length ?? 0) > 0;
    const cameras = this.stations.flatMap((s) => s.cameras);
    const grasped = answer?.objects.some((o) => o.grasps.some((g) => g.baseFromGripper)) ?? false;
    const grasps = answer?.objects.some((o) => o.grasps.length > 0) ?? false;
    return [
      { title: t.server, done: !!info && !this.error, says: this.error ? [this.error] : [info ? t.reached(info.version) : text.busy] },
      {
        title: t.part,
        done: (info?.objectCount ?? 0) > 0,
        says: [
          info?.objectCount ? t.parts(info.objectCount) : t.noPart,
          ...(info?.pendingObjectCount ? [t.pending(info.pendingObjectCount)] : []),
          ...(info?.unusableObjectCount ? [t.unusable(info.unusableObjectCount)] : []),
        ],
        link: "#/parts",
        label: text.nav.parts,
      },
      { title: t.photographs, done: !!answer, says: [t.how], link: "#/try", label: text.nav.try },
      {
        title: t.answer,
        done: found,
        says: answer ? [found ? t.found(answer.objects.length) : t.nothing, ...answer.reasons.map((r) => text.reasons[r.kind] ?? r.detail)] : [t.noAnswer],
        link: "#/try",
        label: text.nav.try,
      },
      {
        title: t.base,
        done: grasped,
        says: grasped
          ? [t.grasped]
          : [
              ...(found && !grasps ? [t.noGrasp] : []),
              ...(cameras.length === 0 ? [t.noStation] : cameras.some((c) => c.baseFromCamera) ? [t.nameStation] : [t.noBase]),
            ],
        link: "#/stations",
        label: text.nav.stations,
      },
    ];
  }

  render() {
    const steps = this.steps();
    const next = steps.findIndex((s) => !s.done);
    return html`<h1>${t.title}</h1><p class="quiet">${next < 0 ? t.all : t.next(next + 1)}</p>
      <ol>${steps.map((s, i) => html`<li class="step ${s.done ? "done" : ""}" aria-current=${i === next ? "step" : nothing}>
        <h2>${i + 1}. ${s.title} <span class="quiet">${s.done ? "✓ " + t.done : ""}</span></h2>
        <ul>${s.says.map((line) => html`<li>${line}</li>`)}</ul>
        ${s.link && !s.done ? html`<a href=${s.link}>${t.go(s.label ?? "")}</a>` : nothing}</li>`)}</ol>`;
  }
}
