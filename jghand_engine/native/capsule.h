// Soft capsules, the flesh of bones, before lights: what learned cast shadows and those of a scene share.
#pragma once
#include <math.h>

#include "learned.h"

namespace jg {

constexpr int FLOCK = 64;            // distant lamps that are looked at together: bits of one number
constexpr float ROUNDING_M = 1e-5f;  // that distances in single precision are good for

// Rays from points in a ball, nearly one way. turn: the largest difference of one's unit direction from `direction`
// half_width: the largest of the lamp per distance
template <class Number>
struct Rays {
  Number middle[3], radius, direction[3], turn, half_width;
};

// Which of sixteen pairs of a ray through the middle of such a ball and a capsule may be near enough for any ray from the
// ball to lose light, one bit each: lower bounds of distances. What is left out takes nothing.
// along, axis_along: of the way from the middle to the capsule's start, and of its axis, in the ray's direction
// mixed, from2, length2: their product and squares · ends: the way from the middle to any point of the axis, at most
template <class Number>
JG_INLINE uint32_t may_meet(const CastTask& t, const Rays<Number>& rays, float softness, vf along, vf axis_along,
                            Number mixed, Number from2, float length2, float radius, Number ends) {
  // the least distance from the line, and from its start where all of a capsule is behind that
  const vf s = clamped((along * axis_along - mixed) * inverse(max(length2 - axis_along * axis_along, all(t.distance2_min))));
  const vf to_line = along + s * axis_along, farthest = max(along, along + axis_along), behind = max(-farthest, vf{});
  const vf distance2 = from2 + s * (2.f * mixed + s * length2) - to_line * to_line + behind * behind;
  const vf way = max(farthest + rays.radius + (ends + rays.radius) * rays.turn, vf{});
  const vf width = max(softness * radius + rays.half_width * way, all(t.width_min));
  const vf clear = radius + width + rays.radius + way * rays.turn + ROUNDING_M;
  return 0xffffu & ~bit_mask(distance2 >= clear * clear);
}

// Of one capsule and rays from sixteen balls.
JG_INLINE uint32_t balls_behind(const CastTask& t, const Rays<vf>& rays, int k, float softness) {
  const float *capsule = t.capsule + CAPSULE * k, length2 = 1.f / capsule[6];
  vf along = {}, axis_along = {}, mixed = {}, from2 = {};
  for (int i = 0; i < 3; i++) {
    const vf from = capsule[i] - rays.middle[i];
    along += from * rays.direction[i], axis_along += capsule[3 + i] * rays.direction[i];
    mixed += from * capsule[3 + i], from2 += from * from;
  }
  const vf ends = quick_sqrt(2.f * (from2 + length2));
  return may_meet(t, rays, softness, along, axis_along, mixed, from2, length2, capsule[7], ends);
}

// Of one capsule and sixteen distant lamps, one group of them.
JG_INLINE uint32_t lamps_behind(const CastTask& t, const Rays<float>& rays, int k, int group) {
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
  const vf edge = clamped(0.5f + 0.5f * (distance - radius) * inverse(width));
  return edge * edge * (3.f - 2.f * edge);
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

// Distant lamps from sixteen points: bits of those that face each, and their cosines to it.
struct Distant {
  uint32_t facing[FLOCK];
  vf cosines[FLOCK];
};

// Those of a group and after it, 64 at most, and, unless that is known, visible (lamps, 16): the part of each that points
// see which face it. Returns bits of lamps that any faces. foreign: of the points, as in CastTask
JG_INLINE uint64_t distant_seen(const CastTask& t, const float* foreign, const Ball& ball, const vf p[3],
                                const vf normal[3], int group, bool keeps_visible, Distant& out, float* visible) {
  const int groups = t.groups - group < FLOCK / LANES ? t.groups - group : FLOCK / LANES;
  uint64_t faced = 0;
  for (int lamp = 0; lamp < LANES * groups; lamp++) {
    const float* d = t.lamp + 6 * LANES * (group + lamp / LANES) + lamp % LANES;
    out.cosines[lamp] = max(normal[0] * d[0] + normal[1] * d[LANES] + normal[2] * d[2 * LANES], vf{});
    out.facing[lamp] = bit_mask(out.cosines[lamp] > 0);
    faced |= (uint64_t)(out.facing[lamp] > 0) << lamp;
  }
  if (keeps_visible) return faced;
  const Rays<float> rays = {{ball.middle[0], ball.middle[1], ball.middle[2]}, ball.radius, {}, 0, t.lamp_width};
  for (int lamp = 0; lamp < LANES * groups; lamp++) store(visible + LANES * lamp, all(1.f));
  alignas(64) float near[FLOCK][2 * LANES];
  int32_t passed[FLOCK];
  for (int k = 0; k < t.capsules; k++) {
    const bool far = k >= BONES;
    const vf hides = far ? all(t.other[k - BONES]) : load(foreign + LANES * k);
    const uint32_t behind = bit_mask(hides > 0);
    if (!behind) continue;
    const float *capsule = t.capsule + CAPSULE * k, radius = capsule[7];
    vf from_start[3];
    for (int i = 0; i < 3; i++) from_start[i] = p[i] - capsule[i];
    uint64_t some = 0;
    for (int g = 0; g < groups; g++) some |= (uint64_t)lamps_behind(t, rays, k, group + g) << (LANES * g);
    // no branch on what is hidden, which nobody could foretell: first those that lose light, then how much
    int count = 0;
    for (some &= faced; some; some &= some - 1) {
      const int lamp = __builtin_ctzll(some), g = group + lamp / LANES;
      const float* d = t.lamp + 6 * LANES * g + lamp % LANES;
      const float* capsule_lamp = t.capsule_lamp + 2 * LANES * (t.groups * k + g) + lamp % LANES;
      const vf direction[3] = {all(d[0]), all(d[LANES]), all(d[2 * LANES])};
      vf distance2, way;
      nearest_to(capsule, from_start, direction, all(capsule_lamp[0]), all(capsule_lamp[LANES]), distance2, way);
      const vf clear = radius + max(t.softness * radius + t.lamp_width * way, all(t.width_min));
      store(near[count], distance2), store(near[count] + LANES, way);
      passed[count] = lamp;
      count += (out.facing[lamp] & behind & bit_mask(distance2 < clear * clear)) != 0;
    }
    for (int i = 0; i < count; i++) {
      const vf distance2 = load(near[i]), at_capsule = t.lamp_width * load(near[i] + LANES);
      const vf width = max(t.softness * radius + at_capsule, all(t.width_min));
      vf behind_it = 1.f - soft_edge(quick_sqrt(max(distance2, all(t.distance2_min))), radius, width);
      if (far) behind_it *= min(radius * inverse(max(at_capsule, all(t.width_min))), all(1.f));
      float* seen = visible + LANES * passed[i];
      store(seen, load(seen) * (1.f - hides * behind_it));
    }
  }
  return faced;
}

}  // namespace jg
