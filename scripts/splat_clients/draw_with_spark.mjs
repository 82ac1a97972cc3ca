// Draws a splat file with Spark (three.js, WebGL) in a headless Chromium, as a camera of JGHand sees it.
//
//     node draw_with_spark.mjs FILE CAMERA.json PICTURE.png [SETTINGS.json]
//
// FILE: numbers in the axes x right, y down, z forward. CAMERA: width, height, fx, fy, cx, cy, camera_from_world (4 x 4,
// world of the file turned so that y is up). SETTINGS: options of SparkRenderer. JGHAND_CHROMIUM names the browser.
import fs from 'node:fs';
import http from 'node:http';
import path from 'node:path';
import { fileURLToPath } from 'node:url';
import { chromium } from 'playwright-core';

const [file, cameraFile, picture, settingsFile] = process.argv.slice(2);
const camera = JSON.parse(fs.readFileSync(cameraFile, 'utf8'));
const settings = settingsFile ? JSON.parse(fs.readFileSync(settingsFile, 'utf8')) : {};
const modules = path.join(path.dirname(fileURLToPath(import.meta.url)), 'node_modules');

const PAGE = `<!doctype html><style>body{margin:0;background:#000}canvas{display:block}</style>
<script type="importmap">{"imports": {
  "three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/",
  "@sparkjsdev/spark": "/@sparkjsdev/spark/dist/spark.module.js"}}</script>
<script type="module">
import * as THREE from 'three';
import { SparkRenderer, SplatMesh } from '@sparkjsdev/spark';
const c = ${JSON.stringify(camera)};
const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
renderer.setSize(c.width, c.height, false);
document.body.appendChild(renderer.domElement);
const scene = new THREE.Scene();
scene.add(new SparkRenderer({ renderer, ...${JSON.stringify(settings)} }));
const splats = new SplatMesh({ url: '/splats${path.extname(file)}' });
splats.quaternion.set(1, 0, 0, 0);
scene.add(splats);
await splats.initialized;
const camera = new THREE.PerspectiveCamera();
const near = 0.01, far = 10;
camera.projectionMatrix.set(
  2 * c.fx / c.width, 0, 1 - 2 * c.cx / c.width, 0,
  0, 2 * c.fy / c.height, 2 * c.cy / c.height - 1, 0,
  0, 0, -(far + near) / (far - near), -2 * far * near / (far - near),
  0, 0, -1, 0);
camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
const m = c.camera_from_world;
camera.matrixAutoUpdate = false;
camera.matrix.set(...m[0], ...m[1].map((x) => -x), ...m[2].map((x) => -x), ...m[3]).invert();
camera.matrix.decompose(camera.position, camera.quaternion, camera.scale);
camera.updateMatrixWorld(true);
// sorting is done by a worker between frames
for (let frame = 0; frame < 20; frame++) {
  renderer.render(scene, camera);
  await new Promise((done) => setTimeout(done, 100));
}
window.picture = renderer.domElement.toDataURL('image/png');
</script>`;

const TYPES = { '.js': 'text/javascript', '.wasm': 'application/wasm' };
const server = http.createServer((request, response) => {
  const name = decodeURIComponent(new URL(request.url, 'http://localhost').pathname);
  if (name === '/') {
    response.writeHead(200, { 'content-type': 'text/html' }).end(PAGE);
    return;
  }
  const found = name.startsWith('/splats') ? file : path.join(modules, path.normalize(name));
  if (!fs.existsSync(found) || !fs.statSync(found).isFile()) {
    response.writeHead(404).end();
    return;
  }
  response.writeHead(200, { 'content-type': TYPES[path.extname(found)] ?? 'application/octet-stream' });
  fs.createReadStream(found).pipe(response);
});
await new Promise((done) => server.listen(0, '127.0.0.1', done));

const browser = await chromium.launch({
  executablePath: process.env.JGHAND_CHROMIUM,
  args: ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'],
});
try {
  const page = await browser.newPage({ viewport: { width: camera.width, height: camera.height } });
  page.on('console', (message) => console.error(message.text()));
  page.on('pageerror', (error) => console.error(String(error)));
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  await page.waitForFunction(() => window.picture, null, { timeout: 120000 });
  const data = await page.evaluate(() => window.picture);
  fs.writeFileSync(picture, Buffer.from(data.split(',')[1], 'base64'));
} finally {
  await browser.close();
  server.close();
}
