// Detail: a textured surface that follows the bones, found at each pixel, multiplies the colors of drawn Gaussians; and
// light of lamps that was drawn apart is added as far as it reaches that surface (pixel_shadow.h).
//
//   skin     vertices of all hands to pixels
//   round    of large hands vertices in the middles of sides, so that outlines have no corners
//   set up   per face the planes of what is interpolated, and what it may touch; groups of sixteen neighbors
//   surface  per tile: the nearest face of each pixel, which is told, and how near it is
//   shade    once Gaussians are blended, per tile: the texture there
//
// A surface that is where the skin is ends the hand: alpha becomes the part of a pixel that it covers. Gaussians end
// within their own width, and skin closer than that.
//
// A relief is light that falls on skin of another slope: vertices ask how the light turns with their normal, and pixels
// multiply that by how their own leans. Gloss is narrower: vertices ask for its lobe, and pixels where they are in it.
//
// What is nearer is a larger `near`, 1/z or, of parallel rays, -z: it is linear on the image, and so are the texture's
// coordinates times it (of parallel rays: by themselves).
#include "export.h"
#include "pixel_shadow.h"
#include "projection.h"
#include "team.h"

namespace jg {

namespace {

constexpr int PARTS = 32;            // items per hand of the steps over vertices and faces
constexpr float EDGE_PX = 1.f / 512;  // faces reach so much farther: no gaps between neighbors
constexpr float AREA_MIN_PX2 = 1e-9f;
constexpr int SMALLEST_LOG2 = 2;      // the last level has 4 x 4 texels
constexpr float MIX_FROM = 0.25f, MIX_TO = 0.75f;  // of the way from one level to the next: between them both are mixed
constexpr int TEXEL_BITS = 10;
constexpr float FIELD_MIDDLE = 1.5f;  // what changes nothing, see `field`
constexpr int CUT_AHEAD_PX = 8;       // so many rows before their turn alpha is fetched
constexpr float AHEAD_PX = 4;         // so many rows before their turn texels are fetched from memory
constexpr float BEFORE_LAST = 1.f + 1.f / 2048;  // texels: look-ups end so far before the end of the square, where the
                                                 // last texel counts wholly but for rounding, and one more is never read
constexpr int FLOAT_BIAS = 127, FLOAT_FRACTION_BITS = 23, FLOAT_ONE = FLOAT_BIAS << FLOAT_FRACTION_BITS;
constexpr int PICTURE_PLANES = 5, ALPHA = 3, DEPTH = 4;
constexpr float FILLED_FROM = 1.f / 64;  // alpha from which on a pixel is the hand's wholly: enough to know its color
constexpr float CAP_SOFT = 0.2f;  // part of a cap's height over which it ends while it comes into sight
constexpr float SHARPER = 4.f;  // how much more is shown of what fades where a cap closes it, which begins there
constexpr float LIGHT_LEAST = 0.4f, LIGHT_MOST = 2.5f;  // of what relief makes of light: a slope is no first order there

JG_INLINE vi to_int(vf x) { return __builtin_convertvector(x, vi); }
JG_INLINE vi least(vi a, vi b) { return a < b ? a : b; }

// Stores what points along v in the camera's axes, rows apart.
JG_INLINE void store_in_camera(const DetailTask& t, const vf v[3], float* out, int64_t rows) {
  for (int i = 0; i < 3; i++) {
    const double* axis = t.camera_from_position + 4 * i;
    store(out + i * rows, v[0] * (float)axis[0] + v[1] * (float)axis[1] + v[2] * (float)axis[2]);
  }
}

void skin_vertices(const DetailTask& t, const DetailHand& hand, int32_t block) {
  const LearnedTask& surface = *hand.surface;
  const SkinTask& s = surface.skin;
  vf m[MAP_ENTRIES], p[3], turn[9];
  blend(s, block, m);
  posed_center(s, block, m, p);
  const bool moves = surface.correctives == LINEAR;
  if (moves || hand.rise > 0 || t.layers) turning(s, surface.volume_min, m, volume(s, m), turn);
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
  const int64_t rows = rows_of(hand), row = LANES * (int64_t)block;
  // a face with a corner that is no number is not drawn
  store(hand.vertex + row, select(z > t.z_near, x, all(__builtin_nanf(""))));
  store(hand.vertex + rows + row, y);
  store(hand.vertex + 2 * rows + row, t.orthographic ? -z : iz);
  if (!(hand.rise > 0) && !t.layers) return;
  const float* at_rest = hand.normal + 3 * row;
  vf n[3], slope[3];
  for (int i = 0; i < 3; i++) n[i] = load(at_rest + LANES * i), p[i] -= s.shift[i];
  vf normal[3];
  turn_by(turn, n, normal);
  make_unit(normal, surface.length2_min);
  if (t.layers) store_in_camera(t, normal, hand.turned + row, rows);
  if (!(hand.rise > 0)) return;
  const int64_t around = ANCHORS_AROUND * row;
  GlossLobe gloss = {};
  const bool is_glossy = hand.gloss && hand.learned->scene;
  light_slope(*hand.learned, hand.nearest + around, hand.beside + around, hand.share + around, p, normal, slope,
              is_glossy ? &gloss : nullptr);
  store_in_camera(t, slope, hand.slope + row, rows);
  store(hand.slope + 3 * rows + row, dot(slope, normal));
  if (!hand.gloss) return;
  store_in_camera(t, gloss.way, hand.gloss + row, rows);
  store(hand.gloss + 3 * rows + row, gloss.width2), store(hand.gloss + 4 * rows + row, gloss.part);
}

// Puts vertices into the middles of sides, on a smooth surface through those around: render/fine_faces.py.
void round_sides(const DetailTask& t, const DetailHand& hand, int32_t block) {
  const int64_t rows = rows_of(hand), row = LANES * (int64_t)(hand.surface->skin.blocks + block);
  vi from[AROUND_SIDE];
  memcpy(from, hand.around + AROUND_SIDE * LANES * (int64_t)block, sizeof from);
  const float* shares = hand.side_share + AROUND_SIDE * LANES * (int64_t)block;
  vf x{}, y{}, z{};
  for (int k = 0; k < AROUND_SIDE; k++) {
    const vf near = gather(hand.vertex + 2 * rows, from[k]), away = t.orthographic ? -near : 1.f / near;
    const vf own = load(shares + LANES * k), share = own * (t.orthographic ? all(1.f) : away);
    x += share * (gather(hand.vertex, from[k]) - t.cx), y += share * (gather(hand.vertex + rows, from[k]) - t.cy);
    z += own * away;
  }
  const vf iz = t.orthographic ? all(1.f) : 1.f / z;
  store(hand.vertex + row, select(z > t.z_near, x * iz + t.cx, all(__builtin_nanf(""))));
  store(hand.vertex + rows + row, y * iz + t.cy);
  store(hand.vertex + 2 * rows + row, t.orthographic ? -z : iz);
  const auto mean = [&](float* p) { store(p + row, 0.5f * (gather(p, from[0]) + gather(p, from[1]))); };
  for (int i = 0; t.layers && i < 3; i++) mean(hand.turned + i * rows);
  if (!(hand.rise > 0)) return;
  for (int i = 0; i < 4; i++) mean(hand.slope + i * rows);
  for (int i = 0; i < 5; i++) mean(hand.gloss + i * rows);
  mean(hand.bend);
}

// Pixels whose centers lie from `low` to `high`, as far as the image reaches.
JG_INLINE void centers(vf low, vf high, int32_t size, vi& first, vi& last) {
  const vf limit = all((float)size);
  first = -floor_to_int(-min(max(low - 0.5f - EDGE_PX, vf{}), limit));
  last = floor_to_int(min(max(high - 0.5f + EDGE_PX, all(-1.f)), limit - 1.f));
}

// Sixteen faces while they are set up: what is kept of each, in rows; and by how much shares of the second and the third
// corner change by x and by y.
struct Faces {
  vf at[LANES], by_x[LANES], by_y[LANES];
  vf share_x[2], share_y[2];
};

// Sets what has these values at the corners.
JG_INLINE void set_plane(Faces& faces, int plane, const vf corner[3]) {
  const vf second = corner[1] - corner[0], third = corner[2] - corner[0];
  faces.at[plane] = corner[0];
  faces.by_x[plane] = second * faces.share_x[0] + third * faces.share_x[1];
  faces.by_y[plane] = second * faces.share_y[0] + third * faces.share_y[1];
}

// What a rise of the relief does to light. Affine on the image: faces are small.
void relief_of_group(const DetailTask& t, const DetailHand& hand, int32_t group, const vf x[3], const vf y[3],
                     const vf near[3], Faces& faces) {
  const int64_t rows = rows_of(hand);
  const float* uv = hand.corner_uv + 6 * LANES * (int64_t)group;
  vf p[3][3], side[2][3], du[2], dv[2], turn[2][3], along[3], bend[3], way[2][3], part[3], width2 = {};
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
  // axes on the face, the first along u
  vf axis[2][3];
  const auto unit_of = [](const vf vector[3], vf out[3]) __attribute__((always_inline)) {
    const vf length2 = dot(vector, vector), shorter = select(length2 > 0, inverse_sqrt(length2), vf{});
    for (int i = 0; i < 3; i++) out[i] = vector[i] * shorter;
  };
  unit_of(u, axis[0]);
  const vf aside = dot(v, axis[0]);
  for (int i = 0; i < 3; i++) axis[1][i] = v[i] - aside * axis[0][i];
  unit_of(axis[1], axis[1]);
  for (int k = 0; k < 3; k++) {
    vi row;
    memcpy(&row, hand.corner + (3 * (int64_t)group + k) * LANES, sizeof row);
    const auto along_axes = [&](const float* vectors, vf out[2][3]) __attribute__((always_inline)) {
      vf vector[3];
      for (int i = 0; i < 3; i++) vector[i] = gather(vectors + i * rows, row);
      for (int a = 0; a < 2; a++) out[a][k] = dot(vector, axis[a]);
    };
    along_axes(hand.slope, turn), along_axes(hand.gloss, way);
    width2 += (1.f / 3) * gather(hand.gloss + 3 * rows, row), part[k] = gather(hand.gloss + 4 * rows, row);
    along[k] = gather(hand.slope + 3 * rows, row), bend[k] = gather(hand.bend, row);
  }
  for (int a = 0; a < 2; a++) set_plane(faces, TURN_0 + a, turn[a]), set_plane(faces, WAY_0 + a, way[a]);
  set_plane(faces, ALONG, along), set_plane(faces, BEND, bend), set_plane(faces, PART, part);
  faces.by_x[X] = dot(u, axis[0]), faces.by_x[Y] = aside, faces.by_y[X] = dot(v, axis[1]), faces.by_y[Y] = width2;
}

void set_up_group(const DetailTask& t, const DetailHand& hand, int32_t group) {
  const int64_t rows = rows_of(hand);
  const float* uv = hand.corner_uv + 6 * LANES * (int64_t)group;
  vf x[3], y[3], near[3];
  vi row_of_corner[3];
  for (int k = 0; k < 3; k++) {
    vi& row = row_of_corner[k];
    memcpy(&row, hand.corner + (3 * (int64_t)group + k) * LANES, sizeof row);
    x[k] = gather(hand.vertex, row), y[k] = gather(hand.vertex + rows, row), near[k] = gather(hand.vertex + 2 * rows, row);
  }
  const vf x1 = x[1] - x[0], y1 = y[1] - y[0], x2 = x[2] - x[0], y2 = y[2] - y[0], area = x1 * y2 - x2 * y1;
  vi first_x, last_x, first_y, last_y;
  centers(min(min(x[0], x[1]), x[2]), max(max(x[0], x[1]), x[2]), t.width, first_x, last_x);
  centers(min(min(y[0], y[1]), y[2]), max(max(y[0], y[1]), y[2]), t.height, first_y, last_y);
  vi seen = (hand.facing == 0 ? abs(area) : area * hand.facing) > AREA_MIN_PX2, kind = all(0);
  if (t.outline > 0) {
    // a pixel whose center it does not reach may be covered in part
    seen &= (max(max(x[0], x[1]), x[2]) >= 0) & (min(min(x[0], x[1]), x[2]) <= (float)t.width);
    seen &= (max(max(y[0], y[1]), y[2]) >= 0) & (min(min(y[0], y[1]), y[2]) <= (float)t.height);
  } else {
    seen &= (first_x <= last_x) & (first_y <= last_y);
  }
  vf whole[3];
  for (int k = 0; k < 3; k++) whole[k] = gather(hand.whole, row_of_corner[k]);
  const vi is_cap = whole[0] < 0;
  // a cap that is not there hides nothing behind it
  if (hand.cap == 0) seen &= ~is_cap;
  // and skin that fades stands in no lamp's light: its ragged end would be seen on the cap
  if (hand.facing == 0) seen &= is_cap | (min(min(whole[0], whole[1]), whole[2]) == 1);
  const int32_t stride = groups_stride(hand.groups);
  if (!bit_mask(seen)) {
    hand.box[group] = INT32_MAX, hand.box[stride + group] = -1;
    return;
  }
  if (t.outline > 0) {
    kind = min(min(whole[0], whole[1]), whole[2]) < 1 ? all(FADES) : all(0);
    kind |= is_cap & CAP;
    for (int k = 0; k < 3; k++) {
      vi across;
      memcpy(&across, hand.opposite + (3 * (int64_t)group + k) * LANES, sizeof across);
      const int next = (k + 1) % 3;
      const vf dx = gather(hand.vertex, across) - x[k], dy = gather(hand.vertex + rows, across) - y[k];
      const vf beyond = dx * (y[next] - y[k]) - (x[next] - x[k]) * dy;
      kind |= ~((beyond > 0) & (area > 0)) & ~((beyond < 0) & (area < 0)) & (1 << k);
    }
  }
  const vi nowhere = all((int32_t)INT32_MAX);
  first_x = seen ? first_x : nowhere, last_x = seen ? last_x : all(-1);
  first_y = seen ? first_y : nowhere, last_y = seen ? last_y : all(-1);
  int32_t* bounds = hand.bounds + BOUNDS * LANES * (int64_t)group;
  store(bounds, first_x), store(bounds + LANES, last_x), store(bounds + 2 * LANES, first_y);
  store(bounds + 3 * LANES, last_y), store(bounds + FACE_KIND * LANES, kind);
  int32_t box[4] = {INT32_MAX, -1, INT32_MAX, -1};
  for (int i = 0; i < LANES; i++) {
    if (bounds[i] < box[0]) box[0] = bounds[i];
    if (bounds[LANES + i] > box[1]) box[1] = bounds[LANES + i];
    if (bounds[2 * LANES + i] < box[2]) box[2] = bounds[2 * LANES + i];
    if (bounds[3 * LANES + i] > box[3]) box[3] = bounds[3 * LANES + i];
  }
  for (int k = 0; k < 4; k++) hand.box[k * stride + group] = box[k];
  Faces faces = {};
  const vf inverse = 1.f / select(seen, area, all(1.f));
  faces.share_x[0] = y2 * inverse, faces.share_y[0] = -x2 * inverse;
  faces.share_x[1] = -y1 * inverse, faces.share_y[1] = x1 * inverse;
  const vf corner_share[3][3] = {{all(1.f), vf{}, vf{}}, {vf{}, all(1.f), vf{}}, {vf{}, vf{}, all(1.f)}};
  for (int k = 0; k < 3; k++) {
    const int plane = SHARE_0 + k;
    set_plane(faces, plane, corner_share[k]);
    const vf by_x = faces.by_x[plane], by_y = faces.by_y[plane];
    faces.at[plane] += EDGE_PX * sqrt(by_x * by_x + by_y * by_y);
  }
  faces.at[X] = x[0], faces.at[Y] = y[0];
  set_plane(faces, NEAR, near), set_plane(faces, WHOLE, whole);
  for (int k = 0; k < 2; k++) {
    vf w[3];
    for (int i = 0; i < 3; i++) w[i] = load(uv + LANES * (2 * i + k)) * (t.orthographic ? all(1.f) : near[i]);
    set_plane(faces, U + k, w);
  }
  if (hand.rise > 0) relief_of_group(t, hand, group, x, y, near, faces);
  transpose(faces.at), transpose(faces.by_x), transpose(faces.by_y);
  float* out = hand.planes + FACE_NUMBERS * LANES * (int64_t)group;
  for (int i = 0; i < LANES; i++, out += FACE_NUMBERS)
    store(out, faces.at[i]), store(out + BY_X, faces.by_x[i]), store(out + BY_Y, faces.by_y[i]);
}

// Sets up sixteen groups, and the box around them.
void set_up_sixteen(const DetailTask& t, const DetailHand& hand, int32_t sixteen) {
  const int32_t first = LANES * sixteen, stride = groups_stride(hand.groups);
  for (int32_t group = first; group < first + LANES && group < hand.groups; group++) set_up_group(t, hand, group);
  for (int k = 0; k < 4; k++) {
    const int32_t* of_group = hand.box + k * stride + first;
    int32_t bound = of_group[0];
    for (int i = 1; i < LANES; i++) bound = (of_group[i] < bound) == (k % 2 == 0) ? of_group[i] : bound;
    hand.wide_box[k * groups_stride(stride / LANES) + sixteen] = bound;
  }
}

// Where a level of the texture lies in memory.
struct Level {
  vi size_log2, start;
};
JG_INLINE Level level_of(int32_t size_log2, vi number) {
  // texels of the levels before it: four times what is left out of the square, over 3, which is a factor modulo 2^32
  const vi four_times = all(4 << 2 * size_log2);
  return {all(size_log2) - number, (four_times - (four_times >> 2 * number)) * all((int32_t)0xaaaaaaab)};
}
JG_INLINE vf size_of(const Level& level) { return float_of((level.size_log2 + FLOAT_BIAS) << FLOAT_FRACTION_BITS); }
JG_INLINE vi column_of(vi x) { return (x & ~3) << 2 | (x & 3); }
JG_INLINE vi row_of(const Level& level, vi y) {
  return level.start + ((y & ~3) << level.size_log2) + ((y & 3) << 2);
}

// The texture, and the relief's rises by column and row, straight, then bent: each 1 to 2, as `field` has it.
enum Channel { RED, GREEN, BLUE, STRAIGHT, BENT = STRAIGHT + 2, CHANNELS = BENT + 2 };

// Bits of a texel as the fraction of a float, which is quicker than a conversion; of two's complement, the middle is 0.
template <int first, int bits, bool is_signed = false>
JG_INLINE vf field(vi texel) {
  constexpr int up = FLOAT_FRACTION_BITS - first - bits, mask = ((1 << bits) - 1) << (FLOAT_FRACTION_BITS - bits);
  constexpr int sign = is_signed ? 1 << (FLOAT_FRACTION_BITS - 1) : 0;
  return float_of(((up > 0 ? texel << (up > 0 ? up : 0) : texel >> (up > 0 ? 0 : -up)) & mask) ^ (FLOAT_ONE | sign));
}

// Texel of a level at (u, v), `before` of its sides farther to the left and up, as far as the square reaches.
struct Place {
  vf x, y;
};
JG_INLINE Place place_on(const Level& level, vf u, vf v, float before) {
  const vf size = size_of(level), last = size - BEFORE_LAST;
  // coordinates of pixels that another hand covers may be no numbers
  return {min(max(u * size - before, vf{}), last), min(max(v * size - before, vf{}), last)};
}

// Has texels around (u, v) brought from memory, those of every `step`th pixel.
template <bool has_relief, int step>
JG_INLINE void fetch_level(const uint32_t* texels, const Level& level, vf u, vf v) {
  const Place at = place_on(level, u, v, 0);
  alignas(64) int32_t index[LANES];
  store(index, row_of(level, to_int(at.y)) + column_of(to_int(at.x)));
  for (int i = 0; i < LANES; i += step) __builtin_prefetch(texels + (has_relief ? 2 : 1) * (int64_t)index[i]);
}

// Adds `part` of what a level shows at (u, v) by the four texels around it.
template <bool has_relief>
JG_INLINE void add_level(const uint32_t* texels, const Level& level, vf u, vf v, vf part, vf out[CHANNELS]) {
  const Place at = place_on(level, u, v, 0.5f);
  const vf left = floor(at.x), top = floor(at.y), fx = at.x - left, lower = (at.y - top) * part, upper = part - lower;
  const vi x0 = to_int(left), y0 = to_int(top);
  const vi column[2] = {column_of(x0), column_of(x0 + 1)}, row[2] = {row_of(level, y0), row_of(level, y0 + 1)};
  const vf share[4] = {upper - upper * fx, upper * fx, lower - lower * fx, lower * fx};
  for (int k = 0; k < 4; k++) {
    const vi index = row[k / 2] + column[k % 2];
    vi color, rises;
    if constexpr (has_relief) gather_pairs<2>(texels, index, color, rises);
    else color = gather_bits(texels, index);
    out[RED] += share[k] * field<0, TEXEL_BITS>(color);
    out[GREEN] += share[k] * field<TEXEL_BITS, TEXEL_BITS>(color);
    out[BLUE] += share[k] * field<2 * TEXEL_BITS, TEXEL_BITS>(color);
    if constexpr (!has_relief) continue;
    out[STRAIGHT] += share[k] * field<0, 8, true>(rises), out[STRAIGHT + 1] += share[k] * field<8, 8, true>(rises);
    out[BENT] += share[k] * field<16, 8, true>(rises), out[BENT + 1] += share[k] * field<24, 8, true>(rises);
  }
}

// 1 from `full` on, 0 up to `none`, smooth between.
JG_INLINE vf smooth(vf x, float none, float full) {
  const vf s = min(max((x - none) * (1.f / (full - none)), vf{}), all(1.f));
  return s * s * (3.f - 2.f * s);
}

// The level for texels of which a pixel spans the root of spans2, and the part of the next one.
struct Chosen {
  vi fine;
  vf part;
};
JG_INLINE Chosen level_for(vf spans2, int32_t last) {
  const vf wanted = min(max(0.5f * log2(spans2), vf{}), all((float)last)), fine = floor(wanted);
  return {to_int(fine), clamped((wanted - fine - MIX_FROM) * (1.f / (MIX_TO - MIX_FROM)))};
}

// What a relief makes of the color of sixteen pixels.
struct Relit {
  vf light;  // by which it is multiplied
  vf part;   // of it that is mirrored
  vf shine;  // by which that is multiplied
};

// How much more light skin of the relief's slope gets than the surface: with the slope of the light q, normals n and n',
// 1 + q.(n' - n); and how much more it mirrors. rise: by column and row, over hand.rise
JG_INLINE Relit relit(const DetailHand& hand, const Interpolated& n, const vf rise[2]) {
  const vf *at = n.at, du = rise[0] * hand.rise, dv = rise[1] * hand.rise;
  const vf tilt[2] = {du * n.of_face[0] + dv * n.of_face[1], dv * n.of_face[2]};
  const vf upright = inverse_sqrt(1.f + tilt[0] * tilt[0] + tilt[1] * tilt[1]);
  const vf light = 1.f - at[ALONG] + (at[ALONG] - tilt[0] * at[TURN_0] - tilt[1] * at[TURN_1]) * upright;
  vf before = n.of_face[3], after = before;
  for (int a = 0; a < 2; a++) {
    const vf way = at[WAY_0 + a], left = way + tilt[a] * upright;
    before += way * way, after += left * left;
  }
  const vf ratio = before * inverse(max(after, all(WIDTH2_MIN)));
  return {min(max(light, all(LIGHT_LEAST)), all(LIGHT_MOST)), max(at[PART], vf{}), ratio * ratio};
}

// How much the Gaussians at this depth are those below the face of `mine`, at sixteen pixels of a row.
JG_INLINE vf below(const DetailTask& t, const DetailHand& hand, const Interpolated& n, vi mine, vf depth) {
  const vf near = n.at[NEAR], z = t.orthographic ? -near : inverse(near), over = t.orthographic ? all(1.f) : z;
  // what lies below a surface is farther along a ray that grazes it
  const vf slope_x = n.by_x[NEAR] * t.fx * over, slope_y = n.by_y[NEAR] * t.fy * over;
  const vf upright = max(inverse_sqrt(1.f + slope_x * slope_x + slope_y * slope_y), all(1.f / t.graze_max));
  const vf apart = abs(depth - z - hand.depth) * upright;
  return select(mine & (apart < hand.fade_to), 1.f - smooth(apart, hand.fade_from, hand.fade_to), vf{});
}

// Multiplies the colors of sixteen pixels of a row. skin: how much they are those of what is below their faces
template <bool has_relief>
JG_INLINE void shade(const DetailTask& t, const DetailHand& hand, const Interpolated& n, vi mine, vf alpha, vf skin,
                     vf color[3]) {
  const vf weight = smooth(alpha, t.alpha_from, t.alpha_to) * skin * hand.strength;
  if (!bit_mask(weight > 0)) return;
  const vf near = n.at[NEAR], z = t.orthographic ? -near : inverse(near), over = t.orthographic ? all(1.f) : z;
  const vf u = n.at[U] * over, v = n.at[V] * over;
  // how many texels a pixel spans: the mean square of its two sides
  const vf turn = t.orthographic ? vf{} : all(1.f), nu = u * turn, nv = v * turn;
  const vf ux = n.by_x[U] - nu * n.by_x[NEAR], uy = n.by_y[U] - nu * n.by_y[NEAR];
  const vf vx = n.by_x[V] - nv * n.by_x[NEAR], vy = n.by_y[V] - nv * n.by_y[NEAR];
  const float size = (float)(1 << hand.size_log2);
  const int32_t last = hand.size_log2 - SMALLEST_LOG2;
  const vf spans2 = (ux * ux + uy * uy + vx * vx + vy * vy) * over * over * (0.5f * size * size);
  const Chosen chosen = level_for(spans2, last);
  const Level fine = level_of(hand.size_log2, chosen.fine);
  const Level coarse = level_of(hand.size_log2, least(chosen.fine + 1, all(last)));
  const vf far = over * AHEAD_PX, u_far = u + uy * far, v_far = v + vy * far;
  fetch_level<has_relief, 1>(hand.texels, fine, u_far, v_far);
  fetch_level<has_relief, 2>(hand.texels, coarse, u_far, v_far);
  vf texel[CHANNELS] = {};
  add_level<has_relief>(hand.texels, fine, u, v, 1.f - chosen.part, texel);
  if (bit_mask(mine & (chosen.part > 0))) add_level<has_relief>(hand.texels, coarse, u, v, chosen.part, texel);
  const vf exponent = weight * hand.exponent;
  for (int i = 0; i < 3; i++) color[i] = color[i] * exp2(exponent * (texel[RED + i] - FIELD_MIDDLE));
  if constexpr (has_relief) {
    vf rise[2];
    for (int i = 0; i < 2; i++)
      rise[i] = texel[STRAIGHT + i] - FIELD_MIDDLE + n.at[BEND] * (texel[BENT + i] - texel[STRAIGHT + i]);
    const Relit relief = relit(hand, n, rise);
    const vf light = 1.f + weight * (relief.light - 1.f);
    // it is taken as white: no more of it is in a color than in its least channel, so that none becomes negative
    const vf shown = luminance(color), white = min(relief.part * shown, min(min(color[0], color[1]), color[2]));
    const vf mirrored = weight * min(white * (relief.shine - relief.light), (LIGHT_MOST - relief.light) * shown);
    for (int i = 0; i < 3; i++) color[i] = color[i] * light + mirrored;
  }
}

// What of a hand is the nearest in a tile.
template <bool has_relief>
void shade_hand(const DetailTask& task, int32_t number, const Surface& tile) {
  // copies: what is written into the picture might be these numbers, as far as a compiler knows
  const DetailTask t = task;
  const DetailHand hand = t.hands[number];
  const int64_t pixels = (int64_t)t.width * t.height;
  add_layers(t, hand, number, tile);
  const Apron apron = apron_of(t);
  for (int32_t row = apron.y; row < TILE_Y - apron.y && tile.y + row < t.height; row++) {
    for (int32_t x = apron.x; x < TILE_X - apron.x && tile.x + x < t.width; x += LANES) {
      vi face;
      memcpy(&face, &tile.face[row][x], sizeof face);
      const vi mine = face >> FACE_BITS == all(number);
      if (!bit_mask(mine)) continue;
      const int32_t left = tile.x + x, n = t.width - left;
      float* p = t.picture + (int64_t)(tile.y + row) * t.width + left;
      // a tile is too narrow for what prefetches by itself
      for (int k = 0; k < PICTURE_PLANES; k++) __builtin_prefetch(p + k * pixels + 2 * (int64_t)t.width);
      const vf alpha = load_first(p + ALPHA * pixels, n);
      if (!bit_mask(mine & (alpha > (t.outline > 0 ? 0.f : t.alpha_from)))) continue;
      const Interpolated at = interpolate<has_relief>(hand, &tile.face[row][x], mine, (float)left + 0.5f,
                                                      (float)(tile.y + row) + 0.5f);
      const vf filled = min(alpha * (1.f / FILLED_FROM), all(1.f));
      const vf depth = load_first(p + DEPTH * pixels, n) * inverse(max(alpha, all(FILLED_FROM)));
      vf color[3];
      for (int k = 0; k < 3; k++) color[k] = load_first(p + k * pixels, n);
      const vf skin = below(t, hand, at, mine, depth);
      shade<has_relief>(t, hand, at, mine, alpha + t.outline * (filled - alpha), skin, color);
      if (t.outline > 0) {
        const vi solid = bits_at(tile.solid[row], x);
        // a cap comes into sight from its edge on, where it lies close to the skin; sides of others reach a little below 0
        const vf own = at.at[WHOLE], height = -1.f - own, behind = clamped(all(2.f * hand.cap));
        const vf cap = clamped((hand.cap * (1.f + CAP_SOFT) + CAP_SOFT - height) * (1.f / CAP_SOFT));
        const vf faded = clamped(own * (1.f + SHARPER * hand.cap)), with_cap = 1.f - (1.f - faded) * (1.f - behind);
        const vf at_end = select(own < -0.5f, cap, select(bits_at(tile.capped[row], x), with_cap, faded));
        const vf whole = select(solid, all(1.f), at_end);
        const vf wanted = filled * whole * covered_part(tile, row, x);
        const vf more = select(mine & (alpha > 0), 1.f + t.outline * (wanted * inverse(alpha) - 1.f), all(1.f));
        if (bit_mask(more != 1)) {
          for (int k = 0; k < 3; k++) color[k] *= more;
          store_first(p + ALPHA * pixels, min(alpha * more, all(1.f)), n);
          store_first(p + DEPTH * pixels, load_first(p + DEPTH * pixels, n) * more, n);
        }
      }
      for (int k = 0; k < 3; k++) store_first(p + k * pixels, color[k], n);
    }
  }
}

// Takes away what no surface covers.
void cut_outside(const DetailTask& t, const Surface& tile) {
  const int64_t pixels = (int64_t)t.width * t.height;
  const Apron apron = apron_of(t);
  for (int32_t row = apron.y; row < TILE_Y - apron.y && tile.y + row < t.height; row++) {
    for (int32_t x = apron.x; x < TILE_X - apron.x && tile.x + x < t.width; x += LANES) {
      vi outside = all(-1);
      if (tile.is_clear) memcpy(&outside, &tile.face[row][x], sizeof outside);
      outside = outside < 0;
      const int32_t left = tile.x + x, n = t.width - left;
      float* p = t.picture + (int64_t)(tile.y + row) * t.width + left;
      // a tile is too narrow for what prefetches by itself
      if (!bit_mask(outside)) continue;
      __builtin_prefetch(p + ALPHA * pixels + CUT_AHEAD_PX * (int64_t)t.width);
      if (!bit_mask(outside & (load_first(p + ALPHA * pixels, n) > 0))) continue;
      const vf stays = select(outside, all(1.f - t.outline), all(1.f));
      for (int k = 0; k < PICTURE_PLANES; k++)
        store_first(p + k * pixels, load_first(p + k * pixels, n) * stays, n);
    }
  }
}

JG_INLINE int32_t kind_of(const DetailTask& t, int32_t face) {
  const int32_t row = face & ((1 << FACE_BITS) - 1);
  return t.hands[face >> FACE_BITS].bounds[LANES * (BOUNDS * (row / LANES) + FACE_KIND) + row % LANES];
}

void keep_hits(const DetailTask& t, Surface& tile) {
  const int32_t columns = t.width - tile.x < TILE_X ? t.width - tile.x : TILE_X;
  for (int32_t y = 0; y < TILE_Y && tile.y + y < t.height; y++) {
    int32_t* hit = t.hit + (int64_t)(tile.y + y) * t.width + tile.x;
    float* near = t.hit_near + (int64_t)(tile.y + y) * t.near_stride + tile.x;
    if (!tile.is_clear) {
      for (int32_t x = 0; x < columns; x++) hit[x] = -1, near[x] = NOT_NEAR;
      continue;
    }
    for (int32_t x = 0; tile.fades && t.outline > 0 && x < columns; x++)
      if (tile.face[y][x] >= 0 && kind_of(t, tile.face[y][x]) & (FADES | CAP)) tile.near[y][x] = NOT_NEAR;
    memcpy(hit, tile.face[y], columns * sizeof *hit), memcpy(near, tile.near[y], columns * sizeof *near);
  }
}

// The nearest faces of a tile's pixels.
void surface_tile(const DetailTask& t, int32_t item, int32_t tiles_x) {
  Surface tile;
  tile.x = item % tiles_x * TILE_X, tile.y = item / tiles_x * TILE_Y, tile.is_clear = tile.fades = false;
  // one that is not drawn hides others all the same
  for (int32_t hand = 0; hand < t.hand_count; hand++) cover_hand(tile, t.hands[hand], hand);
  keep_hits(t, tile);
}

// Takes a tile's faces from where they were kept.
void load_hits(const DetailTask& t, Surface& tile) {
  tile.is_clear = tile.fades = false;
  const int32_t left = tile.x < 0 ? -tile.x : 0, right = t.width - tile.x < TILE_X ? t.width - tile.x : TILE_X;
  for (int32_t y = 0; y < TILE_Y; y++) {
    if (tile.y + y < 0 || tile.y + y >= t.height) continue;
    const int32_t* from = t.hit + (int64_t)(tile.y + y) * t.width + tile.x;
    for (int32_t x = left; x < right && !tile.is_clear; x++)
      if (from[x] >= 0) clear(tile);
    if (tile.is_clear) memcpy(tile.face[y] + left, from + left, (right - left) * sizeof *from);
  }
}

void shade_tile(const DetailTask& t, int32_t item, int32_t tiles_x) {
  Surface tile;
  const Apron apron = apron_of(t);
  tile.x = item % tiles_x * (TILE_X - 2 * apron.x) - apron.x, tile.y = item / tiles_x * (TILE_Y - 2 * apron.y) - apron.y;
  load_hits(t, tile);
  if (t.outline > 0) {
    for (int32_t hand = 0; hand < t.hand_count; hand++) doubt_outlines(tile, t.hands[hand]);
    for (int32_t hand = 0; tile.fades && hand < t.hand_count; hand++) mark_solid(tile, t.hands[hand]);
    for (int32_t hand = 0; tile.is_clear && hand < t.hand_count; hand++) sample_hand(tile, t.hands[hand], hand);
    cut_outside(t, tile);
  }
  for (int32_t hand = 0; tile.is_clear && hand < t.hand_count; hand++) {
    if (t.hands[hand].strength == 0) continue;
    if (t.hands[hand].learned) shade_hand<true>(t, hand, tile);
    else shade_hand<false>(t, hand, tile);
  }
}

}  // namespace
}  // namespace jg

