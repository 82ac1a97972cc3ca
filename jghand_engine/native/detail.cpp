// Detail: a textured surface that follows the bones, found at each pixel, multiplies the colors of drawn Gaussians.
//
//   skin     vertices of all hands to pixels
//   set up   per face the planes of what is interpolated, and what it may touch; groups of sixteen neighbors
//   shade    per tile: the nearest face of each pixel, then the texture there; or the faces are told, for learning
//
// A relief is light that falls on skin of another slope: vertices ask how the light turns with their normal, and pixels
// multiply that by how their own leans.
//
// What is nearer is a larger `near`, 1/z or, of parallel rays, -z: it is linear on the image, and so are the texture's
// coordinates times it (of parallel rays: by themselves).
#include "export.h"
#include "projection.h"
#include "scene_light.h"
#include "shadow.h"
#include "skin.h"
#include "team.h"

namespace jg {

// Of one hand. Mirrored field by field in native/detail_task.py.
struct DetailHand {
  const LearnedTask* surface;  // of the vertices: their skin, and linear correctives of their places or none
  float* vertex;             // (3, 16 blocks): x, y px, near
  const int32_t* corner;     // (groups, 3, 16): rows of vertices
  const float* corner_uv;    // (groups, 6, 16): column and row of the texture, 0..1, of each corner
  float* planes;             // (groups, FACE_ROWS, 16)
  int32_t* bounds;           // (groups, 4, 16): pixels x0, x1, y0, y1 of each face, both ends included; x0 > x1: none
  int32_t* box;              // (4, groups up to 16): the same of a group
  const uint32_t* texels;    // every level in squares of 4 x 4: three channels of ten bits, 512 changes nothing
  int32_t size_log2, groups;
  float facing;              // sign of the area on the image of a face seen from outside
  float depth;               // m, of the Gaussians below the surface, times the hand's scale
  float fade_from, fade_to;  // m: apart from that depth by this much, detail begins to fade, and is gone
  float strength;            // 0..1; 0: not drawn
  float exponent;            // log2 of a ratio per step of a texel
  // relief
  const LearnedTask* learned;  // whose light falls on it; null: there is none
  const uint32_t* rises;     // as texels: four signed bytes, rise by column and row, straight, then bent
  const float* normal;       // (blocks, 3, 16) of the vertices at rest, unit
  const int32_t* nearest;    // (blocks, ANCHORS_AROUND, 16): anchors of the light around them
  const int32_t* beside;     // (blocks, ANCHORS_AROUND, 16): rows of Gaussians there
  const float* share;        // (blocks, ANCHORS_AROUND, 16)
  const float* bend;         // (16 blocks): 0 straight to 1 bent
  float* slope;              // (4, 16 blocks): how their light turns with the normal, in the camera's axes; along it
  float rise;                // m per side of the square, of a step, times the hand's scale; 0: not drawn
};

// Mirrored field by field in native/detail_task.py.
struct DetailTask {
  const DetailHand* hands;
  float* picture;  // (5, H, W) premultiplied R G B, alpha, sum of weight * z
  int32_t* hit;    // (H, W) row of the nearest face of the first hand, -1: none; null where colors are wanted
  float* hit_near; // (H, W)
  double camera_from_position[12];
  float fx, fy, cx, cy, z_near;
  float alpha_from, alpha_to;  // detail fades in between them: at the outline there is none
  float graze_max;             // lengths along a ray that grazes the surface are longer by this factor at most
  int32_t hand_count, width, height, orthographic;
};

namespace {

constexpr int PARTS = 32;            // items per hand of the steps over vertices and faces
constexpr int TILE_X = 64, TILE_Y = 32;
constexpr float EDGE_PX = 1.f / 512;  // faces reach so much farther: no gaps between neighbors
constexpr float AREA_MIN_PX2 = 1e-9f;
constexpr int FACE_BITS = 20;        // of a number of a face; the hand's stands above
constexpr int SMALLEST_LOG2 = 2;      // the last level has 4 x 4 texels
constexpr float MIX_FROM = 0.25f, MIX_TO = 0.75f;  // of the way from one level to the next: between them both are mixed
constexpr float TEXEL_ZERO = 512;
constexpr int TEXEL_BITS = 10;

// rows of a face: its first corner; corners' shares 1 and 2 by x and y; the constants of all three; planes of near and
// of the texture's column and row, each at the corner, by x, by y. Of relief: planes of the light's change with a rise by
// column and by row, of its change along the normal, and of the bend; squares of what a rise by column and row tilts
enum {
  X, Y, S1X, S1Y, S2X, S2Y, S0, S1, S2, NEAR, NEAR_X, NEAR_Y, U, U_X, U_Y, V, V_X, V_Y,
  BY_U, BY_U_X, BY_U_Y, BY_V, BY_V_X, BY_V_Y, ALONG, ALONG_X, ALONG_Y, BEND, BEND_X, BEND_Y, UU, UV, VV, FACE_ROWS
};
constexpr float LIGHT_LEAST = 0.4f, LIGHT_MOST = 2.5f;  // of what relief makes of light: a slope is no first order there

JG_INLINE vi gather_bits(const void* p, vi index) { return bits_of(gather((const float*)p, index)); }
JG_INLINE vi least(vi a, vi b) { return a < b ? a : b; }
JG_INLINE vi most(vi a, vi b) { return a > b ? a : b; }

void skin_vertices(const DetailTask& t, const DetailHand& hand, int32_t block) {
  const LearnedTask& surface = *hand.surface;
  const SkinTask& s = surface.skin;
  vf m[MAP_ENTRIES], p[3], turn[9];
  blend(s, block, m);
  posed_center(s, block, m, p);
  const bool moves = surface.correctives == LINEAR;
  if (moves || hand.rise > 0) turning(s, surface.volume_min, m, volume(s, m), turn);
  if (moves) {
    vf correction[CORRECTION], moved[3];
    linear_correction(surface, block, correction);
    turn_by(turn, correction, moved);
    for (int i = 0; i < 3; i++) p[i] += moved[i] * s.scale;
  }
  for (int i = 0; i < 3; i++) p[i] += s.shift[i];
  const vf z = to_camera(t.camera_from_position + 8, p[0], p[1], p[2]);
  const vf iz = t.orthographic ? all(1.f) : 1.f / z;
  const vf x = to_camera(t.camera_from_position, p[0], p[1], p[2]) * iz * t.fx + t.cx;
  const vf y = to_camera(t.camera_from_position + 4, p[0], p[1], p[2]) * iz * t.fy + t.cy;
  const int64_t rows = LANES * (int64_t)s.blocks, row = LANES * (int64_t)block;
  // a face with a corner that is no number is not drawn
  store(hand.vertex + row, select(z > t.z_near, x, all(__builtin_nanf(""))));
  store(hand.vertex + rows + row, y);
  store(hand.vertex + 2 * rows + row, t.orthographic ? -z : iz);
  if (!(hand.rise > 0)) return;
  const float* at_rest = hand.normal + 3 * row;
  vf n[3], slope[3];
  for (int i = 0; i < 3; i++) n[i] = load(at_rest + LANES * i), p[i] -= s.shift[i];
  vf normal[3];
  turn_by(turn, n, normal);
  make_unit(normal, surface.length2_min);
  const int64_t around = ANCHORS_AROUND * row;
  light_slope(*hand.learned, hand.nearest + around, hand.beside + around, hand.share + around, p, normal, slope);
  for (int i = 0; i < 3; i++) {
    const double* axis = t.camera_from_position + 4 * i;
    store(hand.slope + i * rows + row, slope[0] * (float)axis[0] + slope[1] * (float)axis[1] + slope[2] * (float)axis[2]);
  }
  store(hand.slope + 3 * rows + row, dot(slope, normal));
}

// Pixels whose centers lie from `low` to `high`, as far as the image reaches.
JG_INLINE void centers(vf low, vf high, int32_t size, vi& first, vi& last) {
  const vf limit = all((float)size);
  first = -floor_to_int(-min(max(low - 0.5f - EDGE_PX, vf{}), limit));
  last = floor_to_int(min(max(high - 0.5f + EDGE_PX, all(-1.f)), limit - 1.f));
}

struct Plane {
  vf x, y;
};
// How what is a at the first corner and da more at the others changes along the image.
JG_INLINE Plane slope(vf da1, vf da2, const vf face[FACE_ROWS]) {
  return {da1 * face[S1X] + da2 * face[S2X], da1 * face[S1Y] + da2 * face[S2Y]};
}

// What a rise of the relief does to light. Affine on the image: faces are small.
void relief_of_group(const DetailTask& t, const DetailHand& hand, int32_t group, const vf x[3], const vf y[3],
                     const vf near[3], vf face[FACE_ROWS]) {
  const int64_t rows = LANES * (int64_t)hand.surface->skin.blocks;
  const float* uv = hand.corner_uv + 6 * LANES * (int64_t)group;
  vf p[3][3], side[2][3], du[2], dv[2], by_u[3], by_v[3], along[3], bend[3];
  for (int k = 0; k < 3; k++) {
    const vf z = t.orthographic ? -near[k] : 1.f / near[k], over = t.orthographic ? all(1.f) : z;
    p[k][0] = (x[k] - t.cx) * over * (1.f / t.fx), p[k][1] = (y[k] - t.cy) * over * (1.f / t.fy), p[k][2] = z;
  }
  for (int k = 0; k < 2; k++) {
    for (int i = 0; i < 3; i++) side[k][i] = p[k + 1][i] - p[0][i];
    du[k] = load(uv + LANES * 2 * (k + 1)) - load(uv), dv[k] = load(uv + LANES * (2 * (k + 1) + 1)) - load(uv + LANES);
  }
  // along the skin, how column and row grow per meter: by the metric of the sides
  const vf g00 = dot(side[0], side[0]), g01 = dot(side[0], side[1]), g11 = dot(side[1], side[1]);
  const vf det = g00 * g11 - g01 * g01, inverse = select(det > 0, 1.f / det, vf{});
  vf u[3], v[3];
  for (int i = 0; i < 3; i++) {
    const vf first = (g11 * side[0][i] - g01 * side[1][i]) * inverse, second = (g00 * side[1][i] - g01 * side[0][i]) * inverse;
    u[i] = du[0] * first + du[1] * second, v[i] = dv[0] * first + dv[1] * second;
  }
  face[UU] = dot(u, u), face[UV] = dot(u, v), face[VV] = dot(v, v);
  for (int k = 0; k < 3; k++) {
    vi row;
    memcpy(&row, hand.corner + (3 * (int64_t)group + k) * LANES, sizeof row);
    vf slope[3];
    for (int i = 0; i < 3; i++) slope[i] = gather(hand.slope + i * rows, row);
    by_u[k] = dot(slope, u), by_v[k] = dot(slope, v);
    along[k] = gather(hand.slope + 3 * rows, row), bend[k] = gather(hand.bend, row);
  }
  const auto plane = [&](int at, const vf value[3]) __attribute__((always_inline)) {
    const Plane d = slope(value[1] - value[0], value[2] - value[0], face);
    face[at] = value[0], face[at + 1] = d.x, face[at + 2] = d.y;
  };
  plane(BY_U, by_u), plane(BY_V, by_v), plane(ALONG, along), plane(BEND, bend);
}

void set_up_group(const DetailTask& t, const DetailHand& hand, int32_t group) {
  const int64_t rows = LANES * (int64_t)hand.surface->skin.blocks;
  const float* uv = hand.corner_uv + 6 * LANES * (int64_t)group;
  vf x[3], y[3], near[3];
  for (int k = 0; k < 3; k++) {
    vi row;
    memcpy(&row, hand.corner + (3 * (int64_t)group + k) * LANES, sizeof row);
    x[k] = gather(hand.vertex, row), y[k] = gather(hand.vertex + rows, row), near[k] = gather(hand.vertex + 2 * rows, row);
  }
  const vf x1 = x[1] - x[0], y1 = y[1] - y[0], x2 = x[2] - x[0], y2 = y[2] - y[0], area = x1 * y2 - x2 * y1;
  vi first_x, last_x, first_y, last_y;
  centers(min(min(x[0], x[1]), x[2]), max(max(x[0], x[1]), x[2]), t.width, first_x, last_x);
  centers(min(min(y[0], y[1]), y[2]), max(max(y[0], y[1]), y[2]), t.height, first_y, last_y);
  const vi seen = (area * hand.facing > AREA_MIN_PX2) & (first_x <= last_x) & (first_y <= last_y);
  const vi nowhere = all((int32_t)INT32_MAX);
  first_x = seen ? first_x : nowhere, last_x = seen ? last_x : all(-1);
  first_y = seen ? first_y : nowhere, last_y = seen ? last_y : all(-1);
  int32_t* bounds = hand.bounds + 4 * LANES * (int64_t)group;
  store(bounds, first_x), store(bounds + LANES, last_x), store(bounds + 2 * LANES, first_y);
  store(bounds + 3 * LANES, last_y);
  int32_t box[4] = {INT32_MAX, -1, INT32_MAX, -1};
  for (int i = 0; i < LANES; i++) {
    if (bounds[i] < box[0]) box[0] = bounds[i];
    if (bounds[LANES + i] > box[1]) box[1] = bounds[LANES + i];
    if (bounds[2 * LANES + i] < box[2]) box[2] = bounds[2 * LANES + i];
    if (bounds[3 * LANES + i] > box[3]) box[3] = bounds[3 * LANES + i];
  }
  const int64_t stride = (hand.groups + LANES - 1) / LANES * LANES;
  for (int k = 0; k < 4; k++) hand.box[k * stride + group] = box[k];
  if (box[1] < 0) return;
  vf face[FACE_ROWS];
  const vf inverse = 1.f / select(seen, area, all(1.f));
  face[X] = x[0], face[Y] = y[0];
  face[S1X] = y2 * inverse, face[S1Y] = -x2 * inverse, face[S2X] = -y1 * inverse, face[S2Y] = x1 * inverse;
  const vf s0x = face[S1X] + face[S2X], s0y = face[S1Y] + face[S2Y];
  face[S0] = 1.f + EDGE_PX * sqrt(s0x * s0x + s0y * s0y);
  face[S1] = EDGE_PX * sqrt(face[S1X] * face[S1X] + face[S1Y] * face[S1Y]);
  face[S2] = EDGE_PX * sqrt(face[S2X] * face[S2X] + face[S2Y] * face[S2Y]);
  const Plane d = slope(near[1] - near[0], near[2] - near[0], face);
  face[NEAR] = near[0], face[NEAR_X] = d.x, face[NEAR_Y] = d.y;
  for (int k = 0; k < 2; k++) {
    vf w[3];
    for (int i = 0; i < 3; i++) w[i] = load(uv + LANES * (2 * i + k)) * (t.orthographic ? all(1.f) : near[i]);
    const Plane e = slope(w[1] - w[0], w[2] - w[0], face);
    face[U + 3 * k] = w[0], face[U_X + 3 * k] = e.x, face[U_Y + 3 * k] = e.y;
  }
  if (hand.rise > 0) relief_of_group(t, hand, group, x, y, near, face);
  float* out = hand.planes + FACE_ROWS * LANES * (int64_t)group;
  for (int k = 0; k < (hand.rise > 0 ? FACE_ROWS : BY_U); k++) store(out + LANES * k, face[k]);
}

// The nearest face of each pixel of a part of the image.
struct Surface {
  // with room for a vector that begins at the last column
  alignas(64) float near[TILE_Y][TILE_X + LANES];
  alignas(64) int32_t face[TILE_Y][TILE_X + LANES];  // its number and its hand's; -1: none
  int32_t x, y;
};

const vf LANE = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};

// Puts what a face covers of the tile where nothing is nearer.
JG_INLINE void cover_face(Surface& tile, const float* f, int32_t number, int32_t x0, int32_t x1, int32_t y0, int32_t y1) {
  const auto at = [f](int row) __attribute__((always_inline)) { return f[LANES * row]; };
  const float s1x = at(S1X), s1y = at(S1Y), s2x = at(S2X), s2y = at(S2Y), near_x = at(NEAR_X), near_y = at(NEAR_Y);
  const float dy = (float)(tile.y + y0) + 0.5f - at(Y);
  for (int32_t x = x0; x <= x1; x += LANES) {
    const vf dx = LANE + ((float)(tile.x + x) + 0.5f - at(X));
    vf share1 = dx * s1x + (at(S1) + dy * s1y), share2 = dx * s2x + (at(S2) + dy * s2y);
    vf share0 = (at(S0) - dy * (s1y + s2y)) - dx * (s1x + s2x), near = dx * near_x + (at(NEAR) + dy * near_y);
    for (int32_t y = y0; y <= y1; y++) {
      const vf before = load(&tile.near[y][x]);
      const vi closer = (min(min(share1, share2), share0) >= 0) & (near > before);
      vi face;
      memcpy(&face, &tile.face[y][x], sizeof face);
      store(&tile.near[y][x], select(closer, near, before));
      store(&tile.face[y][x], closer ? all(number) : face);
      share1 += s1y, share2 += s2y, share0 -= s1y + s2y, near += near_y;
    }
  }
}

// Whether anything of a hand is in the tile.
bool cover_hand(Surface& tile, const DetailHand& hand, int32_t number) {
  const int64_t stride = (hand.groups + LANES - 1) / LANES * LANES;
  const int32_t right = tile.x + TILE_X - 1, bottom = tile.y + TILE_Y - 1;
  const auto touching = [&](const int32_t* p, int64_t step) __attribute__((always_inline)) {
    vi x0, x1, y0, y1;
    memcpy(&x0, p, sizeof x0), memcpy(&x1, p + step, sizeof x1);
    memcpy(&y0, p + 2 * step, sizeof y0), memcpy(&y1, p + 3 * step, sizeof y1);
    return bit_mask((x0 <= right) & (x1 >= tile.x) & (y0 <= bottom) & (y1 >= tile.y));
  };
  bool any = false;
  for (int32_t sixteen = 0; sixteen < hand.groups; sixteen += LANES) {
    for (uint32_t groups = touching(hand.box + sixteen, stride); groups; groups &= groups - 1) {
      const int32_t group = sixteen + __builtin_ctz(groups);
      const int32_t* bounds = hand.bounds + 4 * LANES * (int64_t)group;
      for (uint32_t faces = touching(bounds, LANES); faces; faces &= faces - 1, any = true) {
        const int i = __builtin_ctz(faces);
        const int32_t x0 = bounds[i] - tile.x, x1 = bounds[LANES + i] - tile.x;
        const int32_t y0 = bounds[2 * LANES + i] - tile.y, y1 = bounds[3 * LANES + i] - tile.y;
        cover_face(tile, hand.planes + FACE_ROWS * LANES * (int64_t)group + i, number << FACE_BITS | (LANES * group + i),
                   x0 < 0 ? 0 : x0, x1 < TILE_X ? x1 : TILE_X - 1, y0 < 0 ? 0 : y0, y1 < TILE_Y ? y1 : TILE_Y - 1);
      }
    }
  }
  return any;
}

struct Color {
  vf r, g, b;
};

// Where a level of the texture lies in memory.
struct Level {
  vi size, start;
};
JG_INLINE Level level_of(int32_t size_log2, vi number) {
  // texels of the levels before it: four times what is left out of the square, over 3, which is a factor modulo 2^32
  const vi four_times = all(4 << 2 * size_log2);
  return {all(1 << size_log2) >> number, (four_times - (four_times >> 2 * number)) * all((int32_t)0xaaaaaaab)};
}
JG_INLINE vi column_of(const Level& level, vi x) {
  const vi inside = least(most(x, vi{}), level.size - 1);
  return (inside >> 2 << 4) + (inside & 3);
}
JG_INLINE vi row_of(const Level& level, vi y) {
  const vi inside = least(most(y, vi{}), level.size - 1);
  return level.start + (inside >> 2) * (level.size << 2) + ((inside & 3) << 2);
}

// The four texels around (u, v) of a level, and their shares.
struct Around {
  vi index[4];
  vf share[4];
};
JG_INLINE Around around(const Level& level, vf u, vf v) {
  const vf limit = to_float(level.size);
  // in floats first: coordinates of pixels that another hand covers may be no numbers
  const vf x = min(max(u * limit - 0.5f, all(-1.f)), limit), y = min(max(v * limit - 0.5f, all(-1.f)), limit);
  const vi x0 = floor_to_int(x), y0 = floor_to_int(y);
  const vf fx = x - to_float(x0), fy = y - to_float(y0), wx = 1.f - fx, wy = 1.f - fy;
  const vi left = column_of(level, x0), right = column_of(level, x0 + 1);
  const vi top = row_of(level, y0), bottom = row_of(level, y0 + 1);
  return {{top + left, top + right, bottom + left, bottom + right}, {wx * wy, fx * wy, wx * fy, fx * fy}};
}

// The texture there, in steps of a texel.
JG_INLINE Color look_up(const DetailHand& hand, const Around& near) {
  Color out = {};
  for (int k = 0; k < 4; k++) {
    const vi texel = gather_bits(hand.texels, near.index[k]), mask = all((1 << TEXEL_BITS) - 1);
    out.r += near.share[k] * to_float(texel & mask);
    out.g += near.share[k] * to_float((texel >> TEXEL_BITS) & mask);
    out.b += near.share[k] * to_float((texel >> (2 * TEXEL_BITS)) & mask);
  }
  return out;
}

// The relief's rises there, by column and row, in steps.
JG_INLINE void rises_at(const DetailHand& hand, const Around& near, vf bend, vf out[2]) {
  vf four[4] = {};
  const bool is_bent = bit_mask(bend > 0);
  for (int k = 0; k < 4; k++) {
    const vi texel = gather_bits(hand.rises, near.index[k]);
    const auto add = [&](int byte) __attribute__((always_inline)) {
      four[byte] += near.share[k] * to_float((texel << (24 - 8 * byte)) >> 24);
    };
    add(0), add(1);
    if (is_bent) add(2), add(3);
  }
  for (int i = 0; i < 2; i++) out[i] = is_bent ? four[i] + bend * (four[2 + i] - four[i]) : four[i];
}

// 1 from `full` on, 0 up to `none`, smooth between.
JG_INLINE vf smooth(vf x, float none, float full) {
  const vf s = min(max((x - none) * (1.f / (full - none)), vf{}), all(1.f));
  return s * s * (3.f - 2.f * s);
}

// What is interpolated on a face, at sixteen pixels: itself, and its change by x and by y.
struct Interpolated {
  vf at, x, y;
};

// Sets it in the lanes `mine` to that of one face, `row` of its planes; the pixels lie (dx, dy) from its first corner.
JG_INLINE void interpolate(Interpolated& i, vi mine, const float* face, int row, vf dx, float dy) {
  const float x = face[LANES * (row + 1)], y = face[LANES * (row + 2)];
  i.at = select(mine, face[LANES * row] + dx * x + dy * y, i.at);
  i.x = select(mine, all(x), i.x), i.y = select(mine, all(y), i.y);
}

// The level for texels of which a pixel spans the root of spans2, and the part of the next one.
struct Chosen {
  vi fine;
  vf part;
};
JG_INLINE Chosen level_for(vf spans2, vi mine, int32_t last) {
  if (!bit_mask(mine & (spans2 > 1.f))) return {};
  const vf wanted = min(max(0.5f * log2(spans2), vf{}), all((float)last));
  const vi fine = floor_to_int(wanted);
  return {fine, min(max((wanted - to_float(fine) - MIX_FROM) * (1.f / (MIX_TO - MIX_FROM)), vf{}), all(1.f))};
}

// What of a face's relief counts at sixteen pixels.
struct ReliefAt {
  vf by_u, by_v, along, bend, uu, uv, vv;
};
JG_INLINE void interpolate(ReliefAt& r, vi mine, const float* face, vf dx, float dy) {
  const auto plane = [&](vf& at, int row) __attribute__((always_inline)) {
    const float *f = face + LANES * row;
    at = select(mine, f[0] + dx * f[LANES] + dy * f[2 * LANES], at);
  };
  plane(r.by_u, BY_U), plane(r.by_v, BY_V), plane(r.along, ALONG), plane(r.bend, BEND);
  r.uu = select(mine, all(face[LANES * UU]), r.uu), r.uv = select(mine, all(face[LANES * UV]), r.uv);
  r.vv = select(mine, all(face[LANES * VV]), r.vv);
}

// How much more light skin of the relief's slope gets than the surface: with the slope of the light q, normals n and n',
// 1 + q.(n' - n). rise: by column and row, in steps
JG_INLINE vf relief_light(const DetailHand& hand, const ReliefAt& r, const vf rise[2]) {
  const vf du = rise[0] * hand.rise, dv = rise[1] * hand.rise;
  const vf steep2 = du * du * r.uu + 2.f * du * dv * r.uv + dv * dv * r.vv;
  const vf light = 1.f - r.along + (r.along - du * r.by_u - dv * r.by_v) * inverse_sqrt(1.f + steep2);
  return min(max(light, all(LIGHT_LEAST)), all(LIGHT_MOST));
}

// What the colors of sixteen pixels of a row are multiplied by, where the face of `mine` is the nearest.
JG_INLINE Color ratios(const DetailTask& t, const DetailHand& hand, vi face, vi mine, vf x, float y, vf alpha, vf depth) {
  Interpolated n = {all(1.f), vf{}, vf{}}, iu = {}, iv = {};
  ReliefAt relief = {};
  // few faces share sixteen pixels
  for (uint32_t rest = bit_mask(mine); rest;) {
    const int32_t number = face[__builtin_ctz(rest)], place = number & ((1 << FACE_BITS) - 1);
    const float* f = hand.planes + (int64_t)FACE_ROWS * LANES * (place / LANES) + place % LANES;
    const vi same = face == all(number);
    const vf dx = x - f[LANES * X];
    const float dy = y - f[LANES * Y];
    interpolate(n, same, f, NEAR, dx, dy), interpolate(iu, same, f, U, dx, dy), interpolate(iv, same, f, V, dx, dy);
    if (hand.rise > 0) interpolate(relief, same, f, dx, dy);
    rest &= ~bit_mask(same);
  }
  const vf z = t.orthographic ? -n.at : 1.f / n.at, over = t.orthographic ? all(1.f) : z;
  // what lies below a surface is farther along a ray that grazes it
  const vf slope_x = n.x * t.fx * over, slope_y = n.y * t.fy * over;
  const vf graze = min(sqrt(1.f + slope_x * slope_x + slope_y * slope_y), all(t.graze_max));
  const vf apart = abs(depth - z - hand.depth) / graze;
  vf weight = smooth(alpha, t.alpha_from, t.alpha_to) * (1.f - smooth(apart, hand.fade_from, hand.fade_to));
  weight = select(mine & (apart < hand.fade_to), weight, vf{}) * hand.strength;
  if (!bit_mask(weight > 0)) return {all(1.f), all(1.f), all(1.f)};
  const vf u = iu.at * over, v = iv.at * over;
  // how many texels a pixel spans: the mean square of its two sides
  const vf turn = t.orthographic ? vf{} : all(1.f), nu = u * turn, nv = v * turn;
  const vf ux = iu.x - nu * n.x, uy = iu.y - nu * n.y, vx = iv.x - nv * n.x, vy = iv.y - nv * n.y;
  const float size = (float)(1 << hand.size_log2);
  const int32_t last = hand.size_log2 - SMALLEST_LOG2;
  const vf spans2 = (ux * ux + uy * uy + vx * vx + vy * vy) * over * over * (0.5f * size * size);
  const Chosen chosen = level_for(spans2, mine, last);
  const Level level = level_of(hand.size_log2, chosen.fine);
  // texels of the pixels two rows farther down are on their way when those have their turn
  const vf far = over * 2.f, limit = to_float(level.size);
  const vf x_far = min(max((u + uy * far) * limit, vf{}), limit), y_far = min(max((v + vy * far) * limit, vf{}), limit);
  const vi ahead = column_of(level, floor_to_int(x_far)) + row_of(level, floor_to_int(y_far));
  for (int lane = 0; lane < LANES; lane += 3) __builtin_prefetch(hand.texels + ahead[lane]);
  const Around near = around(level, u, v);
  Color texel = look_up(hand, near);
  vf rise[2];
  if (hand.rise > 0) rises_at(hand, near, relief.bend, rise);
  const vf part = chosen.part;
  if (bit_mask(mine & (part > 0))) {
    const Around next = around(level_of(hand.size_log2, least(chosen.fine + 1, all(last))), u, v);
    const Color other = look_up(hand, next);
    texel.r += part * (other.r - texel.r), texel.g += part * (other.g - texel.g), texel.b += part * (other.b - texel.b);
    if (hand.rise > 0) {
      vf coarser[2];
      rises_at(hand, next, relief.bend, coarser);
      for (int i = 0; i < 2; i++) rise[i] += part * (coarser[i] - rise[i]);
    }
  }
  texel.r -= TEXEL_ZERO, texel.g -= TEXEL_ZERO, texel.b -= TEXEL_ZERO;
  const vf step = weight * hand.exponent;
  vf light = all(1.f);
  if (hand.rise > 0) light += weight * (relief_light(hand, relief, rise) - 1.f);
  return {light * exp2(step * texel.r), light * exp2(step * texel.g), light * exp2(step * texel.b)};
}

void shade_row(const DetailTask& t, const Surface& tile, int32_t row) {
  const int64_t pixels = (int64_t)t.width * t.height;
  for (int32_t x = 0; x < TILE_X && tile.x + x < t.width; x += LANES) {
    vi face;
    memcpy(&face, &tile.face[row][x], sizeof face);
    if (!bit_mask(face >= 0)) continue;
    const int32_t left = tile.x + x, n = t.width - left;
    float* p = t.picture + (int64_t)(tile.y + row) * t.width + left;
    const vf alpha = load_first(p + 3 * pixels, n), covered = max(alpha, all(t.alpha_from));
    const vf depth = load_first(p + 4 * pixels, n) / covered;
    if (!bit_mask((face >= 0) & (alpha > t.alpha_from))) continue;
    vf r = load_first(p, n), g = load_first(p + pixels, n), b = load_first(p + 2 * pixels, n);
    for (int32_t hand = 0; hand < t.hand_count; hand++) {
      const vi mine = face >> FACE_BITS == all(hand);
      if (t.hands[hand].strength == 0 || !bit_mask(mine)) continue;
      const float y = (float)(tile.y + row) + 0.5f;
      const Color ratio = ratios(t, t.hands[hand], face, mine, LANE + ((float)left + 0.5f), y, alpha, depth);
      r *= ratio.r, g *= ratio.g, b *= ratio.b;
    }
    store_first(p, r, n), store_first(p + pixels, g, n), store_first(p + 2 * pixels, b, n);
  }
}

void keep_hits(const DetailTask& t, const Surface& tile) {
  const int32_t columns = t.width - tile.x < TILE_X ? t.width - tile.x : TILE_X;
  for (int32_t y = 0; y < TILE_Y && tile.y + y < t.height; y++) {
    const int64_t first = (int64_t)(tile.y + y) * t.width + tile.x;
    memcpy(t.hit + first, tile.face[y], columns * sizeof *t.hit);
    memcpy(t.hit_near + first, tile.near[y], columns * sizeof *t.hit_near);
  }
}

void shade_tile(const DetailTask& t, int32_t item, int32_t tiles_x) {
  Surface tile;
  tile.x = item % tiles_x * TILE_X, tile.y = item / tiles_x * TILE_Y;
  const vf nothing = all(-3.0e38f);
  const vi no_face = all(-1);
  for (int y = 0; y < TILE_Y; y++)
    for (int x = 0; x < TILE_X; x += LANES) store(&tile.near[y][x], nothing), store(&tile.face[y][x], no_face);
  bool any = false;
  // one that is not drawn hides others all the same
  for (int32_t hand = 0; hand < t.hand_count; hand++) any |= cover_hand(tile, t.hands[hand], hand);
  if (t.hit) return keep_hits(t, tile);
  for (int32_t y = 0; any && y < TILE_Y && tile.y + y < t.height; y++) shade_row(t, tile, y);
}

}  // namespace
}  // namespace jg

