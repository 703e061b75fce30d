// What others are answered, as it comes: one stream for all pages, as long as one of them looks.
import { answers, Code, isCode, said } from "./api";
import type { WatchedAnswer } from "./gen/horopter/v1/answers_pb";
import { text } from "./strings";

const MOST = 50;
const AGAIN_MS = 2000;

export interface Feed {
  answers: WatchedAnswer[];  // the latest first
  lost: number;
  refused: number;
  connected: boolean;
  error: string;
}

const feed: Feed = { answers: [], lost: 0, refused: 0, connected: false, error: "" };
const listeners = new Set<(feed: Feed) => void>();
let abort: AbortController | undefined;
let after = 0n;

const tell = () => listeners.forEach((listener) => listener({ ...feed }));

function take(answer: WatchedAnswer) {
  feed.refused = Number(answer.refused);
  feed.lost += Number(answer.lost);
  if (answer.number === 0n) return;
  after = answer.number;
  feed.answers = [answer, ...feed.answers.filter((a) => a.requestId !== answer.requestId)].slice(0, MOST);
}

// Who may not, and where nobody may, it is said once.
function wontWork(error: unknown): string {
  if (isCode(error, Code.PermissionDenied)) return text.live.mayNot;
  if (isCode(error, Code.FailedPrecondition)) return text.live.off;
  if (isCode(error, Code.Unimplemented)) return text.live.old;
  if (isCode(error, Code.Unauthenticated)) return text.signIn.over;
  return "";
}

async function run(signal: AbortSignal) {
  while (!signal.aborted) {
    try {
      for await (const answer of answers.watchAnswers({ last: MOST, after, previews: true }, { signal })) {
        feed.connected = true;
        feed.error = "";
        take(answer);
        tell();
      }
    } catch (error) {
      if (signal.aborted) return;
      feed.connected = false;
      const final = wontWork(error);
      feed.error = final || said(error);
      tell();
      if (final) {
        abort = undefined;
        return;
      }
    }
    await new Promise((done) => setTimeout(done, AGAIN_MS));
  }
}

// Returns how to stop.
export function watch(listener: (feed: Feed) => void): () => void {
  listeners.add(listener);
  listener({ ...feed });
  if (!abort) {
    abort = new AbortController();
    run(abort.signal);
  }
  return () => {
    listeners.delete(listener);
    if (listeners.size) return;
    abort?.abort();
    abort = undefined;
    feed.connected = false;
  };
}
