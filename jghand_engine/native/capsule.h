// Soft capsules, the flesh of bones, before lights: what learned cast shadows and those of a scene share.
#pragma once
#include <math.h>

#include "learned.h"

namespace jg {

constexpr float ROUNDING_M = 1e-5f;  // that distances in single precision are good for

JG_INLINE vf clamped(vf x) { return min(max(x, vf{}), all(1.f)); }

JG_INLINE float sum_of(vf v) {
  float lanes[LANES], sum = 0;
  store(lanes, v);
  for (int i = 0; i < LANES; i++) sum += lanes[i];
  return sum;
}

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
template <class Point>
JG_INLINE void nearest_to(const float* capsule, const Point from_start[3], const vf direction[3], vf axis_along,
                          vf inverse_sine2, vf& distance2, vf& way) {
  const float* axis = capsule + 3;
  const Point point_along_axis = from_start[0] * axis[0] + from_start[1] * axis[1] + from_start[2] * axis[2];
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

// What shines past a capsule, from sixteen directions to a point or from a lamp to sixteen points, which lie
// `from_start` of its start; see past_capsule in learn/cast_shadow.py, also for `far`. False: all of all.
// half_width: of a lamp per distance
template <bool far, class Point, class Width>
JG_INLINE bool past_capsule(const CastTask& t, const float* capsule, const Point from_start[3], const vf direction[3],
                            vf axis_along, vf inverse_sine2, float softness, Width half_width, vf& part) {
  const float radius = capsule[7];
  vf distance2, way;
  nearest_to(capsule, from_start, direction, axis_along, inverse_sine2, distance2, way);
  const vf width = max(softness * radius + half_width * way, all(t.width_min)), clear = radius + width;
  if (!bit_mask(distance2 < clear * clear)) return false;
  part = soft_edge(sqrt(max(distance2, all(t.distance2_min))), radius, width);
  if (far) part = 1.f - (1.f - part) * min(radius / max(half_width * way, all(t.width_min)), all(1.f));
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

// What of sixteen distant lamps, one group of them, a point sees past one capsule.
template <bool far>
JG_INLINE bool distant_past(const CastTask& t, int k, int group, const float point[3], const vf direction[3], vf& part) {
  const float* capsule = t.capsule + CAPSULE * k;
  const float from_start[3] = {point[0] - capsule[0], point[1] - capsule[1], point[2] - capsule[2]};
  const float* capsule_lamp = t.capsule_lamp + 2 * LANES * (t.groups * k + group);
  return past_capsule<far>(t, capsule, from_start, direction, load(capsule_lamp), load(capsule_lamp + LANES), t.softness,
                           t.lamp_width, part);
}

// Sixteen of the distant lamps from a point: cosines to them, and the part of each that is seen. False: none is faced.
JG_INLINE bool distant_seen(const CastTask& t, const float* foreign, const float point[3], const float normal[3],
                            int group, vf& cosine, vf& visible) {
  const float* lamp = t.lamp + 6 * LANES * group;
  vf direction[3], part;
  for (int i = 0; i < 3; i++) direction[i] = load(lamp + LANES * i);
  cosine = max(direction[0] * normal[0] + direction[1] * normal[1] + direction[2] * normal[2], vf{});
  if (!bit_mask(cosine > 0)) return false;
  visible = all(1.f);
  for (int bone = 0; bone < BONES; bone++) {
    const float hides = foreign[LANES * bone];
    if (hides != 0 && distant_past<false>(t, bone, group, point, direction, part)) visible *= 1.f - hides * (1.f - part);
  }
  for (int k = BONES; k < t.capsules; k++) {
    const float* other = t.other + OTHER * (k - BONES);
    if (stands_before(t, t.capsule[CAPSULE * k + 7], other + 1, point, normal, direction) &&
        distant_past<true>(t, k, group, point, direction, part))
      visible *= 1.f - other[0] * (1.f - part);
  }
  return true;
}

}  // namespace jg
