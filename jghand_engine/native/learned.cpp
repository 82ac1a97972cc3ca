// The skin of a trained hand: first everything that its pose decides, then what is reflected towards the camera, which
// is all that a camera that moves alone asks for.
#include "learned.h"

#include "constants.h"
#include "export.h"
#include "scene_light.h"

namespace jg {
namespace {

constexpr int BLOCKS_PER_ITEM = 16, ANCHOR_BLOCKS_PER_ITEM = 2;

int32_t items_of(int32_t blocks, int32_t per_item) { return (blocks + per_item - 1) / per_item; }

// The cast shadow of a block, from the anchors around each Gaussian.
JG_INLINE void add_fallen(const LearnedTask& t, int32_t block, vf exponent[3]) {
  const int64_t first = ANCHORS_AROUND * LANES * (int64_t)block;
  for (int k = 0; k < ANCHORS_AROUND; k++) {
    const int32_t* nearest = t.nearest + first + LANES * k;
    const vf share = load(t.share + first + LANES * k);
    float values[3][LANES];
    for (int lane = 0; lane < LANES; lane++)
      for (int i = 0; i < 3; i++) values[i][lane] = t.cast.fallen[4 * (int64_t)nearest[lane] + i];
    for (int i = 0; i < 3; i++) exponent[i] += share * load(values[i]);
  }
}

void pose_block(const LearnedTask& t, int32_t block, const vf correction[CORRECTION]) {
  const SkinTask& s = t.skin;
  vf m[MAP_ENTRIES], p[3], turn[9], moved[3];
  blend(s, block, m);
  posed_center(s, block, m, p);
  const vf size = volume(s, m);
  turning(s, t.volume_min, m, size, turn);
  turn_by(turn, correction, moved);
  for (int i = 0; i < 3; i++) {
    const float side = i == 0 ? (float)t.world_offsets : 1.f;
    p[i] += t.world_offsets ? correction[i] * side : moved[i] * s.scale;
  }
  store_shapes(s, block, m, p, size);

  const float* look = t.look + LOOK * LANES * (int64_t)block;
  vf rest[3], normal[3], waves[HARMONICS], exponent[3], rgb[3];
  for (int i = 0; i < 3; i++) rest[i] = load(look + LANES * i);
  turn_by(turn, rest, normal);
  make_unit(normal, t.length2_min);
  if (t.scene) return reflecting_block(t, block, normal, correction);
  harmonics(normal, waves);
  for (int i = 0; i < 3; i++) exponent[i] = correction[3 + i];
  if (t.nearest) add_fallen(t, block, exponent);
  for (int i = 0; i < 3; i++) {
    vf light = waves[0] * t.irradiance[i];
    for (int k = 1; k < HARMONICS; k++) light += waves[k] * t.irradiance[3 * k + i];
    const vf inside = min(max(light + exponent[i], all(-t.exponent_max)), all(t.exponent_max));
    rgb[i] = load(look + LANES * (3 + i)) * exp2(inside * LOG2E);
  }
  if (!t.matt) return store_triples(t.rgb + 3 * LANES * (int64_t)block, rgb[0], rgb[1], rgb[2]);
  float* matt = t.matt + MATT * LANES * (int64_t)block;
  for (int i = 0; i < 3; i++) store(matt + LANES * i, normal[i]), store(matt + LANES * (3 + i), rgb[i]);
}

void pose_blocks(const LearnedTask& t, int32_t begin, int32_t end) {
  for (int32_t block = begin; block < end; block += NETWORK_BLOCKS) {
    const int count = end - block < NETWORK_BLOCKS ? end - block : NETWORK_BLOCKS;
    vf correction[NETWORK_BLOCKS][CORRECTION] = {};
    if (t.correctives == NETWORK) network_correction(t, block, count, correction);
    for (int b = 0; b < count; b++) {
      float* given = t.given ? t.given + CORRECTION * LANES * (int64_t)(block + b) : nullptr;
      if (t.correctives == NETWORK && given) memcpy(given, correction[b], sizeof *correction);
      if (t.correctives == LINEAR) linear_correction(t, block + b, correction[b]);
      if (t.correctives == GIVEN) memcpy(correction[b], given, sizeof *correction);
      pose_block(t, block + b, correction[b]);
    }
  }
}

// What a block reflects towards the eye; `gloss` in learn/light.py.
void gloss_block(const LearnedTask& t, int32_t block) {
  const int64_t row = LANES * (int64_t)block;
  vf p[3], n[3], rgb[3], eye[3], mirrored[3], lobes[3] = {};
  load_triples(t.skin.position + 3 * row, p[0], p[1], p[2]);
  for (int i = 0; i < 3; i++) {
    n[i] = load(t.matt + MATT * row + LANES * i), rgb[i] = load(t.matt + MATT * row + LANES * (3 + i));
    eye[i] = t.eye[i] - p[i];
  }
  make_unit(eye, t.length2_min);
  const vf facing = dot(n, eye), fade = t.front ? seen_from_outside(t, row, facing) : all(1.f);
  if (!bit_mask(fade > 0)) return store_triples(t.rgb + 3 * row, vf{}, vf{}, vf{});
  for (int i = 0; i < 3; i++) mirrored[i] = 2.f * facing * n[i] - eye[i];
  add_lobes(t.lobe, t.lobes, mirrored, lobes);
  const vf grazing = 1.f - min(max(facing, vf{}), all(1.f)), square = grazing * grazing;
  const vf shine = load(t.look + LOOK * row + LANES * 6) * (1.f + t.rim * (square * square * grazing));
  for (int i = 0; i < 3; i++) rgb[i] = fade * (rgb[i] + shine * lobes[i]);
  store_triples(t.rgb + 3 * row, rgb[0], rgb[1], rgb[2]);
}

}  // namespace
}  // namespace jg

