// Gradient of the darkened color: to the premultiplied color directly, to depth through the visibility, and from
// depth to alpha and the depth sum. Normals and sample positions carry no gradient (METHOD 5.2).
//
// A tap adds to the depth of its sample, in another row. The picture is cut into a fixed number of row stripes with
// about equally many pixels; each owns a padded buffer, and the buffers are added in stripe order: the sum does not
// depend on the number of threads.
#include "constants.h"
#include "export.h"
#include "shadow.h"
#include "team.h"

namespace jg {

// Mirrored field by field in native/tasks.py.
struct ShadeGradient {
  const float* visibility;  // (H, W) of the forward pass
  const float* darkened;    // (3, H, W) gradient of the loss to the darkened color
  float* stripes;           // (H + 2 pad_rows SHADOW_STRIPES) rows of the padded stride: the stripes, one after another
  float* out;               // (5, H, W) gradient to R G B, alpha, depth sum
  int32_t pad_columns;      // floats between the start of a padded row and pixel 0
};

namespace {

struct Stripes {
  int32_t begin[SHADOW_STRIPES + 1];
};
Stripes cut(const ShadeTask& s) {
  int64_t total = 0, seen = 0;
  for (int y = 0; y < s.height; y++) total += s.row_valid[y];
  Stripes r = {};
  int next = 1;
  for (int y = 0; y < s.height && next < SHADOW_STRIPES; y++) {
    seen += s.row_valid[y];
    while (next < SHADOW_STRIPES && seen * SHADOW_STRIPES >= total * next) r.begin[next++] = y + 1;
  }
  while (next <= SHADOW_STRIPES) r.begin[next++] = s.height;
  return r;
}

// Row y of the buffer of stripe i, which holds the rows [begin - pad, end + pad).
JG_INLINE float* stripe_row(const ShadeTask& s, const ShadeGradient& g, int i, int y) {
  return g.stripes + ((int64_t)y + (2 * i + 1) * s.pad_rows) * s.stride + g.pad_columns;
}

// Adds the gradients of a tap's samples where these lie.
JG_INLINE void scatter(float* to, const Aim& a, vf gradient) {
  const auto add = [&](float* at, vf part) __attribute__((always_inline)) { store(at, load(at) + part); };
  float* near = to + a.offset;
  if (!a.split) return add(near, gradient);
  add(near, select(a.far_x | a.far_y, vf{}, gradient));
  add(near + a.right, select(a.far_x & ~a.far_y, gradient, vf{}));
  add(near + a.down, select(a.far_y & ~a.far_x, gradient, vf{}));
  add(near + a.down + a.right, select(a.far_x & a.far_y, gradient, vf{}));
}

void block_gradient(Block& b, const Curve& curve, const ShadeTask& s, const ShadeGradient& g, float* to, int x, int y) {
  const float* c = s.depth + (int64_t)y * s.stride + x;
  set_block(b, curve, c, x, y, s);
  if (!bit_mask(b.valid)) return;
  const int64_t pixels = (int64_t)s.width * s.height, at = (int64_t)y * s.width + x;
  const int n = s.width - x;
  vf to_v = {};
  for (int k = 0; k < 3; k++)
    to_v += s.darkness[k] * load_first(g.darkened + k * pixels + at, n) * load_first(s.picture + k * pixels + at, n);
  // V = 2^(exponent * sum)
  const vf to_sum = to_v * load_first(g.visibility + at, n) * (curve.exponent * LN2);
  const vf normal_ray = b.nx * b.ray_x + (b.ny * b.ray_y + b.nz);
  vf own = {};
  const auto push = [&](const Aim& a, const Tap& t) __attribute__((always_inline)) {
    // a sample that is the pixel itself moves with it: skipped, because its two huge parts would cancel only nearly
    vi counts = b.lanes & (t.fall > 0);
    if (!a.offset) counts &= a.far_x | a.far_y;
    const vf e = t.steep + curve.shift, power = exp2_of_negative<5>(max(-abs(e), all(EXPONENT_MIN)));
    const vf sigmoid = select(e > 0, all(1.f), power) / (1.f + power);
    const vf along = sigmoid * t.fall * t.fall * t.inverse;
    const vf radial = -along * t.steep * t.inverse - 2.f * t.soft * t.fall * curve.inverse_radius * t.inverse;
    const vf at_ray = along * normal_ray + radial * (t.vx * b.ray_x + (t.vy * b.ray_y + t.vz));
    const vf shifted = along * (b.nx * a.turn_x + b.ny * a.turn_y) + radial * (t.vx * a.turn_x + t.vy * a.turn_y);
    own -= select(counts, at_ray * to_sum, vf{});
    scatter(to, a, select(counts, (at_ray + shifted) * to_sum, vf{}));
  };
  while (next_taps(b, s)) for_taps<true>(b, curve, c, s, push);
  store(to, load(to) + own);
}

void stripe_gradient(const ShadeTask& s, const ShadeGradient& g, const Stripes& stripes, int i) {
  const Curve curve = curve_of(s);
  const int y0 = stripes.begin[i], y1 = stripes.begin[i + 1];
  float* first = g.stripes + ((int64_t)y0 + 2 * i * s.pad_rows) * s.stride;
  memset(first, 0, sizeof(float) * (size_t)s.stride * (size_t)(y1 - y0 + 2 * s.pad_rows));
  Block block;
  start(block, s);
  for (int y = y0; y < y1; y++) {
    if (!s.row_valid[y]) continue;
    for (int x = 0; x < s.width; x += LANES) block_gradient(block, curve, s, g, stripe_row(s, g, i, y) + x, x, y);
  }
}

// Adds the stripes in order and follows z = D / A.
void finish_row(const ShadeTask& s, const ShadeGradient& g, const Stripes& stripes, int y) {
  const int64_t pixels = (int64_t)s.width * s.height, row = (int64_t)y * s.width;
  for (int x = 0; x < s.width; x += LANES) {
    const int n = s.width - x;
    const int64_t at = row + x;
    const vf v = load_first(g.visibility + at, n);
    for (int k = 0; k < 3; k++) {
      const vf direct = load_first(g.darkened + k * pixels + at, n) * (1.f - s.darkness[k] * (1.f - v));
      store_first(g.out + k * pixels + at, direct, n);
    }
    const vf z = load(s.depth + (int64_t)y * s.stride + x), alpha = load_first(s.picture + 3 * pixels + at, n);
    const vi valid = z < SHADOW_FAR_M;
    vf to_z = {};
    for (int i = 0; i < SHADOW_STRIPES; i++) {
      const int y0 = stripes.begin[i], y1 = stripes.begin[i + 1];
      if (y0 < y1 && y >= y0 - s.pad_rows && y < y1 + s.pad_rows) to_z += load(stripe_row(s, g, i, y) + x);
    }
    const vf to_sum = select(valid, to_z / select(valid, alpha, all(1.f)), vf{});
    store_first(g.out + 4 * pixels + at, to_sum, n);
    store_first(g.out + 3 * pixels + at, select(valid, -to_sum * (z + s.origin), vf{}), n);
  }
}

}  // namespace
}  // namespace jg

JG_API int32_t jg_shade_gradient_bytes() { return sizeof(jg::ShadeGradient); }

// The gradient of jg_shade's darkened color to the picture's five planes.
JG_API void jg_shade_backward(jg::Team* team, const jg::ShadeTask* task, const jg::ShadeGradient* gradient) {
  const jg::ShadeTask s = *task;
  const jg::ShadeGradient g = *gradient;
  jg::share(*team, 0, s.height, [&](int32_t y) { jg::prepare_depth(s, y); });
  const jg::Stripes stripes = jg::cut(s);
  jg::share(*team, 1, jg::SHADOW_STRIPES, [&](int32_t i) { jg::stripe_gradient(s, g, stripes, i); });
  jg::share(*team, 2, s.height, [&](int32_t y) { jg::finish_row(s, g, stripes, y); });
}
