// The operator's way, step by step, in a real browser. See test.sh.
const assert = require("assert");
const fs = require("fs");
const path = require("path");
const { chromium } = require("playwright-core");
const axe = fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");

const [url, browserPath, data, out, work] = process.argv.slice(2);
const parts = path.join(data, "parts");
const photographs = [0, 1, 2, 3].map((i) => path.join(parts, "val", "000011", "rgb", `00000${i}.png`));
const step = path.join(parts, "cad", "obj_000001.step");
const RECOGNITION_MS = 300_000;  // not timed: machines are loaded

const WAIT_MS = 120_000;

const errors = [];

async function look(page, name) {
  await page.screenshot({ path: path.join(out, `${name}.png`) });
  // The page's policy lets no script in; the debugger's own world is not bound by it.
  const found = await page.evaluate(`(() => { const module = undefined, exports = undefined, define = undefined; ${axe}; return axe.run(); })()`);
  for (const v of found.violations) errors.push(`${name}: ${v.id}: ${v.help}: ${v.nodes.map((n) => n.html).join(" | ").slice(0, 500)}`);
}

async function walk() {
  const browser = await chromium.launch({
    executablePath: browserPath,
    args: ["--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
      "--disable-background-networking", "--disable-component-update", "--disable-sync"],
  });
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, acceptDownloads: true });
  context.setDefaultTimeout(WAIT_MS);
  const page = await context.newPage();
  page.on("pageerror", (error) => errors.push(`script: ${error}`));
  page.on("console", (m) => { if (/Content Security Policy/.test(m.text())) errors.push(`policy: ${m.text()}`); });
  const began = Date.now();

  await page.goto(url);
  await page.getByRole("heading", { name: "Sign in" }).waitFor();
  const paint = await page.evaluate(() => performance.getEntriesByName("first-contentful-paint")[0]?.startTime ?? 0);
  await look(page, "sign-in");
  await page.getByLabel("Token").fill("wrong");
  await page.getByRole("button", { name: "Sign in" }).click();
  await page.getByText("the token is not known").waitFor();
  await page.getByLabel("Token").fill(process.env.HOROPTER_TOKEN);
  await page.keyboard.press("Enter");

  // The part.
  await page.getByText("Step 2 is next.").waitFor();
  await page.getByRole("link", { name: "Parts", exact: true }).click();
  await page.getByText("No part is enrolled yet.").waitFor();
  await page.setInputFiles("input#file", { name: "broken.step", mimeType: "", buffer: Buffer.from("ISO-10303-21;\nHEADER;\n") });
  await page.getByRole("button", { name: "Enrol" }).click();
  await page.getByText("The file was refused").waitFor({ timeout: RECOGNITION_MS });
  await page.setInputFiles("input#file", step);
  await page.getByLabel("Id").fill("block");
  await page.getByRole("button", { name: "Enrol" }).click();
  await page.getByText("block is enrolled.").waitFor({ timeout: RECOGNITION_MS });
  for (const number of ["000002", "000003"]) {
    await page.setInputFiles("input#file", path.join(parts, "cad", `obj_${number}.step`));
    await page.getByRole("button", { name: "Enrol" }).click();
    await page.getByText(`obj_${number} is enrolled.`).waitFor({ timeout: RECOGNITION_MS });
  }
  await page.getByLabel("Search").fill("blo");
  await page.getByText("1 of 3 parts").waitFor();
  await page.getByLabel("Search").fill("");
  await look(page, "parts");
  await page.getByRole("link", { name: "block" }).click();
  await page.getByText("Drag to turn").waitFor();
  await page.getByRole("heading", { name: "Look-alikes" }).waitFor({ timeout: RECOGNITION_MS });
  await page.getByRole("group", { name: /block in three dimensions/ }).press("ArrowLeft");
  await grasp(page);
  await labels(page);
  await look(page, "part");
  await conflict(context, page);

  const stationBegan = Date.now();
  await station(page);
  const besides = Date.now() - stationBegan;

  // The photographs.
  await page.getByRole("link", { name: "Try", exact: true }).click();
  await page.setInputFiles("input#photos", photographs);
  await page.getByRole("button", { name: "Recognise" }).click();
  const asked = Date.now();
  await page.getByRole("heading", { name: /^Run 1: / }).waitFor({ timeout: RECOGNITION_MS });
  const waited = Date.now() - asked;
  const title = await page.getByRole("heading", { name: /^Run 1: / }).textContent();
  assert.equal(await page.locator("img.drawing").count(), 4, "a drawing over each photograph");
  const drawn = await page.locator("img.drawing").evaluateAll((all) => all.every((i) => i.complete && i.naturalWidth > 0));
  assert.ok(drawn, "the drawings are shown");
  await page.locator("horopter-answer").first().scrollIntoViewIfNeeded();
  await look(page, "try");
  await page.screenshot({ path: path.join(out, "console.jpg"), type: "jpeg", quality: 75 });
  console.log(`${title}; ${((Date.now() - began - waited - besides) / 1000).toFixed(1)} s besides recognition; first paint after ${paint.toFixed(0)} ms`);

  // A part is chosen on the photograph, and seen in the scene.
  await page.getByRole("button", { name: /^obj_000003, score / }).first().press("Enter");
  await page.getByRole("region", { name: "obj_000003" }).waitFor();
  await page.getByText("The scene in three dimensions").click();
  await page.getByText("Pyramids are cameras").waitFor();
  await page.getByText("Pyramids are cameras").scrollIntoViewIfNeeded();
  await look(page, "scene");

  const saving = page.waitForEvent("download");
  await page.getByRole("button", { name: "Save as recording" }).click();
  const saved = await saving;
  await saved.saveAs(path.join(work, saved.suggestedFilename()));

  // Why not?
  await page.getByLabel("Why is a part not there?").selectOption("obj_000002");
  await page.getByRole("button", { name: "Explain" }).click();
  await page.getByRole("heading", { name: /^Why it is not there: obj_000002/ }).waitFor({ timeout: RECOGNITION_MS });
  await page.getByRole("heading", { name: /^Why it is not there: obj_000002/ }).scrollIntoViewIfNeeded();
  await look(page, "why");

  // What is still wanting, and a run with what the station knows beside the first.
  await page.getByRole("link", { name: "First steps", exact: true }).click();
  await page.getByText("Step 5 is next.").waitFor();
  await look(page, "start");
  await page.getByRole("link", { name: "Try", exact: true }).click();
  await page.getByLabel("Cameras of").selectOption("stations/cell");
  await page.getByRole("button", { name: "Recognise" }).click();
  await page.getByRole("heading", { name: /^Run 3: / }).waitFor({ timeout: RECOGNITION_MS });
  await page.getByLabel("Compare with").selectOption("1");
  assert.equal(await page.locator("horopter-answer").count(), 2, "two runs side by side");

  await live(page);
  await reload(page);

  await page.getByRole("link", { name: "Health", exact: true }).click();
  await page.locator("horopter-chart canvas").first().waitFor();
  const kept = page.waitForEvent("download");
  await page.getByRole("button", { name: /^Save the recording of / }).first().click();
  assert.match((await kept).suggestedFilename(), /\.horec$/);
  await page.getByRole("button", { name: "Check the catalog" }).click();
  await page.getByText("all is well").waitFor({ timeout: RECOGNITION_MS });
  const copying = page.waitForEvent("download");
  await page.getByRole("button", { name: "Download a backup" }).click();
  assert.match((await copying).suggestedFilename(), /^horopter-.*\.db$/);
  await look(page, "health");

  await flat(url);
  await back(page);
  await browser.close();
}

