// The page of one part: grasps, labels, two people at once, history. See test.sh.
const assert = require("assert");
const fs = require("fs");
const path = require("path");
const { RECOGNITION_MS, look, program, work } = require("./walk_shared.cjs");

// Two fingers and a cup, each where the part is clicked; both are there after a reload. One is moved and turned by hand.
async function grasp(page) {
  const view = page.getByRole("group", { name: /block in three dimensions/ });
  for (const [kind, name] of [["Two fingers", "rim"], ["Suction cup", "face"]]) {
    await page.getByRole("button", { name: kind }).click();
    await view.click();
    await page.getByLabel("Name of the grasp").fill(name);
    await page.getByRole("button", { name: /^x \+15°/ }).click();
    if (kind === "Two fingers") await page.getByText(/mm between the fingers/).waitFor();
    await look(page, `grasp-${name}`, { picture: kind === "Two fingers" });
    await page.getByRole("button", { name: "Save the grasp" }).click();
    await page.getByRole("cell", { name, exact: true }).waitFor();
  }
  await page.reload();
  await page.getByRole("cell", { name: "rim", exact: true }).waitFor();
  await gizmo(page, view);
  await page.getByRole("button", { name: "Delete the grasp face" }).click();
  await page.getByRole("cell", { name: "face", exact: true }).waitFor({ state: "detached" });
  await page.getByRole("heading", { name: "Look-alikes" }).waitFor({ timeout: RECOGNITION_MS });
}

// By numbers into the part, which is said; by an arrow and a ring of the picture.
async function gizmo(page, view) {
  await page.getByRole("button", { name: "Move the grasp rim" }).click();
  const fields = ["x", "y", "z"].map((a) => page.getByLabel(a, { exact: true }));
  const values = () => Promise.all(fields.map((f) => f.inputValue()));
  const middle = await view.boundingBox();
  const [u, v] = [middle.x + middle.width / 2, middle.y + middle.height / 2];
  for (const f of fields) {
    await f.fill("0");
    await f.press("Enter");
  }
  await page.getByText("The gripper meets the part on its straight way").waitFor();
  // Where the arrows and rings are depends on how the part lies: around the gripper until one is caught.
  const drag = async (done) => {
    for (let i = 0; i < 48; ++i) {
      const [radius, angle] = [24 + 12 * Math.floor(i / 12), (i * Math.PI) / 6];
      const [du, dv] = [Math.cos(angle), Math.sin(angle)];
      await page.mouse.move(u + radius * du, v + radius * dv);
      await page.mouse.down();
      await page.mouse.move(u + (radius + 10) * du - 6 * dv, v + (radius + 10) * dv + 6 * du, { steps: 3 });
      await page.mouse.up();
      if (await done()) return true;
    }
    return false;
  };
  const before = await values();
  assert.ok(await drag(async () => String(await values()) !== String(before)), "an arrow moves the grasp");
  await page.getByRole("button", { name: "Turn by the rings" }).click();
  const pose = () => page.locator("horopter-grasp-editor").evaluate((e) => JSON.stringify(e.draft.objectFromGripper.rotation));
  const facing = await pose();
  assert.ok(await drag(async () => (await pose()) !== facing), "a ring turns the grasp");
  await page.getByRole("button", { name: "Cancel" }).click();
  await page.getByRole("cell", { name: "rim", exact: true }).waitFor();
}

// Labels come and go; what a camera sees of the part, and its axes.
async function labels(page) {
  await page.getByLabel("Label", { exact: true }).fill("bin");
  await page.getByLabel("Value").fill("<i>7</i>");
  await page.getByRole("button", { name: "Add" }).click();
  await page.getByRole("cell", { name: "<i>7</i>" }).waitFor();
  await page.getByRole("button", { name: "Remove the label bin" }).click();
  await page.getByRole("cell", { name: "<i>7</i>" }).waitFor({ state: "detached" });
  // The server's own views, in pages; a click shows the part from there.
  const templates = page.locator("horopter-view-templates li");
  await templates.nth(11).waitFor();
  assert.ok(await templates.evaluateAll((all) => all.every((li) => [...li.querySelectorAll("path")].reduce((n, p) => n + p.getAttribute("d").length, 0) > 500)), "edges are drawn");
  await page.getByRole("button", { name: "Show more" }).click();
  await templates.nth(23).waitFor();
  await templates.first().scrollIntoViewIfNeeded();
  await look(page, "templates", { picture: true });
  const azimuth = () => page.locator("horopter-part-view").first().evaluate((e) => e.orbit.azimuth);
  const from = await azimuth();
  await page.getByRole("button", { name: "See the part as in view 3" }).click();
  assert.notEqual(await azimuth(), from);
  const pictures = page.locator("horopter-thumbnails img");
  await pictures.first().waitFor();
  assert.ok(await pictures.evaluateAll((all) => all.every((i) => i.naturalWidth > 0)), "resting poses are shown");
}

