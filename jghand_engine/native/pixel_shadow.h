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

// a pixel and those beside it: rows and columns; and how much itself counts where each of the others is one
constexpr int BESIDE[5][2] = {{0, 0}, {0, -1}, {0, 1}, {-1, 0}, {1, 0}};
constexpr float OWN_SHARE = 4.0f;

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

// Of the surface at sixteen pixels of a row from (left, y) on, in the camera's axes: places, m, and unit normals.
struct Spot {
  vf p[3], n[3];
};
JG_INLINE Spot spot_of(const DetailTask& t, const DetailHand& hand, const int32_t* face, vi mine, float left, float y) {
  const vf x = LANE + left;
  const int64_t rows = rows_of(hand);
  vf near = all(1.f);
  Spot spot = {};
  each_shown(hand, face, mine, [&](const float* f, int32_t number, vi same) __attribute__((always_inline)) {
    const float* by_x = f + BY_X;
    const vf dx = x - f[X];
    alignas(64) float at[LANES];
    store(at, load(f) + (y - f[Y]) * load(f + BY_Y));
    near = select(same, dx * by_x[NEAR] + at[NEAR], near);
    vf n[3] = {};
    for (int k = 0; k < 3; k++) {
      const vf share = dx * by_x[SHARE_0 + k] + at[SHARE_0 + k];
      const float* of_corner = hand.turned + hand.corner[(number / LANES * 3 + k) * LANES + number % LANES];
      for (int i = 0; i < 3; i++) n[i] += share * of_corner[i * rows];
    }
    for (int i = 0; i < 3; i++) spot.n[i] = select(same, n[i], spot.n[i]);
  });
  const vf z = t.orthographic ? -near : inverse(near), over = t.orthographic ? all(1.f) : z;
  spot.p[0] = (x - t.cx) * over * (1.f / t.fx), spot.p[1] = (y - t.cy) * over * (1.f / t.fy), spot.p[2] = z;
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

// How much of a layer's light reaches the pixels of a tile; below 0 where there is none, or not this hand.
struct Reached {
  alignas(64) float part[TILE_Y][TILE_X + LANES];
};

// Sixteen pixels of a row of the picture, which may begin before it by half of them, as tiles with an apron do.
JG_INLINE vf load_across(const float* row, int32_t left, int32_t width) {
  if (left >= 0) return load_first(row + left, width - left);
  return JG_SHUFFLE(vf{}, load_first(row, width), 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23);
}

// Asks the picture of a layer's lamp at the pixels of a hand; false where none of its light is seen.
inline bool ask_pixels(const DetailTask& t, const DetailHand& hand, int32_t number, const Surface& tile, int32_t layer,
                       const Towards& to, Reached& reached) {
  const int64_t pixels = (int64_t)t.width * t.height;
  bool any = false;
  for (int32_t row = 0; row < TILE_Y; row++) {
    for (int32_t x = 0; x < TILE_X; x += LANES) {
      store(&reached.part[row][x], all(-1.f));
      const int32_t left = tile.x + x, y = tile.y + row;
      // faces may reach beyond the image
      if (y < 0 || y >= t.height || left >= t.width) continue;
      vi face;
      memcpy(&face, &tile.face[row][x], sizeof face);
      const vi mine = face >> FACE_BITS == all(number);
      if (!bit_mask(mine)) continue;
      const float* light = t.layer[layer] + (int64_t)y * t.width;
      vf sum = {};
      for (int k = 0; k < 3; k++) sum += load_across(light + k * pixels, left, t.width);
      const vi lit = mine & (sum > LAYER_UNSEEN);
      if (!bit_mask(lit)) continue;
      any = true;
      vf part = load_across(light + 3 * pixels, left, t.width) / max(sum, all(LAYER_UNSEEN));
      // where a lamp has no picture for this hand Gaussians of another one reach here
      const vf asked = hand.pictures[layer].part * clamped(min(part, 1.f - part) * (1.f / EDGE_PART) - 1.f);
      if (bit_mask(lit & (asked > 0))) {
        const Spot spot = spot_of(t, hand, &tile.face[row][x], mine, (float)left + 0.5f, (float)y + 0.5f);
        part += asked * (reaching_spot(hand.pictures[layer], to, spot, part) - part);
      }
      store(&reached.part[row][x], select(lit, part, all(-1.f)));
    }
  }
  return any;
}

// Adds the layers to the pixels of a hand, as far as they reach each and those beside it: or edges of shadows, and of skin
// before other skin, would be staircases.
inline void add_layers(const DetailTask& t, const DetailHand& hand, int32_t number, const Surface& tile) {
  const int64_t pixels = (int64_t)t.width * t.height;
  const Apron apron = apron_of(t);
  Reached reached;
  for (int32_t layer = 0; layer < t.layers; layer++) {
    if (!ask_pixels(t, hand, number, tile, layer, towards(t, hand.pictures[layer]), reached)) continue;
    for (int32_t row = apron.y; row < TILE_Y - apron.y && tile.y + row < t.height; row++) {
      for (int32_t x = apron.x; x < TILE_X - apron.x && tile.x + x < t.width; x += LANES) {
        vf own, sum = {}, shares = {};
        memcpy(&own, &reached.part[row][x], sizeof own);
        if (!bit_mask(own >= 0)) continue;
        for (int k = 0; k < 5; k++) {
          vf part;
          memcpy(&part, &reached.part[row + BESIDE[k][0]][x + BESIDE[k][1]], sizeof part);
          const vf share = select(part >= 0, all(k ? 1.f : OWN_SHARE), vf{});
          sum += share * part, shares += share;
        }
        const int32_t n = t.width - tile.x - x;
        const int64_t at = (int64_t)(tile.y + row) * t.width + tile.x + x;
        const vf reaches = sum / max(shares, all(1.f));
        for (int k = 0; k < 3; k++) {
          float* color = t.picture + at + k * pixels;
          const vf more = reaches * load_first(t.layer[layer] + at + k * pixels, n);
          store_first(color, load_first(color, n) + select(own >= 0, more, vf{}), n);
        }
      }
    }
  }
}

}  // namespace jg
