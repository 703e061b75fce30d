// Two changes of one part go together, and what tells two states apart.
import assert from "node:assert/strict";
import { create } from "@bufbuild/protobuf";
import { GraspSchema, type Grasp } from "../src/gen/horopter/v1/catalog_pb";
import { differences, entriesOf, merged, type Edited } from "../src/part_diff";

const grasp = (name: string, x: number): Grasp =>
  create(GraspSchema, { name, objectFromGripper: { rotation: { w: 1 }, translationM: { x } }, gripper: { case: "suction", value: { cupRadiusM: 0.01 } } });
const part = (displayName: string, labels: Record<string, string>, ...grasps: Grasp[]): Edited => ({ displayName, labels, grasps });
const names = (e: Edited) => e.grasps.map((g) => `${g.name} ${g.objectFromGripper!.translationM!.x}`);
const base = part("part", { bin: "1", old: "x" }, grasp("a", 1), grasp("b", 2));

// Nothing differs from itself; each kind of change is one difference.
assert.deepEqual(differences(base, base), []);
assert.deepEqual(differences(base, part("new", { bin: "2", shelf: "y" }, grasp("a", 5), grasp("c", 3))).map((d) => [d.field, d.key, d.how]),
  [["name", "", "changed"], ["label", "bin", "changed"], ["label", "old", "removed"], ["label", "shelf", "added"], ["grasp", "a", "changed"], ["grasp", "b", "removed"], ["grasp", "c", "added"]]);

// Changes of different things are all taken over without a question.
{
  const mine = part("part", { bin: "1", old: "x", mine: "m" }, grasp("a", 1), grasp("b", 2), grasp("m", 7));
  const theirs = part("theirs", { bin: "1" }, grasp("a", 9), grasp("b", 2));
  const entries = entriesOf(base, mine, theirs);
  assert.ok(entries.every((e) => !e.clash));
  const both = merged(mine, theirs, entries);
  assert.equal(both.displayName, "theirs");
  assert.deepEqual(both.labels, { bin: "1", mine: "m" });
  assert.deepEqual(names(both), ["a 9", "b 2", "m 7"]);
}

// Of what both changed each choice does what it says; both grasps can be had, one under another name.
{
  const mine = part("mine", { bin: "m", old: "x" }, grasp("a", 5), grasp("a_2", 6));
  const theirs = part("theirs", { bin: "t", old: "x" }, grasp("a", 9), grasp("b", 2));
  const entries = entriesOf(base, mine, theirs);
  assert.deepEqual(entries.map((e) => [e.field, e.key, e.clash, e.both, e.choice]), [
    ["name", "", true, false, "mine"], ["label", "bin", true, false, "mine"], ["grasp", "a", true, true, "mine"], ["grasp", "a_2", false, false, "mine"], ["grasp", "b", false, false, "mine"]]);
  const choose = (choice: "mine" | "theirs" | "both") => merged(mine, theirs, entries.map((e) => ({ ...e, choice: choice === "both" && !e.both ? "mine" : choice })));
  assert.deepEqual(choose("theirs"), theirs);
  assert.deepEqual(differences(choose("mine"), mine), []);
  assert.deepEqual(names(choose("both")).sort(), ["a 9", "a_2 6", "a_3 5"]);
}

// A long name stays within the server's 63 bytes, whole characters each.
{
  const long = "ü".repeat(31);
  const entries = entriesOf(part("", {}, grasp(long, 1)), part("", {}, grasp(long, 2)), part("", {}, grasp(long, 3)));
  const name = merged(part("", {}, grasp(long, 2)), part("", {}, grasp(long, 3)), entries.map((e) => ({ ...e, choice: "both" as const }))).grasps[1].name;
  assert.ok(new TextEncoder().encode(name).length <= 63 && /^ü+_2$/.test(name), name);
}

console.log("two changes of one part go together");
