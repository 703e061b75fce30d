// What the steps of the walk share: the browser, pictures, checks, the program. See test.sh.
const fs = require("fs");
const path = require("path");
const { chromium } = require("playwright-core");
const axe = fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");

const [url, browserPath, data, out, work] = process.argv.slice(2);
const parts = path.join(data, "parts");
const photographs = [0, 1, 2, 3].map((i) => path.join(parts, "val", "000011", "rgb", `00000${i}.png`));
const RECOGNITION_MS = 300_000;  // not timed: machines are loaded
const WAIT_MS = 120_000;

const errors = [];

let painter;  // a page without a policy, that makes small pictures for the documentation

async function small(png, name) {
  painter ??= await (await launch()).newPage();
  const encoded = await painter.evaluate(async ([source, width]) => {
    const image = new Image();
    image.src = `data:image/png;base64,${source}`;
    await image.decode();
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [width, Math.round((width * image.naturalHeight) / image.naturalWidth)];
    const paint = canvas.getContext("2d");
    paint.imageSmoothingQuality = "high";
    paint.drawImage(image, 0, 0, canvas.width, canvas.height);
    return canvas.toDataURL("image/webp", 0.75).split(",")[1];
  }, [png.toString("base64"), 1000]);
  fs.writeFileSync(path.join(out, `console-${name}.webp`), Buffer.from(encoded, "base64"));
}

// picture: one for docs/console.md, too.
async function look(page, name, { picture = false } = {}) {
  const png = await page.screenshot({ path: path.join(out, `${name}.png`) });
  if (picture) await small(png, name);
  // The page's policy lets no script in; the debugger's own world is not bound by it.
  const found = await page.evaluate(`(() => { const module = undefined, exports = undefined, define = undefined; ${axe}; return axe.run(); })()`);
  for (const v of found.violations) errors.push(`${name}: ${v.id}: ${v.help}: ${v.nodes.map((n) => n.html).join(" | ").slice(0, 500)}`);
}

function launch(...more) {
  return chromium.launch({
    executablePath: browserPath,
    args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
      "--disable-sync", ...more],
  });
}

async function close() {
  await painter?.context().browser().close();
}

function program(...args) {
  return require("child_process").execFileSync(process.env.HOROPTER_PROGRAM, args, { stdio: ["ignore", "pipe", "inherit"], encoding: "utf8" });
}

function recognise(...more) {
  return new Promise((done, failed) => require("child_process").execFile(process.env.HOROPTER_PROGRAM, ["recognize", ...photographs, ...more],
    (error) => (error && error.code > 5 ? failed(error) : done())));
}

module.exports = { url, data, out, work, parts, photographs, RECOGNITION_MS, WAIT_MS, errors, look, launch, close, program, recognise };
