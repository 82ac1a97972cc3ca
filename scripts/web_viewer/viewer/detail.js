// The texture of the skin on its surface, which multiplies the picture of the Gaussians: native/detail.cpp.
import * as THREE from 'three';
import { shader } from './shader.js';

const VERTEX = `
  in vec3 position;
  in vec2 uv;
  uniform mat4 viewMatrix, projectionMatrix;
  out vec2 at;
  out float z;
  void main() {
    vec4 eye = viewMatrix * vec4(position, 1.0);
    at = uv, z = -eye.z;
    gl_Position = projectionMatrix * eye;
  }`;

const FRAGMENT = `
  in vec2 at;
  in float z;
  uniform mat4 projectionMatrix;
  uniform sampler2D picture, more, ratios;
  uniform vec2 size, alphas, fades, mixes;
  uniform float texels, logRatioMax, depth, grazeMax, middle, scale, coverFrom;
  uniform bool fills;
  out vec4 ratio;
  void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float alpha = texelFetch(picture, pixel, 0).a;
    float drawn = middle + texelFetch(more, pixel, 0).g / max(alpha, alphas.x);
    // what lies below a surface is farther along a ray that grazes it
    vec2 focal = 0.5 * size * vec2(projectionMatrix[0][0], projectionMatrix[1][1]), slope = vec2(dFdx(z), dFdy(z)) * focal / z;
    float apart = abs(drawn - z - scale * depth) / min(sqrt(1.0 + dot(slope, slope)), grazeMax);
    float cover = fills ? smoothstep(coverFrom, 1.0, alpha) : alpha;
    float weight = smoothstep(alphas.x, alphas.y, cover) * (1.0 - smoothstep(scale * fades.x, scale * fades.y, apart));
    vec2 x = dFdx(at), y = dFdy(at);
    float level = max(0.5 * log2(0.5 * texels * texels * (dot(x, x) + dot(y, y))), 0.0);
    level = floor(level) + clamp((fract(level) - mixes.x) / (mixes.y - mixes.x), 0.0, 1.0);
    vec3 steps = (255.0 * textureLod(ratios, at, level).rgb - 128.0) / 127.0;
    ratio = vec4(0.5 * exp(weight * logRatioMax * steps), 1.0);
  }`;

export class Detail extends THREE.Mesh {
  constructor(hand, common) {
    const { detail } = hand.description, { views } = hand.memory, geometry = new THREE.BufferGeometry();
    const position = new THREE.BufferAttribute(hand.detail.positions, 3).setUsage(THREE.DynamicDrawUsage);
    geometry.setAttribute('position', position).setAttribute('uv', new THREE.BufferAttribute(views['detail.uv'], 2));
    geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(views['detail.faces']), 1));
    const ratios = new THREE.DataTexture(hand.detail.texture, detail.size, detail.size);
    Object.assign(ratios, {
      generateMipmaps: true, minFilter: THREE.LinearMipmapLinearFilter, magFilter: THREE.LinearFilter, needsUpdate: true,
    });
    const { scale } = views, values = {
      ratios, texels: detail.size, logRatioMax: detail.log_ratio_max, depth: detail.depth_m, grazeMax: detail.graze_max,
      alphas: new THREE.Vector2(...detail.alphas), fades: new THREE.Vector2(...detail.fades_m), mixes: new THREE.Vector2(...detail.mixes),
    };
    const uniforms = { ...common, scale: { get value() { return scale[0]; } } };
    for (const [name, value] of Object.entries(values)) uniforms[name] = { value };
    super(geometry, shader(VERTEX, FRAGMENT, {
      depthTest: true, depthWrite: true, uniforms,
      side: hand.description.handedness === 'left' ? THREE.BackSide : THREE.FrontSide,
      // twice what is drawn times half the ratio, whose range is up to 2; alpha stays
      blending: THREE.CustomBlending, blendSrc: THREE.DstColorFactor, blendDst: THREE.SrcColorFactor,
      blendSrcAlpha: THREE.ZeroFactor, blendDstAlpha: THREE.OneFactor,
    }));
    this.frustumCulled = false;
    this.skin = hand.detail;
  }

  // After hand.pose
  showPose() {
    this.skin.pose();
    this.geometry.attributes.position.needsUpdate = true;
  }
}
