// What the hand does: a motion that plays, or a pose that is held, with smooth ways between poses.

const TURN_S = 0.55;

export class Player {
  // hand, articulated: of pose.js · motion: { joints: Float32Array, frames, fps }
  constructor(hand, articulated, motion, onChange) {
    Object.assign(this, { hand, articulated, motion, onChange });
    this.frame = 0;
    this.speed = 1;
    this.playing = false;
    this.angles = undefined;  // of the pose that is held; undefined while the motion has the hand
    this.turn = undefined;
    this.showFrame();
  }

  get holds() {
    return this.angles !== undefined;
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
    this.angles = this.turn = undefined;
  }

  // angles: (5, 4), radians; smoothly: on the way that a hand would take
  hold(angles, smoothly = false) {
    this.playing = false;
    const from = this.anglesNow();
    this.palm ??= this.hand.palm;
    this.angles = this.articulated.clamped(angles);
    this.turn = smoothly ? { from, to: this.angles, start: undefined } : undefined;
    if (smoothly) this.angles = from;
    else this.showAngles();
    this.onChange();
  }

  // of what is shown, whether motion or pose; of a turn that is under way its goal
  anglesNow() {
    return this.angles ?? this.articulated.clamped(this.articulated.angles(this.joints, this.hand.palm));
  }

  // The next moment; whether there are more to come. now: milliseconds
  step(now) {
    if (this.turn) {
      const { turn } = this;
      turn.start ??= now;
      const part = Math.min((now - turn.start) / 1000 / TURN_S, 1);
      // minimum jerk
      const share = part ** 3 * (10 - 15 * part + 6 * part ** 2);
      this.angles = turn.from.map((finger, f) => finger.map((x, k) => x + share * (turn.to[f][k] - x)));
      if (part === 1) this.turn = undefined;
      this.showAngles();
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
    this.palm = undefined;
    this.pose();
  }

  showAngles() {
    this.palm ??= this.hand.palm;
    this.joints = Float64Array.from(this.articulated.joints(this.angles, Array.from(this.palm), Array.from(this.joints.slice(0, 3))));
    this.pose();
  }

  pose() {
    this.hand.pose(this.joints);
    this.posed?.();
  }
}
