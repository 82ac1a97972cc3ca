// How sixteen Gaussians follow the bones (METHOD 2.8, 2.9): what painted and learned skin share.
//
// Gaussians lie in blocks of sixteen neighbors, which share most of their bones: a block lists the bones that any of
// its Gaussians has a weight for, and blends their matrices densely. That reads a quarter of what 21 weights would.
#pragma once
#include <stdint.h>

#include "vec.h"

namespace jg {

// Mirrored field by field in native/tasks.py.
struct SkinTask {
  const float* rest;           // (blocks, 4, 16): x y z relative to the canonical root, sigma; meters
  const int32_t* block_start;  // (blocks + 1): where the bones of each block begin
  const int32_t* bone;         // (entries)
  const float* weight;         // (entries, 16)
  const float* axes;           // (blocks, 9, 16): axes of ellipsoids, as the rows of a matrix; null: spheres
  const float* linear_offset;  // (21, 3, 4): x_posed - root = linear_offset [x; 1]
  float* position;             // (16 blocks, 3)
  float* sigma;                // (16 blocks)
  float* covariance;           // (16 blocks, 6) xx, xy, xz, yy, yz, zz; null: not wanted
  float shift[3];              // added to every position
  float scale, inverse_scale;  // of the hand, s_g; the inverse of a hand without size is finite
  float stretch_min, stretch_max;
  int32_t blocks;
};

constexpr int MAP_ENTRIES = 12;

// The blended maps [L | offset] of a block, row by row.
JG_INLINE void blend(const SkinTask& s, int32_t block, vf m[MAP_ENTRIES]) {
  for (int k = 0; k < MAP_ENTRIES; k++) m[k] = vf{};
  for (int32_t e = s.block_start[block]; e < s.block_start[block + 1]; e++) {
    const float* matrix = s.linear_offset + MAP_ENTRIES * s.bone[e];
    const vf w = load(s.weight + LANES * (int64_t)e);
    for (int k = 0; k < MAP_ENTRIES; k++) m[k] += w * matrix[k];
  }
}

// The posed centers relative to the hand's root.
JG_INLINE void posed_center(const SkinTask& s, int32_t block, const vf m[MAP_ENTRIES], vf p[3]) {
  const float* rest = s.rest + 4 * LANES * (int64_t)block;
  const vf x = load(rest), y = load(rest + LANES), z = load(rest + 2 * LANES);
  for (int i = 0; i < 3; i++) p[i] = m[4 * i] * x + (m[4 * i + 1] * y + (m[4 * i + 2] * z + m[4 * i + 3]));
}

// |det L| over s_g^3. The scale goes first: the determinant of a tiny hand would vanish.
JG_INLINE vf volume(const SkinTask& s, const vf m[MAP_ENTRIES]) {
  vf l[9];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) l[3 * i + j] = m[4 * i + j] * s.inverse_scale;
  return abs(l[0] * (l[4] * l[8] - l[5] * l[7]) - l[1] * (l[3] * l[8] - l[5] * l[6]) +
             l[2] * (l[3] * l[7] - l[4] * l[6]));
}

// x^(1 / 3) of normal positive numbers.
JG_INLINE vf cube_root(vf x) { return exp2(log2(x) * (1.f / 3.f)); }

// Writes centers, to which the shift is added last (the hand keeps its precision wherever it is), radii and, where they
// are wanted, covariances.
JG_INLINE void store_shapes(const SkinTask& s, int32_t block, const vf m[MAP_ENTRIES], const vf p[3], vf volume) {
  const int64_t row = LANES * (int64_t)block;
  store_triples(s.position + 3 * row, p[0] + s.shift[0], p[1] + s.shift[1], p[2] + s.shift[2]);
  const float least = s.stretch_min, most = s.stretch_max;
  const vf part = min(max(volume, all(least * least * least)), all(most * most * most));
  const vf sigma = load(s.rest + 4 * row + 3 * LANES) * (cube_root(part) * s.scale);
  store(s.sigma + row, sigma);
  if (!s.covariance) return;
  vf six[6] = {sigma * sigma, vf{}, vf{}, sigma * sigma, vf{}, sigma * sigma};
  if (s.axes) {
    vf a[9], c[9];  // c = L a; the covariance is c times its transpose
    for (int k = 0; k < 9; k++) a[k] = load(s.axes + 9 * row + LANES * k);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) c[3 * i + j] = m[4 * i] * a[j] + m[4 * i + 1] * a[3 + j] + m[4 * i + 2] * a[6 + j];
    for (int i = 0, k = 0; i < 3; i++)
      for (int j = i; j < 3; j++, k++)
        six[k] = c[3 * i] * c[3 * j] + c[3 * i + 1] * c[3 * j + 1] + c[3 * i + 2] * c[3 * j + 2];
  }
  store_sixes(s.covariance + 6 * row, six);
}

}  // namespace jg
