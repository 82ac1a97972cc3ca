// Which face of a hand's surface is the nearest at each pixel of a tile, and which part of a pixel faces cover where the
// hand ends. Faces are set up in detail.cpp.
#pragma once
#include "constants.h"
#include "scene_light.h"
#include "skin.h"

namespace jg {

// Of one hand. Mirrored field by field in native/detail_task.py.
struct DetailHand {
  const LearnedTask* surface;  // of the vertices: their skin, and linear correctives of their places or none
  float* vertex;             // (3, rows): x, y px, near; of the surface's blocks, then of those in the middles of sides
  const int32_t* corner;     // (groups, 3, 16): rows of vertices
  const int32_t* opposite;   // (groups, 3, 16): rows of the vertices across the sides from a corner to the next; where
                             // no face is across, that corner
  const float* corner_uv;    // (groups, 6, 16): column and row of the texture, 0..1, of each corner
  const float* whole;        // (rows): 0..1, how much of the hand is shown there; of a cap -1 at its edge to -2 in its middle
  float* planes;             // (16 groups, 3, 16): see `Plane`
  int32_t* bounds;           // (groups, BOUNDS, 16): pixels x0, x1, y0, y1 of each face whose centers it may cover, both
                             // ends included, and its kind: bits of its sides, each from a corner to the next, that are
                             // at an outline, and FADES
  int32_t* box;              // (4, groups up to 16): the same of a group; x1 < 0: none of its faces is seen
  int32_t* wide_box;         // (4, a sixteenth of these up to 16): the same of sixteen groups
  const uint32_t* texels;    // every level in squares of 4 x 4: three channels of ten bits, 512 changes nothing; with a
                             // relief a second word each, four signed bytes: rise by column and row, straight, then bent
  int32_t size_log2, groups;
  float facing;              // sign of the area on the image of a face seen from outside; 0: both sides are drawn
  float depth;               // m, of the Gaussians below the surface, times the hand's scale
  float fade_from, fade_to;  // m: apart from that depth by this much, detail begins to fade, and is gone
  float strength;            // 0..1; 0: not drawn
  float exponent;            // log2 of a ratio over the range of a texel's channel
  float cap;                 // 0..1, how much is seen of the cap that closes the hand where it ends
  // relief
  const LearnedTask* learned;  // whose light falls on it; null: there is none
  const float* normal;       // (blocks, 3, 16) of the vertices at rest, unit
  const int32_t* nearest;    // (blocks, ANCHORS_AROUND, 16): anchors of the light around them
  const int32_t* beside;     // (blocks, ANCHORS_AROUND, 16): rows of Gaussians there
  const float* share;        // (blocks, ANCHORS_AROUND, 16)
  float* bend;               // (rows): 0 straight to 1 bent, given for the surface's blocks
  float* slope;              // (4, rows): how their light turns with the normal, in the camera's axes; along it
  float* gloss;              // (5, rows): `GlossLobe` of it: way in the camera's axes, width2, part; null: vertices alone are asked for
  float rise;                // m per side of the square, over the range of a byte, times the hand's scale; 0: not drawn
  // vertices in the middles of sides
  const int32_t* around;     // (side_blocks, AROUND_SIDE, 16): rows of the vertices around each: see `round_sides`
  const float* side_share;   // (side_blocks, AROUND_SIDE, 16): how much each of them counts
  int32_t side_blocks;
  // shadows at pixels
  float* turned;             // (3, rows): unit normals of the vertices in the camera's axes
  const LampDepth* pictures; // (layers): of the lamps of the layers; without a part where one is not this hand's
};
constexpr int AROUND_SIDE = 8;

// Rows of groups, of faces or of sixteen groups: whole vectors.
JG_INLINE int32_t groups_stride(int32_t groups) { return (groups + LANES - 1) / LANES * LANES; }
inline int64_t rows_of(const DetailHand& hand) { return LANES * (int64_t)(hand.surface->skin.blocks + hand.side_blocks); }

// Mirrored field by field in native/detail_task.py.
struct DetailTask {
  const DetailHand* hands;
  float* picture;  // (5, H, W) premultiplied R G B, alpha, sum of weight * z
  int32_t* hit;    // (H, W) the nearest face: its row, the hand's number above; -1: none
  float* hit_near; // (H, W), rows near_stride apart: how near that is; where a hand ends in what fades, or its cap, and the
                   // image has hands that end, as if there were none: what lies beneath is seen, too
  double camera_from_position[12];
  float fx, fy, cx, cy, z_near;
  float alpha_from, alpha_to;  // detail fades in between them: at the outline there is none
  float graze_max;             // lengths along a ray that grazes the surface are longer by this factor at most
  float outline;               // 0..1: how much of alpha is what the surfaces cover
  const float* const* layer;   // (layers): (4, H, W) each, light to be shadowed at each pixel: rgb, and the sum of these as
                               // far as Gaussians say that it reaches them
  int32_t hand_count, width, height, orthographic, layers, near_stride;
};

JG_INLINE vi gather_bits(const void* p, vi index) { return bits_of(gather((const float*)p, index)); }

constexpr int TILE_X = 64, TILE_Y = 32;
// Columns and rows around what is drawn of a tile of which the nearest face is known, too: pixels beside its own may be
// asked. So many columns that vectors of the picture begin where they do without them.
struct Apron {
  int32_t x, y;
};
inline Apron apron_of(const DetailTask& t) { return t.layers > 0 ? Apron{LANES / 2, 1} : Apron{0, 0}; }
constexpr int FACE_BITS = 20;        // of a number of a face; the hand's stands above
constexpr int BOUNDS = 5, FACE_KIND = 4;
constexpr int FADES = 8, CAP = 16;  // bits of a face, beside those of its sides: the hand ends there; it closes the end
// of a pixel where a face may cover it: a Hammersley set, spread as the film filter of Cycles weighs places (Blackman-Harris,
// 1.5 pixels to each side), so that outlines are as soft as those of what Blender renders beside
const vf SAMPLE_X = {-0.7699f, -0.5554f, -0.4290f, -0.3312f, -0.2478f, -0.1724f, -0.1018f, -0.0337f,
                     0.0337f, 0.1018f, 0.1724f, 0.2478f, 0.3312f, 0.4290f, 0.5554f, 0.7699f};
const vf SAMPLE_Y = {-0.7699f, 0.0337f, -0.2478f, 0.3312f, -0.4290f, 0.1724f, -0.1018f, 0.5554f,
                     -0.5554f, 0.1018f, -0.1724f, 0.4290f, -0.3312f, 0.2478f, -0.0337f, 0.7699f};
constexpr float SAMPLES_TO = 0.78f;  // pixels to each side

// What is kept of a face. First what is affine on the image: near; the texture's column and row times it; how much is
// shown; of relief the light's change with a lean along two axes on the face, its change along the normal, and the bend, and
// of the lobe of its gloss the way along these axes and the part; and corners' shares. Each has its value at the first
// corner, and by how much it changes by x and by y, in a vector each: three that lie together. Behind the values stands
// that corner; behind the changes how a rise by column tilts the first axis, a rise by row the first and the second, and
// the width of the lobe.
enum Plane { NEAR, U, V, WHOLE, TURN_0, TURN_1, ALONG, BEND, WAY_0, WAY_1, PART, SHARE_0, SHARE_1, SHARE_2, X, Y };
constexpr int BY_X = LANES, BY_Y = 2 * LANES, FACE_NUMBERS = 3 * LANES;
enum OfFace { BY_COLUMN_0 = BY_X + X, BY_ROW_0 = BY_X + Y, BY_ROW_1 = BY_Y + X, WIDTH2 = BY_Y + Y };
constexpr int OF_FACE[] = {BY_COLUMN_0, BY_ROW_0, BY_ROW_1, WIDTH2};

// The nearest face of each pixel of a part of the image.
struct Surface {
  // with room for a vector that begins at the last column
  alignas(64) float near[TILE_Y][TILE_X + LANES];
  alignas(64) int32_t face[TILE_Y][TILE_X + LANES];  // its number and its hand's; -1: none
  uint64_t solid[TILE_Y];            // bits of pixels where a face is that does not fade away, however far
  uint64_t capped[TILE_Y];           // ... where one of a cap is
  uint64_t doubted[TILE_Y];          // bits of pixels that the surface may cover in part
  uint16_t samples[TILE_Y][TILE_X];  // of these, which samples of a pixel it covers
  uint8_t most[TILE_Y][TILE_X];      // ... by the face above, where none covers the center
  int32_t x, y;
  bool is_clear;  // whether anything stands above: in most tiles nothing is seen
  bool fades;     // whether a face that reaches into it does; before Gaussians are blended, or is of a cap
};
static_assert(TILE_X == 64 && LANES == 16, "a row of pixels is a word, samples of a pixel are a vector");

inline void clear(Surface& tile) {
  const vf nothing = all(NOT_NEAR);
  const vi no_face = all(-1);
  memset(tile.solid, 0, sizeof tile.solid), memset(tile.capped, 0, sizeof tile.capped);
  memset(tile.doubted, 0, sizeof tile.doubted);
  memset(tile.samples, 0, sizeof tile.samples), memset(tile.most, 0, sizeof tile.most);
  for (int y = 0; y < TILE_Y; y++)
    for (int x = 0; x < TILE_X; x += LANES) store(&tile.near[y][x], nothing), store(&tile.face[y][x], no_face);
  tile.is_clear = true;
}

const vf LANE = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
const vi LANE_NUMBER = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};

