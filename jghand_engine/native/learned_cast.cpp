// Shadows that fingers, and other hands, cast on a hand (learn/cast_shadow.py): anchors times lamps times capsules,
// sixteen lamps at a time. Lamps that an anchor turns away from, flesh of its own and capsules that all sixteen rays pass by well
// are left out, which changes no bit.
#include <math.h>

#include "constants.h"
#include "learned.h"

namespace jg {
namespace {

JG_INLINE vf clamped(vf x) { return min(max(x, vf{}), all(1.f)); }

// What sixteen lamps shine past a capsule to a point; see past_capsule in cast_shadow.py, also for `far`. False: all of
// all of them.
template <bool far>
JG_INLINE bool past_capsule(const CastTask& t, const float* capsule, const float* capsule_lamp, const float point[3],
                            const vf direction[3], vf& part) {
  const float from_start[3] = {point[0] - capsule[0], point[1] - capsule[1], point[2] - capsule[2]};
  const float* axis = capsule + 3;
  const float inverse_length2 = capsule[6], radius = capsule[7];
  const float point_along_axis = from_start[0] * axis[0] + from_start[1] * axis[1] + from_start[2] * axis[2];
  const vf axis_along = load(capsule_lamp), inverse_sine2 = load(capsule_lamp + LANES);
  const vf along = direction[0] * from_start[0] + direction[1] * from_start[1] + direction[2] * from_start[2];
  vf s = clamped((point_along_axis - axis_along * along) * inverse_sine2);
  const vf way = max(s * axis_along - along, vf{});
  s = clamped((point_along_axis + way * axis_along) * inverse_length2);
  vf distance2 = {};
  for (int i = 0; i < 3; i++) {
    const vf between = from_start[i] + way * direction[i] - s * axis[i];
    distance2 += between * between;
  }
  const vf width = max(t.softness * radius + t.lamp_width * way, all(t.width_min)), clear = radius + width;
  if (!bit_mask(distance2 < clear * clear)) return false;
  const vf edge = clamped(0.5f + 0.5f * (sqrt(max(distance2, all(t.distance2_min))) - radius) / width);
  part = edge * edge * (3.f - 2.f * edge);
  if (far) part = 1.f - (1.f - part) * min(radius / max(t.lamp_width * way, all(t.width_min)), all(1.f));
  return true;
}

// Whether the ball around a capsule may hide any of sixteen lamps that a point faces.
JG_INLINE bool stands_before(const CastTask& t, float radius, const float ball[4], const float point[3],
                             const float normal[3], const vf direction[3]) {
  float to[3], height = 0, square = 0;
  for (int i = 0; i < 3; i++) to[i] = ball[i] - point[i], height += to[i] * normal[i], square += to[i] * to[i];
  const float clear = ball[3] + t.softness * radius + t.lamp_width * (sqrtf(square) + ball[3]);
  if (height < -clear) return false;
  const vf along = max(direction[0] * to[0] + direction[1] * to[1] + direction[2] * to[2], vf{});
  return bit_mask(square - along * along < clear * clear);
}

JG_INLINE float sum_of(vf v) {
  float lanes[LANES], sum = 0;
  store(lanes, v);
  for (int i = 0; i < LANES; i++) sum += lanes[i];
  return sum;
}

// The light that reaches a point, open and with the hand around it.
struct Reaching {
  float open[3], seen[3];
};

Reaching reaching(const CastTask& t, const float* foreign, const float point[3], const float normal[3]) {
  vf open[3] = {}, seen[3] = {};
  for (int g = 0; g < t.groups; g++) {
    const float* lamp = t.lamp + 6 * LANES * g;
    vf direction[3];
    for (int i = 0; i < 3; i++) direction[i] = load(lamp + LANES * i);
    const vf cosine = max(direction[0] * normal[0] + direction[1] * normal[1] + direction[2] * normal[2], vf{});
    if (!bit_mask(cosine > 0)) continue;
    vf visible = all(1.f);
    for (int bone = 0; bone < BONES; bone++) {
      const float hides = foreign[LANES * bone];
      vf part;
      if (hides == 0 || !past_capsule<false>(t, t.capsule + CAPSULE * bone,
                                             t.capsule_lamp + 2 * LANES * (t.groups * bone + g), point, direction, part))
        continue;
      visible *= 1.f - hides * (1.f - part);
    }
    for (int k = BONES; k < t.capsules; k++) {
      const float* other = t.other + OTHER * (k - BONES);
      vf part;
      if (stands_before(t, t.capsule[CAPSULE * k + 7], other + 1, point, normal, direction) &&
          past_capsule<true>(t, t.capsule + CAPSULE * k, t.capsule_lamp + 2 * LANES * (t.groups * k + g), point, direction,
                             part))
        visible *= 1.f - other[0] * (1.f - part);
    }
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

void cast_block(const CastTask& t, const SkinTask& skin, float volume_min, float length2_min, int32_t block) {
  SkinTask s = skin;  // the same bones move anchors
  s.block_start = t.block_start, s.bone = t.bone, s.weight = t.weight;
  const float* rest = t.rest + 6 * LANES * (int64_t)block;
  vf m[MAP_ENTRIES], turn[9], x[3], n[3], p[3], normal[3];
  blend(s, block, m);
  for (int i = 0; i < 3; i++) x[i] = load(rest + LANES * i), n[i] = load(rest + LANES * (3 + i));
  for (int i = 0; i < 3; i++) p[i] = m[4 * i] * x[0] + (m[4 * i + 1] * x[1] + (m[4 * i + 2] * x[2] + m[4 * i + 3]));
  turning(s, volume_min, m, volume(s, m), turn);
  turn_by(turn, n, normal);
  make_unit(normal, length2_min);
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
