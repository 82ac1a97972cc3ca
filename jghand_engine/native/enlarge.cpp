// A picture and its depth at twice the width and height; what it does and why is in native/enlarge.py.
//
// Most of a picture is empty: only what lies beside something drawn is written, the rest stays as it came (zeros).
#include <stdint.h>
#include <string.h>

#include "export.h"
#include "team.h"

namespace jg {

// Mirrored field by field in native/tasks.py.
struct EnlargeTask {
  int32_t width, height;              // of the small picture
  int32_t large_width, large_height;  // twice that, or one less
  int32_t stripes;                    // items that threads share
  float same_surface;                 // depths that differ by less belong together, meters
  const float* rgba;                  // (H, W, 4)
  const float* depth;                 // (H, W)
  int32_t* spans;                     // (H, 2): what is drawn of a row, from its first column to behind its last
  float* large_rgba;                  // (large H, large W, 4), zeros
  float* large_depth;                 // (large H, large W), zeros
};

namespace {

typedef float rgba4 __attribute__((vector_size(16)));

rgba4 pixel(const float* row, int x) {
  rgba4 v;
  memcpy(&v, row + 4 * (int64_t)x, sizeof v);
  return v;
}

int clamped(int place, int size) { return place < 0 ? 0 : place >= size ? size - 1 : place; }

bool is_drawn(const EnlargeTask& t, int64_t place) {
  const float* c = t.rgba + 4 * place;
  return c[0] != 0 || c[1] != 0 || c[2] != 0 || c[3] != 0 || t.depth[place] != 0;
}

void find_span(const EnlargeTask& t, int y) {
  const int64_t row = (int64_t)y * t.width;
  int first = 0, end = t.width;
  while (first < end && !is_drawn(t, row + first)) first++;
  while (end > first && !is_drawn(t, row + end - 1)) end--;
  t.spans[2 * y] = first;
  t.spans[2 * y + 1] = end;
}

// Three quarters of the nearest pixel and one of the next, first down, then across.
void color_row(const EnlargeTask& t, int large_y, int first, int end) {
  const int y = large_y / 2, next = clamped(large_y % 2 ? y + 1 : y - 1, t.height);
  const float *near = t.rgba + 4 * (int64_t)y * t.width, *far = t.rgba + 4 * (int64_t)next * t.width;
  const auto blended = [&](int x) {
    const int at = clamped(x, t.width);
    return 0.75f * pixel(near, at) + 0.25f * pixel(far, at);
  };
  float* to = t.large_rgba + 4 * ((int64_t)large_y * t.large_width + 2 * first);
  rgba4 left = blended(first - 1), middle = blended(first);
  for (int x = first; x < end; x++, to += 8) {
    const rgba4 right = blended(x + 1), here = 0.75f * middle;
    const rgba4 pair[2] = {here + 0.25f * left, here + 0.25f * right};
    memcpy(to, pair, 2 * x + 1 < t.large_width ? sizeof pair : sizeof *pair);
    left = middle;
    middle = right;
  }
}

// The mean of those of the four nearest pixels that show the same surface as the nearest one.
void depth_row(const EnlargeTask& t, int large_y, int first, int end) {
  const int y = large_y / 2, next = clamped(large_y % 2 ? y + 1 : y - 1, t.height);
  const float *near = t.depth + (int64_t)y * t.width, *far = t.depth + (int64_t)next * t.width;
  float* to = t.large_depth + (int64_t)large_y * t.large_width;
  for (int x = first; x < end; x++) {
    const float nearest = near[x];
    for (int across = 0; across < 2 && 2 * x + across < t.large_width; across++) {
      const int beside = clamped(across ? x + 1 : x - 1, t.width);
      float total = 9 * nearest, weight = 9;
      const auto add = [&](float other, float share) {
        const float gap = other - nearest;
        if ((gap < 0 ? -gap : gap) < t.same_surface) {
          total += share * other;
          weight += share;
        }
      };
      add(far[x], 3);
      add(near[beside], 3);
      add(far[beside], 1);
      to[2 * x + across] = total / weight;
    }
  }
}

// Both rows that lie in row y of the small picture.
void enlarge_row(const EnlargeTask& t, int y) {
  int first = t.width, end = 0;
  for (int step = -1; step <= 1; step++) {
    const int32_t* span = t.spans + 2 * clamped(y + step, t.height);
    if (span[0] >= span[1]) continue;
    first = span[0] < first ? span[0] : first;
    end = span[1] > end ? span[1] : end;
  }
  if (first >= end) return;
  first = clamped(first - 1, t.width);
  end = clamped(end, t.width) + 1;
  for (int row = 2 * y; row < 2 * y + 2 && row < t.large_height; row++) {
    color_row(t, row, first, end);
    depth_row(t, row, first, end);
  }
}

}  // namespace
}  // namespace jg

JG_API int32_t jg_enlarge_task_bytes() { return sizeof(jg::EnlargeTask); }

// Fills what is not empty of the large picture, together with the other threads of the team.
JG_API void jg_enlarge(jg::Team* team, const jg::EnlargeTask* task) {
  const jg::EnlargeTask t = *task;
  jg::share(*team, 0, t.stripes, [&](int32_t i) {
    const jg::Range rows = jg::part_of(t.height, i, t.stripes);
    for (int64_t y = rows.begin; y < rows.end; y++) jg::find_span(t, (int)y);
  });
  jg::share(*team, 1, t.stripes, [&](int32_t i) {
    const jg::Range rows = jg::part_of(t.height, i, t.stripes);
    for (int64_t y = rows.begin; y < rows.end; y++) jg::enlarge_row(t, (int)y);
  });
}
