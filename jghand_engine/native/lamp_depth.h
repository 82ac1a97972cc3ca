// What of a lamp's light reaches skin past the surface of hands, by a picture of that surface which is taken from the
// lamp: edges of shadows as the surface has them, as wide as the lamp and what stands before it make them. It is asked
// at Gaussians and anchors, and, of light that is drawn apart, at pixels.
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
  float place[3];         // m, of the origin of the positions, in these axes, from where the picture is taken
  float focal;            // px; of parallel rays px per m
  float part;             // 0..1: how much counts what it says, the rest is said by capsules
  float scale;            // of the hand
  float radius2;          // m2, of what shines; of parallel rays squared sine of half its angle
  int32_t size, orthographic, rows;
  int32_t layer;          // in which its light is drawn apart, to be shadowed at each pixel; -1: none
};

constexpr int TAPS = 16;  // LAMP_TAPS of native/scene_light_task.py
// of a hand of scale 1: what is nearer to a point's plane than this does not stand before it, and from so much more on it
// does wholly; half width of the narrowest edge, at Gaussians, which are as far apart, and at pixels; and how far before
// a point what stands there makes all of a wide edge
constexpr float BIAS_M = 1.5e-3f, RAMP_M = 5e-4f, EDGE_MIN_M = 1e-3f, PIXEL_EDGE_MIN_M = 3e-4f, BEFORE_MAX_M = 0.12f;
constexpr float STEEP_COSINE_MIN = 0.2f;  // of a plane's cosine to the light, as a divisor: light that grazes has faded
constexpr float AROUND_COSINE = 0.1f;     // skin that faces away so far has its own flesh before it, and light all the same
constexpr float REACH_MAX = 0.125f;       // of the picture: taps that are farther apart would miss fingers
constexpr float DEPTH_MIN_M = 1e-6f, DEEPEST_M = 1e9f;  // as a divisor; where nothing is

// Sixteen places in the picture of a lamp: px, depth, m, and unit normals in the picture's axes.
struct Pictured {
  vf x, y, z, n[3];
};

// The skin above the points of a block, with unit normals.
JG_INLINE Pictured above_of(const LampDepth& d, const Above& above, int32_t block, const vf normal[3]) {
  Pictured at = {};
  for (int k = 0; k < 3; k++) {
    const int64_t entry = LANES * (3 * (int64_t)block + k);
    vi row;
    memcpy(&row, above.corner + entry, sizeof row);
    const vf near = gather(d.vertex + 2 * (int64_t)d.rows, row), depth = d.orthographic ? -near : 1.f / near;
    const vf share = load(above.share + entry), flat = share * (d.orthographic ? all(1.f) : depth);
    at.x += flat * gather(d.vertex, row), at.y += flat * gather(d.vertex + d.rows, row), at.z += share * depth;
    at.n[k] = d.axes[3 * k] * normal[0] + d.axes[3 * k + 1] * normal[1] + d.axes[3 * k + 2] * normal[2];
  }
  if (!d.orthographic) at.x *= 1.f / at.z, at.y *= 1.f / at.z;
  return at;
}

// How normals stand to rays: along one whose depth grows by 1, and the cosine to the light.
struct Slant {
  vf along, cosine;
};
JG_INLINE Slant slant_of(const LampDepth& d, const Pictured& at) {
  const vf u = (at.x - 0.5f * (float)d.size) * (1.f / d.focal), v = (at.y - 0.5f * (float)d.size) * (1.f / d.focal);
  const vf along = d.orthographic ? at.n[2] : at.n[2] + u * at.n[0] + v * at.n[1];
  return {along, d.orthographic ? -along : -along * inverse_sqrt(1.f + u * u + v * v)};
}

// How much the picture says of skin by its slant: of what faces away capsules say it.
JG_INLINE vf counts_of(const LampDepth& d, const Slant& slant) {
  return d.part * clamped(1.f + slant.cosine * (1.f / AROUND_COSINE));
}