JG_API int32_t jg_detail_hand_bytes() { return sizeof(jg::DetailHand); }
JG_API int32_t jg_detail_task_bytes() { return sizeof(jg::DetailTask); }

// Where the surfaces are in an image: what Gaussians are drawn with, and then detail. The threads of a team call it
// together.
JG_API void jg_detail_surface(jg::Team* team, const jg::DetailTask* task) {
  const jg::DetailTask t = *task;
  const auto parts = [&](int step, auto count, auto work) {
    jg::share(*team, step, t.hand_count * jg::PARTS, [&](int32_t item) {
      const jg::DetailHand& hand = t.hands[item / jg::PARTS];
      const jg::Range range = jg::part_of(count(hand), item % jg::PARTS, jg::PARTS);
      for (int64_t i = range.begin; i < range.end; i++) work(t, hand, (int32_t)i);
    });
  };
  parts(0, [](const jg::DetailHand& hand) { return (int64_t)hand.surface->skin.blocks; }, jg::skin_vertices);
  parts(1, [](const jg::DetailHand& hand) { return (int64_t)hand.side_blocks; }, jg::round_sides);
  parts(2, [](const jg::DetailHand& hand) { return jg::groups_stride(hand.groups) / jg::LANES; }, jg::set_up_sixteen);
  const int32_t tiles_x = (t.width + jg::TILE_X - 1) / jg::TILE_X, tiles_y = (t.height + jg::TILE_Y - 1) / jg::TILE_Y;
  jg::share(*team, 3, tiles_x * tiles_y, [&](int32_t tile) { jg::surface_tile(t, tile, tiles_x); });
}

// Then, of a drawn picture: adds light that was drawn apart, multiplies the colors by detail, and ends its hands.
JG_API void jg_detail(jg::Team* team, const jg::DetailTask* task) {
  const jg::DetailTask t = *task;
  const int32_t step_x = jg::TILE_X - 2 * jg::apron_of(t).x, step_y = jg::TILE_Y - 2 * jg::apron_of(t).y;
  const int32_t tiles_x = (t.width + step_x - 1) / step_x, tiles_y = (t.height + step_y - 1) / step_y;
  jg::share(*team, 4, tiles_x * tiles_y, [&](int32_t tile) { jg::shade_tile(t, tile, tiles_x); });
}

// Its first step alone, of hands whose surface somebody else draws: the web page.
JG_API void jg_detail_vertices(const jg::DetailTask* task) {
  for (int32_t i = 0; i < task->hand_count; i++)
    for (int32_t block = 0; block < task->hands[i].surface->skin.blocks; block++)
      jg::skin_vertices(*task, task->hands[i], block);
}