JG_API int32_t jg_detail_hand_bytes() { return sizeof(jg::DetailHand); }
JG_API int32_t jg_detail_task_bytes() { return sizeof(jg::DetailTask); }

// Multiplies the colors of a drawn picture by detail, together with the other threads of the team.
JG_API void jg_detail(jg::Team* team, const jg::DetailTask* task) {
  const jg::DetailTask t = *task;
  const auto parts = [&](int step, auto count, auto work) {
    jg::share(*team, step, t.hand_count * jg::PARTS, [&](int32_t item) {
      const jg::DetailHand& hand = t.hands[item / jg::PARTS];
      const jg::Range range = jg::part_of(count(hand), item % jg::PARTS, jg::PARTS);
      for (int64_t i = range.begin; i < range.end; i++) work(t, hand, (int32_t)i);
    });
  };
  parts(0, [](const jg::DetailHand& hand) { return (int64_t)hand.surface->skin.blocks; }, jg::skin_vertices);
  parts(1, [](const jg::DetailHand& hand) { return (int64_t)hand.groups; }, jg::set_up_group);
  const int32_t tiles_x = (t.width + jg::TILE_X - 1) / jg::TILE_X, tiles_y = (t.height + jg::TILE_Y - 1) / jg::TILE_Y;
  jg::share(*team, 2, tiles_x * tiles_y, [&](int32_t tile) { jg::shade_tile(t, tile, tiles_x); });
}

// Its first step alone, of hands whose surface somebody else draws: the web page.
JG_API void jg_detail_vertices(const jg::DetailTask* task) {
  for (int32_t i = 0; i < task->hand_count; i++)
    for (int32_t block = 0; block < task->hands[i].surface->skin.blocks; block++)
      jg::skin_vertices(*task, task->hands[i], block);
}