// Two admins change one part: the second is shown both, and decides line by line; what only one changed is taken over.
async function conflict(context, page) {
  const other = await context.newPage();
  await other.goto(page.url());
  await other.getByLabel("Name", { exact: true }).fill("theirs");
  await other.getByRole("button", { name: "Save the name" }).click();
  await other.getByText("Saved.").waitFor();
  await other.getByLabel("Label", { exact: true }).fill("rack");
  await other.getByLabel("Value").fill("12");
  await other.getByRole("button", { name: "Add" }).click();
  await other.getByRole("cell", { name: "12", exact: true }).waitFor();
  await page.getByLabel("Name", { exact: true }).fill("<b>mine</b>");
  await page.getByRole("button", { name: "Save the name" }).click();
  await page.getByText("Somebody else has changed this part").waitFor();
  const merge = page.locator("horopter-part-merge");
  await merge.getByRole("cell", { name: "theirs" }).waitFor();
  await merge.getByText("both of you changed it").waitFor();
  assert.ok(await merge.getByRole("group", { name: "What is to be saved of Label rack" }).getByLabel("what is there").isChecked(), "what they alone changed is taken over");
  await look(page, "merge", { picture: true });
  // Meanwhile a third change, of the same grasp that is added here.
  const file = path.join(work, "grasps.json");
  fs.writeFileSync(file, JSON.stringify({ grasps: [{ name: "twin", suction_cup_radius_mm: 20, T_gripper_in_object: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 10, 0, 0, 0, 1] }] }));
  program("object", "update", "block", "--grasps", file);
  await merge.getByRole("button", { name: "Save this" }).click();
  await merge.getByRole("rowheader", { name: "Grasp twin" }).waitFor();  // asked again
  await merge.getByRole("button", { name: "Save this" }).click();
  await page.getByText("Saved.").waitFor();
  await page.getByRole("cell", { name: "12", exact: true }).waitFor();
  await other.reload();
  await other.getByRole("button", { name: "Suction cup" }).click();
  await other.getByRole("group", { name: /block in three dimensions/ }).click();
  await other.getByLabel("Name of the grasp").fill("pair");
  program("object", "update", "block", "--grasps", (fs.writeFileSync(file, fs.readFileSync(file, "utf8").replace("twin", "pair")), file));
  await other.getByRole("button", { name: "Save the grasp" }).click();
  const second = other.locator("horopter-part-merge");
  await second.getByRole("group", { name: "What is to be saved of Grasp pair" }).getByLabel("both").check();
  await second.getByRole("button", { name: "Save this" }).click();
  await other.getByRole("cell", { name: "pair", exact: true }).waitFor();
  await other.getByRole("cell", { name: "pair_2", exact: true }).waitFor();
  await other.close();
  await history(page);
  await page.getByRole("link", { name: "All parts" }).click();
  await page.getByRole("cell", { name: "<b>mine</b>" }).waitFor();  // as text
}

// Who changed what; the part as it was enrolled, and back again.
async function history(page) {
  await page.getByRole("link", { name: "History" }).click();
  const table = page.locator("horopter-part-history table");
  await table.getByText("as it is").waitFor();
  await table.getByText("theirs → <b>mine</b>").waitFor();
  await table.getByRole("cell", { name: "operator" }).first().waitFor();
  await look(page, "history", { picture: true });
  const rows = await table.getByRole("button", { name: /^Go back to it: revision/ }).count();
  assert.ok(rows >= 6, `each change is there: ${rows}`);
  await table.getByRole("button", { name: /^Show revision/ }).last().click();
  await page.getByRole("heading", { name: /^As it was at revision/ }).waitFor();
  await table.getByRole("button", { name: /^Go back to it: revision/ }).last().click();
  const before = JSON.parse(program("--json", "object", "history", "block")).versions;
  await page.locator("horopter-part-history").getByRole("button", { name: "Go back to it", exact: true }).first().click();
  await page.getByText("The part is what it was at revision").waitFor();
  const after = JSON.parse(program("--json", "object", "history", "block")).versions;
  assert.deepEqual([after.length, after[0].name, after[0].grasps], [before.length + 1, before.at(-1).name, before.at(-1).grasps]);
  assert.deepEqual([after[0].changed_by, after[0].changed.sort()], ["operator", ["display_name", "grasps", "labels"]]);
  await page.getByRole("link", { name: "As it is" }).click();
  await page.getByText("No grasp is enrolled.").waitFor();
  program("object", "restore", "block", String(after[1].revision));
  await page.goBack();
  await page.getByRole("heading", { name: "block" }).waitFor();
}

module.exports = { grasp, labels, conflict };
