// Shadows that fingers, and other hands, cast on a hand (learn/cast_shadow.py): anchors times lamps times capsules,
// sixteen lamps at a time. Lamps that an anchor turns away from, flesh of its own and capsules that all sixteen rays pass by well
// are left out, which changes no bit.
#include "capsule.h"
#include "constants.h"

namespace jg {
namespace {

// The light that reaches a point, open and with the hand around it.
struct Reaching {
  float open[3], seen[3];
};

Reaching reaching(const CastTask& t, const float* foreign, const float point[3], const float normal[3]) {
  vf open[3] = {}, seen[3] = {};
  for (int g = 0; g < t.groups; g++) {
    vf cosine, visible;
    if (!distant_seen(t, foreign, point, normal, g, cosine, visible)) continue;
    const float* lamp = t.lamp + 6 * LANES * g;
    for (int i = 0; i < 3; i++) {
      const vf light = cosine * load(lamp + LANES * (3 + i));
      open[i] += light, seen[i] += light * visible;
    }
  }
  Reaching sums;
  for (int i = 0; i < 3; i++) sums.open[i] = sum_of(open[i]), sums.seen[i] = sum_of(seen[i]);
  return sums;
}

}  // namespace

void posed_anchors(const CastTask& t, const SkinTask& skin, float volume_min, float length2_min, int32_t block, vf p[3],
                   vf normal[3]) {
  SkinTask s = skin;  // the same bones move anchors
  s.block_start = t.block_start, s.bone = t.bone, s.weight = t.weight;
  const float* rest = t.rest + 6 * LANES * (int64_t)block;
  vf m[MAP_ENTRIES], turn[9], x[3], n[3];
  blend(s, block, m);
  for (int i = 0; i < 3; i++) x[i] = load(rest + LANES * i), n[i] = load(rest + LANES * (3 + i));
  for (int i = 0; i < 3; i++) p[i] = m[4 * i] * x[0] + (m[4 * i + 1] * x[1] + (m[4 * i + 2] * x[2] + m[4 * i + 3]));
  turning(s, volume_min, m, volume(s, m), turn);
  turn_by(turn, n, normal);
  make_unit(normal, length2_min);
}

void cast_block(const CastTask& t, const SkinTask& skin, float volume_min, float length2_min, int32_t block) {
  vf p[3], normal[3];
  posed_anchors(t, skin, volume_min, length2_min, block, p, normal);
  float points[3][LANES], normals[3][LANES];
  for (int i = 0; i < 3; i++) store(points[i], p[i]), store(normals[i], normal[i]);
  vf left[3];
  for (int lane = 0; lane < LANES; lane++) {
    const float point[3] = {points[0][lane], points[1][lane], points[2][lane]};
    const float facing[3] = {normals[0][lane], normals[1][lane], normals[2][lane]};
    const Reaching sums = reaching(t, t.foreign + BONES * LANES * (int64_t)block + lane, point, facing);
    for (int i = 0; i < 3; i++) left[i][lane] = (sums.seen[i] + t.bounced[i]) / (sums.open[i] + t.bounced[i]);
  }
  float out[3][LANES];
  for (int i = 0; i < 3; i++) store(out[i], log2(left[i]) * (t.to_display * LN2));
  for (int lane = 0; lane < LANES; lane++)
    for (int i = 0; i < 3; i++) t.fallen[4 * (LANES * (int64_t)block + lane) + i] = out[i][lane];
}

}  // namespace jg
