// Self-shadow forward, and the finished picture: depth, visibility, RGBA.
#include "shadow.h"

#include "export.h"
#include "team.h"

namespace jg {

namespace {

// Depths of sixteen pixels relative to the origin, or SHADOW_FAR_M; those of the camera go to whoever wants them.
JG_INLINE vf depth_of(const ShadeTask& s, vf alpha, vf sum, int64_t pixel, int n) {
  const vi valid = alpha > s.alpha_min;
  const vf z = (sum - s.origin * alpha) / select(valid, alpha, all(1.f));
  if (s.depth_out) store_first(s.depth_out + pixel, select(valid, z + s.origin, vf{}), n);
  return select(valid, z, all(SHADOW_FAR_M));
}

}  // namespace

void prepare_depth(const ShadeTask& s, int y) {
  const int64_t pixels = (int64_t)s.width * s.height, row = (int64_t)y * s.width;
  const float *alpha = s.picture + 3 * pixels + row, *sum = s.picture + 4 * pixels + row;
  float* out = s.depth + (int64_t)y * s.stride;
  int32_t count = 0;
  for (int x = 0; x < s.width; x += LANES) {
    const int n = s.width - x;
    const vf a = load_first(alpha + x, n);
    const vf z = depth_of(s, a, bit_mask(a > s.alpha_min) ? load_first(sum + x, n) : vf{}, row + x, n);
    store(out + x, z);  // the lanes beyond the row are padding
    count += __builtin_popcount(bit_mask(z < SHADOW_FAR_M));
  }
  s.row_valid[y] = count;
}

namespace {

JG_INLINE vf visibility_of(Block& b, const Curve& curve, const float* c, int x0, int y, const ShadeTask& s) {
  vf v = all(1.f);
  set_block(b, curve, c, x0, y, s);
  while (next_taps(b, s)) {
    vf sum = {};
    for_taps<false>(b, curve, c, s, [&](const Aim&, const Tap& t)
                                        __attribute__((always_inline)) { sum += t.soft * t.fall * t.fall; });
    v = select(b.lanes, exp2_of_negative<5>(max(sum * curve.exponent, all(EXPONENT_MIN))), v);
  }
  return v;
}

// Four planes of 16 pixels -> 16 interleaved RGBA pixels.
JG_INLINE void interleave(const vf c[4], float out[64]) {
  const vf rg0 = JG_SHUFFLE(c[0], c[1], 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
  const vf rg1 = JG_SHUFFLE(c[0], c[1], 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
  const vf ba0 = JG_SHUFFLE(c[2], c[3], 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
  const vf ba1 = JG_SHUFFLE(c[2], c[3], 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
  store(out, JG_SHUFFLE(rg0, ba0, 0, 1, 16, 17, 2, 3, 18, 19, 4, 5, 20, 21, 6, 7, 22, 23));
  store(out + 16, JG_SHUFFLE(rg0, ba0, 8, 9, 24, 25, 10, 11, 26, 27, 12, 13, 28, 29, 14, 15, 30, 31));
  store(out + 32, JG_SHUFFLE(rg1, ba1, 0, 1, 16, 17, 2, 3, 18, 19, 4, 5, 20, 21, 6, 7, 22, 23));
  store(out + 48, JG_SHUFFLE(rg1, ba1, 8, 9, 24, 25, 10, 11, 26, 27, 12, 13, 28, 29, 14, 15, 30, 31));
}

// Which of sixteen pixels are beside the edge of skin before other skin. Through a pinhole a difference of 1/z is one of z
// times that squared.
JG_INLINE uint32_t at_edges(const ShadeTask& s, int x, int y, int n) {
  const float* near = s.surface + (int64_t)y * s.surface_stride + x;
  const vf here = load(near), per_m = s.orthographic ? all(1.f) : here;
  const vf step = per_m * max(per_m * s.edge_step, all(s.edge_steepness / s.fx));
  vi inside = here > NOT_NEAR, beyond = {};
  const int32_t around[] = {-1, 1, -s.surface_stride, s.surface_stride};
  for (const int32_t beside : around) {
    const vf there = load(near + beside);
    inside &= there > NOT_NEAR, beyond |= abs(there - here) > step;
  }
  return bit_mask(inside & beyond) & (n < LANES ? (1u << n) - 1 : ~0u);
}

// Mixes the color of a pixel that is not at the image's border with those around it: what stands before other skin has
// the surface's edge, which would be a staircase.
void smooth_edge(const ShadeTask& s, int x, int y, vf c[4], int lane) {
  const int64_t pixels = (int64_t)s.width * s.height;
  float sum[4] = {};
  for (int down = -1; down <= 1; down++) {
    for (int right = -1; right <= 1; right++) {
      const float weight = (down ? 1.f : 2.f) * (right ? 1.f : 2.f);
      const float* p = s.picture + (int64_t)(y + down) * s.width + x + right;
      for (int k = 0; k < 4; k++) sum[k] += weight * p[k * pixels];
    }
  }
  if (!(sum[3] > 0)) return;
  for (int k = 0; k < 3; k++) c[k][lane] += s.edge_part * (sum[k] / sum[3] * c[3][lane] - c[k][lane]);
}

// Without a shadow depth is found on the way. Of pixels without anything only the alpha is read.
void shade_row(const ShadeTask& s, int y) {
  const int64_t pixels = (int64_t)s.width * s.height, row = (int64_t)y * s.width;
  const bool shadowed = s.samples > 0 && s.row_valid[y] > 0, wants_depth = s.samples == 0 && s.depth_out;
  const Curve curve = curve_of(s);
  Block block;
  if (shadowed) start(block, s);
  for (int x = 0; x < s.width; x += LANES) {
    const int n = s.width - x;
    const float* p = s.picture + row + x;
    vf v = all(1.f), c[4] = {};
    c[3] = load_first(p + 3 * pixels, n);
    const bool covered = bit_mask(c[3] > 0);
    if (shadowed) v = visibility_of(block, curve, s.depth + (int64_t)y * s.stride + x, x, y, s);
    if (s.visibility) store_first(s.visibility + row + x, v, n);
    if (wants_depth) depth_of(s, c[3], covered ? load_first(p + 4 * pixels, n) : vf{}, row + x, n);
    if (!s.rgba) continue;
    for (int k = 0; covered && k < 3; k++) c[k] = load_first(p + k * pixels, n);
    for (uint32_t rest = covered && s.surface ? at_edges(s, x, y, n) : 0; rest; rest &= rest - 1)
      smooth_edge(s, x + __builtin_ctz(rest), y, c, __builtin_ctz(rest));
    for (int k = 0; covered && k < 3; k++) c[k] *= 1.f - s.darkness[k] * (1.f - v);
    float* out = s.rgba + 4 * (row + x);
    if (n >= LANES) {
      interleave(c, out);
    } else {
      alignas(64) float last[4 * LANES];
      interleave(c, last);
      memcpy(out, last, sizeof(float) * 4 * (size_t)n);
    }
  }
}

}  // namespace
}  // namespace jg

JG_API int32_t jg_shade_task_bytes() { return sizeof(jg::ShadeTask); }

// Depth, shadow and RGBA of a drawn picture, together with the other threads of the team.
JG_API void jg_shade(jg::Team* team, const jg::ShadeTask* task) {
  const jg::ShadeTask s = *task;
  int step = 0;
  if (s.samples > 0) {
    jg::share(*team, step++, s.height, [&](int32_t y) { jg::prepare_depth(s, y); });
  }
  jg::share(*team, step, s.height, [&](int32_t y) { jg::shade_row(s, y); });
}
