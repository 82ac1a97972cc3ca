// The arrays that the kernels read and write, laid out in the memory of the WebAssembly module.

const LINE = 64;  // bytes that a vector of sixteen floats takes
const PAGE = 65536;
const VIEWS = { f8: Float64Array, f4: Float32Array, i4: Int32Array, i1: Int8Array, b1: Uint8Array };
// how an array stands in the file -> as what it lies in memory
const IN_MEMORY = { f8: 'f8', f4: 'f4', i4: 'i4', i1: 'i1', b1: 'b1', rounded: 'f4', u1: 'i4', u2: 'i4', empty: 'f4' };
const IN_FILE = { f8: Float64Array, f4: Float32Array, i4: Int32Array, i1: Int8Array, b1: Uint8Array, rounded: Uint16Array, u1: Uint8Array, u2: Uint16Array };

export class Memory {
  // arrays: name -> { kind, shape, at?, low?, step? } · content: the ArrayBuffer that `at` counts bytes of
  // extra: name -> [kind, length], further ones that begin as zeros
  constructor(arrays, content, extra, exports) {
    this.pointers = {};
    this.views = {};
    const places = Object.entries(arrays).map(([name, array]) => [name, IN_MEMORY[array.kind], size(array.shape)]);
    for (const [name, [kind, length]] of Object.entries(extra)) places.push([name, kind, length]);
    let end = exports.__heap_base.value;
    for (const [name, kind, length] of places) {
      end = Math.ceil(end / LINE) * LINE;
      this.pointers[name] = end;
      end += length * VIEWS[kind].BYTES_PER_ELEMENT;
    }
    const missing = end - exports.memory.buffer.byteLength;
    if (missing > 0) exports.memory.grow(Math.ceil(missing / PAGE));
    for (const [name, kind, length] of places)
      this.views[name] = new VIEWS[kind](exports.memory.buffer, this.pointers[name], length);
    for (const [name, array] of Object.entries(arrays)) if (array.kind !== 'empty') fill(this.views[name], array, content);
  }

  // The words of a task that lies in memory by a name: pointers lead to the arrays that are called as they are, behind a prefix
  task(name, { words, pointers }, prefix = '') {
    const task = new Uint32Array(this.views[name].buffer, this.pointers[name], words.length);
    task.set(words);
    for (const [field, place] of Object.entries(pointers)) task[place] = this.pointers[prefix + field] ?? 0;
    return task;
  }
}

function fill(view, array, content) {
  const source = new IN_FILE[array.kind](content, array.at, view.length);
  if (array.kind !== 'rounded') return view.set(source);
  // shape (outer, channels, inner): every channel has steps of its own
  const [, channels, inner] = array.shape;
  for (let i = 0; i < source.length; i++) {
    const channel = Math.floor(i / inner) % channels;
    view[i] = array.low[channel] + array.step[channel] * source[i];
  }
}

function size(shape) {
  return shape.reduce((product, edge) => product * edge, 1);
}
