// An answer with what it was asked of, wherever it comes from: this page's own run, or somebody else's.
import type { Object$ as Part } from "./gen/horopter/v1/catalog_pb";
import type { RecognizeSceneRequest, RecognizeSceneResponse } from "./gen/horopter/v1/recognition_pb";

export interface Photo {
  name: string;
  url: string;         // empty: it cannot be shown
  bytes?: Uint8Array;  // unset: the server has it
  camera?: string;     // of a station
  focalPx?: number;    // known of it
}

export interface Run {
  title: string;
  photos: Photo[];
  request?: RecognizeSceneRequest;
  response: RecognizeSceneResponse;
  seconds: number;
  drawings: string[];  // of the server, object URLs; empty: the page draws
  models: Map<string, Part>;
}
