// Depth order on all 32 bits of the float: a quantized key would depend on the other Gaussians.
#include "raster.h"

namespace jg {
namespace {

constexpr int DIGIT_BITS = 11, DIGITS = 1 << DIGIT_BITS, MAX_PASSES = 3;

struct Histogram {
  uint32_t count[MAX_PASSES][DIGITS];
};

inline uint32_t digit(uint32_t key, int pass) { return key >> (pass * DIGIT_BITS) & (DIGITS - 1); }

}  // namespace

// Stable radix sort, least significant digit first: equal depths keep the order of their indices. The smallest key is
// subtracted first; a hand spans a small range of depths, and two passes of three are then enough.
void sort_visible(RasterJob& job) {
  uint32_t key_min = UINT32_MAX, key_max = 0;
  job.visible = job.invalid = 0;
  for (int32_t part = 0; part < job.parts; part++) {
    const PartSummary& s = job.summaries[part];
    job.visible += s.visible, job.invalid += s.invalid;
    if (s.key_min < key_min) key_min = s.key_min;
    if (s.key_max > key_max) key_max = s.key_max;
  }
  if (!job.visible) return;
  int passes = 1;
  while (passes < MAX_PASSES && (key_max - key_min) >> (passes * DIGIT_BITS)) passes++;

  Histogram histogram = {};
  uint64_t *from = job.sort_b, *to = job.sort_a;
  int32_t n = 0;
  for (int32_t part = 0; part < job.parts; part++) {
    const uint64_t* keys = job.sort_a + part_of(job.count, part, job.parts).begin;
    for (int32_t i = 0; i < job.summaries[part].visible; i++) {
      const uint64_t entry = keys[i] - ((uint64_t)key_min << 32);
      const uint32_t key = (uint32_t)(entry >> 32);
      for (int pass = 0; pass < passes; pass++) histogram.count[pass][digit(key, pass)]++;
      from[n++] = entry;
    }
  }
  for (int pass = 0; pass < passes; pass++) {
    uint32_t* cursor = histogram.count[pass];
    for (uint32_t d = 0, sum = 0; d < DIGITS; d++) {
      const uint32_t c = cursor[d];
      cursor[d] = sum, sum += c;
    }
    const bool last = pass == passes - 1;
    for (int32_t i = 0; i < n; i++) {
      const uint32_t place = cursor[digit((uint32_t)(from[i] >> 32), pass)]++;
      if (last) job.order[place] = (int32_t)(uint32_t)from[i];
      else to[place] = from[i];
    }
    uint64_t* swap = from;
    from = to, to = swap;
  }
}

}  // namespace jg
