// The loaders of three.js in Node: what they read from a splat file, as a table of 32-bit floats, a row for a Gaussian.
//
//     node read_with_three.mjs FILE TABLE          (.ply .splat .spz .glb)
//
// Row: center (3), covariance xx xy xz yy yz zz (6), color (3) and opacity (1), which three keeps in 8 bits.
import fs from 'node:fs';
import path from 'node:path';

globalThis.self ??= globalThis;
globalThis.ProgressEvent ??= class {};

const LOADERS = { '.ply': 'GaussianSplatPLYLoader', '.splat': 'SPLATLoader', '.spz': 'SPZLoader' };

function content(file) {
  const bytes = fs.readFileSync(file);
  return bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
}

async function geometryOf(file) {
  const suffix = path.extname(file).toLowerCase();
  if (suffix === '.glb') {
    const { GLTFLoader } = await import('three/examples/jsm/loaders/GLTFLoader.js');
    const { GLTFGaussianSplatLoaderExtension } = await import(
      'three/examples/jsm/loaders/GLTFGaussianSplatLoaderExtension.js');
    const loader = new GLTFLoader().register((parser) => new GLTFGaussianSplatLoaderExtension(parser));
    let geometry = null;
    (await loader.parseAsync(content(file), '')).scene.traverse((object) => { geometry ??= object.splatGeometry; });
    return geometry;
  }
  const name = LOADERS[suffix];
  const loader = new (await import(`three/examples/jsm/loaders/${name}.js`))[name]();
  return await loader.parse(content(file));
}

const [file, table] = process.argv.slice(2);
const { position, covariance, color } = (await geometryOf(file)).attributes;
const rows = new Float32Array(position.count * 13);
for (let i = 0; i < position.count; i++) {
  rows.set(position.array.subarray(3 * i, 3 * i + 3), 13 * i);
  rows.set(covariance.array.subarray(6 * i, 6 * i + 6), 13 * i + 3);
  rows.set(Array.from(color.array.subarray(4 * i, 4 * i + 4), (byte) => byte / 255), 13 * i + 9);
}
fs.writeFileSync(table, new Uint8Array(rows.buffer));
