// Backward through the blend: the same walk front to back, with what is still to come (`rest`) taken from the finished
// picture. RENDERING 4.1:
//
//   rest = g_rgb . rgb + g_D D - g_A (1 - A)        before the first Gaussian
//   w_c  = weight (g_rgb . rgb_i + g_D z_i);  rest -= w_c
//   dL/d(alpha) alpha = w_c - rest alpha / (1 - alpha)
//
// Determinism: the picture is cut into a fixed number of stripes of tiles, each with gradients of its own, which are
// added in the order of the stripes. Which thread works on which stripe then changes nothing.
#include "tile.h"

namespace jg {
namespace {

// One 4 x 4 block on its way through the list, with the gradient of its pixels.
struct Block {
  vf transmittance, rest;
  vf grad_r, grad_g, grad_b, grad_depth;
};

// Whether any pixel has a gradient; without one the block is left out. A NaN counts as one, so that it is not lost.
JG_INLINE bool start_block(const RasterJob& job, int32_t x, int32_t y, Block& block) {
  auto picture = [&](int plane) { return load_pixels(job, job.planes, plane, x, y); };
  auto gradient = [&](int plane) { return load_pixels(job, job.plane_gradients, plane, x, y); };
  block.transmittance = all(1.0f);
  block.grad_r = gradient(0), block.grad_g = gradient(1), block.grad_b = gradient(2), block.grad_depth = gradient(4);
  const vf grad_alpha = gradient(3);
  block.rest = block.grad_r * picture(0) + block.grad_g * picture(1) + block.grad_b * picture(2) +
               block.grad_depth * picture(4) - grad_alpha * (1.0f - picture(3));
  return bit_mask((block.grad_r != 0) | (block.grad_g != 0) | (block.grad_b != 0) | (block.grad_depth != 0) |
                  (grad_alpha != 0)) != 0;
}

// Sums of sixteen lanes for several vectors at once: each step adds two halves and packs two vectors into one.
JG_INLINE vf fold_8(vf a, vf b) {
  return JG_SHUFFLE(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23) +
         JG_SHUFFLE(a, b, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31);
}
JG_INLINE vf fold_4(vf a, vf b) {
  return JG_SHUFFLE(a, b, 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27) +
         JG_SHUFFLE(a, b, 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31);
}
JG_INLINE vf fold_2(vf a, vf b) {
  return JG_SHUFFLE(a, b, 0, 1, 4, 5, 8, 9, 12, 13, 16, 17, 20, 21, 24, 25, 28, 29) +
         JG_SHUFFLE(a, b, 2, 3, 6, 7, 10, 11, 14, 15, 18, 19, 22, 23, 26, 27, 30, 31);
}
JG_INLINE vf fold_1(vf a, vf b) {
  return JG_SHUFFLE(a, b, 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30) +
         JG_SHUFFLE(a, b, 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
}

template <int SQUARINGS>
JG_INLINE void walk_hits(const RasterJob& job, const Chunk& chunk, int index, const Hits& hits, Block& block,
                         const int32_t* list, RecordGradient* gradients) {
  const vf x = LANE_X + (float)block_x(index), y = LANE_Y + (float)block_y(index);
  const vf gr = block.grad_r, gg = block.grad_g, gb = block.grad_b, gz = block.grad_depth;
  const float log2_alpha_min = job.log2_alpha_min, alpha_max = job.alpha_max, t_stop = job.t_stop;
  vf T = block.transmittance, rest = block.rest;
  for (int i = 0; i < hits.count; i++) {
    const Record& record = chunk.records[hits.index[i]];
    const Coverage c = cover<SQUARINGS>(record, x, y, log2_alpha_min, alpha_max);
    const vf weight = c.alpha * T;
    const vf contribution = weight * (gr * record.r + gg * record.g + gb * record.b + gz * record.z);
    rest -= contribution;
    vf m = contribution - rest * c.alpha / (1.0f - c.alpha);
    m = c.uncapped < alpha_max ? m : vf{};  // a capped alpha does not depend on opacity and shape
    T -= weight;
    const vf mx = m * c.dx, my = m * c.dy;
    const vf a = fold_4(fold_8(m, mx), fold_8(my, mx * c.dx));
    const vf b = fold_4(fold_8(mx * c.dy, my * c.dy), fold_8(weight * gr, weight * gg));
    const vf last = fold_8(weight * gb, weight * gz), d = fold_4(last, last);
    float* sums = &gradients[list[hits.index[i]]].m;
    store(sums, load(sums) + fold_1(fold_2(a, b), fold_2(d, d)));
    if ((i & 3) == 3 && !bit_mask(T > t_stop)) break;  // as blend does
  }
  block.transmittance = T, block.rest = rest;
}

template <int SQUARINGS>
void walk_tile(const RasterJob& job, int32_t index, RecordGradient* gradients) {
  const Tile tile = tile_at(job, index);
  if (!tile.length) return;
  Chunk chunk;
  Hits hits;
  Block blocks[BLOCKS];
  uint32_t live = 0;
  for (int b = 0; b < BLOCKS; b++) {
    const int32_t x = tile.x + block_x(b), y = tile.y + block_y(b);
    if (x < job.width && y < job.height && start_block(job, x, y, blocks[b])) live |= 1u << b;
  }
  for (int32_t begin = 0; begin < tile.length && live; begin += CHUNK) {
    load_chunk(chunk, job, tile, begin);
    for (uint32_t todo = live; todo; todo &= todo - 1) {
      const int b = __builtin_ctz(todo);
      find_hits(chunk, b, hits);
      if (!hits.count) continue;
      walk_hits<SQUARINGS>(job, chunk, b, hits, blocks[b], tile.list + begin, gradients);
      if (!bit_mask(blocks[b].transmittance > job.t_stop)) live &= ~(1u << b);
    }
  }
}

}  // namespace

// Equal shares of the work that blend counted; it depends on the input only, so the cuts do not depend on threads.
Stripes cut_stripes(const RasterJob& job) {
  const int32_t tiles = job.tiles_x * job.tiles_y;
  int64_t total = 0, sum = 0;
  for (int32_t tile = 0; tile < tiles; tile++) total += job.tile_work[tile];
  Stripes stripes = {};
  int stripe = 1;
  for (int32_t tile = 0; tile < tiles; tile++) {
    while (stripe < GRADIENT_STRIPES && sum >= total * stripe / GRADIENT_STRIPES) stripes.cut[stripe++] = tile;
    sum += job.tile_work[tile];
  }
  for (; stripe <= GRADIENT_STRIPES; stripe++) stripes.cut[stripe] = tiles;
  return stripes;
}

void blend_backward_stripe(const RasterJob& job, const Stripes& stripes, int32_t stripe) {
  RecordGradient* gradients = job.record_gradients + (int64_t)stripe * job.count;
  const int32_t begin = stripes.cut[stripe], end = stripes.cut[stripe + 1];
  for (int64_t i = 0; i < job.count; i++)
    if (may_touch(job, job.rects[i], begin, end)) memset(gradients + i, 0, sizeof *gradients);
  const int squarings = squarings_for(job.log2_alpha_min);
  for (int32_t tile = begin; tile < end; tile++) {
    if (squarings == 3) walk_tile<3>(job, tile, gradients);
    else if (squarings == 4) walk_tile<4>(job, tile, gradients);
    else walk_tile<5>(job, tile, gradients);
  }
}

}  // namespace jg