// Two fingers and a cup, each where the part is clicked; both are there after a reload.
async function grasp(page) {
  const view = page.getByRole("group", { name: /block in three dimensions/ });
  for (const [kind, name] of [["Two fingers", "rim"], ["Suction cup", "face"]]) {
    await page.getByRole("button", { name: kind }).click();
    await view.click();
    await page.getByLabel("Name of the grasp").fill(name);
    await page.getByRole("button", { name: "Turn" }).click();
    await page.screenshot({ path: path.join(out, `grasp-${name}.png`) });
    await page.getByRole("button", { name: "Save the grasp" }).click();
    await page.getByRole("cell", { name, exact: true }).waitFor();
  }
  await page.reload();
  await page.getByRole("cell", { name: "rim", exact: true }).waitFor();
  await page.getByRole("button", { name: "Delete the grasp face" }).click();
  await page.getByRole("cell", { name: "face", exact: true }).waitFor({ state: "detached" });
  await page.getByRole("heading", { name: "Look-alikes" }).waitFor({ timeout: RECOGNITION_MS });
}

// Labels come and go; what a camera sees of the part, and its axes.
async function labels(page) {
  await page.getByLabel("Label", { exact: true }).fill("bin");
  await page.getByLabel("Value").fill("<i>7</i>");
  await page.getByRole("button", { name: "Add" }).click();
  await page.getByRole("cell", { name: "<i>7</i>" }).waitFor();
  await page.getByRole("button", { name: "Remove the label bin" }).click();
  await page.getByRole("cell", { name: "<i>7</i>" }).waitFor({ state: "detached" });
  const pictures = page.locator("horopter-thumbnails img");
  await pictures.first().waitFor();
  assert.ok(await pictures.evaluateAll((all) => all.every((i) => i.naturalWidth > 0)), "resting poses are shown");
}

