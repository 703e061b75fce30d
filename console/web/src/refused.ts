// "Nothing found": of each part the best hypothesis and the test that refused it, one question after the other.
import { create } from "@bufbuild/protobuf";
import { recognition } from "./api";
import { Priority, RecognizeSceneRequestSchema, type Explanation, type RecognizeSceneRequest, type SceneImage } from "./gen/horopter/v1/recognition_pb";

// Each takes as long as a recognition.
export const MOST_REFUSED = 8;

// The request once more for an explanation, with the images as they came.
export function explaining(request: RecognizeSceneRequest, images: SceneImage[], name: string): RecognizeSceneRequest {
  return create(RecognizeSceneRequestSchema, {
    ...request,
    images,
    explainObject: name,
    stationReadOnly: !!request.station,
    priority: Priority.BATCH,
    overlay: undefined,
    expectedParts: [],
  });
}

// The nearest to an answer first: who passed more tests, then who missed the last by less.
export function nearestFirst(a: Explanation, b: Explanation): number {
  const rank = (e: Explanation) => (e.failedTest === 0 ? 100 : e.failedTest) + (e.needed > 0 ? Math.min(0.99, Math.max(0, e.value / e.needed)) : 0);
  return rank(b) - rank(a);
}

export async function whyNothing(
  request: RecognizeSceneRequest, images: SceneImage[], names: string[], signal: AbortSignal, step: (found: Explanation[], left: number) => void,
): Promise<void> {
  const found: Explanation[] = [];
  const asked = names.slice(0, MOST_REFUSED);
  for (const [i, name] of asked.entries()) {
    const { explanation } = await recognition.recognizeScene(explaining(request, images, name), { signal });
    if (explanation) found.push(explanation);
    step([...found].sort(nearestFirst), asked.length - i - 1);
  }
}
