// Mean SSIM of two pictures and its gradient with respect to the first, in one call.
//
// learn/ssim.py is the specification: an 11 x 11 Gaussian window, taken apart into columns and rows, windows inside
// the picture only. Colors stay interleaved as they come: the same channel of the pixel k further right lies 3 k floats
// further, so a row of 3 width floats is blurred as it is. The gradient spreads three maps back through the window.
#include <stdint.h>
#include <string.h>

#include "constants.h"
#include "export.h"
#include "team.h"
#include "vec.h"

namespace jg {

constexpr int SSIM_RIM = SSIM_WINDOW_PX - 1, CHANNELS = 3;

// Mirrored field by field in native/tasks.py.
struct SsimTask {
  int32_t width, height;  // pixels, both at least SSIM_WINDOW_PX
  int32_t stride;         // floats of a row of maps and of scratch: at least 3 (width + 10) + 32, a multiple of 16
  int32_t stripes;        // items that threads share; the sums do not depend on it
  float c1, c2;
  float weights[SSIM_WINDOW_PX];
  const float* rgb;    // (H, W, 3)
  const float* truth;  // (H, W, 3)
  float* maps;         // (3, H + 10, stride): d/d mean, d/d E[xx], d/d E[xy] of each window, zeros around
  float* scratch;      // (stripes, 4, stride)
  double* sums;        // (H - 10): SSIM summed over the windows of a row
  float* gradient;     // (H, W, 3), or null: not wanted, nor maps
};

namespace {

// Means over the columns of the window: of x, of y, of xx + yy, of xy.
void blur_down(const SsimTask& s, int y, float* means) {
  const int row = CHANNELS * s.width;
  for (int i = 0; i < row; i += LANES) {
    const int count = row - i < LANES ? row - i : LANES;
    const float* x = s.rgb + (int64_t)y * row + i;
    const float* t = s.truth + (int64_t)y * row + i;
    vf mx = {}, my = {}, squares = {}, product = {};
    for (int k = 0; k < SSIM_WINDOW_PX; k++, x += row, t += row) {
      const vf a = load_first(x, count), b = load_first(t, count), wa = s.weights[k] * a, wb = s.weights[k] * b;
      mx += wa;
      my += wb;
      squares += wa * a + wb * b;
      product += wa * b;
    }
    store(means + i, mx);
    store(means + s.stride + i, my);
    store(means + 2 * s.stride + i, squares);
    store(means + 3 * s.stride + i, product);
  }
  // what a last block of windows reads beyond the row
  for (int m = 0; m < 4; m++) memset(means + m * s.stride + row, 0, sizeof(float) * (size_t)(s.stride - row));
}

JG_INLINE vf blur_across(const SsimTask& s, const float* from) {
  vf sum = {};
  for (int k = 0; k < SSIM_WINDOW_PX; k++) sum += s.weights[k] * load(from + CHANNELS * k);
  return sum;
}

// One row of windows: its sum, and its row of the three maps.
double windows_of(const SsimTask& s, const float* means, float* maps) {
  const int windows = CHANNELS * (s.width - SSIM_RIM);
  const int64_t plane = (int64_t)(s.height + SSIM_RIM) * s.stride;
  const vi lane = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  vf sum = {};
  for (int i = 0; i < windows; i += LANES) {
    const int count = windows - i < LANES ? windows - i : LANES;
    const vf mx = blur_across(s, means + i), my = blur_across(s, means + s.stride + i);
    const vf squares = blur_across(s, means + 2 * s.stride + i), product = blur_across(s, means + 3 * s.stride + i);
    const vf mean_product = mx * my, mean_squares = mx * mx + my * my;
    const vf a1 = 2.f * mean_product + s.c1, a2 = 2.f * (product - mean_product) + s.c2;
    const vf b1 = mean_squares + s.c1, b2 = (squares - mean_squares) + s.c2;
    const vf inverse = 1.f / (b1 * b2), value = a1 * a2 * inverse;
    sum += select(lane < count, value, vf{});
    if (!maps) continue;
    const vf by_xx = -value * (b1 * inverse);  // -value / b2
    float* to = maps + CHANNELS * SSIM_RIM + i;
    store_first(to, 2.f * (my * (a2 - a1) * inverse - mx * (value * (b2 * inverse) + by_xx)), count);
    store_first(to + plane, by_xx, count);
    store_first(to + 2 * plane, 2.f * a1 * inverse, count);
  }
  double total = 0;
  for (int k = 0; k < LANES; k++) total += (double)sum[k];
  return total;
}

void clear(float* p, int64_t count) { memset(p, 0, sizeof(float) * (size_t)count); }

// Row r of the maps: a row of windows with nothing left and right, or nothing at all above and below them.
void forward_row(const SsimTask& s, int r, float* means) {
  const bool inside = r >= SSIM_RIM && r < s.height;
  const int64_t plane = (int64_t)(s.height + SSIM_RIM) * s.stride;
  float* maps = s.gradient ? s.maps + (int64_t)r * s.stride : nullptr;
  const int side = CHANNELS * SSIM_RIM, end = CHANNELS * s.width;
  for (int m = 0; maps && m < 3; m++) {
    float* row = maps + m * plane;
    if (!inside) {
      clear(row, s.stride);
    } else {
      clear(row, side);
      clear(row + end, s.stride - end);
    }
  }
  if (!inside) return;
  blur_down(s, r - SSIM_RIM, means);
  s.sums[r - SSIM_RIM] = windows_of(s, means, maps);
}

// Row y of the gradient: the maps of all windows that see it.
void backward_row(const SsimTask& s, int y, float* spread) {
  const int row = CHANNELS * s.width, wide = row + CHANNELS * SSIM_RIM + LANES;
  const int64_t plane = (int64_t)(s.height + SSIM_RIM) * s.stride;
  const float scale = 1.f / ((float)(s.height - SSIM_RIM) * (float)(CHANNELS * (s.width - SSIM_RIM)));
  for (int m = 0; m < 3; m++) {
    const float* from = s.maps + m * plane + (int64_t)y * s.stride;
    for (int i = 0; i < wide; i += LANES) {
      vf sum = {};
      for (int k = 0; k < SSIM_WINDOW_PX; k++) sum += s.weights[k] * load(from + (int64_t)k * s.stride + i);
      store(spread + m * s.stride + i, sum);
    }
  }
  for (int i = 0; i < row; i += LANES) {
    const int count = row - i < LANES ? row - i : LANES;
    const int64_t at = (int64_t)y * row + i;
    const vf x = load_first(s.rgb + at, count), t = load_first(s.truth + at, count);
    const vf by_mean = blur_across(s, spread + i), by_xx = blur_across(s, spread + s.stride + i);
    const vf by_xy = blur_across(s, spread + 2 * s.stride + i);
    store_first(s.gradient + at, (by_mean + 2.f * x * by_xx + t * by_xy) * scale, count);
  }
}

}  // namespace
}  // namespace jg

JG_API int32_t jg_ssim_task_bytes() { return sizeof(jg::SsimTask); }

// Fills sums, and the gradient where it is wanted, together with the other threads of the team.
JG_API void jg_ssim(jg::Team* team, const jg::SsimTask* task) {
  const jg::SsimTask s = *task;
  jg::share(*team, 0, s.stripes, [&](int32_t i) {
    const jg::Range rows = jg::part_of(s.height + jg::SSIM_RIM, i, s.stripes);
    for (int64_t r = rows.begin; r < rows.end; r++) jg::forward_row(s, (int)r, s.scratch + 4 * (int64_t)i * s.stride);
  });
  if (!s.gradient) return;
  jg::share(*team, 1, s.stripes, [&](int32_t i) {
    const jg::Range rows = jg::part_of(s.height, i, s.stripes);
    for (int64_t y = rows.begin; y < rows.end; y++) jg::backward_row(s, (int)y, s.scratch + 4 * (int64_t)i * s.stride);
  });
}
