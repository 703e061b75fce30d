// What goes wrong: files too large, reloads, markup, clocks, no server, no WebGL, no session. See test.sh.
const assert = require("assert");
const fs = require("fs");
const path = require("path");
const { RECOGNITION_MS, WAIT_MS, errors, launch, look, parts, url, work } = require("./walk_shared.cjs");

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

// A reload in mid-upload is asked about; who goes all the same leaves no half part behind.
async function midUpload(page) {
  await page.getByRole("link", { name: "Parts", exact: true }).click();
  await page.getByText(/^3 parts$/).waitFor();
  const held = [];
  await page.route("**/ImportObject", (route) => held.push(route));
  await page.setInputFiles("input#file", path.join(parts, "cad", "obj_000004.step"));
  await page.getByRole("button", { name: "Enrol" }).click();
  await page.getByText(/^Reading and enrolling/).waitFor();
  let asked = "";
  page.once("dialog", (dialog) => {
    asked = dialog.type();
    return dialog.accept();
  });
  await page.reload();
  assert.equal(asked, "beforeunload", "the reload is asked about");
  await Promise.all(held.map((route) => route.abort().catch(() => {})));
  await page.unroute("**/ImportObject");
  await page.getByText(/^3 parts$/).waitFor();
}

// Names, addresses and files with markup in them are texts.
async function markup(page) {
  page.once("dialog", () => errors.push("markup was carried out"));
  await page.setInputFiles("input#file", { name: "<img src=x onerror=alert(1)>.step", mimeType: "", buffer: Buffer.from("ISO-10303-21;\nHEADER;\n") });
  await page.getByLabel("Id").fill("markup");
  await page.getByRole("button", { name: "Enrol" }).click();
  await page.getByText("The file was refused").waitFor({ timeout: RECOGNITION_MS });
  await page.getByText("<img src=x onerror=alert(1)>.step", { exact: true }).first().waitFor();
  await page.getByRole("button", { name: "Cancel" }).click();
  for (const id of ["<img src=x onerror=alert(1)>", "%3Cscript%3Ealert(1)%3C/script%3E", "../../sign-out", "a".repeat(10_000)]) {
    await page.evaluate((hash) => { location.hash = hash; }, `#/parts/${id}`);
    await page.getByRole("heading", { name: "Parts", exact: true }).waitFor();
  }
  await page.evaluate(() => { location.hash = "#/parts"; });
}

// A browser whose clock is ten years off is signed in as any other, and shows what is there.
async function wrongClock(browser) {
  for (const years of [-10, 10]) {
    const context = await browser.newContext({ viewport: { width: 1280, height: 800 } });
    context.setDefaultTimeout(WAIT_MS);
    const page = await context.newPage();
    page.on("pageerror", (error) => errors.push(`clock: ${error}`));
    await page.clock.install({ time: Date.now() + years * 365 * 86_400_000 });
    await page.goto(url + "/#/parts/block/history");
    await page.getByLabel("Token").fill(process.env.HOROPTER_TOKEN);
    await page.keyboard.press("Enter");
    await page.getByRole("cell", { name: "operator" }).first().waitFor();
    for (const name of ["Live", "Health", "First steps"]) {
      await page.getByRole("link", { name, exact: true }).click();
      await page.getByRole("heading", { name, exact: true }).waitFor();
      await page.clock.runFor(3000);
      assert.doesNotMatch(await page.locator("main").innerText(), /NaN|Invalid Date/);
    }
    await context.close();
  }
}

// The server goes and comes back: the page says so, and goes on by itself.
async function serverGone(page) {
  await page.getByRole("link", { name: "Live", exact: true }).click();
  await page.getByText("Connected.").waitFor();
  process.kill(Number(process.env.HOROPTERD_PID), "SIGTERM");
  await page.getByText("The server cannot be reached.").first().waitFor();
  await look(page, "server-gone");
  const log = fs.openSync(path.join(work, "server-again.log"), "a");
  const server = require("child_process").spawn(process.env.HOROPTERD, process.env.HOROPTERD_ARGUMENTS.split("\n"), { detached: true, stdio: ["ignore", log, log] });
  fs.writeFileSync(path.join(work, "server.pid"), String(server.pid));
  server.unref();
  await page.getByText("Connected.").waitFor();
  await page.getByRole("link", { name: "Parts", exact: true }).click();
  await page.getByText(/^3 parts$/).waitFor();
  await page.getByRole("link", { name: "Health", exact: true }).click();
  await page.getByRole("heading", { name: "Health", exact: true }).waitFor();
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
  const browser = await launch("--disable-3d-apis");
  const page = await browser.newPage({ viewport: { width: 1280, height: 800 } });
  page.setDefaultTimeout(WAIT_MS);
  await page.goto(address + "/#/parts/block");
  await page.getByLabel("Token").fill(process.env.HOROPTER_TOKEN);
  await page.keyboard.press("Enter");
  await page.getByText("This browser shows no 3D").waitFor();
  assert.ok((await page.locator("horopter-part-view line").count()) > 8, "edges are drawn");
  await page.locator("horopter-view-templates li").nth(11).waitFor();  // pictures that need no WebGL
  await look(page, "part-flat");
  await browser.close();
}

module.exports = { reload, midUpload, markup, wrongClock, serverGone, back, flat };
