// What all elements look alike in.
import { css } from "lit";

export const shared = css`
  :host { display: block; }
  h1 { font-size: 1.5rem; margin: 0 0 0.75rem; }
  h2 { font-size: 1.1rem; margin: 1.25rem 0 0.5rem; }
  h3 { font-size: 1.05rem; margin: 1rem 0 0.5rem; }
  button, select, input, .button {
    font: inherit; color: var(--text); background: var(--raised); border: 1px solid var(--line);
    border-radius: 6px; padding: 0.4rem 0.75rem; min-height: 2.4rem; box-sizing: border-box;
  }
  button { cursor: pointer; }
  button.main { background: var(--accent); color: var(--on-accent); border-color: var(--accent); font-weight: 600; }
  a.button { text-decoration: none; display: inline-flex; align-items: center; }
  a.button[aria-current] { background: var(--accent); color: var(--on-accent); border-color: var(--accent); }
  button[aria-pressed="true"] { outline: 2px solid var(--accent); }
  button:disabled { opacity: 0.6; cursor: default; }
  :focus-visible { outline: 3px solid var(--accent); outline-offset: 2px; }
  a { color: var(--accent); }
  table { border-collapse: collapse; width: 100%; }
  th, td { text-align: left; padding: 0.35rem 0.6rem; border-bottom: 1px solid var(--line); vertical-align: top; }
  th { color: var(--quiet); font-weight: 600; }
  td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
  .drop { border: 2px dashed var(--line); border-radius: 10px; padding: 1.25rem; text-align: center; }
  .drop.over { border-color: var(--accent); background: var(--raised); }
  .row { display: flex; flex-wrap: wrap; gap: 0.75rem; align-items: end; margin: 0.75rem 0; }
  label { display: flex; flex-direction: column; gap: 0.2rem; color: var(--quiet); }
  .error { border-left: 4px solid var(--bad); background: var(--raised); padding: 0.6rem 0.9rem; margin: 0.75rem 0; white-space: pre-line; overflow-wrap: anywhere; }
  .good { border-left: 4px solid var(--good); background: var(--raised); padding: 0.6rem 0.9rem; margin: 0.75rem 0; }
  .quiet { color: var(--quiet); }
  .hidden { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
`;
