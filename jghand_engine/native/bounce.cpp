// Light that skin throws onto skin, by what stands before what. Along each of SWEPT directions all anchors pass from the
// far end to the near one through a picture of the light that comes towards them: skin that faces them covers what is
// behind it with what it throws, and skin that faces the light reads it. Costs nothing per pair of anchors.
#include <math.h>

#include "export.h"
#include "scene_light.h"

namespace jg {
namespace {

typedef float v4 __attribute__((vector_size(16), may_alias));

constexpr int GRID = 96;              // texels along a side of the picture
constexpr int AROUND_HAND = 2;        // of them on each side, for what is spread over three
constexpr int DEPTHS = 2048;          // steps by which anchors are ordered: 0.1 mm of a hand with its forearm
constexpr float COVERS = 2.f;         // how often anchors cover the skin around them: gaps between them are closed
constexpr float EXTENT_MIN = 1e-6f;   // m, as a divisor

// All anchors along a direction. column, row: in texels · along: m · cosine: of skin to it · depth: steps from the far end ·
// order: from there on
struct Sweep {
  float *column, *row, *along, *cosine;
  int32_t *depth, *order;
  v4* texels;
};

int64_t sweep_floats(int32_t rows) { return 4 * GRID * GRID + 6 * (int64_t)rows; }

Sweep sweep_of(const SceneLightTask& s, int32_t rows, int32_t item) {
  float* at = s.sweeping + sweep_floats(rows) * (int64_t)item;
  const auto take = [&](int64_t count) { return at += count, at - count; };
  Sweep out;
  out.texels = (v4*)take(4 * GRID * GRID);
  out.column = take(rows), out.row = take(rows), out.along = take(rows), out.cosine = take(rows);
  out.depth = (int32_t*)take(rows), out.order = (int32_t*)take(rows);
  return out;
}

// Two unit vectors across a unit vector.
void axes_across(const float* w, float u[3], float v[3]) {
  const bool is_x = fabsf(w[0]) < 0.6f;
  const float long2 = is_x ? w[1] * w[1] + w[2] * w[2] : w[0] * w[0] + w[2] * w[2], shorter = 1.f / sqrtf(long2);
  u[0] = is_x ? 0.f : -w[2] * shorter, u[1] = is_x ? w[2] * shorter : 0.f, u[2] = (is_x ? -w[1] : w[0]) * shorter;
  v[0] = w[1] * u[2] - w[2] * u[1], v[1] = w[2] * u[0] - w[0] * u[2], v[2] = w[0] * u[1] - w[1] * u[0];
}

// The least for what is no number: joints may be anywhere.
JG_INLINE float clamped(float x, float least, float most) { return fminf(fmaxf(x, least), most); }

// Where anchors are along a direction, and their order. Texels across one.
float place(const LearnedTask& t, const float* w, Sweep& to) {
  const SceneLightTask& s = *t.scene;
  const int32_t rows = LANES * t.cast.blocks;
  float u[3], v[3];
  axes_across(w, u, v);
  vf low[3], high[3];
  for (int i = 0; i < 3; i++) low[i] = all(3e38f), high[i] = all(-3e38f);
  for (int32_t b = 0; b < t.cast.blocks; b++) {
    const float* posed = s.posed + POSED * LANES * (int64_t)b;
    vf p[3], n[3], along[3];
    for (int i = 0; i < 3; i++) p[i] = load(posed + LANES * i), n[i] = load(posed + LANES * (3 + i));
    along[0] = p[0] * u[0] + p[1] * u[1] + p[2] * u[2];
    along[1] = p[0] * v[0] + p[1] * v[1] + p[2] * v[2];
    along[2] = p[0] * w[0] + p[1] * w[1] + p[2] * w[2];
    for (int i = 0; i < 3; i++) low[i] = min(low[i], along[i]), high[i] = max(high[i], along[i]);
    store(to.column + LANES * b, along[0]), store(to.row + LANES * b, along[1]);
    store(to.along + LANES * b, along[2]);
    store(to.cosine + LANES * b, n[0] * w[0] + n[1] * w[1] + n[2] * w[2]);
  }
  float least[3], extent[3];
  for (int i = 0; i < 3; i++) {
    float most = high[i][0];
    least[i] = low[i][0];
    for (int k = 1; k < LANES; k++) least[i] = fminf(least[i], low[i][k]), most = fmaxf(most, high[i][k]);
    extent[i] = fmaxf(most - least[i], EXTENT_MIN);
  }
  const float texel_m = fmaxf(s.texel_m * t.skin.scale, fmaxf(extent[0], extent[1]) / (GRID - 2 * AROUND_HAND - 2));
  const float per_m = 1.f / texel_m, steps = (DEPTHS - 1) / extent[2];
  // whole texels, so that a hand that only moves keeps its light
  const float first[2] = {floorf(least[0] * per_m) - AROUND_HAND, floorf(least[1] * per_m) - AROUND_HAND};
  int32_t count[DEPTHS + 1] = {};
  for (int32_t i = 0; i < rows; i++) {
    to.column[i] = clamped(to.column[i] * per_m - first[0], AROUND_HAND, GRID - 1 - AROUND_HAND);
    to.row[i] = clamped(to.row[i] * per_m - first[1], AROUND_HAND, GRID - 1 - AROUND_HAND);
    to.depth[i] = DEPTHS - 1 - (int32_t)clamped((to.along[i] - least[2]) * steps, 0, DEPTHS - 1);
    count[to.depth[i] + 1]++;
  }
  for (int d = 0; d < DEPTHS; d++) count[d + 1] += count[d];
  for (int32_t i = 0; i < rows; i++) to.order[count[to.depth[i]]++] = i;
  return texel_m;
}

}  // namespace

void sweep_some(const LearnedTask& t, int32_t item, int32_t step) {
  const SceneLightTask& s = *t.scene;
  const int32_t rows = LANES * t.cast.blocks;
  Sweep at = sweep_of(s, rows, item);
  v4* caught = (v4*)s.caught + (int64_t)rows * item;
  memset(caught, 0, sizeof(v4) * (size_t)rows);
  for (int32_t k = SWEPT / SWEEPS * item; k < SWEPT / SWEEPS * (item + 1); k += step) {
    const float texels = t.skin.scale / place(t, s.swept + 3 * k, at), covers = COVERS * texels * texels;
    memset(at.texels, 0, sizeof(v4) * GRID * GRID);
    for (int32_t n = 0; n < rows; n++) {
      const int32_t i = at.order[n];
      const float cosine = at.cosine[i], x = at.column[i], y = at.row[i];
      if (cosine > 0) {
        const int32_t column = (int32_t)x, row = (int32_t)y;
        const float dx = x - column, dy = y - row;
        const v4* of = at.texels + GRID * row + column;
        const v4 light = (of[0] * (1 - dx) + of[1] * dx) * (1 - dy) + (of[GRID] * (1 - dx) + of[GRID + 1] * dx) * dy;
        caught[i] += cosine * light;
      } else if (cosine < 0) {
        const int32_t column = (int32_t)(x + 0.5f), row = (int32_t)(y + 0.5f);
        const float dx = x - column, dy = y - row, *own = s.sent + 3 * LANES * (int64_t)(i / LANES) + i % LANES;
        const v4 light = {own[0], own[LANES], own[2 * LANES], 1.f};
        const float covered = -cosine * covers * s.area[i];
        // quadratic splines
        const float across[3] = {0.5f * (0.5f - dx) * (0.5f - dx), 0.75f - dx * dx, 0.5f * (0.5f + dx) * (0.5f + dx)};
        const float down[3] = {0.5f * (0.5f - dy) * (0.5f - dy), 0.75f - dy * dy, 0.5f * (0.5f + dy) * (0.5f + dy)};
        v4* to = at.texels + GRID * (row - 1) + column - 1;
        for (int r = 0; r < 3; r++, to += GRID)
          for (int c = 0; c < 3; c++) to[c] += fminf(covered * down[r] * across[c], 1.f) * (light - to[c]);
      }
    }
  }
}

// W/m2 that sixteen anchors catch of what is thrown: where flesh is before them, skin of the mean color of all that they
// see, so that a hand throws back what it hides of an even world. step: of the directions
JG_INLINE void caught_at(const LearnedTask& t, int32_t block, int32_t step, vf out[3]) {
  const SceneLightTask& s = *t.scene;
  const int64_t rows = LANES * (int64_t)t.cast.blocks;
  const int columns = columns_of(s);
  const float *posed = s.posed + POSED * LANES * (int64_t)block, *reached = s.reached + columns * LANES * (int64_t)block;
  vf n[3], cosines = {}, sums[4];
  for (int i = 0; i < 3; i++) n[i] = load(posed + LANES * (3 + i));
  for (int k = 0; k < SWEPT; k += step) {
    const float* w = s.swept + 3 * k;
    cosines += max(n[0] * w[0] + n[1] * w[1] + n[2] * w[2], vf{});
  }
  for (int lane = 0; lane < LANES; lane++) {
    v4 sum = {};
    for (int item = 0; item < SWEEPS; item++) sum += ((const v4*)s.caught)[rows * item + LANES * (int64_t)block + lane];
    for (int i = 0; i < 4; i++) sums[i][lane] = sum[i];
  }
  const vf hidden = 1.f - load_column(reached + OF_SKY, columns);
  const vf gain = hidden / max(max(sums[3], FACED_PART_MIN * hidden * cosines), all(FACED_MIN));
  for (int i = 0; i < 3; i++) out[i] = gain * sums[i];
}

void anchor_again(const LearnedTask& t, int32_t block) {
  const SceneLightTask& s = *t.scene;
  vf caught[3];
  caught_at(t, block, AGAIN_STEP, caught);
  for (int i = 0; i < 3; i++) {
    const int64_t at = LANES * (3 * (int64_t)block + i);
    store(s.sent + at, load(s.once + at) + s.bounce[i] * caught[i]);
  }
}

void anchor_caught(const LearnedTask& t, int32_t block) {
  const SceneLightTask& s = *t.scene;
  const int columns = columns_of(s);
  vf caught[3];
  caught_at(t, block, 1, caught);
  for (int i = 0; i < 3; i++)
    store_column(s.reached + columns * LANES * (int64_t)block + OF_BOUNCED + i, columns, caught[i]);
}

}  // namespace jg

JG_API int64_t jg_sweep_floats(int32_t rows) { return jg::sweep_floats(rows); }