// Puts what a face covers of the tile where nothing is nearer.
JG_INLINE void cover_face(Surface& tile, const float* face, int32_t number, int32_t x0, int32_t x1, int32_t y0,
                          int32_t y1) {
  const float *by_x = face + BY_X, *by_y = face + BY_Y;
  alignas(64) float at[LANES];
  store(at, load(face) + ((float)(tile.y + y0) + 0.5f - face[Y]) * load(by_y));
  for (int32_t x = x0; x <= x1; x += LANES) {
    const vf dx = LANE + ((float)(tile.x + x) + 0.5f - face[X]);
    vf near = dx * by_x[NEAR] + at[NEAR], share[3];
    for (int k = 0; k < 3; k++) share[k] = dx * by_x[SHARE_0 + k] + at[SHARE_0 + k];
    for (int32_t y = y0; y <= y1; y++) {
      const vf before = load(&tile.near[y][x]);
      const vi closer = (min(min(share[1], share[2]), share[0]) >= 0) & (near > before);
      vi face_before;
      memcpy(&face_before, &tile.face[y][x], sizeof face_before);
      store(hidden(&tile.near[y][x]), select(closer, near, before));
      store(hidden(&tile.face[y][x]), closer ? all(number) : face_before);
      for (int k = 0; k < 3; k++) share[k] += by_y[SHARE_0 + k];
      near += by_y[NEAR];
    }
  }
}

