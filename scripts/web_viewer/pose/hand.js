// An avatar that is posed again and again: jghand_engine/avatar/posing.py with the same kernels.
import { Capsules } from './capsules.js';
import { LinearTier, Network } from './correctives.js';
import { Detail } from './detail.js';
import { Light } from './light.js';
import { Memory } from './memory.js';

const JOINTS = 21, TEAM_BYTES = 2048, ANGLES = 37;
const TIERS = { linear: LinearTier, network: Network };

export class Hand {
  // description, content: of hand.js · kernels: exports of the WebAssembly module
  constructor(description, content, kernels) {
    this.description = description;
    this.kernels = kernels;
    kernels._initialize?.();
    const { task, light, detail } = description;
    if (kernels.jg_learned_task_bytes() !== 4 * task.words.length)
      throw new Error('hand.js and pose.js are of different versions of JGHand. Export the folder anew.');
    const extra = {
      task: ['i4', task.words.length], team: ['i4', TEAM_BYTES / 4], joints: ['f8', 3 * JOINTS],
      matrices: ['f8', 12 * JOINTS], scale: ['f8', 1], angles: ['f8', ANGLES], 'skin.linear_offset': ['f4', 12 * JOINTS],
    };
    if (light) {
      extra['scene.task'] = ['i4', light.task.words.length];
      extra['scene.look'] = ['f4', description.arrays.look.shape.reduce((product, edge) => product * edge, 1)];
    }
    for (const [name, { words }] of Object.entries(detail?.tasks ?? {})) extra[`detail.${name}`] = ['i4', words.length];
    this.memory = new Memory(description.arrays, content, extra, kernels);
    const { pointers, views } = this.memory;
    this.words = this.memory.task('task', task);
    this.floats = new Float32Array(views.task.buffer, pointers.task, task.words.length);
    if (!description.fades) this.words[task.pointers.front] = 0;
    this.fields = task.fields;
    const { correctives, cast } = description;
    this.correctives = correctives && new TIERS[correctives.kind](correctives, views);
    this.capsules = cast && new Capsules(cast, views);
    this.painted = !('look' in views);
    this.reflects = 'matt' in views;
    this.count = description.rows;
    this.positions = views['skin.position'];
    this.sigmas = views['skin.sigma'];
    this.covariances = views['skin.covariance'];
    this.rgb = views.rgb;
    this.front = views.front?.fill(1);
    this.opacities = views.opacity;
    this.detail = detail && new Detail(detail, this);
    this.light = light && new Light(light, this);
  }

  // joints: 63 numbers, level order, meters, from the origin of the page. Gives `positions`, `sigmas`, `covariances`
  // and, where nothing is reflected, `rgb`.
  pose(joints) {
    const { views, pointers } = this.memory;
    this.joints = joints;
    views.joints.set(joints);
    const { skeleton, matrices, scale, angles } = pointers;
    this.flags = this.kernels.jg_bone_transforms(skeleton, pointers.joints, matrices, scale, angles);
    views['skin.linear_offset'].set(views.matrices);
    const whole = views.scale[0], inverse = 1 / Math.max(whole, 1.17549435e-38);
    this.set('skin.shift', joints.slice(0, 3));
    this.set('skin.scale', [whole]);
    this.set('skin.inverse_scale', [inverse]);
    this.correctives?.prepare(views.angles);
    (this.light?.on ? this.light : this).capsules?.prepare(views.matrices, whole);
    views.team.fill(0);
    if (this.painted) this.kernels.jg_skin(pointers.team, pointers.task);
    else this.kernels.jg_learned_pose(pointers.team, pointers.task);
    if (this.light?.on) this.light.grow(this);
  }

  // towards: (3) unit, to the sun that lights the hand from now on; undefined: the light that it carries. Of a hand with
  // `light` that was posed.
  turnLight(towards) {
    this.light.turn(towards);
    this.pose(this.joints);
  }

  // Gives `rgb` as the eye (3) sees it, after `pose`, of light where a light is turned, and `front`, the part of each that
  // is seen from outside.
  shine(eye) {
    if (!this.reflects) return;
    const { views, pointers } = this.memory;
    this.set('eye', eye);
    views.team.fill(0);
    this.kernels.jg_learned_gloss(pointers.team, pointers.task);
  }

  // The palm's map of the last pose, 3 x 4 row by row: posed - root = L (canonical - canonical root) + t.
  get palm() {
    return this.memory.views.matrices.slice(0, 12);
  }

  set(field, values) {
    this.floats.set(values, this.fields[field]);
  }
}
