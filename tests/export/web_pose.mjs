// Poses the hand of an exported page as the page does, without a browser.
//
//     node web_pose.mjs FOLDER PLAN.json OUT
//
// PLAN: { "joints": [[63 numbers], …], "eye": [3], "suns": [[3] or null, …], "angles": [[(5, 4) radians], …], "from": [[63
// numbers], …] }; of each joints the direction to its sun, null for the light that the hand carries. OUT: float32,
// for every joints the positions (rows, 3), radii (rows), colors (rows, 3) and, of hands that have them, what is seen from
// outside (rows), covariances (rows, 6) and of the detail's surface x, y and -z (3, vertices), how the light turns with its
// normal (4, vertices) and how bent it is (vertices). Its texture goes to OUT.texture as RGBA, its relief to OUT.rises.
// Prints as JSON, for every "from", what the page's player makes of a hand that is shown so:
//     posed    its joints in each of the poses "angles" · back    the angles that these joints give back
//     hurried    its joints when it is turned into each pose, and one finger is touched on the way
//     untouched    its joints when every slider is touched and none is moved
//     moved    its joints when one finger after the other, and only that, is bent a little and spread a little
import fs from 'node:fs';
import vm from 'node:vm';
import { Player } from '../../scripts/web_viewer/viewer/player.js';

const [folder, planFile, out] = process.argv.slice(2);
const plan = JSON.parse(fs.readFileSync(planFile, 'utf8'));
for (const script of ['hand.js', 'pose.js']) vm.runInThisContext(fs.readFileSync(`${folder}/${script}`, 'utf8'));
const { openHand, Articulated } = globalThis.JGHandPose;
const hand = await openHand(globalThis.JGHAND_HAND);
const parts = [];
for (const [k, joints] of plan.joints.entries()) {
  hand.pose(Float64Array.from(joints));
  if (plan.suns) hand.turnLight(plan.suns[k] ?? undefined);
  hand.shine(plan.eye);
  hand.detail?.pose(hand);
  const surface = ['vertex', 'slope', 'bend'].map((name) => hand.memory.views[`detail.${name}`]);
  for (const view of [hand.positions, hand.sigmas, hand.rgb, hand.front, hand.covariances, ...surface]) if (view) parts.push(Buffer.from(view.slice().buffer));
}
fs.writeFileSync(out, Buffer.concat(parts));
for (const name of ['texture', 'rises']) if (hand.detail?.[name]) fs.writeFileSync(`${out}.${name}`, hand.detail[name]);
const articulated = new Articulated(hand.description.articulated);

function shown(joints) {
  return new Player(hand, articulated, { joints: Float64Array.from(joints), frames: 1, fps: 30 }, () => {});
}

const joints = (player) => Array.from(player.joints), bent = ([flexion, spread, ...rest]) => [flexion + 0.2, spread + 0.05, ...rest];
console.log(JSON.stringify(plan.from.map((from) => {
  const poses = plan.angles.map((angles) => {
    const player = shown(from);
    player.hold(angles);
    return player;
  });
  const hurried = plan.angles.map((angles) => {
    const player = shown(from);
    player.hold(angles, true);
    player.step(0);
    player.step(200);
    player.bend(1, player.goal.angles[1]);
    return joints(player);
  });
  const untouched = shown(from), { angles } = untouched.goal;
  angles.forEach((finger, f) => untouched.bend(f, articulated.curledBy(finger, f, 0)));
  const moved = angles.map((finger, f) => {
    const player = shown(from);
    player.bend(f, bent(finger));
    return joints(player);
  });
  return {
    posed: poses.map(joints), hurried, back: poses.map((player) => articulated.taken(player.joints, hand.palm).angles), untouched: joints(untouched), moved,
  };
})));