// Two admins change one part: the second is shown both, and decides.
async function conflict(context, page) {
  const other = await context.newPage();
  await other.goto(page.url());
  await other.getByLabel("Name").fill("theirs");
  await other.getByRole("button", { name: "Save the name" }).click();
  await other.getByText("Saved.").waitFor();
  await other.close();
  await page.getByLabel("Name").fill("<b>mine</b>");
  await page.getByRole("button", { name: "Save the name" }).click();
  await page.getByText("Somebody else has changed this part").waitFor();
  await page.getByRole("cell", { name: "theirs" }).waitFor();
  await page.getByRole("button", { name: "Save yours" }).click();
  await page.getByText("Saved.").waitFor();
  await page.getByRole("link", { name: "All parts" }).click();
  await page.getByRole("cell", { name: "<b>mine</b>" }).waitFor();  // as text
}

function recognise(...more) {
  return new Promise((done, failed) => require("child_process").execFile(process.env.HOROPTER_PROGRAM, ["recognize", ...photographs, ...more],
    (error) => (error && error.code > 5 ? failed(error) : done())));
}

// What others ask is seen as it comes, with its reasons; of nothing, what was nearest.
async function live(page) {
  await page.getByRole("link", { name: "Live", exact: true }).click();
  await page.getByText("Connected.").waitFor();
  const list = page.getByRole("list", { name: "The last answers" });
  await list.getByRole("button").nth(3).waitFor();  // the answers so far
  const before = await list.getByRole("button").count();
  await recognise("--candidates", "obj_000003");
  await page.waitForFunction((n) => document.querySelector("horopter-app").shadowRoot.querySelector("horopter-live").shadowRoot.querySelectorAll("ol li").length > n, before);
  await page.getByRole("heading", { name: /^Answer \d+: 1 part found/ }).waitFor();
  const pictures = page.locator("horopter-live horopter-picture img");
  await pictures.nth(3).waitFor();
  assert.ok(await pictures.evaluateAll((all) => all.every((i) => i.naturalWidth > 0 && i.naturalWidth <= 800)), "small pictures are shown");
  assert.ok((await page.locator("horopter-live horopter-picture path").count()) >= 2, "the part is drawn over them");
  await page.locator("horopter-live").getByRole("button", { name: /^obj_000003, score / }).first().press("Enter");
  await look(page, "live");
  await page.screenshot({ path: path.join(out, "console-live.jpg"), type: "jpeg", quality: 75 });
  await page.locator("horopter-live").getByRole("button", { name: "Why this?" }).click();
  await page.getByRole("heading", { name: "Why it is there: obj_000003" }).waitFor({ timeout: RECOGNITION_MS });
  await page.locator("horopter-live horopter-picture polyline.supported").first().waitFor({ state: "attached" });  // edges that were found

  await recognise("--candidates", "obj_000002");
  await page.getByRole("heading", { name: /^Answer \d+: Nothing found/ }).waitFor({ timeout: RECOGNITION_MS });
  await page.locator("horopter-live").getByRole("button", { name: "Why was nothing found?" }).click();
  await page.locator("horopter-live").getByRole("cell", { name: "obj_000002", exact: true }).waitFor({ timeout: RECOGNITION_MS });
  await page.locator("horopter-live").getByRole("cell", { name: "obj_000002", exact: true }).scrollIntoViewIfNeeded();
  await look(page, "nothing");
}

// What was run is there after a reload; what is far too large is refused before it is read.
async function reload(page) {
  await page.getByRole("link", { name: "Try", exact: true }).click();
  await page.reload();
  await page.getByRole("heading", { name: /^Run 3: / }).waitFor();
  for (const [name, tag] of [["a.png", "horopter-try"], ["a.step", "horopter-parts"]]) {
    if (tag === "horopter-parts") await page.getByRole("link", { name: "Parts", exact: true }).click();
    await page.locator(`${tag} .drop`).evaluate((zone, file) => {
      const huge = new File(["x"], file);
      Object.defineProperty(huge, "size", { value: 2 ** 31 });
      huge.arrayBuffer = () => { throw new Error("it was read"); };
      const event = new Event("drop", { bubbles: true, cancelable: true });
      Object.defineProperty(event, "dataTransfer", { value: { files: [huge] } });
      zone.dispatchEvent(event);
    }, name);
    await page.getByText(`${name} has 2147 MB; at most`).waitFor();
  }
}

