// Canvas, camera and orbit; draws when something changed, and only then.
import * as THREE from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { Painter } from './painter.js';

const NEAR_M = 0.01, FAR_M = 100;
const NEAREST = 0.3, FARTHEST = 6;  // of the first distance, how far one may zoom
const PIXEL_RATIO_MAX = 2;
const FADE_MS = 100;  // between pictures, above which turning stops at once
const SLOW_MS = 45, SLOW_FRAMES = 8;  // so many frames as slow as this, and the picture gets coarser

export class Stage {
  // view: { to_eye, up, focal } as the command chose them · points: [[x, y, z, radius], …] that must be in sight
  constructor(canvas, hand, { view, points, contract }, beforeDrawing) {
    this.hand = hand;
    this.canvas = canvas;
    this.beforeDrawing = beforeDrawing;
    this.view = view;
    this.points = points;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: false, alpha: true, powerPreference: 'high-performance' });
    this.renderer.setClearColor(0, 0);
    this.camera = new THREE.PerspectiveCamera(30, 1, NEAR_M, FAR_M);
    this.camera.up.fromArray(view.up);
    this.painter = new Painter(this.renderer, hand, contract);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.dampingFactor = 0.12;
    this.controls.zoomSpeed = 0.8;
    this.controls.addEventListener('change', () => this.ask());
    this.ratio = Math.min(window.devicePixelRatio, PIXEL_RATIO_MAX);
    this.room = { top: 0, right: 0, bottom: 0 };
    this.slow = 0;
    this.posed = true;
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    // a phone takes the graphics card away from pages that are not looked at, and gives it back
    this.losses = 0;
    canvas.addEventListener('webglcontextlost', () => {
      this.lost = true;
      this.losses++;
      this.told?.('The graphics card is busy elsewhere.');
    });
    canvas.addEventListener('webglcontextrestored', () => {
      this.lost = false;
      this.error = undefined;
      this.told?.('');
      this.changed();
    });
    this.resize();
    this.home();
  }

  // The camera where the command put it, as near as everything fits
  home() {
    this.fixed = false;
    const toEye = new THREE.Vector3().fromArray(this.view.to_eye).normalize();
    const right = new THREE.Vector3().fromArray(this.view.up).cross(toEye).normalize();
    const up = toEye.clone().cross(right);
    const axes = [right, up, toEye], low = [Infinity, Infinity, Infinity], high = low.map((x) => -x);
    const seen = this.points.map(([x, y, z, radius]) => axes.map((axis, k) => {
      const along = axis.x * x + axis.y * y + axis.z * z;
      low[k] = Math.min(low[k], along - radius);
      high[k] = Math.max(high[k], along + radius);
      return along;
    }));
    const center = low.map((x, k) => (x + high[k]) / 2);
    const { width, height } = this.free;
    const focal = this.focal;
    let distance = 0;
    seen.forEach((point, i) => [width, height].forEach((edge, k) => {
      const radius = this.points[i][3], beside = Math.abs(point[k] - center[k]) + radius;
      distance = Math.max(distance, point[2] - center[2] + radius + (focal * beside) / (0.5 * edge * this.view.fill));
    }));
    const target = new THREE.Vector3();
    axes.forEach((axis, k) => target.addScaledVector(axis, center[k]));
    this.controls.target.copy(target);
    this.camera.position.copy(target).addScaledVector(toEye, distance);
    this.controls.minDistance = NEAREST * distance;
    this.controls.maxDistance = FARTHEST * distance;
    this.project();
    this.controls.update();
    this.atHome = true;
    this.ask();
  }

  // room: pixels that are covered at the top, at the right and at the bottom: the hand stays in the middle of the rest
  keepFree(room) {
    this.room = room;
    this.resize();
  }

  get free() {
    return { width: Math.max(this.width - this.room.right, 1), height: Math.max(this.height - this.room.top - this.room.bottom, 1) };
  }

  get focal() {
    const { width, height } = this.free;
    return this.view.focal * Math.max(width, height);
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    this.width = Math.max(clientWidth, 1);
    this.height = Math.max(clientHeight, 1);
    this.renderer.setPixelRatio(this.ratio);
    this.renderer.setSize(this.width, this.height, false);
    if (this.fixed) return;
    this.project();
    if (this.atHome && !this.touched) this.home();
    this.ask();
  }

  project() {
    const { width, height, camera } = this;
    camera.aspect = width / height;
    camera.fov = THREE.MathUtils.radToDeg(2 * Math.atan(height / 2 / this.focal));
    camera.setViewOffset(width, height, this.room.right / 2, (this.room.bottom - this.room.top) / 2, width, height);
    camera.updateProjectionMatrix();
  }

  // A pinhole camera as JGHand writes it into camera.json; the canvas must have its proportions. origin: of the page, in
  // the world of the motion
  lookThrough({ width, height, fx, fy, cx, cy, camera_from_world: m }, origin) {
    const { camera } = this;
    this.fixed = true;
    camera.view = null;
    camera.projectionMatrix.set(
      (2 * fx) / width, 0, 1 - (2 * cx) / width, 0,
      0, (2 * fy) / height, (2 * cy) / height - 1, 0,
      0, 0, -(FAR_M + NEAR_M) / (FAR_M - NEAR_M), (-2 * FAR_M * NEAR_M) / (FAR_M - NEAR_M),
      0, 0, -1, 0,
    );
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
    camera.matrix.set(...m[0], ...m[1].map((x) => -x), ...m[2].map((x) => -x), ...m[3]);
    camera.matrix.multiply(new THREE.Matrix4().makeTranslation(...origin)).invert();
    camera.matrix.decompose(camera.position, camera.quaternion, camera.scale);
    camera.updateMatrixWorld(true);
    this.ask();
  }

  // A sun at angles, degrees, around the hand from where it was seen at first, and above it
  lightFrom(around, height) {
    const toEye = new THREE.Vector3().fromArray(this.view.to_eye), up = new THREE.Vector3().fromArray(this.view.up).normalize();
    const right = up.clone().cross(toEye).normalize(), degree = Math.PI / 180;
    const towards = right.clone().cross(up).applyAxisAngle(up, around * degree).multiplyScalar(Math.cos(height * degree));
    this.turnLight(towards.addScaledVector(up, Math.sin(height * degree)).toArray(), around, height);
  }

  // The light that the hand carries
  ownLight() {
    this.turnLight();
  }

  turnLight(towards, ...angles) {
    this.hand.turnLight(towards);
    this.lit?.(...angles);
    this.changed();
  }

  // The hand was posed anew
  changed() {
    this.posed = true;
    this.ask();
  }

  ask() {
    if (!this.error && !this.lost) this.asked ??= requestAnimationFrame((now) => this.tryToDraw(now));
  }

  // A picture that fails because the graphics card is taken away is drawn again when it is back
  tryToDraw(now) {
    const { losses } = this;
    try {
      this.draw(now);
    } catch (error) {
      if (losses === this.losses) this.fail(error ?? new Error('It could not be drawn.'));
      else this.ask();
    }
  }

  // Nothing is drawn any more: who waits for `settled` is told why, and once the hand was seen, the page says it
  fail(error) {
    this.error = error;
    if (!this.told) return;
    console.error(error);
    this.told(error.message);
  }

  draw(now) {
    this.asked = undefined;
    if (this.lost) return;
    const took = this.running ? now - this.last : 0;
    this.last = now;
    const more = this.beforeDrawing(now);
    // a turn that fades out over many pictures would take minutes where each takes long
    this.controls.enableDamping = took < FADE_MS;
    if (!this.fixed) this.controls.update();
    this.camera.updateMatrixWorld();
    this.show();
    this.painter.draw(this.camera);
    this.drawn = (this.drawn ?? 0) + 1;
    if (more) {
      this.ask();
      this.watchSpeed(took);
    }
    this.running = Boolean(this.asked);
  }

  // What changed goes to the graphics card
  show() {
    const eye = this.camera.position;
    const turned = this.hand.reflects && !this.eye?.equals(eye);
    if (this.posed) this.painter.showPose();
    if (this.posed || turned) {
      this.hand.shine(eye.toArray());
      this.painter.showColors();
      this.eye = eye.clone();
    }
    this.posed = false;
  }

  // A machine that cannot keep up gets fewer pixels
  watchSpeed(took) {
    this.slow = took > SLOW_MS ? this.slow + 1 : Math.max(this.slow - 1, 0);
    if (this.slow < SLOW_FRAMES || this.ratio <= 1 || this.fixed) return;
    this.ratio = Math.max(1, this.ratio / 1.5);
    this.slow = 0;
    this.resize();
  }

  // Resolves when nothing is left to be drawn; rejects with what stopped the drawing
  async settled() {
    this.ask();
    for (let calm = 0; calm < 3;) {
      if (this.error) throw this.error;
      await new Promise((done) => setTimeout(done, 50));
      calm = this.asked || this.lost || !this.drawn ? 0 : calm + 1;
    }
  }
}
