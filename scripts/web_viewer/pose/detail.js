// The surface of the skin's texture: skinned as Gaussians are, without correctives (jghand_engine/render/detail.py).

export class Detail {
  constructor({ size }, views) {
    Object.assign(this, { size, views });
    this.positions = new Float32Array(views['detail.rest'].length);
    this.texture = shades(views['detail.shades'], size);
  }

  // By the bones that `matrices` has, from the root of the pose
  pose() {
    const { matrices, joints } = this.views, { positions } = this;
    const [rest, bones, weights] = ['rest', 'bone', 'weight'].map((name) => this.views[`detail.${name}`]);
    const most = weights.length / (rest.length / 3), m = new Float64Array(12);
    for (let i = 0; i < rest.length / 3; i++) {
      m.fill(0);
      for (let k = most * i; k < most * (i + 1); k++)
        for (let n = 0; n < 12; n++) m[n] += weights[k] * matrices[12 * bones[k] + n];
      for (let row = 0; row < 3; row++) {
        const at = 4 * row;
        positions[3 * i + row] = joints[row] + m[at] * rest[3 * i] + m[at + 1] * rest[3 * i + 1] + m[at + 2] * rest[3 * i + 2] + m[at + 3];
      }
    }
  }
}

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