JG_API int32_t jg_learned_task_bytes() { return sizeof(jg::LearnedTask); }

// Poses one avatar, or lights it anew in the pose that it has (`keeps_pose`), together with the other threads.
JG_API void jg_learned_pose(jg::Team* team, const jg::LearnedTask* task) {
  const jg::LearnedTask t = *task;
  // calls work(begin, end) for all of a number of blocks, some at a time
  const auto by_blocks = [&](int step, int32_t blocks, int32_t per_item, auto work) {
    jg::share(*team, step, jg::items_of(blocks, per_item), [&](int32_t item) {
      const int32_t begin = item * per_item, end = begin + per_item;
      work(begin, end < blocks ? end : blocks);
    });
  };
  const int32_t anchor_blocks = t.nearest ? t.cast.blocks : 0;
  const auto at_anchors = [&](int step, auto work) {
    by_blocks(step, anchor_blocks, jg::ANCHOR_BLOCKS_PER_ITEM, [&](int32_t begin, int32_t end) {
      for (int32_t b = begin; b < end; b++) work(b);
    });
  };
  if (t.scene) {
    by_blocks(0, anchor_blocks, jg::LANES, [&](int32_t begin, int32_t end) { jg::anchor_lamps(t, begin, end); });
    at_anchors(1, [&](int32_t b) { jg::anchor_world(t, b); });
    if (t.scene->area && t.scene->shade > 0 && !t.scene->baked) {
      by_blocks(2, jg::SWEEPS, 1, [&](int32_t item, int32_t) { jg::sweep_some(t, item, jg::AGAIN_STEP); });
      at_anchors(3, [&](int32_t b) { jg::anchor_again(t, b); });
      by_blocks(4, jg::SWEEPS, 1, [&](int32_t item, int32_t) { jg::sweep_some(t, item, 1); });
      at_anchors(5, [&](int32_t b) { jg::anchor_caught(t, b); });
    } else {
      at_anchors(2, [&](int32_t b) { jg::anchor_bounced(t, b); });
      at_anchors(3, [&](int32_t b) { jg::anchor_evened(t, b); });
    }
  } else {
    at_anchors(0, [&](int32_t b) { jg::cast_block(t.cast, t.skin, t.volume_min, t.length2_min, b); });
  }
  by_blocks(6, t.skin.blocks, jg::BLOCKS_PER_ITEM, [&](int32_t begin, int32_t end) {
    if (!t.scene || !t.scene->keeps_pose) jg::pose_blocks(t, begin, end);
    if (t.scene) jg::light_blocks(t, begin, end);
  });
}

// Colors as the eye sees them, of an avatar that is posed and has `matt`; together with the other threads.
JG_API void jg_learned_gloss(jg::Team* team, const jg::LearnedTask* task) {
  const jg::LearnedTask t = *task;
  constexpr int PER_ITEM = 4 * jg::BLOCKS_PER_ITEM;
  jg::share(*team, 0, jg::items_of(t.skin.blocks, PER_ITEM), [&](int32_t item) {
    for (int32_t b = item * PER_ITEM; b < (item + 1) * PER_ITEM && b < t.skin.blocks; b++)
      t.scene ? jg::seen_block(t, b) : jg::gloss_block(t, b);
  });
}
