// The operator's way, step by step, in a real browser. See test.sh.
const assert = require("assert");
const fs = require("fs");
const path = require("path");
const { RECOGNITION_MS, WAIT_MS, close, errors, launch, look, parts, photographs, recognise, url, work } = require("./walk_shared.cjs");
const { conflict, grasp, labels } = require("./walk_parts.cjs");
const { back, flat, markup, midUpload, reload, serverGone, wrongClock } = require("./walk_faults.cjs");

async function walk() {
  const browser = await launch("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader");
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, acceptDownloads: true });
  context.setDefaultTimeout(WAIT_MS);
  const page = await context.newPage();
  page.on("pageerror", (error) => errors.push(`script: ${error}`));
  page.on("console", (m) => { if (/Content Security Policy/.test(m.text())) errors.push(`policy: ${m.text()}`); });

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
  await page.getByText(/The file was refused: .*(DATA|section|STEP|end)/s).waitFor({ timeout: RECOGNITION_MS });  // in words
  const dropped = Date.now();
  await page.setInputFiles("input#file", path.join(parts, "cad", "obj_000001.step"));
  await page.getByLabel("Id").fill("block");
  await page.getByRole("button", { name: "Enrol" }).click();
  await page.getByText("block is enrolled.").waitFor({ timeout: RECOGNITION_MS });
  const enrolled = Date.now() - dropped;
  for (const number of ["000002", "000003"]) {
    await page.setInputFiles("input#file", path.join(parts, "cad", `obj_${number}.step`));
    await page.getByRole("button", { name: "Enrol" }).click();
    await page.getByText(`obj_${number} is enrolled.`).waitFor({ timeout: RECOGNITION_MS });
  }
  await page.getByLabel("Search").fill("blo");
  await page.getByText("1 of 3 parts").waitFor();
  await page.getByLabel("Search").fill("");
  await look(page, "parts", { picture: true });
  await page.getByRole("link", { name: "block" }).click();
  await page.getByText("Drag to turn").waitFor();
  await page.getByRole("heading", { name: "Look-alikes" }).waitFor({ timeout: RECOGNITION_MS });
  await page.getByRole("group", { name: /block in three dimensions/ }).press("ArrowLeft");
  await grasp(page);
  await labels(page);
  await look(page, "part", { picture: true });
  await conflict(context, page);

  await station(page);

  // The photographs.
  const opened = Date.now();
  await page.getByRole("link", { name: "Try", exact: true }).click();
  await page.setInputFiles("input#photos", photographs);
  await page.getByRole("button", { name: "Recognise" }).click();
  const asked = Date.now();
  await page.getByRole("heading", { name: /^Run 1: / }).waitFor({ timeout: RECOGNITION_MS });
  const waited = Date.now() - asked;
  const title = await page.getByRole("heading", { name: /^Run 1: / }).textContent();
  await page.locator("img.drawing").nth(3).waitFor();
  assert.equal(await page.locator("img.drawing").count(), 4, "a drawing over each photograph");
  const drawn = await page.locator("img.drawing").evaluateAll((all) => all.every((i) => i.complete && i.naturalWidth > 0));
  assert.ok(drawn, "the drawings are shown");
  const looked = Date.now() - opened - waited;
  await page.locator("horopter-answer").first().scrollIntoViewIfNeeded();
  await look(page, "try", { picture: true });
  console.log(`${title}; from the STEP file to the drawing ${((enrolled + looked) / 1000).toFixed(1)} s besides recognition (enrolment ${(enrolled / 1000).toFixed(1)} s); first paint after ${paint.toFixed(0)} ms`);

  // A part is chosen on the photograph, and seen in the scene.
  await page.getByRole("button", { name: /^obj_000003, score / }).first().press("Enter");
  await page.getByRole("region", { name: "obj_000003" }).waitFor();
  await page.getByText("The scene in three dimensions").click();
  await page.getByText("Pyramids are cameras").waitFor();
  await page.getByText("Pyramids are cameras").scrollIntoViewIfNeeded();
  await look(page, "scene", { picture: true });

  const saving = page.waitForEvent("download");
  await page.getByRole("button", { name: "Save as recording" }).click();
  const saved = await saving;
  await saved.saveAs(path.join(work, saved.suggestedFilename()));

  // Why not?
  await page.getByLabel("Why is a part not there?").selectOption("obj_000002");
  await page.getByRole("button", { name: "Explain" }).click();
  await page.getByRole("heading", { name: /^Why it is not there: obj_000002/ }).waitFor({ timeout: RECOGNITION_MS });
  await page.getByRole("heading", { name: /^Why it is not there: obj_000002/ }).scrollIntoViewIfNeeded();
  await look(page, "why", { picture: true });

  // What is still wanting, and a run with what the station knows beside the first.
  await page.getByRole("link", { name: "First steps", exact: true }).click();
  await page.getByText("Step 5 is next.").waitFor();
  await look(page, "start", { picture: true });
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
  await look(page, "health", { picture: true });

  await midUpload(page);
  await markup(page);
  await wrongClock(browser);
  await serverGone(page);
  await flat(url);
  await back(page);
  await close();
  await browser.close();
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
  await look(page, "live", { picture: true });
  await page.locator("horopter-live").getByRole("button", { name: "Why this?" }).click();
  await page.getByRole("heading", { name: "Why it is there: obj_000003" }).waitFor({ timeout: RECOGNITION_MS });
  await page.locator("horopter-live horopter-picture polyline.supported").first().waitFor({ state: "attached" });  // edges that were found

  await recognise("--candidates", "obj_000002");
  await page.getByRole("heading", { name: /^Answer \d+: Nothing found/ }).waitFor({ timeout: RECOGNITION_MS });
  await page.locator("horopter-live").getByRole("button", { name: "Why was nothing found?" }).click();
  await page.locator("horopter-live").getByRole("cell", { name: "obj_000002", exact: true }).waitFor({ timeout: RECOGNITION_MS });
  await page.locator("horopter-live").getByRole("cell", { name: "obj_000002", exact: true }).scrollIntoViewIfNeeded();
  await look(page, "nothing", { picture: true });
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
  await look(page, "station", { picture: true });
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
