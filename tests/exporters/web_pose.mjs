// Poses the hand of an exported page as the page does, without a browser.
//
//     node web_pose.mjs FOLDER PLAN.json OUT
//
// PLAN: { "joints": [[63 numbers], …], "eye": [3], "angles": [[(5, 4) radians], …] }. OUT: float32, for every joints the
// positions (rows, 3), radii (rows), colours (rows, 3) and, of ellipsoids, covariances (rows, 6). Prints as JSON the joints of
// the angles on the palm of the last pose, and the angles that these joints give back.
import fs from 'node:fs';
import vm from 'node:vm';

const [folder, planFile, out] = process.argv.slice(2);
const plan = JSON.parse(fs.readFileSync(planFile, 'utf8'));
for (const script of ['hand.js', 'pose.js']) vm.runInThisContext(fs.readFileSync(`${folder}/${script}`, 'utf8'));
const { openHand, Articulated } = globalThis.JGHandPose;
const hand = await openHand(globalThis.JGHAND_HAND);
const parts = [];
for (const joints of plan.joints) {
  hand.pose(Float64Array.from(joints));
  hand.shine(plan.eye);
  for (const view of [hand.positions, hand.sigmas, hand.rgb, hand.covariances]) if (view) parts.push(Buffer.from(view.slice().buffer));
}
fs.writeFileSync(out, Buffer.concat(parts));
const articulated = new Articulated(hand.description.articulated);
const posed = plan.angles.map((angles) => articulated.joints(angles, Array.from(hand.palm), [0, 0, 0]));
console.log(JSON.stringify({ posed, back: posed.map((joints) => articulated.angles(joints, hand.palm)) }));
