// What poses the hand, without any drawing: the engine's own kernels as WebAssembly, and the little around them that the
// engine does in Python. Runs in browsers and in Node.
import wasm from './kernels.wasm';
import { Hand } from './hand.js';

// threads that wait for others may sleep: here there is one thread, which never waits
const SYSTEM = { wasi_snapshot_preview1: { poll_oneoff: () => 0 } };

export { Articulated } from './articulated.js';

// The hand of a file hand.js: its description, and its arrays packed.
export async function openHand({ description, arrays }) {
  const [{ instance }, content] = await Promise.all([WebAssembly.instantiate(wasm, SYSTEM), unpacked(arrays)]);
  return new Hand(description, content, instance.exports);
}

// base64 of gzip -> ArrayBuffer
async function unpacked(text) {
  if (typeof DecompressionStream === 'undefined') throw new Error('This browser is too old: it cannot unpack data.');
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
  return new Response(stream).arrayBuffer();
}
