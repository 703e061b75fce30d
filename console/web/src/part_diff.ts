// What tells two states of a part apart, and how two changes of one state go together. Pure functions.
import type { Grasp, Object$ as Part } from "./gen/horopter/v1/catalog_pb";

// What is changed on the page.
export interface Edited { displayName: string; labels: Record<string, string>; grasps: Grasp[] }
export type Field = "name" | "label" | "grasp";
export type How = "added" | "removed" | "changed";

export interface Difference { field: Field | "geometry" | "symmetries" | "file"; key: string; how: How; before: string; after: string }

const mm = (m: number) => (1000 * m).toFixed(1);
const f = (x?: number) => (x ?? 0).toFixed(9);

// Equal for grasps that a robot cannot tell apart; without the name.
export function graspPrint(grasp?: Grasp): string {
  if (!grasp) return "";
  const poses = [grasp.objectFromGripper, grasp.objectFromPregrasp].map((p) => p && [p.rotation?.w ?? 1, p.rotation?.x, p.rotation?.y, p.rotation?.z, p.translationM?.x, p.translationM?.y, p.translationM?.z].map(f).join(" "));
  const g = grasp.gripper;
  const gripper = g.case === "suction" ? [g.value.cupRadiusM] : g.case === "parallelJaw" ? [g.value.jawOpeningM, g.value.gripWidthM] : [];
  return [g.case ?? "", ...gripper.map(f), f(grasp.quality ?? 1), ...poses].join("|");
}

// For people.
export function graspWords(grasp?: Grasp): string {
  if (!grasp) return "";
  const t = grasp.objectFromGripper?.translationM;
  const g = grasp.gripper;
  const size = g.case === "suction" ? `⌀ ${mm(2 * g.value.cupRadiusM)}` : g.case === "parallelJaw" ? `↔ ${mm(g.value.jawOpeningM)}` : "";
  return `${size} (${[t?.x, t?.y, t?.z].map((x) => mm(x ?? 0)).join(", ")}) mm`;
}

function ofMaps<T>(field: Field, before: Map<string, T>, after: Map<string, T>, print: (v?: T) => string, words: (v?: T) => string): Difference[] {
  return [...new Set([...before.keys(), ...after.keys()])].sort().flatMap((key): Difference[] => {
    const [a, b] = [before.get(key), after.get(key)];
    if (before.has(key) && after.has(key) && print(a) === print(b)) return [];
    return [{ field, key, how: !before.has(key) ? "added" : !after.has(key) ? "removed" : "changed", before: words(a), after: words(b) }];
  });
}

export const labelMap = (part: Edited) => new Map(Object.entries(part.labels));
export const graspMap = (part: Edited) => new Map(part.grasps.map((g) => [g.name, g]));

export function differences(before: Edited, after: Edited): Difference[] {
  const found: Difference[] = [];
  if (before.displayName !== after.displayName) found.push({ field: "name", key: "", how: "changed", before: before.displayName, after: after.displayName });
  found.push(...ofMaps("label", labelMap(before), labelMap(after), (v) => v ?? "", (v) => v ?? ""));
  found.push(...ofMaps("grasp", graspMap(before), graspMap(after), graspPrint, graspWords));
  return found;
}

// With what the page does not change; paths: ObjectVersion.changed_fields.
export function allDifferences(before: Part, after: Part, paths: string[]): Difference[] {
  const found = differences(before, after);
  const size = (p: Part) => `⌀ ${mm(p.diameterM)} mm, ${p.edgeCount} / ${p.triangleCount}`;
  const file = (p: Part) => (p.source?.fileName ? `${p.source.fileName} ${p.source.sha256.slice(0, 8)}` : "–");
  if (paths.includes("mesh")) found.push({ field: "geometry", key: "", how: "changed", before: size(before), after: size(after) });
  if (paths.includes("object_from_symmetric_object")) {
    found.push({ field: "symmetries", key: "", how: "changed", before: String(before.objectFromSymmetricObject.length), after: String(after.objectFromSymmetricObject.length) });
  }
  if (paths.includes("source")) found.push({ field: "file", key: "", how: "changed", before: file(before), after: file(after) });
  return found;
}

export type Choice = "theirs" | "mine" | "both";

// What both sides make of one entry. clash: both changed it, and not alike. both: can be had, a grasp under another name.
export interface Entry { field: Field; key: string; theirs: string; mine: string; clash: boolean; both: boolean; choice: Choice }

export function entriesOf(base: Edited, mine: Edited, theirs: Edited): Entry[] {
  const touched = (side: Edited) => new Set(differences(base, side).map((d) => `${d.field} ${d.key}`));
  const [byMe, byThem] = [touched(mine), touched(theirs)];
  return differences(theirs, mine).map(({ field, key, how, before, after }): Entry => {
    const id = `${field} ${key}`;
    const clash = byMe.has(id) && byThem.has(id);
    // What one side alone changed is taken over; where both did, the person who is asked began with his own.
    return { field: field as Field, key, theirs: before, mine: after, clash, both: field === "grasp" && how === "changed", choice: byMe.has(id) ? "mine" : "theirs" };
  });
}

const NAME_BYTES = 63;

// A name that neither has.
function freeName(name: string, taken: Set<string>): string {
  for (let i = 2; ; ++i) {
    const ending = `_${i}`;
    let stem = name;
    while (new TextEncoder().encode(stem + ending).length > NAME_BYTES) stem = [...stem].slice(0, -1).join("");
    if (!taken.has(stem + ending)) return stem + ending;
  }
}

export function merged(mine: Edited, theirs: Edited, entries: Entry[]): Edited {
  const labels = { ...theirs.labels };
  const grasps = graspMap(theirs);
  const [myLabels, myGrasps] = [labelMap(mine), graspMap(mine)];
  let displayName = theirs.displayName;
  for (const { field, key, choice } of entries) {
    if (choice === "theirs") continue;
    if (field === "name") displayName = mine.displayName;
    if (field === "label") {
      if (myLabels.has(key)) labels[key] = myLabels.get(key)!;
      else delete labels[key];
    }
    if (field === "grasp") {
      const own = myGrasps.get(key);
      if (!own) grasps.delete(key);
      else if (choice === "mine") grasps.set(key, own);
      else {
        const name = freeName(key, new Set([...grasps.keys(), ...myGrasps.keys()]));
        grasps.set(name, { ...own, name });
      }
    }
  }
  return { displayName, labels, grasps: [...grasps.values()] };
}
