// Front to back: weight = alpha T, T -= weight; color, depth and coverage are sums of weights.
#include "tile.h"

namespace jg {
namespace {

constexpr float ANY_DEPTH_M = 1e9f;  // no Gaussian is as far away
constexpr int UNROLL = 4;  // Gaussians between two tests whether all pixels of a block are covered

// What pixels get of Gaussians: their colors; and FRONT: the color of what is seen from outside and stands in front, and a
// sharper outline, as coverage goes up from COVER_FROM on; LAYER: with colors that are drawn beside, too.
enum Kind { PLAIN, FRONT, LAYER };

// Transmittance from which on a pixel may stop. Of FRONT it goes no lower: what comes after would add nothing.
template <Kind KIND>
JG_INLINE float stop_of(const RasterJob& job) {
  return KIND == PLAIN ? job.t_stop : BENEATH_FROM;
}

// Which depths are those of the skin that a pixel shows: other Gaussians are of a finger before or behind it, and would
// blur its edge. middle, half: m
struct Own {
  vf middle, half;
};

// From `own_before` before to `own_behind` behind the skin, and the width of a pixel farther; more where it is steep, up to
// `own_steepest` times; where there is none, all.
JG_INLINE Own own_depths(const RasterJob& job, int32_t x, int32_t y) {
  const Own all_depths = {vf{}, all(ANY_DEPTH_M)};
  if (!job.surface) return all_depths;
  const auto near_at = [&](int dx, int dy) __attribute__((always_inline)) {
    vf near;
    const float* from = job.surface + (int64_t)(y + dy) * job.surface_stride + x + dx;
    for (int row = 0; row < BLOCK_PX; row++, from += job.surface_stride)
      memcpy((char*)&near + 4 * BLOCK_PX * row, from, 4 * BLOCK_PX);
    return near;
  };
  const auto is_there = [](vf near) { return near > NOT_NEAR; };
  const auto depth = [&](vf near) { return job.orthographic ? -near : 1.0f / near; };
  const vf here = near_at(0, 0);
  if (!bit_mask(is_there(here))) return all_depths;
  const vf z = depth(here), per_m = job.orthographic ? all(1.0f) : here;
  vf steep2 = {};
  for (int axis = 0; axis < 2; axis++) {
    vf change = all(ANY_DEPTH_M);
    for (int side = -1; side <= 1; side += 2) {
      const vf beside = near_at(axis ? 0 : side, axis ? side : 0);
      change = min(change, select(is_there(beside), abs(depth(beside) - z), all(ANY_DEPTH_M)));
    }
    const vf slope = change * per_m * (axis ? job.fy : job.fx);
    steep2 += slope * slope;
  }
  const vf steep = min(sqrt(1.0f + steep2), all(job.own_steepest));
  const vf middle = z + 0.5f * (job.own_behind - job.own_before) * steep;
  const vf half = (0.5f * (job.own_behind + job.own_before) + 1.0f / (per_m * job.fx)) * steep;
  return {select(is_there(here), middle, vf{}), select(is_there(here), half, all(ANY_DEPTH_M))};
}

// One 4 x 4 block on its way through the list.
struct Block {
  vf transmittance, r, g, b, depth, front, layer[4];
  Own own;
};

template <int SQUARINGS, Kind KIND>
JG_INLINE void blend_hits(const RasterJob& job, const Chunk& chunk, int index, const Hits& hits, Block& block) {
  const vf x = LANE_X + (float)block_x(index), y = LANE_Y + (float)block_y(index);
  const float log2_alpha_min = job.log2_alpha_min, alpha_max = job.alpha_max, t_stop = stop_of<KIND>(job);
  vf T = block.transmittance, r = block.r, g = block.g, b = block.b, depth = block.depth, front = block.front;
  const vf middle = block.own.middle, half = block.own.half, others = all(job.others_part);
  vf layer[4];
  for (int k = 0; k < 4; k++) layer[k] = block.layer[k];
  auto add = [&](int hit) __attribute__((always_inline)) {
    const Record& record = chunk.records[hit];
    vf alpha = cover<SQUARINGS>(record, x, y, log2_alpha_min, alpha_max).alpha;
    if (KIND != PLAIN) alpha = select(abs(record.z - middle) < half, alpha, alpha * others);
    const vf weight = alpha * T;
    const vf shown = KIND != PLAIN ? weight * clamped((T - BENEATH_FROM) * (1.0f / (BENEATH_WHOLE - BENEATH_FROM))) : weight;
    const vf beneath = KIND != PLAIN ? max(T - weight, all(BENEATH_FROM)) : T - weight;
    const vf counted = KIND != PLAIN ? T - beneath : weight;
    T = beneath;
    r += shown * record.r, g += shown * record.g, b += shown * record.b, depth += counted * record.z;
    if (KIND != PLAIN) front += shown * record.front;
    for (int k = 0; KIND == LAYER && k < 4; k++) layer[k] += shown * record.layer[k];
  };
  int i = 0, n = hits.count;
  for (; i + UNROLL <= n; i += UNROLL) {
    for (int k = 0; k < UNROLL; k++) add(hits.index[i + k]);
    if (!bit_mask(T > t_stop)) n = 0;
  }
  for (; i < n; i++) add(hits.index[i]);
  block = {T, r, g, b, depth, front, {layer[0], layer[1], layer[2], layer[3]}, block.own};
}

template <Kind KIND>
JG_INLINE void store_block(const RasterJob& job, const Block& block, int32_t layer, int32_t x, int32_t y) {
  const vf alpha = 1.0f - block.transmittance;
  vf gain = all(1.0f), cover = alpha, nearer = gain;
  if (KIND != PLAIN) {
    cover = smooth((alpha - COVER_FROM) / (COVER_WHOLE - COVER_FROM));
    gain = select(alpha > 0, cover / max(block.front, FRONT_MIN * alpha), vf{});
    nearer = select(alpha > 0, cover / alpha, vf{});
  }
  const vf planes[5] = {block.r * gain, block.g * gain, block.b * gain, cover, block.depth * nearer};
  for (int plane = 0; plane < 5; plane++) store_pixels(job, job.planes, plane, x, y, planes[plane]);
  for (int k = 0; KIND == LAYER && k < 4; k++)
    store_pixels(job, job.layer_planes, 4 * layer + k, x, y, block.layer[k] * gain);
}

template <int SQUARINGS, Kind KIND>
void blend_with(const RasterJob& job, int32_t index, int32_t layer) {
  const Tile tile = tile_at(job, index);
  Chunk chunk;
  Hits hits;
  Block blocks[BLOCKS];
  uint32_t live = 0;  // blocks on the picture with a pixel that still lets light through
  for (int b = 0; b < BLOCKS; b++) {
    blocks[b] = {all(1.0f)};
    const int32_t x = tile.x + block_x(b), y = tile.y + block_y(b);
    if (x >= job.width || y >= job.height) continue;
    live |= 1u << b;
    if (KIND != PLAIN && tile.length) blocks[b].own = own_depths(job, x, y);
  }
  const uint32_t on_picture = live;
  int32_t work = 0;
  for (int32_t begin = 0; begin < tile.length && live; begin += CHUNK) {
    load_chunk(chunk, job, tile, begin, KIND == LAYER ? job.layer + 4 * job.count * (int64_t)layer : nullptr);
    work += chunk.length;
    for (uint32_t rest = live; rest; rest &= rest - 1) {
      const int b = __builtin_ctz(rest);
      find_hits(chunk, b, hits);
      if (!hits.count) continue;
      work += hits.count;
      blend_hits<SQUARINGS, KIND>(job, chunk, b, hits, blocks[b]);
      if (!bit_mask(blocks[b].transmittance > stop_of<KIND>(job))) live &= ~(1u << b);
    }
  }
  job.tile_work[index] = work;
  for (uint32_t rest = on_picture; rest; rest &= rest - 1) {
    const int b = __builtin_ctz(rest);
    store_block<KIND>(job, blocks[b], layer, tile.x + block_x(b), tile.y + block_y(b));
  }
}

template <Kind KIND>
void blend(const RasterJob& job, int32_t tile, int32_t layer = 0) {
  switch (squarings_for(job.log2_alpha_min)) {
    case 3: return blend_with<3, KIND>(job, tile, layer);
    case 4: return blend_with<4, KIND>(job, tile, layer);
    default: return blend_with<5, KIND>(job, tile, layer);
  }
}

}  // namespace

void blend_tile(const RasterJob& job, int32_t tile) {
  if (job.tile_start[tile] == job.tile_start[tile + 1] && job.keeps_empty && !job.tile_work[tile]) return;
  // each with the rest anew: there is hardly ever more than one
  for (int32_t layer = 0; layer < job.layers; layer++) blend<LAYER>(job, tile, layer);
  if (job.layers) return;
  job.front ? blend<FRONT>(job, tile) : blend<PLAIN>(job, tile);
}

}  // namespace jg