// A station is made, gets a camera's calibration, gives it back and forgets it.
async function station(page) {
  await page.getByRole("link", { name: "Stations", exact: true }).click();
  await page.getByText("There is no station yet.").waitFor();
  await teach(page);
  await page.getByText("What is still wanting").waitFor();
  const saving = page.waitForEvent("download");
  await page.getByRole("button", { name: "Save", exact: true }).first().click();
  const file = path.join(work, "left.json");
  await (await saving).saveAs(file);
  const calibration = JSON.parse(fs.readFileSync(file, "utf8"));
  assert.equal(calibration.imageWidthPx, 640);
  const choosing = page.waitForEvent("filechooser");
  await page.getByRole("button", { name: "Load" }).first().click();
  await (await choosing).setFiles({ name: "c.json", mimeType: "application/json", buffer: Buffer.from(JSON.stringify({ ...calibration, focalLogSigma: 0.003 })) });
  await page.getByText("The calibration is taken over.").waitFor();
  const asRos = page.waitForEvent("download");
  await page.getByRole("button", { name: "Save for ROS" }).first().click();
  await (await asRos).saveAs(path.join(work, "left.yaml"));
  const choosingRos = page.waitForEvent("filechooser");
  await page.getByRole("button", { name: "Load" }).first().click();
  await (await choosingRos).setFiles(path.join(work, "left.yaml"));
  await page.getByText("The calibration is taken over.").waitFor();
  await page.getByRole("group", { name: /^The cameras in three dimensions/ }).press("ArrowUp");
  await page.getByRole("row", { name: /^left .* px/ }).waitFor();  // its residual
  await look(page, "station");
  await page.getByRole("button", { name: "Forget what was learnt" }).click();
  await page.getByRole("button", { name: "Forget what was learnt" }).click();
  await page.getByText("What was learnt is forgotten.").waitFor();
}

// By the program, as a cell's own would.
async function teach(page) {
  await page.getByLabel("New station").fill("cell");
  await page.getByRole("button", { name: "Make it" }).click();
  await page.getByText("No camera is known yet").waitFor();
  require("child_process").execFileSync(process.env.HOROPTER_PROGRAM,
    ["recognize", ...photographs, "--station", "cell", "--station-cameras", "left,right,front,top"], { stdio: ["ignore", "ignore", "inherit"] });
  await page.reload();
}

// Back button, an id that is not there, dark, narrow, the session gone.
async function back(page) {
  await page.goBack();
  await page.getByRole("heading", { name: "Parts", exact: true }).waitFor();
  await page.evaluate(() => { location.hash = "#/parts/no-such-part"; });
  await page.getByRole("alert").waitFor();
  await page.emulateMedia({ colorScheme: "dark" });
  await page.setViewportSize({ width: 820, height: 1180 });
  await page.evaluate(() => { location.hash = "#/parts"; });
  await page.getByRole("cell", { name: "<b>mine</b>" }).waitFor();
  await look(page, "parts-dark");
  // The token is taken away in mid-session.
  const access = fs.readFileSync(path.join(work, "access"));
  const allow = (lines) => {
    fs.writeFileSync(path.join(work, "access.new"), lines);
    fs.renameSync(path.join(work, "access.new"), path.join(work, "access"));
  };
  allow("# nobody\n");
  await page.evaluate(() => { location.hash = "#/health"; });
  await page.getByText("Your session is over.").waitFor();
  allow(access);
}

// Without WebGL.
async function flat(address) {
  const browser = await chromium.launch({
    executablePath: browserPath,
    args: ["--no-sandbox", "--disable-gpu", "--disable-3d-apis", "--disable-quic", "--no-first-run", "--disable-background-networking",
      "--disable-component-update", "--disable-sync"],
  });
  const page = await browser.newPage({ viewport: { width: 1280, height: 800 } });
  page.setDefaultTimeout(WAIT_MS);
  await page.goto(address + "/#/parts/block");
  await page.getByLabel("Token").fill(process.env.HOROPTER_TOKEN);
  await page.keyboard.press("Enter");
  await page.getByText("This browser shows no 3D").waitFor();
  assert.ok((await page.locator("horopter-part-view line").count()) > 8, "edges are drawn");
  await look(page, "part-flat");
  await browser.close();
}

walk().then(
  () => {
    for (const error of errors) console.error(error);
    process.exit(errors.length ? 1 : 0);
  },
  (error) => {
    console.error(error);
    for (const e of errors) console.error(e);
    process.exit(1);
  },
);
