// Light of lamps that was drawn apart, a layer each, is added to a drawn picture as far as it reaches the surface at each
// pixel: by the pictures that are taken from these lamps (lamp_depth.h), which have edges that Gaussians fray.
#pragma once
#include "detail_surface.h"

namespace jg {

constexpr float SHARE2_MIN = 1e-6f;    // squared length of a mean of unit normals, as a divisor
constexpr float LAYER_UNSEEN = 1e-6f;  // W/(m2 sr) of all colors: less is not seen whatever is hidden, and a divisor
// part of light, from none or all of it, from which on pixels begin to be asked, and are from twice that on: where
// Gaussians, whose edges are wider, say that less is hidden or seen there is no edge
constexpr float EDGE_PART = 0.004f;
// cosines to the lamp over which pixels begin to be asked: light that grazes faces finds them before each other
constexpr float GRAZES_NONE = 0.0f, GRAZES_WHOLE = 0.1f;

// From the camera's axes to those of a lamp's picture.
struct Towards {
  float axes[9], place[3];
};
inline Towards towards(const DetailTask& t, const LampDepth& d) {
  Towards out;
  const double* camera = t.camera_from_position;
  for (int i = 0; i < 3; i++) {
    double place = d.place[i];
    for (int j = 0; j < 3; j++) {
      double turned = 0;
      for (int k = 0; k < 3; k++) turned += d.axes[3 * i + k] * camera[4 * j + k];
      out.axes[3 * i + j] = (float)turned, place -= turned * camera[4 * j + 3];
    }
    out.place[i] = (float)place;
  }
  return out;
}

// Of the surface at sixteen pixels of a row, in the camera's axes: places, m, and unit normals.
struct Spot {
  vf p[3], n[3];
};
JG_INLINE Spot spot_of(const DetailTask& t, const DetailHand& hand, vi face, vi mine, const Interpolated& of, vf x, float y) {
  const vf near = of.at[NEAR], z = t.orthographic ? -near : inverse(near), over = t.orthographic ? all(1.f) : z;
  Spot spot = {{(x - t.cx) * over * (1.f / t.fx), (y - t.cy) * over * (1.f / t.fy), z}, {}};
  const int64_t rows = rows_of(hand);
  const vi number = mine ? face & ((1 << FACE_BITS) - 1) : all(0);
  const vi first = (number / LANES) * (3 * LANES) + number % LANES, plane = number * FACE_NUMBERS;
  const vf dx = x - gather(hand.planes + X, plane), dy = y - gather(hand.planes + Y, plane);
  for (int k = 0; k < 3; k++) {
    const float* share = hand.planes + SHARE_0 + k;
    const vf part = gather(share, plane) + dx * gather(share + BY_X, plane) + dy * gather(share + BY_Y, plane);
    const vi row = gather_bits(hand.corner, first + k * LANES);
    for (int i = 0; i < 3; i++) spot.n[i] += part * gather(hand.turned + i * rows, row);
  }
  make_unit(spot.n, SHARE2_MIN);
  return spot;
}

// What of a lamp's light reaches a spot, where Gaussians say that `seen` does.
JG_INLINE vf reaching_spot(const LampDepth& d, const Towards& to, const Spot& spot, vf seen) {
  Pictured at;
  vf q[3];
  for (int i = 0; i < 3; i++) {
    const float* axis = to.axes + 3 * i;
    q[i] = axis[0] * spot.p[0] + axis[1] * spot.p[1] + axis[2] * spot.p[2] + to.place[i];
    at.n[i] = axis[0] * spot.n[0] + axis[1] * spot.n[1] + axis[2] * spot.n[2];
  }
  const float middle = 0.5f * (float)d.size;
  const vf shrinks = d.orthographic ? all(d.focal) : d.focal / max(q[2], all(DEPTH_MIN_M));
  at.x = q[0] * shrinks + middle, at.y = q[1] * shrinks + middle, at.z = q[2];
  const vf sine2 = d.orthographic ? all(d.radius2) : d.radius2 / (dot(q, q) + d.radius2);
  const Slant slant = slant_of(d, at);
  const vf asked = clamped((slant.cosine - GRAZES_NONE) * (1.f / (GRAZES_WHOLE - GRAZES_NONE)));
  return seen + asked * (reaching<true>(d, at, slant, sqrt(sine2)) - seen);
}

// The surface of a hand at sixteen pixels of a row and beside them.
struct Spots {
  Spot at[5];
  vi there[5];
  int count;
};
inline Spots spots_of(const DetailTask& t, const DetailHand& hand, int32_t number, const Surface& tile, int32_t row, int32_t x,
                      bool beside) {
  constexpr int STEPS[5][2] = {{0, 0}, {-1, 0}, {1, 0}, {0, -1}, {0, 1}};
  Spots spots = {};
  for (const int(&step)[2] : STEPS) {
    const int32_t column = x + step[0], line = row + step[1];
    const vf at_x = LANE + ((float)(tile.x + column) + 0.5f);
    const float at_y = (float)(tile.y + line) + 0.5f;
    vi face;
    memcpy(&face, &tile.face[line][column], sizeof face);
    const vi there = (face >> FACE_BITS == all(number)) & (LANE_NUMBER < TILE_X - column);
    const Interpolated near = interpolate<false>(hand, &tile.face[line][column], there, at_x, at_y);
    spots.at[spots.count] = spot_of(t, hand, face, there, near, at_x, at_y), spots.there[spots.count++] = there;
    if (!beside) break;
  }
  return spots;
}

// Adds the layers to n pixels of a row of a hand.
// skin: how much their Gaussians are those below their faces. Where they are not, those of two skins mix: the mean of what
// a pixel and the four beside it say keeps the edge between the skins from being a staircase.
inline void add_layers(const DetailTask& t, const DetailHand& hand, int32_t number, const Surface& tile, int32_t row, int32_t x,
                       int32_t n, vi mine, vf skin, const Towards* to, vf color[3]) {
  const int64_t pixels = (int64_t)t.width * t.height;
  Spots spots = {};
  for (int32_t layer = 0; layer < t.layers; layer++) {
    const float* p = t.layer[layer] + (int64_t)(tile.y + row) * t.width + tile.x + x;
    vf light[3], sum = {};
    for (int k = 0; k < 3; k++) light[k] = load_first(p + k * pixels, n), sum += light[k];
    const vi lit = mine & (sum > LAYER_UNSEEN);
    if (!bit_mask(lit)) continue;
    vf part = load_first(p + 3 * pixels, n) / max(sum, all(LAYER_UNSEEN));
    // where a lamp has no picture for this hand Gaussians of another one reach here
    const vf asked = hand.pictures[layer].part * clamped(min(part, 1.f - part) * (1.f / EDGE_PART) - 1.f);
    if (bit_mask(lit & (asked > 0))) {
      if (!spots.count) spots = spots_of(t, hand, number, tile, row, x, bit_mask(mine & (skin < 1)));
      vf own = {}, all_around = {}, count = {};
      for (int k = 0; k < spots.count; k++) {
        const vf reaches = reaching_spot(hand.pictures[layer], to[layer], spots.at[k], part);
        if (k == 0) own = reaches;
        all_around += select(spots.there[k], reaches, vf{}), count += select(spots.there[k], all(1.f), vf{});
      }
      const vf mixed = all_around / max(count, all(1.f));
      part += asked * (mixed + skin * (own - mixed) - part);
    }
    for (int k = 0; k < 3; k++) color[k] += select(mine, part * light[k], vf{});
  }
}

}  // namespace jg
