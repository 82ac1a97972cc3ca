// By how much the texture of the skin and its relief change the colors of the Gaussians, and the part of a pixel that the
// surface covers, where the hand ends with it: native/detail.cpp. Colors change by what is seen at the middle of a pixel.
import * as THREE from 'three';
import { shader } from './shader.js';

const VERTEX = `
  in float x, y, near;
  in vec2 uv;
  uniform mat4 viewMatrix, projectionMatrix;
  out vec2 at;
  out float z;
#ifdef RELIEF
  in float slopeX, slopeY, slopeZ, along, bend;
  out vec3 place, slope;
  out vec2 alongAndBend;
#endif
  void main() {
    vec4 eye = viewMatrix * vec4(x, y, -near, 1.0);
    at = uv, z = -eye.z;
    gl_Position = projectionMatrix * eye;
#ifdef RELIEF
    place = eye.xyz, slope = mat3(viewMatrix) * vec3(slopeX, slopeY, slopeZ), alongAndBend = vec2(along, bend);
#endif
  }`;

const FRAGMENT = `
  in vec2 at;
  in float z;
  uniform mat4 projectionMatrix;
  uniform sampler2D picture, more, ratios;
  uniform vec2 size, alphas, fades, mixes, logRatiosMax;
  uniform float texels, depth, grazeMax, middle, scale, coverFrom, coverWhole, filledFrom;
  uniform bool fills, linear;
  out vec4 change;
#ifdef RELIEF
  in vec3 place, slope;
  in vec2 alongAndBend;
  uniform sampler2D rises;
  uniform vec2 limits;
  uniform float stepM;

  // How much more light skin of the relief's slope gets than the surface. x, y: how the texture's place changes on the picture
  float light(vec2 x, vec2 y, float level) {
    // along the skin, how column and row grow per meter: by the metric of its sides
    vec3 right = dFdx(place), up = dFdy(place);
    float rr = dot(right, right), ru = dot(right, up), uu = dot(up, up), det = rr * uu - ru * ru;
    vec3 byX = (uu * right - ru * up) / det, byY = (rr * up - ru * right) / det;
    vec4 steps = 255.0 * textureLod(rises, at, level) - 128.0;
    vec2 rise = scale * stepM * mix(steps.xy, steps.zw, alongAndBend.y);
    vec3 tilt = rise.x * (x.x * byX + y.x * byY) + rise.y * (x.y * byX + y.y * byY);
    float along = alongAndBend.x, got = 1.0 - along + (along - dot(slope, tilt)) * inversesqrt(1.0 + dot(tilt, tilt));
    return det > 0.0 ? clamp(got, limits.x, limits.y) : 1.0;
  }
#endif
  void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float alpha = texelFetch(picture, pixel, 0).a;
    float drawn = middle + texelFetch(more, pixel, 0).g / max(alpha, filledFrom);
    // what lies below a surface is farther along a ray that grazes it
    vec2 focal = 0.5 * size * vec2(projectionMatrix[0][0], projectionMatrix[1][1]), slope = vec2(dFdx(z), dFdy(z)) * focal / z;
    float apart = abs(drawn - z - scale * depth) / min(sqrt(1.0 + dot(slope, slope)), grazeMax);
    float cover = fills ? smoothstep(coverFrom, coverWhole, alpha) : alpha;
#ifdef ENDS
    cover = min(cover / filledFrom, 1.0);
#endif
    float weight = smoothstep(alphas.x, alphas.y, cover) * (1.0 - smoothstep(scale * fades.x, scale * fades.y, apart));
    vec2 x = dFdx(at), y = dFdy(at);
    float level = max(0.5 * log2(0.5 * texels * texels * (dot(x, x) + dot(y, y))), 0.0);
    level = floor(level) + clamp((fract(level) - mixes.x) / (mixes.y - mixes.x), 0.0, 1.0);
    vec3 steps = (255.0 * textureLod(ratios, at, level).rgb - 128.0) / 127.0;
    float lit = 1.0;
#ifdef RELIEF
    lit += weight * (light(x, y, level) - 1.0);
#endif
    change = vec4(lit * exp(weight * (linear ? logRatiosMax.y : logRatiosMax.x) * steps) - 1.0, 1.0);
  }`;

