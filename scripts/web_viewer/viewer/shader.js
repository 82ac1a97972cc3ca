// What the shaders of the page have in common.
import * as THREE from 'three';

const HEAD = 'precision highp float;\nprecision highp int;\nprecision highp sampler2D;\n';

// options: of a THREE.RawShaderMaterial, which neither tests nor writes depths unless they say so
export function shader(vertex, fragment, options) {
  return new THREE.RawShaderMaterial({
    glslVersion: THREE.GLSL3, depthTest: false, depthWrite: false, transparent: true, ...options,
    vertexShader: HEAD + vertex, fragmentShader: HEAD + fragment,
  });
}
