// What the hand does: a motion that plays, or a pose that is held, with smooth ways between poses.

const TURN_S = 0.55;

export class Player {
  // hand, articulated: of pose.js · motion: { joints: Float32Array, frames, fps }
  constructor(hand, articulated, motion, onChange) {
    Object.assign(this, { hand, articulated, motion, onChange });
    this.frame = 0;
    this.speed = 1;
    this.playing = false;
    this.held = undefined;  // the pose, { angles, own } of Articulated.joints; undefined while the motion has the hand
    this.taken = undefined;  // the hand that is posed, as it was when the motion was left
    this.turn = undefined;
    this.showFrame();
  }

  get holds() {
    return this.held !== undefined;
  }

  play() {
    if (this.motion.frames < 2) return;
    this.release();
    if (this.frame >= this.motion.frames - 1) this.frame = 0;
    this.playing = true;
    this.last = undefined;
    this.onChange();
  }

  pause() {
    this.playing = false;
    this.onChange();
  }

  seek(frame) {
    this.release();
    this.frame = Math.min(Math.max(frame, 0), this.motion.frames - 1);
    this.showFrame();
    this.onChange();
  }

  // back from a pose to the motion
  release() {
    this.held = this.turn = this.taken = undefined;
  }

  // A pose: angles (5, 4), radians, of a hand with straight bones; smoothly: on the way that a hand would take
  hold(angles, smoothly = false) {
    const from = this.held ?? this.goal, to = { angles, own: 0 };
    this.show(smoothly ? from : to);
    this.turn = smoothly ? { from, to, start: undefined } : undefined;
    this.onChange();
  }

  // The angles (4) of one finger; all else stays as it is, or as the turn that is under way leads to
  bend(f, finger) {
    const { angles, own } = this.goal;
    this.turn = undefined;
    this.show({ angles: angles.map((others, g) => (g === f ? finger : others)), own });
    this.onChange();
  }

  // The pose of what is shown, whether motion or pose; of a turn that is under way the one that it leads to
  get goal() {
    return this.turn?.to ?? this.held ?? { angles: this.articulated.taken(this.joints, this.hand.palm).angles, own: 1 };
  }

  // The next moment; whether there are more to come. now: milliseconds
  step(now) {
    if (this.turn) {
      const { turn } = this;
      turn.start ??= now;
      const part = Math.min((now - turn.start) / 1000 / TURN_S, 1);
      // minimum jerk
      const share = part ** 3 * (10 - 15 * part + 6 * part ** 2);
      const between = (from, to) => from + share * (to - from), { from, to } = turn;
      this.show({
        angles: from.angles.map((finger, f) => finger.map((x, k) => between(x, to.angles[f][k]))), own: between(from.own, to.own),
      });
      if (part === 1) this.turn = undefined;
      this.onChange();
      return Boolean(this.turn);
    }
    if (!this.playing) return false;
    const passed = (now - (this.last ?? now)) / 1000;
    this.last = now;
    const frames = this.motion.frames;
    this.frame += passed * this.speed * this.motion.fps;
    // the last frame stays as long as any other
    if (this.frame >= frames) this.frame %= frames;
    this.showFrame();
    this.onChange();
    return true;
  }

  showFrame() {
    const { joints, frames } = this.motion;
    const low = Math.min(Math.floor(this.frame), frames - 1), high = Math.min(low + 1, frames - 1), part = Math.min(this.frame - low, 1);
    this.joints = Float64Array.from({ length: 63 }, (_, k) => (1 - part) * joints[63 * low + k] + part * joints[63 * high + k]);
    this.pose();
  }

  show(held) {
    this.playing = false;
    this.taken ??= this.articulated.taken(this.joints, this.hand.palm);
    this.held = held;
    this.joints = this.articulated.joints(this.taken, held);
    this.pose();
  }

  pose() {
    this.hand.pose(this.joints);
    this.posed?.();
  }
}
