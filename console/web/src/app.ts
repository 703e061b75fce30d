// The frame of all pages: navigation, sign-in, what the address says.
import { html, css, LitElement, nothing } from "lit";
import { customElement, state } from "lit/decorators.js";
import { forgetRuns } from "./kept_runs";
import { readSession, signIn, signOut, SIGNED_OUT, type Session } from "./api";
import { shared } from "./style";
import { text } from "./strings";
import "./health";
import "./live";
import "./parts";
import "./start";
import "./stations";
import "./try";
import type { Run } from "./run";

const PAGES = ["start", "live", "try", "parts", "stations", "health"] as const;
type Page = (typeof PAGES)[number];

@customElement("horopter-app")
export class App extends LitElement {
  static styles = [
    shared,
    css`
      header { display: flex; flex-wrap: wrap; gap: 0.25rem 1.5rem; align-items: center; padding: 0.5rem 1.25rem; background: var(--raised); border-bottom: 1px solid var(--line); }
      header strong { font-size: 1.15rem; }
      nav { display: flex; gap: 0.25rem; flex: 1; }
      nav a { padding: 0.5rem 0.9rem; border-radius: 6px; text-decoration: none; color: var(--text); }
      nav a[aria-current] { background: var(--accent); color: var(--on-accent); }
      main { padding: 1.25rem; max-width: 1500px; margin: 0 auto; }
      dialog { border: 1px solid var(--line); border-radius: 10px; background: var(--ground); color: var(--text); padding: 1.5rem; max-width: 26rem; }
      dialog::backdrop { background: rgb(0 0 0 / 60%); }
      form { display: flex; flex-direction: column; gap: 0.75rem; }
      .skip:not(:focus) { position: absolute; left: -100rem; }
    `,
  ];

  @state() private hash = location.hash;
  @state() private session?: Session;
  @state() private run?: Run;
  @state() private asking = false;
  @state() private busy = false;
  @state() private over = false;
  @state() private error = "";

  connectedCallback() {
    super.connectedCallback();
    window.addEventListener("hashchange", () => {
      this.hash = location.hash;
      this.updateComplete.then(() => this.renderRoot.querySelector("main")?.focus());
    });
    window.addEventListener(SIGNED_OUT, () => this.ask(true));
    this.begin();
  }

  private get page(): Page {
    const named = this.hash.replace(/^#\/?/, "").split("/")[0] as Page;
    return PAGES.includes(named) ? named : "start";
  }

  private async begin() {
    try {
      this.session = await readSession();
      this.error = "";
    } catch {
      this.error = text.consoleGone;
      setTimeout(() => this.begin(), 2000);
      return;
    }
    if (this.session.signed_in) return;
    // Servers that ask for no token let everybody in.
    const refused = await signIn("").catch(() => text.consoleGone);
    if (refused) this.ask(false, /token|unknown|required/.test(refused) ? "" : refused);
    else this.session = await readSession();
  }

  private ask(over: boolean, error = "") {
    if (this.asking) return;
    this.asking = true;
    this.over = over;
    this.error = error;
    this.updateComplete.then(() => this.renderRoot.querySelector("dialog")?.showModal());
  }

  private async submit(event: SubmitEvent) {
    event.preventDefault();
    const field = this.renderRoot.querySelector<HTMLInputElement>("#token")!;
    this.busy = true;
    this.error = await signIn(field.value).catch(() => text.consoleGone);
    this.busy = false;
    if (this.error) return;
    field.value = "";
    this.renderRoot.querySelector("dialog")?.close();
    this.asking = false;
    this.session = await readSession();
  }

  render() {
    const page = this.page;
    return html`
      <header>
        <button class="skip" @click=${this.toContent}>${text.skip}</button>
        <strong>${text.title}</strong>
        <nav aria-label=${text.nav.label}>
          ${PAGES.map((p) => html`<a href="#/${p}" aria-current=${p === page ? "page" : nothing}>${text.nav[p]}</a>`)}
        </nav>
        ${this.session?.with_token ? html`<button @click=${this.leave}>${text.signIn.out}</button>` : nothing}
      </header>
      <main id="main" tabindex="-1">
        ${this.error && !this.asking ? html`<p class="error" role="alert">${this.error}</p>` : nothing}
        ${this.session?.signed_in
          ? html`
              <horopter-try ?hidden=${page !== "try"} .session=${this.session} .shown=${page === "try"}
                @ran=${(e: CustomEvent<Run>) => (this.run = e.detail)}></horopter-try>
              ${page === "start" ? html`<horopter-start .run=${this.run}></horopter-start>` : nothing}
              ${page === "live" ? html`<horopter-live></horopter-live>` : nothing}
              ${page === "parts" ? html`<horopter-parts .session=${this.session} .path=${this.hash}></horopter-parts>` : nothing}
              ${page === "stations" ? html`<horopter-stations .path=${this.hash}></horopter-stations>` : nothing}
              ${page === "health" ? html`<horopter-health></horopter-health>` : nothing}
            `
          : html`<p>${text.busy}</p>`}
      </main>
      ${this.asking ? this.dialog() : nothing}
    `;
  }

  private dialog() {
    return html`<dialog aria-labelledby="sign-in" @cancel=${(e: Event) => e.preventDefault()}>
      <form @submit=${this.submit}>
        <h1 id="sign-in">${text.signIn.title}</h1>
        <p>${this.over ? text.signIn.over : text.signIn.why}</p>
        <label>${text.signIn.token}<input id="token" type="password" autocomplete="off" required autofocus /></label>
        ${this.error ? html`<p class="error" role="alert">${this.error}</p>` : nothing}
        <button class="main" ?disabled=${this.busy}>${this.busy ? text.signIn.busy : text.signIn.button}</button>
      </form>
    </dialog>`;
  }

  private toContent() {
    this.renderRoot.querySelector("main")?.focus();
  }

  private async leave() {
    await forgetRuns();
    await signOut();
    location.reload();
  }
}
