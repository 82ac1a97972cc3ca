// Soft capsules, the flesh of bones, before lights: what learned cast shadows and those of a scene share.
#pragma once
#include <math.h>

#include "learned.h"

namespace jg {

constexpr float ROUNDING_M = 1e-5f;  // that distances in single precision are good for

// Rays from points in a ball, nearly one way. turn: the largest difference of one's unit direction from `direction`
// half_width: the largest of the lamp per distance
struct Rays {
  float middle[3], radius, direction[3], turn, half_width;
};

// Which of sixteen pairs of a ray through the middle of such a ball and a capsule may be near enough for any ray from the
// ball to lose light, one bit each: lower bounds of distances. What is left out takes nothing.
// along, axis_along: of the way from the middle to the capsule's start, and of its axis, in the ray's direction
// mixed, from2, length2: their product and squares · ends: the way from the middle to any point of the axis, at most
template <class Number>
JG_INLINE uint32_t may_meet(const CastTask& t, const Rays& rays, float softness, vf along, vf axis_along, Number mixed,
                            Number from2, Number length2, Number radius, Number ends) {
  // the least distance from the line, and from its start where all of a capsule is behind that
  const vf s = clamped((along * axis_along - mixed) / max(length2 - axis_along * axis_along, all(t.distance2_min)));
  const vf to_line = along + s * axis_along, farthest = max(along, along + axis_along), behind = max(-farthest, vf{});
  const vf distance2 = from2 + s * (2.f * mixed + s * length2) - to_line * to_line + behind * behind;
  const vf way = max(farthest + rays.radius + (ends + rays.radius) * rays.turn, vf{});
  const vf width = max(softness * radius + rays.half_width * way, all(t.width_min));
  const vf clear = radius + width + rays.radius + way * rays.turn + ROUNDING_M;
  return 0xffffu & ~bit_mask(distance2 >= clear * clear);
}

// Of sixteen capsules, from `first` on, and nearly one direction.
JG_INLINE uint32_t capsules_before(const CastTask& t, const Rays& rays, int first, float softness) {
  const float* c = t.capsule_lanes + CAPSULE * first;
  vf along = {}, axis_along = {}, mixed = {}, from2 = {}, length2 = {};
  for (int i = 0; i < 3; i++) {
    const vf from = load(c + LANES * i) - rays.middle[i], axis = load(c + LANES * (3 + i));
    along += from * rays.direction[i], axis_along += axis * rays.direction[i];
    mixed += from * axis, from2 += from * from, length2 += axis * axis;
  }
  const vf radius = load(c + LANES * 7), ends = sqrt(2.f * (from2 + length2));
  const uint32_t some = may_meet(t, rays, softness, along, axis_along, mixed, from2, length2, radius, ends);
  return t.capsules - first < LANES ? some & ((1u << (t.capsules - first)) - 1) : some;
}

// Of one capsule and sixteen distant lamps, one group of them.
JG_INLINE uint32_t lamps_behind(const CastTask& t, const Rays& rays, int k, int group) {
  const float *capsule = t.capsule + CAPSULE * k, *lamp = t.lamp + 6 * LANES * group;
  float mixed = 0, from2 = 0;
  vf along = {};
  for (int i = 0; i < 3; i++) {
    const float from = capsule[i] - rays.middle[i];
    mixed += from * capsule[3 + i], from2 += from * from, along += from * load(lamp + LANES * i);
  }
  const vf axis_along = load(t.capsule_lamp + 2 * LANES * (t.groups * k + group));
  return may_meet(t, rays, t.softness, along, axis_along, mixed, from2, 1.f / capsule[6], capsule[7], 0.f);
}

// The least distance between a capsule's axis and sixteen rays, squared, and how far along these it is.
JG_INLINE void nearest_to(const float* capsule, const vf from_start[3], const vf direction[3], vf axis_along,
                          vf inverse_sine2, vf& distance2, vf& way) {
  const float* axis = capsule + 3;
  const vf point_along_axis = from_start[0] * axis[0] + from_start[1] * axis[1] + from_start[2] * axis[2];
  const vf along = direction[0] * from_start[0] + direction[1] * from_start[1] + direction[2] * from_start[2];
  vf s = clamped((point_along_axis - axis_along * along) * inverse_sine2);
  way = max(s * axis_along - along, vf{});
  s = clamped((point_along_axis + way * axis_along) * capsule[6]);
  distance2 = vf{};
  for (int i = 0; i < 3; i++) {
    const vf between = from_start[i] + way * direction[i] - s * axis[i];
    distance2 += between * between;
  }
}

// What passes at a distance from the axis of a capsule: 0 within it, 1 well beside it, smooth over 2 `width`.
JG_INLINE vf soft_edge(vf distance, float radius, vf width) {
  const vf edge = clamped(0.5f + 0.5f * (distance - radius) / width);
  return edge * edge * (3.f - 2.f * edge);
}

// What of a distant lamp shines past a capsule to sixteen points, which lie `from_start` of its start; see past_capsule
// in learn/cast_shadow.py, also for `far`. Where nothing is hidden `part` stays.
template <bool far>
JG_INLINE void past_capsule(const CastTask& t, const float* capsule, const vf from_start[3], const vf direction[3],
                            vf axis_along, vf inverse_sine2, vf& part) {
  const float radius = capsule[7];
  vf distance2, way;
  nearest_to(capsule, from_start, direction, axis_along, inverse_sine2, distance2, way);
  const vf width = max(t.softness * radius + t.lamp_width * way, all(t.width_min)), clear = radius + width;
  if (!bit_mask(distance2 < clear * clear)) return;
  part = soft_edge(sqrt(max(distance2, all(t.distance2_min))), radius, width);
  if (far) part = 1.f - (1.f - part) * min(radius / max(t.lamp_width * way, all(t.width_min)), all(1.f));
}

// A ball around sixteen points.
struct Ball {
  float middle[3], radius;
};
JG_INLINE Ball ball_around(const vf p[3]) {
  const auto sum = [](vf a, vf b) { return a + b; };
  vf from[3], middle[3];
  for (int i = 0; i < 3; i++) middle[i] = folded(p[i], sum) * (1.f / LANES), from[i] = p[i] - middle[i];
  const vf radius2 = folded(dot(from, from), [](vf a, vf b) { return max(a, b); });
  return {{middle[0][0], middle[1][0], middle[2][0]}, sqrtf(radius2[0])};
}

// Sixteen of the distant lamps, one group of them, from sixteen points: cosines to each, and the part of each that they
// see, of those that any of them faces: their bits. foreign: of the points, as in CastTask · visible: (16 lamps, 16
// points); `keeps_visible` where it is known
JG_INLINE uint32_t distant_seen(const CastTask& t, const float* foreign, const Ball& ball, const vf p[3],
                                const vf normal[3], int group, bool keeps_visible, vf cosines[LANES], float* visible) {
  const float* lamps = t.lamp + 6 * LANES * group;
  uint32_t faced = 0;
  for (int lamp = 0; lamp < LANES; lamp++) {
    const float* d = lamps + lamp;
    cosines[lamp] = max(normal[0] * d[0] + normal[1] * d[LANES] + normal[2] * d[2 * LANES], vf{});
    if (bit_mask(cosines[lamp] > 0)) faced |= 1u << lamp;
  }
  if (keeps_visible || !faced) return faced;
  const Rays rays = {{ball.middle[0], ball.middle[1], ball.middle[2]}, ball.radius, {}, 0, t.lamp_width};
  for (int lamp = 0; lamp < LANES; lamp++) store(visible + LANES * lamp, all(1.f));
  for (int k = 0; k < t.capsules; k++) {
    const bool far = k >= BONES;
    const vf hides = far ? all(t.other[k - BONES]) : load(foreign + LANES * k);
    if (!bit_mask(hides > 0)) continue;
    const float *capsule = t.capsule + CAPSULE * k, *capsule_lamp = t.capsule_lamp + 2 * LANES * (t.groups * k + group);
    vf from_start[3];
    for (int i = 0; i < 3; i++) from_start[i] = p[i] - capsule[i];
    for (uint32_t some = faced & lamps_behind(t, rays, k, group); some; some &= some - 1) {
      const int lamp = __builtin_ctz(some);
      const vf direction[3] = {all(lamps[lamp]), all(lamps[LANES + lamp]), all(lamps[2 * LANES + lamp])};
      const vf along = all(capsule_lamp[lamp]), inverse_sine2 = all(capsule_lamp[LANES + lamp]);
      vf part = all(1.f);
      far ? past_capsule<true>(t, capsule, from_start, direction, along, inverse_sine2, part)
          : past_capsule<false>(t, capsule, from_start, direction, along, inverse_sine2, part);
      store(visible + LANES * lamp, load(visible + LANES * lamp) * (1.f - hides * (1.f - part)));
    }
  }
  return faced;
}

}  // namespace jg
