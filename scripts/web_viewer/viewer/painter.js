// One picture: the Gaussians, blended beside each other in float16 as color and as what else is known of a pixel, then by how
// much the detail of the skin changes it, then the color of what is seen from outside (native/raster_blend.cpp).
import * as THREE from 'three';
import { Detail, Ends } from './detail.js';
import { shader } from './shader.js';
import { Splats } from './splats.js';

const SAMPLES_MOST = 8;  // of a pixel, by which the part of it that the surface covers is found
const SAMPLES = 200;  // Gaussians whose mean depth is the middle: depths are blended from there, or halves were too coarse

const VERTEX = `
  void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;
const FRAGMENT = `
  uniform sampler2D picture, more, changes, parts;
  uniform float frontMin, coverFrom, coverWhole, filledFrom;
  uniform bool linear, fills;
  out vec4 shown;
  void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 sum = texelFetch(picture, at, 0);
    vec3 rgb = sum.rgb / max(texelFetch(more, at, 0).r, max(frontMin * sum.a, 1e-6));
    float alpha = fills ? smoothstep(coverFrom, coverWhole, sum.a) : sum.a;
#ifdef DETAIL
    rgb *= 1.0 + texelFetch(changes, at, 0).rgb;
#endif
#ifdef ENDS
    alpha = min(alpha / filledFrom, 1.0) * texelFetch(parts, at, 0).r;
#endif
    if (linear) rgb = mix(12.92 * rgb, 1.055 * pow(max(rgb, 1e-6), vec3(1.0 / 2.4)) - 0.055, greaterThan(rgb, vec3(0.0031308)));
    shown = vec4(clamp(rgb, 0.0, 1.0), 1.0) * alpha;
  }`;

export class Painter {
  constructor(renderer, hand, contract) {
    this.renderer = renderer;
    this.hand = hand;
    if (!['EXT_color_buffer_float', 'EXT_color_buffer_half_float'].some((name) => renderer.extensions.has(name)))
      throw new Error('The graphics card cannot draw in sixteen bits. Open the page on another device.');
    renderer.autoClear = false;
    const halves = { type: THREE.HalfFloatType, minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter };
    this.target = new THREE.WebGLRenderTarget(1, 1, { count: 2, depthBuffer: false, ...halves });
    const [picture, more] = this.target.textures.map((value) => ({ value }));
    this.fills = { value: false };
    this.linear = { value: false };
    const cover = { fills: this.fills, coverFrom: { value: contract.cover_from }, coverWhole: { value: contract.cover_whole }, linear: this.linear };
    this.common = { size: { value: new THREE.Vector2() }, middle: { value: 0 }, ...cover };
    this.splats = new Splats(hand, contract, this.common);
    this.detail = hand.detail && new Detail(hand, { ...this.common, picture, more });
    this.changes = hand.detail && new THREE.WebGLRenderTarget(1, 1, halves);
    const { ends_hand: endsHand, filled_from: filledFrom } = hand.description.detail ?? {};
    this.ends = endsHand && new Ends(this.detail);
    this.parts = endsHand && new THREE.WebGLRenderTarget(1, 1, { samples: Math.min(renderer.capabilities.maxSamples, SAMPLES_MOST) });
    const geometry = new THREE.BufferGeometry().setIndex([0, 1, 2]);
    this.resolve = new THREE.Mesh(geometry, shader(VERTEX, FRAGMENT, {
      blending: THREE.NoBlending, defines: { ...(hand.detail && { DETAIL: 1 }), ...(endsHand && { ENDS: 1 }) }, uniforms: {
        picture, more, changes: { value: this.changes?.texture }, parts: { value: this.parts?.texture },
        frontMin: { value: contract.front_min }, filledFrom: { value: filledFrom }, ...cover,
      },
    }));
    this.resolve.frustumCulled = false;
  }

  // After hand.pose
  showPose() {
    this.splats.showPose();
    this.detail?.showPose();
  }

  // After hand.shine
  showColors() {
    this.splats.showColors();
  }

  draw(camera) {
    const { renderer, target, changes, ends, parts, common, splats, detail, resolve } = this;
    renderer.getDrawingBufferSize(common.size.value);
    target.setSize(common.size.value.x, common.size.value.y);
    common.middle.value = this.middle(camera);
    splats.sort(camera);
    this.linear.value = Boolean(this.hand.light?.on);
    this.fills.value = this.linear.value || this.hand.description.fades;
    renderer.setRenderTarget(target);
    renderer.clear();
    renderer.render(splats, camera);
    if (detail) {
      changes.setSize(common.size.value.x, common.size.value.y);
      renderer.setRenderTarget(changes);
      renderer.clear();
      renderer.render(detail, camera);
    }
    if (ends) {
      parts.setSize(common.size.value.x, common.size.value.y);
      renderer.setRenderTarget(parts);
      renderer.clear();
      renderer.render(ends, camera);
    }
    renderer.setRenderTarget(null);
    renderer.clear();
    renderer.render(resolve, camera);
  }

  middle(camera) {
    const { positions, count } = this.hand, step = Math.ceil(count / SAMPLES), sum = new THREE.Vector3();
    for (let i = 0; i < count; i += step) sum.add(new THREE.Vector3().fromArray(positions, 3 * i));
    return -sum.divideScalar(Math.ceil(count / step)).applyMatrix4(camera.matrixWorldInverse).z;
  }
}
