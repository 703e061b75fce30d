// The last runs of the page Try, kept by the browser over a reload; a browser that keeps nothing is no fault.
import { fromBinary, toBinary } from "@bufbuild/protobuf";
import {
  RecognizeSceneRequestSchema, RecognizeSceneResponseSchema, type RecognizeSceneRequest, type RecognizeSceneResponse,
} from "./gen/horopter/v1/recognition_pb";

const MOST = 8;
const MOST_BYTES = 200e6;

interface KeptRun { request: RecognizeSceneRequest; response: RecognizeSceneResponse; seconds: number; names: string[] }
interface Stored { request: Uint8Array; response: Uint8Array; seconds: number; names: string[] }

function opened(): Promise<IDBDatabase> {
  return new Promise((done, failed) => {
    const asked = indexedDB.open("horopter", 1);
    asked.onupgradeneeded = () => asked.result.createObjectStore("runs", { autoIncrement: true });
    asked.onsuccess = () => done(asked.result);
    asked.onerror = () => failed(asked.error);
  });
}

function ended<T>(asked: IDBRequest<T>): Promise<T> {
  return new Promise((done, failed) => {
    asked.onsuccess = () => done(asked.result);
    asked.onerror = () => failed(asked.error);
  });
}

export async function keptRuns(): Promise<KeptRun[]> {
  try {
    const all = await ended((await opened()).transaction("runs").objectStore("runs").getAll() as IDBRequest<Stored[]>);
    return all.map((s) => ({
      ...s,
      request: fromBinary(RecognizeSceneRequestSchema, s.request),
      response: fromBinary(RecognizeSceneResponseSchema, s.response),
    }));
  } catch {
    return [];
  }
}

export async function keepRun(run: KeptRun) {
  const stored: Stored = {
    ...run, request: toBinary(RecognizeSceneRequestSchema, run.request), response: toBinary(RecognizeSceneResponseSchema, run.response),
  };
  try {
    const runs = (await opened()).transaction("runs", "readwrite").objectStore("runs");
    const [keys, all] = [await ended(runs.getAllKeys()), await ended(runs.getAll() as IDBRequest<Stored[]>)];
    let bytes = stored.request.length + stored.response.length;
    if (bytes > MOST_BYTES) return;
    // The oldest go first.
    for (let i = all.length - 1; i >= 0; --i) {
      bytes += all[i].request.length + all[i].response.length;
      if (bytes > MOST_BYTES || all.length - i >= MOST) runs.delete(keys[i]);
    }
    await ended(runs.add(stored));
  } catch {
    // Private windows and full disks keep nothing.
  }
}

export async function forgetRuns() {
  try {
    (await opened()).transaction("runs", "readwrite").objectStore("runs").clear();
  } catch {
    // There is nothing.
  }
}
