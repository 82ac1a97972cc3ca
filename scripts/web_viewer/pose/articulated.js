// A hand that is posed by anatomical angles, and the angles of a posed hand: jghand_engine/hand/kinematics.py.
// Fingers from the thumb; angles of each: first joint's flexion, its abduction, second and third joint's flexion, radians.

const FINGERS = 5, LEVELS = 3, DEGREE = Math.PI / 180;

export class Articulated {
  // Of the canonical hand with straight fingers: straight, flexion, abduction: (3 levels, 5 fingers, 3) where bones point,
  // and their axes · side: (5) · ranges_deg: (5, 4, 2) · curled_deg: (5, 4) what a full curl is · poses_deg: by name (5, 4)
  constructor(about) {
    Object.assign(this, about);
    this.ranges = about.ranges_deg.map((finger) => finger.map((range) => range.map((angle) => angle * DEGREE)));
    this.curled = radians(about.curled_deg);
    this.poses = Object.fromEntries(Object.entries(about.poses_deg).map(([name, angles]) => [name, radians(angles)]));
  }

  // (5, 4) angles within their ranges
  clamped(angles) {
    return angles.map((finger, f) => finger.map((angle, k) => between(this.ranges[f][k], angle)));
  }

  // A hand that is shown, to be posed by angles: 63 numbers and the map of its palm, 3 x 4. Gives its joints, palm and
  // angles, and its bones as they are where all its angles are 0: with their lengths, and with what no angle says.
  taken(joints, palm) {
    // the map turns, mirrors a left hand, and scales
    const columns = [0, 1, 2].map((k) => unit([palm[k], palm[4 + k], palm[8 + k]]));
    const angles = [], bones = [];
    for (let f = 0; f < FINGERS; f++) {
      const posed = Array.from({ length: LEVELS }, (_, level) => {
        const from = 1 + f + FINGERS * level, bone = minus(jointOf(joints, from + FINGERS), jointOf(joints, from));
        return columns.map((column) => dot(column, bone));
      });
      angles.push(this.anglesOf(posed, f));
      const turns = this.turns(angles[f], f);
      bones.push(posed.map((bone, level) => apply(transposed(turns[level]), bone)));
    }
    return { joints: Float64Array.from(joints), palm: transposed(columns), angles, bones };
  }

  // 63 numbers: a hand that was taken, with other angles (5, 4). own: how far its bones keep what no angle says, from 0,
  // bones of the canonical hand but for their lengths, to 1, with which its own angles give its own joints.
  joints({ joints, palm, bones }, { angles, own }) {
    const found = Float64Array.from(joints);
    angles.forEach((finger, f) => this.turns(finger, f).forEach((turn, level) => {
      const from = 1 + f + FINGERS * level, kept = bones[f][level], length = Math.hypot(...kept);
      const ahead = unit(kept.map((x, k) => own * x + (1 - own) * length * this.straight[level][f][k]));
      const bone = apply(palm, apply(turn, ahead.map((x) => length * x)));
      found.set(jointOf(found, from).map((x, k) => x + bone[k]), 3 * (from + FINGERS));
    }));
    return found;
  }

  // How the bones of a finger are turned by its angles: 3 matrices
  turns([flexion, abduction, second, third], f) {
    let turn = axisTurn(this.abduction[0][f], -this.side[f] * abduction);
    return [flexion, second, third].map((angle, level) => (turn = times(turn, axisTurn(this.flexion[level][f], angle))));
  }

  // The angles (4) of a finger whose bones (3, 3) point there, in the axes of the palm; their lengths do not matter
  anglesOf(bones, f) {
    const up = this.abduction[0][f], axis = this.flexion[0][f], first = unit(bones[0]);
    const flexion = Math.asin(between([-1, 1], dot(first, up)));
    const turned = Math.atan2(-dot(first, axis), dot(first, this.straight[0][f]));
    let turn = times(axisTurn(up, turned), axisTurn(axis, flexion));
    const further = [1, 2].map((level) => {
      const ahead = this.straight[level][f], hinge = this.flexion[level][f];
      const bone = apply(transposed(turn), bones[level]);
      const angle = Math.atan2(dot(bone, cross(hinge, ahead)), dot(bone, ahead));
      turn = times(turn, axisTurn(hinge, angle));
      return angle;
    });
    return [flexion, -turned / this.side[f], ...further];
  }

  // How far a finger is curled, 0 straight and 1 as in a fist
  curl(finger, f) {
    const full = this.curled[f];
    return bends.reduce((sum, k) => sum + finger[k] * full[k], 0) / bends.reduce((sum, k) => sum + full[k] * full[k], 0);
  }

  // The same finger with its curl changed by `part`: no angle leaves its range that was not beyond it
  curledBy(finger, f, part) {
    return finger.map((angle, k) => {
      const [low, high] = this.ranges[f][k];
      const bent = angle + (bends.includes(k) ? part * this.curled[f][k] : 0);
      return between([Math.min(low, angle), Math.max(high, angle)], bent);
    });
  }
}

const bends = [0, 2, 3];  // the angles that curl a finger

const radians = (angles) => angles.map((finger) => finger.map((angle) => angle * DEGREE));
const jointOf = (joints, index) => Array.from(joints.slice(3 * index, 3 * index + 3));
const between = ([low, high], value) => Math.min(Math.max(value, low), high);
const minus = (a, b) => a.map((x, k) => x - b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((x) => x / (Math.hypot(...a) || 1));  // a bone without length points nowhere
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
