// The Gaussians of a posed hand in the scene, drawn and sorted by Spark. Their numbers go to the graphics card as they are,
// in float32: nothing is packed or baked.
import { dyno, SparkRenderer, SplatGenerator } from '@sparkjsdev/spark';
import * as THREE from 'three';

const COLUMNS = 512;  // of the textures; the shaders below divide by it

// renderer: THREE.WebGLRenderer · contract: what JGHand's own rasterizer does, see export/web/page.py
export function newSpark(renderer, hand, contract) {
  return new SparkRenderer({
    renderer, autoUpdate: false, accumExtSplats: true, covSplats: Boolean(hand.covariances), sortRadial: false, blurAmount: 0,
    preBlurAmount: contract.blur_px2, minAlpha: contract.alpha_min, maxStdDev: contract.reach_sigma, enableLod: false,
  });
}

export class Splats extends SplatGenerator {
  constructor(hand) {
    super({ numSplats: hand.count });
    this.hand = hand;
    this.places = table(hand.count);
    this.colors = table(hand.count);
    const textures = [this.places, this.colors];
    if (hand.covariances) {
      this.shapes = [table(hand.count), table(hand.count)];
      textures.push(...this.shapes);
    }
    const samplers = textures.map((value, k) => new dyno.DynoSampler2D({ key: `table${k}`, value }));
    if (hand.covariances) this.covGenerator = ellipsoids(samplers);
    else this.generator = balls(samplers);
    hand.opacities.forEach((opacity, i) => { this.colors.image.data[4 * i + 3] = opacity; });
  }

  // After hand.pose
  showPose() {
    const { positions, sigmas, covariances, count } = this.hand, places = this.places.image.data;
    for (let i = 0; i < count; i++) {
      places[4 * i] = positions[3 * i];
      places[4 * i + 1] = positions[3 * i + 1];
      places[4 * i + 2] = positions[3 * i + 2];
      places[4 * i + 3] = sigmas[i];
    }
    this.places.needsUpdate = true;
    if (covariances) {
      const [diagonal, beside] = this.shapes.map((shape) => shape.image.data);
      for (let i = 0; i < count; i++) {
        const [xx, xy, xz, yy, yz, zz] = covariances.subarray(6 * i, 6 * i + 6);
        diagonal.set([xx, yy, zz], 4 * i);
        beside.set([xy, xz, yz], 4 * i);
      }
      for (const shape of this.shapes) shape.needsUpdate = true;
    }
    this.updateVersion();
  }

  // After hand.shine, or a pose of a hand that reflects nothing
  showColors() {
    const { rgb, count } = this.hand, colors = this.colors.image.data;
    for (let i = 0; i < count; i++) {
      colors[4 * i] = rgb[3 * i];
      colors[4 * i + 1] = rgb[3 * i + 1];
      colors[4 * i + 2] = rgb[3 * i + 2];
    }
    this.colors.needsUpdate = true;
    this.updateVersion();
  }
}

function table(count) {
  const rows = Math.ceil(count / COLUMNS);
  const texture = new THREE.DataTexture(new Float32Array(4 * COLUMNS * rows), COLUMNS, rows, THREE.RGBAFormat, THREE.FloatType);
  texture.needsUpdate = true;
  return texture;
}

const FETCH = (inputs, k) => `texelFetch(${inputs[`table${k}`]}, ivec2(${inputs.index} & 511, ${inputs.index} >> 9), 0)`;

function generator(samplers, outTypes, globals, statements) {
  return dyno.dynoBlock({ index: 'int' }, outTypes, ({ index }) => {
    const inTypes = { index: 'int' }, inputs = { index };
    samplers.forEach((sampler, k) => {
      inTypes[`table${k}`] = 'sampler2D';
      inputs[`table${k}`] = sampler;
    });
    return new dyno.Dyno({ inTypes, outTypes, inputs, globals: () => [globals], statements }).outputs;
  });
}

function balls(samplers) {
  return generator(samplers, { gsplat: dyno.Gsplat }, dyno.defineGsplat, ({ inputs, outputs: { gsplat } }) => [
    `vec4 place = ${FETCH(inputs, 0)};`,
    `${gsplat}.center = place.xyz;`,
    `${gsplat}.scales = place.www;`,
    `${gsplat}.quaternion = vec4(0.0, 0.0, 0.0, 1.0);`,
    `${gsplat}.rgba = ${FETCH(inputs, 1)};`,
    `${gsplat}.index = ${inputs.index};`,
    // what fills up the last block has no size
    `${gsplat}.flags = place.w > 0.0 ? GSPLAT_FLAG_ACTIVE : 0u;`,
  ]);
}

function ellipsoids(samplers) {
  return generator(samplers, { covsplat: dyno.CovSplat }, dyno.defineCovSplat, ({ inputs, outputs: { covsplat } }) => [
    `vec4 place = ${FETCH(inputs, 0)};`,
    `${covsplat}.center = place.xyz;`,
    `${covsplat}.rgba = ${FETCH(inputs, 1)};`,
    `${covsplat}.xxyyzz = ${FETCH(inputs, 2)}.xyz;`,
    `${covsplat}.xyxzyz = ${FETCH(inputs, 3)}.xyz;`,
    `${covsplat}.index = ${inputs.index};`,
    `${covsplat}.flags = place.w > 0.0 ? 1u : 0u;`,
  ]);
}
