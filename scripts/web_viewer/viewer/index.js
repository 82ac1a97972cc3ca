// The page: hand.js holds the data, pose.js poses, this draws and listens. `jghand` is for whoever drives the page from
// outside, such as a page that frames it, or a test.
import { Controls } from './controls.js';
import { Player } from './player.js';
import { Stage } from './stage.js';

async function start() {
  const data = globalThis.JGHAND_HAND, { openHand, Articulated } = globalThis.JGHandPose ?? {};
  if (!data || !openHand) throw new Error('Files are missing: index.html, hand.js, pose.js and viewer.js belong together.');
  if (!document.createElement('canvas').getContext('webgl2')) throw new Error('This browser does not offer WebGL 2, which draws the hand.');
  const hand = await openHand(data), { description } = hand;
  const joints = hand.memory.views.motion, frames = joints.length / 63;
  const articulated = new Articulated(description.articulated);
  let controls;
  const player = new Player(hand, articulated, { joints, frames, fps: description.fps }, () => controls?.refresh());
  const stage = new Stage(document.getElementById('canvas'), hand, {
    view: description.view, points: pointsInSight(joints, description.reach_m), contract: description.contract,
  }, (now) => player.step(now));
  player.posed = () => stage.changed();
  document.getElementById('panel').hidden = document.getElementById('bar').hidden = false;
  controls = new Controls(player, stage, description);
  stage.home();
  const ask = (done) => (...words) => { done(...words); stage.ask(); };
  controls.refresh = ((refresh) => () => { refresh.call(controls); stage.ask(); })(controls.refresh);
  await stage.settled();
  stage.told = told;
  told('');
  if (frames > 1 && !matchMedia('(prefers-reduced-motion: reduce)').matches && !location.hash.includes('still')) player.play();
  return {
    description,
    hand,
    play: ask(() => player.play()),
    pause: ask(() => player.pause()),
    seek: ask((frame) => {
      if (!Number.isFinite(frame)) throw new Error(`A frame is a number, not ${frame}.`);
      controls.forget();
      player.playing = false;
      player.seek(frame);
    }),
    // the name of a pose, or angles (5 fingers, 4), radians
    pose: ask((pose, smoothly = true) => {
      const angles = anglesOf(pose, articulated);
      controls.forget();
      if (typeof pose === 'string') controls.pose = pose;
      player.hold(angles, smoothly);
    }),
    // degrees of a sun around the hand and above it; nothing: the light that the hand carries
    light: (around, height) => {
      if (around === undefined && height === undefined) return void (description.light && stage.ownLight());
      if (!Number.isFinite(around) || !Number.isFinite(height)) throw new Error(`A light is two angles in degrees, not ${around} and ${height}.`);
      if (!description.light) throw new Error('This hand has no light that can be turned.');
      stage.lightFrom(around, height);
    },
    lookThrough: (camera) => stage.lookThrough(camera, description.origin_m),
    reset: () => stage.home(),
    settled: () => stage.settled(),
    get drawn() { return stage.drawn; },
    get frame() { return player.frame; },
    get playing() { return player.playing; },
  };
}

// (5, 4) of a pose by name or by angles, which are brought within their ranges
function anglesOf(pose, articulated) {
  if (Object.hasOwn(articulated.poses, pose)) return articulated.poses[pose];
  const right = Array.isArray(pose) && pose.length === 5 && pose.every((finger) => finger?.length === 4 && finger.every(Number.isFinite));
  if (!right) throw new Error(`A pose is 5 fingers of 4 angles, or one of ${Object.keys(articulated.poses).join(', ')}.`);
  return articulated.clamped(pose);
}

// Where the hand gets to in the motion: at most some hundred frames of it decide
function pointsInSight(joints, reach) {
  const frames = joints.length / 63, step = Math.max(1, Math.floor(frames / 200)), points = [];
  for (let frame = 0; frame < frames; frame += step)
    for (let joint = 0; joint < 21; joint++) points.push([...joints.subarray(63 * frame + 3 * joint, 63 * frame + 3 * joint + 3), reach[joint]]);
  return points;
}

// Why the hand is not seen; '' when it is
function told(reason) {
  document.body.classList.toggle('ready', !reason);
  document.body.classList.toggle('failed', Boolean(reason));
  document.getElementById('message').textContent = reason && `The hand cannot be shown.\n${reason}`;
}

globalThis.jghand = { ready: start() };
globalThis.jghand.ready.then(
  (page) => Object.defineProperties(globalThis.jghand, Object.getOwnPropertyDescriptors(page)),
  (error) => {
    console.error(error);
    told(error.message);
  },
);
