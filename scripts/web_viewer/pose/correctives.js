// What the angles of a pose become before the kernels add it to the skin: jghand_engine/avatar/corrective_task.py.

const BONES = 21;

// The learned planes of the angles: 37 angles -> (21, channels) features of the bones.
class Features {
  constructor({ level1, source, offset, slope, shape }, texels) {
    Object.assign(this, { level1, source, offset, slope, texels });
    [, this.rows, this.columns, this.channels] = shape;
    this.found = new Float64Array(BONES * this.channels);
  }

  of(angles) {
    const { channels, found } = this;
    const own = Array.from({ length: 20 }, (_, bone) => this.lookUp(bone, angles));
    found.fill(0, 0, channels);
    for (let c = 0; c < channels; c++) {
      for (let bone = 0; bone < 20; bone++) {
        const above = bone < 5 ? own[bone][c] : found[(bone - 4) * channels + c];
        found[(bone + 1) * channels + c] = 0.5 * (above + own[bone][c]);
      }
      for (let bone = 0; bone < 5; bone++) found[c] += own[bone][c] / 5;
    }
    return found;
  }

  // bilinear, clamped to the plane
  lookUp(bone, angles) {
    const { rows, columns, channels, texels } = this;
    const last = rows - 1;
    const spots = [0, 1].map((k) => {
      const still = bone < 5 && !this.level1;
      const at = still ? 0 : angles[this.source[bone][k]] * this.slope[bone][k] + this.offset[bone][k];
      const spot = Math.min(Math.max((at + 1) * 0.5 * last, 0), last);
      const low = Math.min(Math.floor(spot), Math.max(last - 1, 0));
      return [low, Math.min(low + 1, last), spot - low];
    });
    const [[left, right, x], [top, bottom, y]] = spots;
    const plane = bone < 5 ? 0 : bone - 4;
    const row = (r, c) => ((plane * rows + r) * columns + c) * channels;
    const corners = [row(top, left), row(top, right), row(bottom, left), row(bottom, right)];
    const shares = [(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y];
    return Array.from({ length: channels }, (_, c) => {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += shares[k] * texels[corners[k] + c];
      return sum;
    });
  }
}

// The linear tier: numbers of every bone from its features.
export class LinearTier {
  constructor(about, views) {
    Object.assign(this, about);
    this.maker = new Features(about.features, views.texels);
    this.numbers = views.numbers;
  }

  prepare(angles) {
    const { mean, projection, first, second, basis } = this;
    const features = this.maker.of(angles), channels = mean.length, simple = projection[0].length;
    for (let bone = 0; bone < BONES; bone++) {
      const own = Array.from({ length: simple }, (_, k) => {
        let sum = 0;
        for (let c = 0; c < channels; c++) sum += (features[bone * channels + c] - mean[c]) * projection[c][k];
        return sum;
      });
      for (let k = 0; k < basis; k++)
        this.numbers[bone * basis + k] = k < simple ? own[k] : own[first[k - simple]] * own[second[k - simple]];
    }
  }
}

// The network: the part of its first layer that depends on the angles.
export class Network {
  constructor(about, views) {
    this.maker = new Features(about.features, views.texels);
    this.hidden = about.hidden;
    this.weights = views.angles_in;
    this.features = views.features;
  }

  prepare(angles) {
    const features = this.maker.of(angles), { hidden, weights } = this, channels = this.maker.channels;
    for (let bone = 0; bone < BONES; bone++)
      for (let h = 0; h < hidden; h++) {
        let sum = 0;
        for (let c = 0; c < channels; c++) sum += features[bone * channels + c] * weights[c * hidden + h];
        this.features[bone * hidden + h] = sum;
      }
  }
}
