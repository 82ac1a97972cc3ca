// Opens a web page of JGHand from the disk in a headless Chromium, drives it and takes its picture.
//
//     node photograph_page.mjs FOLDER PLAN.json OUT
//
// PLAN: { "shots": [{ "name", "width", "height", "scale", "touch", "before", "steps": [[action, …], …], "canvas", "watch" }] }.
// Actions: seek FRAME, pose NAME, look CAMERA, play SECONDS, slide SELECTOR VALUE, click SELECTOR, drag DX DY, background COLOR,
// run SCRIPT; "before" is a script that runs before those of the page. A shot leaves OUT/NAME.png, of the whole page or, with
// "canvas", of the hand alone in exactly its pixels. Prints as JSON what was asked for beside the folder's own files, what the
// page complained about, and figures of each shot; with "watch" also what was shown before the first step and after each:
// the joints, and a hash of the picture without panel and bar.
// JGHAND_CHROMIUM names the browser.
import crypto from 'node:crypto';
import fs from 'node:fs';
import path from 'node:path';
import { pathToFileURL } from 'node:url';
import { chromium } from 'playwright-core';

const [folder, planFile, out] = process.argv.slice(2);
const plan = JSON.parse(fs.readFileSync(planFile, 'utf8'));
const home = pathToFileURL(path.resolve(folder)).href;
const result = { foreign: [], complaints: [], shots: {} };

const ACTIONS = {
  seek: (page, frame) => page.evaluate((f) => jghand.seek(f), frame),
  pose: (page, name) => page.evaluate((n) => jghand.pose(n, false), name),
  look: (page, camera) => page.evaluate((c) => jghand.lookThrough(c), camera),
  background: (page, color) => page.evaluate((c) => { document.body.style.background = c; }, color),
  click: (page, selector) => page.click(selector),
  run: (page, script) => page.evaluate(script),
  slide: (page, selector, value) => page.$eval(selector, (element, v) => {
    element.value = v;
    element.dispatchEvent(new Event('input', { bubbles: true }));
  }, value),
  drag: async (page, dx, dy) => {
    const { width, height } = page.viewportSize();
    await page.mouse.move(width / 3, height / 2);
    await page.mouse.down();
    await page.mouse.move(width / 3 + dx, height / 2 + dy, { steps: 6 });
    await page.mouse.up();
  },
  // how fast it plays, by what it draws meanwhile
  play: async (page, seconds) => page.evaluate(async (s) => {
    jghand.seek(0);
    jghand.play();
    const drawn = jghand.drawn, began = performance.now();
    await new Promise((done) => setTimeout(done, 1000 * s));
    const took = (performance.now() - began) / 1000;
    return { frame: jghand.frame, pictures_per_s: (jghand.drawn - drawn) / took, playing: jghand.playing };
  }, seconds),
};

// Waits until nothing moves; false when it still does after a minute
const calm = (page) => page.evaluate(() => jghand.playing || Promise.race([
  jghand.settled().then(() => true, () => true), new Promise((done) => setTimeout(() => done(false), 60000)),
]));

async function shown(page) {
  await calm(page);
  const { width, height } = page.viewportSize();
  const picture = await page.screenshot({ clip: { x: 0, y: 80, width: 0.6 * width, height: height - 170 }, timeout: 120000 });
  const joints = await page.evaluate(() => Array.from(jghand.hand.memory.views.joints));
  return { joints, picture: crypto.createHash('sha256').update(picture).digest('hex') };
}

const browser = await chromium.launch({
  executablePath: process.env.JGHAND_CHROMIUM,
  args: ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'],
});
try {
  for (const shot of plan.shots) {
    const context = await browser.newContext({
      viewport: { width: shot.width, height: shot.height }, deviceScaleFactor: shot.scale ?? 1, hasTouch: Boolean(shot.touch),
    });
    const page = await context.newPage();
    if (shot.before) await page.addInitScript(shot.before);
    page.on('console', (message) => result.complaints.push(`${message.type()}: ${message.text()}`));
    page.on('pageerror', (error) => result.complaints.push(String(error)));
    page.on('request', (request) => {
      const url = request.url();
      if (!url.startsWith(home) && !/^(blob|data):/.test(url)) result.foreign.push(url);
    });
    const began = Date.now();
    await page.goto(`${home}/index.html#still`);
    await page.waitForFunction(() => document.body.matches('.ready, .failed'), null, { timeout: 120000 });
    const figures = { ready_s: (Date.now() - began) / 1000, message: await page.textContent('#message') };
    if (!figures.message) {
      if (shot.watch) {
        await page.waitForTimeout(700);  // the hand has faded in
        figures.shown = [await shown(page)];
      }
      for (const [action, ...words] of shot.steps) {
        Object.assign(figures, { [action]: await ACTIONS[action](page, ...words) });
        if (shot.watch) figures.shown.push(await shown(page));
      }
      figures.message = await page.textContent('#message');
      if (!await calm(page)) result.complaints.push(`${shot.name}: still draws after a minute`);
    }
    if (shot.canvas) await page.addStyleTag({ content: '#head, #panel, #bar { display: none !important } canvas { transition: none !important; opacity: 1 !important }' });
    await page.waitForTimeout(700);  // what fades has faded
    await page.screenshot({ path: path.join(out, `${shot.name}.png`), timeout: 120000 });
    result.shots[shot.name] = figures;
    await context.close();
  }
} finally {
  await browser.close();
}
console.log(JSON.stringify(result));
