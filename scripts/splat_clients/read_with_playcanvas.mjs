// What the engine of PlayCanvas reads from a GLB with KHR_gaussian_splatting, in Node on its device that draws nothing:
// a table of 32-bit floats, a row for a Gaussian, in an order of its own.
//
//     node read_with_playcanvas.mjs FILE TABLE
//
// Row: center (3), sigma (3), quaternion w, x, y, z (4), color (3), opacity (1).
import fs from 'node:fs';
import { NullGraphicsDevice } from 'playcanvas';
import { khrGaussianSplatting } from
  './node_modules/playcanvas/build/playcanvas/src/framework/parsers/glb/extensions/khr-gaussian-splatting.js';

const SH_C0 = 0.28209479177387814;
const NAMES = ['x', 'y', 'z', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3',
  'f_dc_0', 'f_dc_1', 'f_dc_2', 'opacity'];

const [file, table] = process.argv.slice(2);
const bytes = fs.readFileSync(file);
const textLength = bytes.readUInt32LE(12);
const gltf = JSON.parse(bytes.subarray(20, 20 + textLength));
const binary = bytes.subarray(28 + textLength);
// a view of its own memory, as numbers have to begin at multiples of four
const views = gltf.bufferViews.map(({ byteOffset = 0, byteLength }) =>
  new Uint8Array(binary.subarray(byteOffset, byteOffset + byteLength)));

const device = new NullGraphicsDevice({ width: 1, height: 1, addEventListener() {}, removeEventListener() {} });
const [[{ gsplatData }]] = khrGaussianSplatting.createResources(device, gltf, views);
const columns = NAMES.map((name) => gsplatData.getProp(name));
const rows = new Float32Array(gsplatData.numSplats * NAMES.length);
columns.forEach((column, place) => {
  for (let i = 0; i < column.length; i++) {
    const harmonics = place >= 10 && place < 13;
    rows[i * NAMES.length + place] = harmonics ? column[i] * SH_C0 + 0.5 : column[i];
  }
});
fs.writeFileSync(table, new Uint8Array(rows.buffer));
