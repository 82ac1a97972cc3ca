// What of a lamp's light reaches skin past the surface of hands, by a picture of that surface which is taken from the
// lamp: edges of shadows as the surface has them, as wide as the lamp and what stands before it make them.
//
// Percentage-closer soft shadows (Fernando, 2005): the mean depth of what stands before a point says how wide the edge
// is, and the picture, asked over that width, how much is seen.
#pragma once
#include "learned.h"

namespace jg {

// Mirrored field by field in native/scene_light_task.py, as the next one.
struct Above {
  const int32_t* corner;  // (blocks, 3, 16): rows of the vertices of the surface around the places above points
  const float* share;     // (blocks, 3, 16) of each
};
struct LampDepth {
  const float* near;      // (size, size): of the nearest surface 1/z or, of parallel rays, -z, m; what is empty is below all
  const float* disc;      // (2, TAPS): places in the unit disc
  const float* vertex;    // (3, rows) of the hand's surface in the picture: x, y px, near
  Above skin, anchors;    // of its Gaussians, and of the anchors of the light
  float axes[9];          // of the picture, in rows
  float focal;            // px; of parallel rays px per m
  float part;             // 0..1: how much counts what it says, the rest is said by capsules
  float scale;            // of the hand
  int32_t size, orthographic, rows;
};

constexpr int TAPS = 16;  // LAMP_TAPS of native/scene_light_task.py
// of a hand of scale 1: what is nearer to a point's plane than this does not stand before it, and from so much more on it
// does wholly; half width of the narrowest edge, which is as wide as Gaussians are apart; and how far before a point what
// stands there makes all of a wide edge
constexpr float BIAS_M = 1.5e-3f, RAMP_M = 5e-4f, EDGE_MIN_M = 1e-3f, BEFORE_MAX_M = 0.12f;
constexpr float STEEP_COSINE_MIN = 0.2f;  // of a plane's cosine to the light, as a divisor: light that grazes has faded
constexpr float AROUND_COSINE = 0.1f;     // skin that faces away so far has its own flesh before it, and light all the same
constexpr float REACH_MAX_PX = 64.f;      // taps that are farther apart would miss fingers
constexpr float DEPTH_MIN_M = 1e-6f, DEEPEST_M = 1e9f;  // as a divisor; where nothing is

// What reaches the skin above the points of a block, with unit normals, where capsules say that `seen` does.
// sine: of the lamp's half angle there
JG_INLINE vf past_surface(const LampDepth& d, const Above& above, int32_t block, const vf normal[3], vf sine, vf seen) {
  vf x = {}, y = {}, z = {}, n[3];
  for (int k = 0; k < 3; k++) {
    const int64_t at = LANES * (3 * (int64_t)block + k);
    vi row;
    memcpy(&row, above.corner + at, sizeof row);
    const vf near = gather(d.vertex + 2 * (int64_t)d.rows, row), depth = d.orthographic ? -near : 1.f / near;
    const vf share = load(above.share + at), flat = share * (d.orthographic ? all(1.f) : depth);
    x += flat * gather(d.vertex, row), y += flat * gather(d.vertex + d.rows, row), z += share * depth;
    n[k] = d.axes[3 * k] * normal[0] + d.axes[3 * k + 1] * normal[1] + d.axes[3 * k + 2] * normal[2];
  }
  if (!d.orthographic) x *= 1.f / z, y *= 1.f / z;
  const vf px_per_m = d.orthographic ? all(d.focal) : d.focal / max(z, all(DEPTH_MIN_M));
  // along the ray through the point, whose depth grows by 1
  const vf u = (x - 0.5f * (float)d.size) * (1.f / d.focal), v = (y - 0.5f * (float)d.size) * (1.f / d.focal);
  const vf along = d.orthographic ? n[2] : n[2] + u * n[0] + v * n[1];
  const vf cosine = d.orthographic ? -along : -along * inverse_sqrt(1.f + u * u + v * v);
  // how much deeper the plane of the point is, a px to the right and down
  const vf steep = -1.f / (min(along, all(-STEEP_COSINE_MIN)) * px_per_m), deeper_x = n[0] * steep, deeper_y = n[1] * steep;
  const vf last = all((float)(d.size - 1));
  const float bias = BIAS_M * d.scale, over_ramp = 1.f / (RAMP_M * d.scale);
  // what a tap meets: its depth, and how far it is before the plane of the point
  const auto tap = [&](int k, vf reach_px, vf& before) __attribute__((always_inline)) {
    const vi column = floor_to_int(min(max(x + d.disc[k] * reach_px, vf{}), last));
    const vi row = floor_to_int(min(max(y + d.disc[TAPS + k] * reach_px, vf{}), last));
    const vf dx = __builtin_convertvector(column, vf) + 0.5f - x, dy = __builtin_convertvector(row, vf) + 0.5f - y;
    const vf near = gather(d.near, row * d.size + column);
    const vf depth = d.orthographic ? -near : select(near > 0, inverse(near), all(DEEPEST_M));
    before = z + deeper_x * dx + deeper_y * dy - bias - depth;
    return depth;
  };
  const vf least = all(EDGE_MIN_M * d.scale), widest = max(BEFORE_MAX_M * d.scale * sine, least);
  const vf search = min(widest * px_per_m, all(REACH_MAX_PX));
  vf count = {}, sum = {}, before;
  for (int k = 0; k < TAPS; k++) {
    const vf depth = tap(k, search, before);
    const vi stands = before > 0;
    count += select(stands, all(1.f), vf{}), sum += select(stands, depth, vf{});
  }
  const vf counts = d.part * clamped(1.f + cosine * (1.f / AROUND_COSINE));
  if (!bit_mask(count > 0)) return seen + counts * (1.f - seen);
  const vf mean = sum / max(count, all(1.f)), grows = d.orthographic ? all(1.f) : z / max(mean, all(DEPTH_MIN_M));
  // not wider than was searched: light begins where nothing is found
  const vf edge = min(max(sine * max(z - mean, vf{}) * grows, least) * px_per_m, search);
  vf hidden = {};
  for (int k = 0; k < TAPS; k++) {
    tap(k, edge, before);
    hidden += clamped(before * over_ramp);
  }
  return seen + counts * (select(count > 0, 1.f - hidden * (1.f / TAPS), all(1.f)) - seen);
}

}  // namespace jg