// What of the lamp reaches places, by its picture; FINE: between its pixels, too.
// sine: of the lamp's half angle there
template <bool FINE>
JG_INLINE vf reaching(const LampDepth& d, const Pictured& at, const Slant& slant, vf sine) {
  const vf px_per_m = d.orthographic ? all(d.focal) : d.focal / max(at.z, all(DEPTH_MIN_M));
  // how much deeper the plane of the place is, a px to the right and down
  const vf steep = -1.f / (min(slant.along, all(-STEEP_COSINE_MIN)) * px_per_m);
  const vf deeper_x = at.n[0] * steep, deeper_y = at.n[1] * steep;
  const vf last = all((float)(d.size - 1));
  const float bias = BIAS_M * d.scale, over_ramp = 1.f / (RAMP_M * d.scale);
  // of what stands in a pixel: its depth, and how far it is before the plane of the place
  const auto depth_of = [&](vf near) __attribute__((always_inline)) {
    return d.orthographic ? -near : select(near > 0, inverse(near), all(DEEPEST_M));
  };
  const auto before_plane = [&](vf column, vf row, vf depth) __attribute__((always_inline)) {
    const vf dx = column + 0.5f - at.x, dy = row + 0.5f - at.y;
    return at.z + deeper_x * dx + deeper_y * dy - bias - depth;
  };
  const auto hides = [&](vf column, vf row, vf near) __attribute__((always_inline)) {
    return clamped(before_plane(column, row, depth_of(near)) * over_ramp);
  };
  const auto place = [&](vf column, vf row) __attribute__((always_inline)) {
    return __builtin_convertvector(row * (float)d.size + column, vi);
  };
  const vf least = all((FINE ? PIXEL_EDGE_MIN_M : EDGE_MIN_M) * d.scale);
  const vf widest = max(BEFORE_MAX_M * d.scale * sine, least), most = all(REACH_MAX * (float)d.size);
  // between pixels a neighbor hides, too
  const vf search = min(widest * px_per_m + (FINE ? 1.f : 0.f), most);
  vf count = {}, sum = {};
  for (int k = 0; k < TAPS; k++) {
    const vf column = floor(min(max(at.x + d.disc[k] * search, vf{}), last));
    const vf row = floor(min(max(at.y + d.disc[TAPS + k] * search, vf{}), last));
    const vf depth = depth_of(gather(d.near, place(column, row)));
    const vi stands = before_plane(column, row, depth) > 0;
    count += select(stands, all(1.f), vf{}), sum += select(stands, depth, vf{});
  }
  if (!bit_mask(count > 0)) return all(1.f);
  const vf mean = sum / max(count, all(1.f)), grows = d.orthographic ? all(1.f) : at.z / max(mean, all(DEPTH_MIN_M));
  // not wider than was searched: light begins where nothing is found
  const vf edge = min(max(sine * max(at.z - mean, vf{}) * grows, least) * px_per_m, search);
  vf hidden = {};
  for (int k = 0; k < TAPS; k++) {
    const vf x = at.x + d.disc[k] * edge, y = at.y + d.disc[TAPS + k] * edge;
    if (!FINE) {
      const vf column = floor(min(max(x, vf{}), last)), row = floor(min(max(y, vf{}), last));
      hidden += hides(column, row, gather(d.near, place(column, row)));
      continue;
    }
    const vf inside_x = min(max(x - 0.5f, vf{}), last - 1.f), inside_y = min(max(y - 0.5f, vf{}), last - 1.f);
    const vf column = floor(inside_x), row = floor(inside_y), fx = inside_x - column, fy = inside_y - row;
    const auto line = [&](vf row) __attribute__((always_inline)) {
      vi left, right;
      gather_pairs<1>((const uint32_t*)d.near, place(column, row), left, right);
      return hides(column, row, float_of(left)) * (1.f - fx) + hides(column + 1.f, row, float_of(right)) * fx;
    };
    const vf upper = line(row), lower = line(row + 1.f);
    hidden += upper + fy * (lower - upper);
  }
  return select(count > 0, 1.f - hidden * (1.f / TAPS), all(1.f));
}

// What a picture says of the skin above the points of a block, and how much that counts beside capsules.
struct Past {
  vf reaches, counts;
};
JG_INLINE Past past_surface(const LampDepth& d, const Above& above, int32_t block, const vf normal[3], vf sine) {
  const Pictured at = above_of(d, above, block, normal);
  const Slant slant = slant_of(d, at);
  return {reaching<false>(d, at, slant, sine), counts_of(d, slant)};
}

}  // namespace jg