// Where a face is in a tile: centers of pixels, both ends included; none where the first is beyond the last.
struct Span {
  int32_t x0, x1, y0, y1;
};

// Calls act(number of a face, its place) for all faces of a hand that reach into the tile, or to `around` pixels before.
template <typename Act>
JG_INLINE void each_face(const Surface& tile, const DetailHand& hand, int32_t around, Act act) {
  const int32_t stride = groups_stride(hand.groups), wide_stride = groups_stride(stride / LANES);
  const vi left = all(tile.x - around), right = all(tile.x + TILE_X - 1 + around);
  const vi top = all(tile.y - around), bottom = all(tile.y + TILE_Y - 1 + around);
  const auto touching = [&](const int32_t* p, int64_t step) __attribute__((always_inline)) {
    vi x0, x1, y0, y1;
    memcpy(&x0, p, sizeof x0), memcpy(&x1, p + step, sizeof x1);
    memcpy(&y0, p + 2 * step, sizeof y0), memcpy(&y1, p + 3 * step, sizeof y1);
    return bit_mask((x0 <= right) & (x1 >= left) & (y0 <= bottom) & (y1 >= top));
  };
  const auto each = [](int32_t first, uint32_t bits, auto then) __attribute__((always_inline)) {
    for (; bits; bits &= bits - 1) then(first + __builtin_ctz(bits));
  };
  for (int32_t first = 0; first < wide_stride; first += LANES) {
    each(first, touching(hand.wide_box + first, wide_stride), [&](int32_t sixteen) __attribute__((always_inline)) {
      each(LANES * sixteen, touching(hand.box + LANES * sixteen, stride), [&](int32_t group) __attribute__((always_inline)) {
        const int32_t* bounds = hand.bounds + BOUNDS * LANES * (int64_t)group;
        each(0, touching(bounds, LANES), [&](int32_t i) __attribute__((always_inline)) {
          const int32_t x0 = bounds[i] - tile.x - around, x1 = bounds[LANES + i] - tile.x + around;
          const int32_t y0 = bounds[2 * LANES + i] - tile.y - around, y1 = bounds[3 * LANES + i] - tile.y + around;
          act(LANES * group + i, Span{x0 < 0 ? 0 : x0, x1 < TILE_X ? x1 : TILE_X - 1, y0 < 0 ? 0 : y0,
                                      y1 < TILE_Y ? y1 : TILE_Y - 1}, bounds[FACE_KIND * LANES + i]);
        });
      });
    });
  }
}

