// What the pose changes on the skin beyond skinning, by the linear tier or the network (learn/pose_net.py).
#include "constants.h"
#include "learned.h"

namespace jg {
namespace {

typedef int8_t vb __attribute__((vector_size(16)));

JG_INLINE vf load_bytes(const int8_t* p) {
  vb v;
  memcpy(&v, p, sizeof v);
  return __builtin_convertvector(v, vf);
}

// Exact at 0, and 1 beyond it as soon as float32 is.
JG_INLINE vf tanh(vf x) {
  const vf t = exp2(abs(x) * (-2 * LOG2E));
  const vf y = (1.f - t) / (1.f + t);
  return x < 0 ? -y : y;
}

// The first layer of one block: hidden units (hidden, stride) at `to`, and which of them are above 0 anywhere in it.
JG_INLINE void first_layer(const LearnedTask& t, int32_t block, float* to, int stride, bool* alive) {
  constexpr int TILE = 8;
  const SkinTask& s = t.skin;
  const float* places = t.places + (int64_t)block * t.hidden * LANES;
  for (int h = 0; h < t.hidden; h += TILE) {
    vf sum[TILE];
    for (int r = 0; r < TILE; r++) sum[r] = load(places + (h + r) * LANES);
    for (int32_t e = s.block_start[block]; e < s.block_start[block + 1]; e++) {
      const vf w = load(s.weight + LANES * (int64_t)e);
      const float* feature = t.features + s.bone[e] * t.hidden + h;
      for (int r = 0; r < TILE; r++) sum[r] += w * feature[r];
    }
    for (int r = 0; r < TILE; r++) {
      store(to + (h + r) * stride, max(sum[r], vf{}));
      alive[h + r] |= bit_mask(sum[r] > 0) != 0;
    }
  }
}

// The second layer of BLOCKS blocks from `count` units of the first, UNITS of a tile at a time: as many sums as there
// are registers for. `next`: what the first layer reads after this, on its way from memory meanwhile.
template <int BLOCKS, int UNITS>
JG_INLINE void middle_layer(const LearnedTask& t, const float* from, const int16_t* unit, int count, const float* next,
                            float* to) {
  constexpr int STRIDE = BLOCKS * LANES;
  for (int o = 0; o < t.hidden; o += UNITS) {
    for (int r = 0; r < UNITS * BLOCKS; r++) __builtin_prefetch(next + LANES * (o * BLOCKS + r), 0, 2);
    const float* weight = t.middle + (int64_t)(o / NETWORK_TILE) * t.hidden * NETWORK_TILE + o % NETWORK_TILE;
    vf sum[UNITS][BLOCKS];
    for (int r = 0; r < UNITS; r++)
      for (int b = 0; b < BLOCKS; b++) sum[r][b] = all(t.middle_bias[o + r]);
    for (int i = 0; i < count; i++) {
      const int h = unit[i];
      vf x[BLOCKS];
      for (int b = 0; b < BLOCKS; b++) x[b] = load(from + h * STRIDE + b * LANES);
      for (int r = 0; r < UNITS; r++)
        for (int b = 0; b < BLOCKS; b++) sum[r][b] += x[b] * weight[h * NETWORK_TILE + r];
    }
    for (int r = 0; r < UNITS; r++)
      for (int b = 0; b < BLOCKS; b++) store(to + (o + r) * STRIDE + b * LANES, max(sum[r][b], vf{}));
  }
}

template <int BLOCKS>
JG_INLINE void network(const LearnedTask& t, int32_t block, vf out[][CORRECTION]) {
  constexpr int STRIDE = BLOCKS * LANES;
#if defined(__AVX512F__)
  constexpr int UNITS = NETWORK_TILE;
#else
  constexpr int UNITS = NETWORK_TILE / 2;  // a vector is two registers of sixteen
#endif
  alignas(64) float first[HIDDEN_MAX * STRIDE], second[HIDDEN_MAX * STRIDE];
  // neighbors agree about most units: those that are 0 for all of them add nothing
  bool alive[HIDDEN_MAX] = {};
  int16_t unit[HIDDEN_MAX];
  int count = 0;
  for (int b = 0; b < BLOCKS; b++) first_layer(t, block + b, first + b * LANES, STRIDE, alive);
  for (int h = 0; h < t.hidden; h++) unit[count] = (int16_t)h, count += alive[h];
  const int32_t next = block + BLOCKS < t.skin.blocks - BLOCKS ? block + BLOCKS : block;
  middle_layer<BLOCKS, UNITS>(t, first, unit, count, t.places + (int64_t)next * t.hidden * LANES, second);
  vf sum[CORRECTION][BLOCKS];
  for (int j = 0; j < CORRECTION; j++)
    for (int b = 0; b < BLOCKS; b++) sum[j][b] = all(t.out_bias[j]);
  for (int h = 0; h < t.hidden; h++) {
    vf x[BLOCKS];
    for (int b = 0; b < BLOCKS; b++) x[b] = load(second + h * STRIDE + b * LANES);
    for (int j = 0; j < CORRECTION; j++)
      for (int b = 0; b < BLOCKS; b++) sum[j][b] += x[b] * t.out[CORRECTION * h + j];
  }
  for (int b = 0; b < BLOCKS; b++)
    for (int j = 0; j < CORRECTION; j++) out[b][j] = tanh(sum[j][b]) * t.reach[j / 3];
}

}  // namespace

void network_correction(const LearnedTask& t, int32_t block, int count, vf out[][CORRECTION]) {
  if (count == NETWORK_BLOCKS) return network<NETWORK_BLOCKS>(t, block, out);
  for (int b = 0; b < count; b++) network<1>(t, block + b, out + b);
}

void linear_correction(const LearnedTask& t, int32_t block, vf out[CORRECTION]) {
  const SkinTask& s = t.skin;
  const int8_t* direction = t.direction + (int64_t)block * t.basis * CORRECTION * LANES;
  vf sum[CORRECTION] = {};
  for (int k = 0; k < t.basis; k++, direction += CORRECTION * LANES) {
    vf number = {};
    for (int32_t e = s.block_start[block]; e < s.block_start[block + 1]; e++)
      number += load(s.weight + LANES * (int64_t)e) * t.numbers[s.bone[e] * t.basis + k];
    for (int j = 0; j < CORRECTION; j++) sum[j] += number * load_bytes(direction + j * LANES);
  }
  const float* constant = t.constant + (int64_t)block * (CORRECTION + 2) * LANES;
  for (int j = 0; j < CORRECTION; j++)
    out[j] = load(constant + j * LANES) + sum[j] * load(constant + (CORRECTION + j / 3) * LANES);
}

}  // namespace jg
