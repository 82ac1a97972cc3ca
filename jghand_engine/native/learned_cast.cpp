// Shadows that fingers, and other hands, cast on a hand (learn/cast_shadow.py): anchors times lamps times capsules,
// sixteen anchors at a time. Lamps that all of them turn away from, flesh of their own and capsules that all rays pass
// by well are left out, which changes no bit.
#include "capsule.h"
#include "constants.h"

namespace jg {

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
  const float* foreign = t.foreign + BONES * LANES * (int64_t)block;
  const Ball ball = ball_around(p);
  alignas(64) float visible[FLOCK * LANES];
  Distant lamps;
  vf open[3] = {}, seen[3] = {};
  for (int g = 0; g < t.groups; g += FLOCK / LANES) {
    uint64_t faced = distant_seen(t, foreign, ball, p, normal, g, false, lamps, visible);
    for (; faced; faced &= faced - 1) {
      const int lamp = __builtin_ctzll(faced);
      const float* rgb = t.lamp + 6 * LANES * (g + lamp / LANES) + 3 * LANES + lamp % LANES;
      const vf part = load(visible + LANES * lamp);
      for (int i = 0; i < 3; i++) {
        const vf light = lamps.cosines[lamp] * rgb[LANES * i];
        open[i] += light, seen[i] += light * part;
      }
    }
  }
  float out[3][LANES];
  for (int i = 0; i < 3; i++)
    store(out[i], log2((seen[i] + t.bounced[i]) / (open[i] + t.bounced[i])) * (t.to_display * LN2));
  for (int lane = 0; lane < LANES; lane++)
    for (int i = 0; i < 3; i++) t.fallen[4 * (LANES * (int64_t)block + lane) + i] = out[i][lane];
}

}  // namespace jg