inline void cover_hand(Surface& tile, const DetailHand& hand, int32_t number) {
  each_face(tile, hand, 0, [&](int32_t row, const Span& at, int32_t kind) __attribute__((always_inline)) {
    if (!tile.is_clear) clear(tile);
    tile.fades |= (kind & (FADES | CAP)) != 0;
    const float* face = hand.planes + FACE_NUMBERS * (int64_t)row;
    cover_face(tile, face, number << FACE_BITS | row, at.x0, at.x1, at.y0, at.y1);
  });
}

// Bits of the columns of a span.
JG_INLINE uint64_t columns_of(const Span& at) { return (~0ull >> (TILE_X - 1 - (at.x1 - at.x0))) << at.x0; }

// Marks the pixels that a side at an outline crosses.
inline void doubt_outlines(Surface& tile, const DetailHand& hand) {
  each_face(tile, hand, 1, [&](int32_t row, const Span& at, int32_t kind) __attribute__((always_inline)) {
    if (!kind) return;
    if (!tile.is_clear) clear(tile);
    tile.fades |= (kind & FADES) != 0;
    const float* face = hand.planes + FACE_NUMBERS * (int64_t)row;
    for (int side = 0; side < 3; side++) {
      if (!(kind >> side & 1)) continue;
      // the share of the corner across is 0 along it, and changes by this from the middle of a pixel to the last samples
      const int plane = SHARE_0 + (side + 2) % 3;
      const float by_x = face[BY_X + plane], by_y = face[BY_Y + plane];
      const float within = SAMPLES_TO * (__builtin_fabsf(by_x) + __builtin_fabsf(by_y));
      for (int32_t y = at.y0; y <= at.y1; y++) {
        const float first = face[plane] + ((float)(tile.y + y) + 0.5f - face[Y]) * by_y;
        uint64_t crossed = 0;
        for (int32_t x = at.x0 & -LANES; x <= at.x1; x += LANES) {
          const vf share = (LANE + ((float)(tile.x + x) + 0.5f - face[X])) * by_x + first;
          crossed |= (uint64_t)bit_mask(abs(share) <= within) << x;
        }
        tile.doubted[y] |= crossed & columns_of(at);
      }
    }
  });
}

// Marks where something is behind a part of a hand that fades away, or its cap.
inline void mark_solid(Surface& tile, const DetailHand& hand) {
  each_face(tile, hand, 0, [&](int32_t row, const Span& at, int32_t kind) __attribute__((always_inline)) {
    if ((kind & (FADES | CAP)) == FADES) return;
    uint64_t* marked = kind & CAP ? tile.capped : tile.solid;
    const float *face = hand.planes + FACE_NUMBERS * (int64_t)row, *by_x = face + BY_X, *by_y = face + BY_Y;
    for (int32_t y = at.y0; y <= at.y1; y++) {
      const float dy = (float)(tile.y + y) + 0.5f - face[Y];
      for (int32_t x = at.x0 & -LANES; x <= at.x1; x += LANES) {
        const vf dx = LANE + ((float)(tile.x + x) + 0.5f - face[X]);
        vf least = all(0.f);
        for (int k = SHARE_0; k <= SHARE_2; k++) least = min(least, dx * by_x[k] + (face[k] + dy * by_y[k]));
        marked[y] |= (uint64_t)bit_mask(least >= 0) << x;
      }
    }
  });
}

