// The fingers as capsules that stand before lamps: jghand_engine/avatar/cast_task.py.

const BONES = 20, LANES = 16, CAPSULE = 8;  // numbers of a capsule

export class Capsules {
  constructor(about, views) {
    Object.assign(this, about);
    this.capsule = views['cast.capsule'];
    this.lamp = views['cast.capsule_lamp'];
  }

  // matrices: (21, 3, 4) of the pose · scale: of the whole hand
  prepare(matrices, scale) {
    const [starts, ends] = this.flesh_m.map((points) => moved(matrices, points, 1));
    const lamps = this.direction.length, groups = lamps / LANES;
    for (let bone = 0; bone < BONES; bone++) {
      const start = starts[bone], axis = ends[bone].map((x, k) => x - start[k]);
      const length2 = Math.max(dot(axis, axis), this.length2_min);
      this.capsule.set([...start, ...axis, 1 / length2, this.radius_m[bone] * scale], CAPSULE * bone);
      for (let k = 0; k < lamps; k++) {
        const along = dot(axis, this.direction[k]);
        const sine2 = Math.max(length2 - along * along, this.sine2_min * length2);
        const place = 2 * LANES * (groups * bone + Math.floor(k / LANES)) + (k % LANES);
        this.lamp[place] = along;
        this.lamp[place + LANES] = 1 / sine2;
      }
    }
  }
}

// Where the maps of bones, `first` and those after it, carry a point of each, root-relative
export function moved(matrices, points, first = 0) {
  return points.map((point, i) => [0, 1, 2].map((row) => {
    const m = 12 * (first + i) + 4 * row;
    return matrices[m] * point[0] + matrices[m + 1] * point[1] + matrices[m + 2] * point[2] + matrices[m + 3];
  }));
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
