// Questions that are asked again and again while somebody looks.
import { server } from "./api";
import type { ServerInfo } from "./gen/horopter/v1/server_pb";
import { said } from "./api";

export interface Looked { info?: ServerInfo; error: string }

// Calls `tell` every so often until the returned function is called; each time with what is known then.
export function look(everyMs: number, tell: (looked: Looked) => void, also: () => Promise<void> = async () => undefined): () => void {
  let timer = 0;
  let over = false;
  let info: ServerInfo | undefined;
  const once = async () => {
    let error = "";
    try {
      info = await server.getServerInfo({});
      await also();
    } catch (failed) {
      error = said(failed);
    }
    if (over) return;
    tell({ info, error });
    timer = window.setTimeout(once, everyMs);
  };
  once();
  return () => {
    over = true;
    clearTimeout(timer);
  };
}
