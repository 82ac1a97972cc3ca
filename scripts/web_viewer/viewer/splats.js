// The Gaussians of a posed hand, drawn from back to front as JGHand's own rasterizer draws them (docs/RENDERING.md 3). Their
// numbers go to the graphics card as they are, in float32: nothing is packed or baked.
import * as THREE from 'three';
import { shader } from './shader.js';

const COLUMNS = 512;  // of the textures; the shader divides by it
const DIGIT = 16;  // bits of a depth that are sorted at once

const VERTEX = `
  in uint order;
  uniform mat4 viewMatrix, projectionMatrix;
  uniform sampler2D places, colors, opacities, diagonal, beside;
  uniform vec2 size;
  uniform float blur, lowPass, alphaMin, near;
  flat out vec3 conic;
  flat out vec2 center;
  flat out vec4 color;
  flat out float opacity, depth;
  void main() {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // what is not drawn
    ivec2 at = ivec2(order & 511u, order >> 9);
    vec4 place = texelFetch(places, at, 0), eye = viewMatrix * vec4(place.xyz, 1.0);
    opacity = texelFetch(opacities, at, 0).r, depth = -eye.z;
    if (!(depth > near && opacity > alphaMin && place.w > 0.0)) return;
    vec2 j = 0.5 * size * vec2(projectionMatrix[0][0], projectionMatrix[1][1]) / depth, jz = j * eye.xy / depth;
    float low = max(j.x * j.y * lowPass, blur), det;
    vec3 shape;  // xx, xy, yy on the picture, px^2
  #ifdef ELLIPSOIDS
    vec3 on = texelFetch(diagonal, at, 0).xyz, off = texelFetch(beside, at, 0).xyz;
    mat3 covariance = mat3(on.x, off.x, off.y, off.x, on.y, off.z, off.y, off.z, on.z), rows = transpose(mat3(viewMatrix));
    vec3 u = j.x * rows[0] + jz.x * rows[2], v = j.y * rows[1] + jz.y * rows[2], along = covariance * v;
    shape = vec3(dot(u, covariance * u), dot(u, along), dot(v, along));
    det = max(shape.x * shape.z - shape.y * shape.y, 0.0) + (shape.x + shape.z + low) * low;
  #else
    vec2 s = place.w * j, sz = place.w * jz, ss = s * s, zz = sz * sz;
    shape = vec3(ss.x + zz.x, sz.x * sz.y, ss.y + zz.y);
    det = ss.x * ss.y + ss.x * zz.y + zz.x * ss.y + (shape.x + shape.z + low) * low;
  #endif
    shape.xz += low;
    conic = vec3(shape.z, -shape.y, shape.x) / det;
    color = texelFetch(colors, at, 0);
    vec4 clip = projectionMatrix * eye;
    center = (0.5 * clip.xy / clip.w + 0.5) * size;
    vec2 reach = sqrt(2.0 * log(opacity / alphaMin) * shape.xz);
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    gl_Position = vec4((center + corner * reach) / size * 2.0 - 1.0, 0.0, 1.0);
  }`;

const FRAGMENT = `
  flat in vec3 conic;
  flat in vec2 center;
  flat in vec4 color;
  flat in float opacity, depth;
  uniform float alphaMin, alphaMax, middle;
  layout(location = 0) out vec4 picture;
  layout(location = 1) out vec4 more;
  void main() {
    vec2 d = gl_FragCoord.xy - center;
    float alpha = opacity * exp(-0.5 * (conic.x * d.x * d.x + 2.0 * conic.y * d.x * d.y + conic.z * d.y * d.y));
    if (alpha < alphaMin) discard;
    alpha = min(alpha, alphaMax);
    picture = vec4(color.rgb * alpha, alpha);
    more = vec4(color.a * alpha, (depth - middle) * alpha, 0.0, alpha);
  }`;

