// A hand that is posed by anatomical angles, and the angles of a posed hand: jghand_engine/hand/anatomy.py.
// Fingers from the thumb; angles of each: first joint's flexion, its abduction, second and third joint's flexion, radians.

const FINGERS = 5, LEVELS = 3, DEGREE = Math.PI / 180;

export class Articulated {
  // straight_m: (21, 3) joints with straight fingers · flexion, abduction: (3 levels, 5 fingers, 3) axes · side: (5)
  // ranges_deg: (5, 4, 2) · curled_deg: (5, 4) what a full curl is · root_m: of the canonical hand
  constructor(about) {
    Object.assign(this, about);
    this.ranges = about.ranges_deg.map((finger) => finger.map((range) => range.map((angle) => angle * DEGREE)));
    this.curled = radians(about.curled_deg);
    this.poses = Object.fromEntries(Object.entries(about.poses_deg).map(([name, angles]) => [name, radians(angles)]));
  }

  // (5, 4) angles within their ranges
  clamped(angles) {
    return angles.map((finger, f) => finger.map((angle, k) => {
      const [low, high] = this.ranges[f][k];
      return Math.min(Math.max(angle, low), high);
    }));
  }

  // (5, 4) angles -> 63 numbers, as the palm's map (3 x 4) and root (3) of a pose carry the canonical hand
  joints(angles, palm, root) {
    const found = this.straight_m.map((joint) => [...joint]);
    this.clamped(angles).forEach(([flexion, abduction, second, third], f) => {
      let turn = axisTurn(this.abduction[0][f], -this.side[f] * abduction);
      [flexion, second, third].forEach((angle, level) => {
        turn = times(turn, axisTurn(this.flexion[level][f], angle));
        const from = 1 + f + 5 * level, to = from + 5;
        const bone = apply(turn, minus(this.straight_m[to], this.straight_m[from]));
        found[to] = found[from].map((x, k) => x + bone[k]);
      });
    });
    return found.flatMap((joint) => {
      const from = minus(joint, this.root_m);
      return [0, 1, 2].map((row) => root[row] + palm[4 * row + 3] + dot(palm.slice(4 * row, 4 * row + 3), from));
    });
  }

  // The angles (5, 4) of 63 numbers, whose palm's map is given: exact for hands that `joints` made
  angles(joints, palm) {
    const columns = [0, 1, 2].map((k) => [palm[k], palm[4 + k], palm[8 + k]]);
    const joint = (i) => Array.from(joints.slice(3 * i, 3 * i + 3));
    return Array.from({ length: FINGERS }, (_, f) => {
      // the scale of the hand does not matter: only directions are asked for
      const bones = Array.from({ length: LEVELS }, (_, level) => {
        const from = 1 + f + 5 * level;
        const bone = minus(joint(from + 5), joint(from));
        return columns.map((column) => dot(column, bone));
      });
      const straight = unit(minus(this.straight_m[6 + f], this.straight_m[1 + f]));
      const up = this.abduction[0][f], axis = this.flexion[0][f], first = unit(bones[0]);
      const flexion = Math.asin(Math.min(Math.max(dot(first, up), -1), 1));
      const turned = Math.atan2(-dot(first, axis), dot(first, straight));
      let turn = times(axisTurn(up, turned), axisTurn(axis, flexion));
      const further = [1, 2].map((level) => {
        const from = 1 + f + 5 * level;
        const ahead = unit(minus(this.straight_m[from + 5], this.straight_m[from])), hinge = this.flexion[level][f];
        const bone = apply(transposed(turn), bones[level]);
        const angle = Math.atan2(dot(bone, cross(hinge, ahead)), dot(bone, ahead));
        turn = times(turn, axisTurn(hinge, angle));
        return angle;
      });
      return [flexion, -turned / this.side[f], ...further];
    });
  }

  // How far a finger is curled, 0 straight and 1 as in a fist
  curl(finger, f) {
    const full = this.curled[f];
    return bends.reduce((sum, k) => sum + finger[k] * full[k], 0) / bends.reduce((sum, k) => sum + full[k] * full[k], 0);
  }

  // The same finger with its curl changed by `part`
  curledBy(finger, f, part) {
    return this.clamped(this.curled.map((full, g) => full.map((angle, k) => (g === f ? finger[k] + (k === 1 ? 0 : part * angle) : 0))))[f];
  }
}

const bends = [0, 2, 3];  // the angles that curl a finger

const radians = (angles) => angles.map((finger) => finger.map((angle) => angle * DEGREE));
const minus = (a, b) => a.map((x, k) => x - b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((x) => x / Math.hypot(...a));
const apply = (m, v) => m.map((row) => dot(row, v));
const transposed = (m) => [0, 1, 2].map((k) => m.map((row) => row[k]));
const times = (a, b) => a.map((row) => transposed(b).map((column) => dot(row, column)));

function axisTurn([x, y, z], angle) {
  const s = Math.sin(angle), c = Math.cos(angle), k = 1 - c;
  return [
    [c + k * x * x, k * x * y - s * z, k * x * z + s * y],
    [k * x * y + s * z, c + k * y * y, k * y * z - s * x],
    [k * x * z - s * y, k * y * z + s * x, c + k * z * z],
  ];
}
