// The mean of images in linear light; what it is for is in native/mean.py. Where nothing is drawn nothing is computed.
#include <stdint.h>

#include "export.h"
#include "team.h"
#include "vec.h"

namespace jg {

// Mirrored field by field in native/mean.py.
struct MeanTask {
  int32_t width, height;  // of the image that is added, or of the whole mean
  int32_t stride;         // pixels from one row of the sums to the next
  int32_t stripes;        // items that threads share
  int32_t linear;         // whether colors are scene-linear, not display-referred
  float weight;           // of the image in the mean
  float alpha_min;        // a mean depth needs so much coverage
  float* rgba;            // (height, width, 4) premultiplied
  float* depth;           // (height, width) meters, 0 where there is none; or null
  float* sum;             // premultiplied linear light
  float* depth_sum;       // coverage times depth
  float* depth_weight;    // coverage of what has a depth
};

namespace {

constexpr int PIXELS = LANES / 4;

JG_INLINE vf alphas_of(vf rgba) { return JG_SHUFFLE(rgba, rgba, 3, 3, 3, 3, 7, 7, 7, 7, 11, 11, 11, 11, 15, 15, 15, 15); }

JG_INLINE vf power(vf x, float exponent) { return exp2(exponent * log2(x)); }

// The transfer function of sRGB (IEC 61966-2-1), as color.py has it.
JG_INLINE vf linear_of(vf c) { return select(c <= 0.04045f, c / 12.92f, power((c + 0.055f) / 1.055f, 2.4f)); }
JG_INLINE vf display_of(vf c) {
  return select(c <= 0.04045f / 12.92f, c * 12.92f, 1.055f * power(c, 1 / 2.4f) - 0.055f);
}

// `curve` of the straight colors of four premultiplied pixels; alpha stays, and what is not covered is 0.
template <class Curve>
JG_INLINE vf through(vf rgba, vf alpha, Curve curve) {
  const vi is_alpha = {0, 0, 0, -1, 0, 0, 0, -1, 0, 0, 0, -1, 0, 0, 0, -1};
  const vf color = curve(rgba / max(alpha, all(1e-30f))) * alpha;
  return select(alpha > 0, select(is_alpha, alpha, color), vf{});
}

void add_row(const MeanTask& t, int64_t y) {
  const float *rgba = t.rgba + 4 * y * t.width, *depth = t.depth ? t.depth + y * t.width : nullptr;
  float* sum = t.sum + 4 * y * t.stride;
  for (int x = 0; x < t.width; x += PIXELS) {
    const int count = t.width - x < PIXELS ? t.width - x : PIXELS;
    const vf pixels = load_first(rgba + 4 * x, 4 * count), alpha = alphas_of(pixels);
    if (!bit_mask(alpha > 0)) continue;
    const vf before = load_first(sum + 4 * x, 4 * count);
    const vf light = t.linear ? pixels : through(pixels, alpha, linear_of);
    store_first(sum + 4 * x, before + t.weight * light, 4 * count);
    for (int i = x; depth && i < x + count; i++) {
      const float covered = depth[i] > 0 ? t.weight * rgba[4 * i + 3] : 0;
      t.depth_sum[y * t.stride + i] += covered * depth[i];
      t.depth_weight[y * t.stride + i] += covered;
    }
  }
}

void finish_row(const MeanTask& t, int64_t y) {
  const int64_t row = y * t.width;
  for (int x = 0; x < t.width; x += PIXELS) {
    const int count = t.width - x < PIXELS ? t.width - x : PIXELS;
    const vf pixels = load_first(t.sum + 4 * (row + x), 4 * count), alpha = alphas_of(pixels);
    if (!bit_mask(alpha > 0)) continue;
    store_first(t.rgba + 4 * (row + x), t.linear ? pixels : through(pixels, alpha, display_of), 4 * count);
    for (int64_t i = row + x; i < row + x + count; i++)
      if (t.depth_weight[i] > t.alpha_min) t.depth[i] = t.depth_sum[i] / t.depth_weight[i];
  }
}

template <class Row>
void share_rows(Team* team, const MeanTask* task, Row row) {
  const MeanTask t = *task;
  share(*team, 0, t.stripes, [&](int32_t i) {
    const Range rows = part_of(t.height, i, t.stripes);
    for (int64_t y = rows.begin; y < rows.end; y++) row(t, y);
  });
}

}  // namespace
}  // namespace jg

JG_API int32_t jg_mean_task_bytes() { return sizeof(jg::MeanTask); }

// Adds an image to the sums, together with the other threads of the team.
JG_API void jg_mean_add(jg::Team* team, const jg::MeanTask* task) { jg::share_rows(team, task, jg::add_row); }

// Writes the mean into rgba and depth, which are zeros.
JG_API void jg_mean_finish(jg::Team* team, const jg::MeanTask* task) { jg::share_rows(team, task, jg::finish_row); }
