// Linear blend skinning of a whole avatar (METHOD 2.8, 2.9), sixteen Gaussians at a time.
//
// Gaussians lie in blocks of sixteen neighbours, which share most of their bones: a block lists the bones that any of
// its Gaussians has a weight for, and blends their matrices densely. That reads a quarter of what 21 weights would.
#include <stdint.h>

#include "export.h"
#include "team.h"
#include "vec.h"

namespace jg {

// Mirrored field by field in avatar/fast_skinning.py.
struct SkinTask {
  const float* rest;           // (blocks, 4, 16): x y z relative to the canonical root, sigma; metres
  const int32_t* block_start;  // (blocks + 1): where the bones of each block begin
  const int32_t* bone;         // (entries)
  const float* weight;         // (entries, 16)
  const float* linear_offset;  // (21, 3, 4): x_posed - root = linear_offset [x; 1]
  float* position;             // (16 blocks, 3)
  float* sigma;                // (16 blocks)
  float shift[3];              // added to every position
  float scale;                 // of the hand, s_g
  float stretch_min, stretch_max;
  int32_t blocks;
};

namespace {

constexpr int BLOCKS_PER_ITEM = 64, ENTRIES = 12;

void skin_block(const SkinTask& s, int32_t block) {
  vf m[ENTRIES] = {};
  for (int32_t e = s.block_start[block]; e < s.block_start[block + 1]; e++) {
    const float* matrix = s.linear_offset + ENTRIES * s.bone[e];
    const vf w = load(s.weight + LANES * (int64_t)e);
    for (int k = 0; k < ENTRIES; k++) m[k] += w * matrix[k];
  }
  const float* rest = s.rest + 4 * LANES * (int64_t)block;
  const vf x = load(rest), y = load(rest + LANES), z = load(rest + 2 * LANES);
  // the shift last: the hand keeps its precision wherever it is
  const vf px = m[0] * x + (m[1] * y + (m[2] * z + m[3])) + s.shift[0];
  const vf py = m[4] * x + (m[5] * y + (m[6] * z + m[7])) + s.shift[1];
  const vf pz = m[8] * x + (m[9] * y + (m[10] * z + m[11])) + s.shift[2];
  store_triples(s.position + 3 * LANES * (int64_t)block, px, py, pz);
  // |det L|^(1/3) relative to the hand's scale, clamped
  const vf det = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
                 m[2] * (m[4] * m[9] - m[5] * m[8]);
  const float least = s.stretch_min / s.stretch_max, whole = s.stretch_max * s.scale;
  const vf part = min(max(abs(det) * (1.f / (whole * whole * whole)), all(least * least * least)), all(1.f));
  const vf stretch = exp2_of_negative<3>(log2(part) * (1.f / 3.f)) * whole;
  store(s.sigma + LANES * (int64_t)block, load(rest + 3 * LANES) * stretch);
}

}  // namespace
}  // namespace jg

JG_API int32_t jg_skin_task_bytes() { return sizeof(jg::SkinTask); }

// Poses one avatar, together with the other threads of the team.
JG_API void jg_skin(jg::Team* team, const jg::SkinTask* task) {
  const jg::SkinTask s = *task;
  const int32_t items = (s.blocks + jg::BLOCKS_PER_ITEM - 1) / jg::BLOCKS_PER_ITEM;
  jg::share(*team, 0, items, [&](int32_t item) {
    const int32_t end = (item + 1) * jg::BLOCKS_PER_ITEM;
    for (int32_t b = item * jg::BLOCKS_PER_ITEM; b < end && b < s.blocks; b++) jg::skin_block(s, b);
  });
}