export class Splats extends THREE.Mesh {
  constructor(hand, contract, common) {
    const { count, covariances } = hand, geometry = new THREE.InstancedBufferGeometry();
    const order = new THREE.InstancedBufferAttribute(new Uint32Array(count), 1).setUsage(THREE.DynamicDrawUsage);
    geometry.setIndex([0, 1, 2, 2, 1, 3]).setAttribute('order', order);
    geometry.instanceCount = count;
    const tables = { places: table(count), colors: table(count), opacities: table(count, 1) };
    if (covariances) Object.assign(tables, { diagonal: table(count), beside: table(count) });
    const uniforms = {
      ...common, blur: { value: contract.blur_px2 }, lowPass: { value: contract.low_pass_m2 }, near: { value: contract.z_near_m },
      alphaMin: { value: contract.alpha_min }, alphaMax: { value: contract.alpha_max },
    };
    for (const [name, value] of Object.entries(tables)) uniforms[name] = { value };
    super(geometry, shader(VERTEX, FRAGMENT, {
      uniforms, defines: covariances ? { ELLIPSOIDS: 1 } : {},
      blending: THREE.CustomBlending, blendSrc: THREE.OneFactor, blendDst: THREE.OneMinusSrcAlphaFactor,
    }));
    this.frustumCulled = false;
    Object.assign(this, { hand, tables, order });
    this.keys = [new Uint32Array(count), new Uint32Array(count)];
    this.rows = [order.array, new Uint32Array(count)];
    tables.opacities.image.data.set(hand.opacities);
  }

  // After hand.pose
  showPose() {
    const { positions, sigmas, covariances, count } = this.hand, { places, diagonal, beside } = this.tables;
    for (let i = 0; i < count; i++) {
      const place = places.image.data;
      place[4 * i] = positions[3 * i];
      place[4 * i + 1] = positions[3 * i + 1];
      place[4 * i + 2] = positions[3 * i + 2];
      place[4 * i + 3] = sigmas[i];
      if (!covariances) continue;
      const [xx, xy, xz, yy, yz, zz] = covariances.subarray(6 * i, 6 * i + 6);
      diagonal.image.data.set([xx, yy, zz], 4 * i);
      beside.image.data.set([xy, xz, yz], 4 * i);
    }
    for (const texture of [places, diagonal, beside]) if (texture) texture.needsUpdate = true;
  }

  // After hand.shine, or a pose of a hand that reflects nothing
  showColors() {
    const { rgb, front, count } = this.hand, colors = this.tables.colors.image.data;
    for (let i = 0; i < count; i++) {
      colors[4 * i] = rgb[3 * i];
      colors[4 * i + 1] = rgb[3 * i + 1];
      colors[4 * i + 2] = rgb[3 * i + 2];
      colors[4 * i + 3] = front ? front[i] : 1;
    }
    this.tables.colors.needsUpdate = true;
  }

  // From back to front as the camera sees them, on all bits of the depth: those of positive floats count as they grow
  sort(camera) {
    const { positions, count } = this.hand, [, , x, , , , y, , , , z, , , , w] = camera.matrixWorldInverse.elements;
    const depth = new Float32Array(this.keys[0].buffer);
    for (let i = 0; i < count; i++) {
      depth[i] = Math.max(-(x * positions[3 * i] + y * positions[3 * i + 1] + z * positions[3 * i + 2] + w), 0);
      this.rows[0][i] = i;
    }
    for (let pass = 0; pass < 2; pass++) {
      const [keys, sorted] = pass ? [this.keys[1], this.keys[0]] : this.keys, [from, to] = pass ? [this.rows[1], this.rows[0]] : this.rows;
      const place = new Uint32Array(1 << DIGIT), shift = DIGIT * pass, mask = place.length - 1;
      for (let i = 0; i < count; i++) place[(keys[i] >>> shift) & mask]++;
      // the last place of each digit, from the end on: the farthest first, of the same depth the last
      for (let digit = mask, end = 0; digit >= 0; digit--) {
        const many = place[digit];
        place[digit] = end;
        end += many;
      }
      for (let i = 0; i < count; i++) {
        const at = place[(keys[i] >>> shift) & mask]++;
        sorted[at] = keys[i];
        to[at] = from[i];
      }
    }
    this.order.needsUpdate = true;
  }
}

function table(count, channels = 4) {
  const rows = Math.ceil(count / COLUMNS), format = channels === 1 ? THREE.RedFormat : THREE.RGBAFormat;
  const texture = new THREE.DataTexture(new Float32Array(channels * COLUMNS * rows), COLUMNS, rows, format, THREE.FloatType);
  texture.needsUpdate = true;
  return texture;
}
