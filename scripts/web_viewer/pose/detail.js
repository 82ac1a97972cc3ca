// The surface of the skin's texture, and how the light on it turns with its normal: the first step of native/detail.cpp,
// which jghand_engine/render/detail.py prepares.
import { moved } from './capsules.js';

export class Detail {
  constructor({ size, relief, tasks, products, rest }, { memory, kernels }) {
    const { views, pointers } = memory;
    Object.assign(this, { relief, views, pointers, kernels, products, rest, fields: tasks.surface.fields });
    for (const [name, task] of Object.entries(tasks)) this[name] = memory.task(`detail.${name}`, task, 'detail.');
    if (kernels.jg_detail_task_bytes() !== this.task.byteLength || kernels.jg_detail_hand_bytes() !== this.hands.byteLength)
      throw new Error('hand.js and pose.js are of different versions of JGHand. Export the folder anew.');
    this.surface[tasks.surface.pointers['skin.linear_offset']] = pointers['skin.linear_offset'];
    this.hands[tasks.hands.pointers.learned] = pointers.task;
    this.floats = new Float32Array(this.surface.buffer, this.surface.byteOffset, this.surface.length);
    this.texture = shades(views['detail.shades'], size);
    this.rises = relief && rises(views['detail.heights'], size, (0.5 * relief.height_m * size) / relief.step_m);
  }

  // After a pose of the hand: `detail.vertex` and, of a relief, `detail.slope` and `detail.bend`
  pose({ joints }) {
    const { views, pointers, relief, floats, fields } = this, numbers = views['detail.numbers'];
    floats.set(joints.slice(0, 3), fields['skin.shift']);
    floats[fields['skin.scale']] = views.scale[0];
    floats[fields['skin.inverse_scale']] = 1 / Math.max(views.scale[0], 1.17549435e-38);
    if (numbers) numbers.set(angleNumbers(views.angles, this.products).map((number, k) => number - this.rest[k]));
    this.kernels.jg_detail_vertices(pointers['detail.task']);
    if (relief) this.bend();
  }

  // How bent the skin is: Bend of jghand_engine/avatar/relief.py
  bend() {
    const { views, relief } = this, near = views['detail.near'], bend = views['detail.bend'];
    const joints = moved(views.matrices, relief.joints_m), [low, high] = relief.bend_deg;
    const bent = relief.rest_deg.map((rest, k) => {
      const joint = k + 1, before = minus(joints[joint], joints[Math.max(joint - 5, 0)]), after = minus(joints[joint + 5], joints[joint]);
      const cosine = dot(before, after) / (Math.sqrt(dot(before, before) * dot(after, after)) || 1);
      const angle = (Math.acos(Math.min(Math.max(cosine, -1), 1)) * 180) / Math.PI;
      const part = Math.min(Math.max((angle - rest - low) / (high - low), 0), 1);
      return part * part * (3 - 2 * part);
    });
    for (let i = 0, n = 0; i < bend.length; i++) {
      bend[i] = 0;
      for (let k = 0; k < bent.length; k++) bend[i] += bent[k] * near[n++];
    }
  }
}

// `angle_numbers` of jghand_engine/avatar/detail_correctives.py: what the 21 bones say
function angleNumbers(angles, [first, second]) {
  return Array.from({ length: 21 }, (_, bone) => {
    const start = 2 * ((bone - 1) % 5), palm = angles.slice(30);
    const own = bone < 6 ? [...palm] : [0, 1, 10, 11, 20, 21].map((k) => angles[start + k]).concat(0);
    return own.concat(first.map((k, place) => own[k] * own[second[place]]));
  }).flat();
}

const minus = (a, b) => a.map((x, k) => x - b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

// RGBA of what `differences` of avatar/detail_storage.py made: running sums down the columns, and more than green
function shades(packed, size) {
  const plane = size * size, rgba = new Uint8Array(4 * plane);
  for (let channel = 0; channel < 3; channel++)
    for (let i = 0; i < plane; i++)
      rgba[4 * i + channel] = packed[channel * plane + i] + (i < size ? 0 : rgba[4 * (i - size) + channel]);
  for (let i = 0; i < plane; i++) {
    rgba[4 * i] += rgba[4 * i + 1];
    rgba[4 * i + 2] += rgba[4 * i + 1];
    rgba[4 * i + 3] = 255;
  }
  return rgba;
}

// RGBA of what `height_differences` made: how heights rise by column and by row, straight and bent, in so many steps of a
// byte from 128 on
function rises(packed, size, steps) {
  const plane = size * size, rgba = new Uint8Array(4 * plane);
  const heights = [0, 1].map((k) => new Int8Array(packed.slice(k * plane, (k + 1) * plane).buffer));
  heights.forEach((height) => { for (let i = size; i < plane; i++) height[i] += height[i - size]; });
  const [straight, bent] = heights, last = size - 1;
  // RISES of jghand_engine/avatar/relief.py, over 1 / 2
  const rise = (height, i, step, place) => {
    const apart = (k) => height[i + step * Math.min(k, last - place)] - height[i - step * Math.min(k, place)];
    return (8 * apart(1) - apart(2)) / 6;
  };
  for (let i = 0; i < plane; i++) bent[i] += straight[i];
  heights.forEach((height, k) => {
    for (let row = 0, i = 0; row < size; row++)
      for (let column = 0; column < size; column++, i++) {
        rgba[4 * i + 2 * k] = 128 + byte(steps * rise(height, i, 1, column));
        rgba[4 * i + 2 * k + 1] = 128 + byte(steps * rise(height, i, size, row));
      }
  });
  return rgba;
}

const byte = (steps) => Math.min(Math.max(Math.round(steps), -127), 127);