// what a pose changes: attributes by the array that has them, one after the other
const MOVING = { vertex: ['x', 'y', 'near'], slope: ['slopeX', 'slopeY', 'slopeZ', 'along'], bend: ['bend'] };

export class Detail extends THREE.Mesh {
  constructor(hand, common) {
    const { detail } = hand.description, { views } = hand.memory, geometry = new THREE.BufferGeometry();
    const { relief } = detail, rows = views['detail.uv'].length / 2;
    for (const [array, names] of Object.entries(MOVING))
      names.forEach((name, k) => {
        const numbers = views[`detail.${array}`]?.subarray(k * rows, (k + 1) * rows);
        if (numbers) geometry.setAttribute(name, new THREE.BufferAttribute(numbers, 1).setUsage(THREE.DynamicDrawUsage));
      });
    if (detail.ends_hand) geometry.setAttribute('whole', new THREE.BufferAttribute(views['detail.whole'], 1));
    geometry.setAttribute('uv', new THREE.BufferAttribute(views['detail.uv'], 2));
    geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(views['detail.faces']), 1));
    const { scale } = views, values = {
      ratios: mipmapped(hand.detail.texture, detail.size), texels: detail.size, depth: detail.depth_m, grazeMax: detail.graze_max,
      filledFrom: detail.filled_from,
    };
    for (const [name, pair] of Object.entries({ logRatiosMax: 'log_ratios_max', alphas: 'alphas', fades: 'fades_m', mixes: 'mixes' }))
      values[name] = new THREE.Vector2(...detail[pair]);
    if (relief) Object.assign(values, {
      rises: mipmapped(hand.detail.rises, detail.size), stepM: relief.step_m, limits: new THREE.Vector2(...relief.limits),
    });
    const uniforms = { ...common, scale: { get value() { return scale[0]; } } };
    for (const [name, value] of Object.entries(values)) uniforms[name] = { value };
    super(geometry, shader(VERTEX, FRAGMENT, {
      depthTest: true, depthWrite: true, uniforms, blending: THREE.NoBlending,
      defines: { ...(relief && { RELIEF: 1 }), ...(detail.ends_hand && { ENDS: 1 }) },
      side: hand.description.handedness === 'left' ? THREE.BackSide : THREE.FrontSide,
    }));
    this.frustumCulled = false;
    this.hand = hand;
  }

  // After hand.pose
  showPose() {
    this.hand.detail.pose(this.hand);
    for (const name of Object.values(MOVING).flat()) if (name in this.geometry.attributes) this.geometry.attributes[name].needsUpdate = true;
  }
}

const ENDS_VERTEX = `
  in float x, y, near, whole;
  uniform mat4 viewMatrix, projectionMatrix;
  out float shown;
  void main() { shown = whole, gl_Position = projectionMatrix * viewMatrix * vec4(x, y, -near, 1.0); }`;
const ENDS_FRAGMENT = `
  in float shown;
  out vec4 part;
  void main() { part = vec4(shown); }`;

// How much of the hand is shown on the surface of its detail
export class Ends extends THREE.Mesh {
  constructor({ geometry, material: { side } }) {
    super(geometry, shader(ENDS_VERTEX, ENDS_FRAGMENT, { depthTest: true, depthWrite: true, blending: THREE.NoBlending, side }));
    this.frustumCulled = false;
  }
}

function mipmapped(rgba, size) {
  const texture = new THREE.DataTexture(rgba, size, size);
  return Object.assign(texture, {
    generateMipmaps: true, minFilter: THREE.LinearMipmapLinearFilter, magFilter: THREE.LinearFilter, needsUpdate: true,
  });
}
