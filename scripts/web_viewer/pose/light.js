// The hand in a light that can be turned, a sun in an even world, or in the one that it carries:
// jghand_engine/avatar/scene_light_step.py.
import { Capsules } from './capsules.js';

const LANES = 16, LOOK = 7, ALBEDO = 3;  // places in a block of `look`: the normal, the color, the shine

export class Light {
  // about: of hand.js, see export/web/hand.py
  constructor(about, { description, memory, words, fields }) {
    const { pointers, views } = memory;
    Object.assign(this, about, { words, views });
    memory.task('scene.task', about.task, 'scene.');
    this.lamps = ['lamp', 'casting'].map((name) => ({ numbers: views[`scene.${name}`], width: description.arrays[`scene.${name}`].shape[1] }));
    this.capsules = new Capsules({ ...description.cast, direction: about.direction }, { ...views, 'cast.capsule_lamp': views['scene.capsule_lamp'] });
    this.showAlbedo(views.look, views['scene.look']);
    const at = description.task.pointers;
    this.places = [at.scene, at.front, at.look, at['cast.lamp'], at['cast.capsule_lamp'], fields['cast.groups']];
    this.carried = this.places.map((place) => words[place]);
    this.turned = [pointers['scene.task'], pointers.front, ...['look', 'cell', 'capsule_lamp'].map((name) => pointers[`scene.${name}`]), about.direction.length / LANES];
  }

  // towards: (3) unit, to the sun; undefined: back to the light that the hand carries
  turn(towards) {
    this.on = towards !== undefined;
    this.views.front.fill(1);
    const values = this.on ? this.turned : this.carried;
    this.places.forEach((place, k) => { this.words[place] = values[k]; });
    if (!this.on) return;
    for (const { numbers, width } of this.lamps)
      for (let row = 0; row < numbers.length; row += width) numbers.set(towards, row);
  }

  // Radii as `estimated` has them (avatar/relighting.py), after a pose
  grow({ sigmas, covariances }) {
    if (this.grown === 1) return;
    sigmas.forEach((sigma, i) => { sigmas[i] = this.grown * sigma; });
    covariances?.forEach((value, i) => { covariances[i] = this.grown ** 2 * value; });
  }

  showAlbedo(from, to) {
    from.forEach((value, i) => {
      const channel = (Math.floor(i / LANES) % LOOK) - ALBEDO, shown = Math.min(Math.max(value, 0), 1);
      const light = shown > 0.04045 ? ((shown + 0.055) / 1.055) ** 2.4 : shown / 12.92;
      to[i] = channel in this.gain ? Math.min(this.gain[channel] * light, this.most) : value;
    });
  }
}