// Finds which samples of doubted pixels a hand covers. Where no face covers the center of one, it gets the one that covers
// most of it.
inline void sample_hand(Surface& tile, const DetailHand& hand, int32_t number) {
  each_face(tile, hand, 1, [&](int32_t row, const Span& at, int32_t) __attribute__((always_inline)) {
    uint64_t doubted = 0;
    for (int32_t y = at.y0; y <= at.y1; y++) doubted |= tile.doubted[y];
    if (!(doubted & columns_of(at))) return;
    const float *face = hand.planes + FACE_NUMBERS * (int64_t)row, *by_x = face + BY_X, *by_y = face + BY_Y;
    vf share[3];
    for (int k = 0; k < 3; k++) {
      const int plane = SHARE_0 + k;
      share[k] = face[plane] + SAMPLE_X * by_x[plane] + SAMPLE_Y * by_y[plane];
    }
    for (int32_t y = at.y0; y <= at.y1; y++) {
      for (uint64_t pixels = tile.doubted[y] & columns_of(at); pixels; pixels &= pixels - 1) {
        const int x = __builtin_ctzll(pixels);
        const float dx = (float)(tile.x + x) + 0.5f - face[X], dy = (float)(tile.y + y) + 0.5f - face[Y];
        vf least = share[0] + (dx * by_x[SHARE_0] + dy * by_y[SHARE_0]);
        for (int k = 1; k < 3; k++) least = min(least, share[k] + (dx * by_x[SHARE_0 + k] + dy * by_y[SHARE_0 + k]));
        const uint32_t covered = bit_mask(least >= 0);
        tile.samples[y][x] |= (uint16_t)covered;
        const int many = __builtin_popcount(covered);
        if (many <= tile.most[y][x] || (!tile.most[y][x] && tile.face[y][x] >= 0)) continue;
        tile.most[y][x] = (uint8_t)many, tile.face[y][x] = number << FACE_BITS | row;
      }
    }
  });
}

// Which of sixteen pixels of a row from x on have their bit.
JG_INLINE vi bits_at(uint64_t row, int32_t x) { return ((all((int32_t)(row >> x)) >> LANE_NUMBER) & 1) != 0; }

// The part of sixteen pixels that surfaces cover, of those that they cover at all.
JG_INLINE vf covered_part(const Surface& tile, int32_t row, int32_t x) {
  const uint64_t doubted = tile.doubted[row] >> x & 0xffff;
  if (!doubted) return all(1.f);
  alignas(64) float part[LANES];
  store(part, all(1.f));
  for (uint64_t pixels = doubted; pixels; pixels &= pixels - 1) {
    const int i = __builtin_ctzll(pixels);
    part[i] = (1.f / LANES) * (float)__builtin_popcount(tile.samples[row][x + i]);
  }
  return load(part);
}

// Calls act(what is kept of a face, its row, its pixels) for the few faces of a hand that share sixteen pixels.
// face: (16) as `Surface` has them
template <typename Act>
JG_INLINE void each_shown(const DetailHand& hand, const int32_t* face, vi mine, Act act) {
  vi faces;
  memcpy(&faces, face, sizeof faces);
  const vi before = JG_SHUFFLE(faces, faces, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14);
  for (uint32_t first = bit_mask(mine) & (bit_mask(faces != before) | 1); first; first &= first - 1) {
    const int32_t number = face[__builtin_ctz(first)], row = number & ((1 << FACE_BITS) - 1);
    act(hand.planes + (int64_t)FACE_NUMBERS * row, row, faces == all(number));
  }
}

// What is known of sixteen pixels by their faces. See `Plane`.
struct Interpolated {
  vf at[LANES];         // at each pixel
  vf by_x[3], by_y[3];  // of the first three planes
  vf of_face[4];        // OF_FACE
};

// x, y: of the first pixel
template <bool has_relief>
JG_INLINE Interpolated interpolate(const DetailHand& hand, const int32_t* face, vi mine, float x, float y) {
  Interpolated out = {};
  out.at[NEAR] = all(1.f);
  each_shown(hand, face, mine, [&](const float* f, int32_t, vi same) __attribute__((always_inline)) {
    const float *by_x = f + BY_X, *by_y = f + BY_Y;
    const vf dx = LANE + x - f[X];
    alignas(64) float at[LANES];
    store(at, load(f) + (y - f[Y]) * load(by_y));
    // unrolled, or what is chosen stays in memory, where some lanes alone would be stored: see `hidden`
#pragma GCC unroll 16
    for (int k = NEAR; k <= (has_relief ? PART : WHOLE); k++) out.at[k] = select(same, dx * by_x[k] + at[k], out.at[k]);
#pragma GCC unroll 16
    for (int k = NEAR; k <= V; k++)
      out.by_x[k] = select(same, all(by_x[k]), out.by_x[k]), out.by_y[k] = select(same, all(by_y[k]), out.by_y[k]);
#pragma GCC unroll 16
    for (int k = 0; k < (has_relief ? 4 : 0); k++) out.of_face[k] = select(same, all(f[OF_FACE[k]]), out.of_face[k]);
  });
  return out;
}

}  // namespace jg
