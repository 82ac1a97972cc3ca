// Walking through the Gaussians of a 16 x 16 tile, 4 x 4 pixels per vector. Shared by blend and its backward pass, so
// that both meet the same Gaussians and find the same alpha.
#pragma once
#include "raster.h"
#include "vec.h"

namespace jg {

constexpr int BLOCKS = (TILE_PX / BLOCK_PX) * (TILE_PX / BLOCK_PX);
static_assert(BLOCK_PX * BLOCK_PX == LANES, "a block is one vector");

// Pixel centers of a block relative to its top-left corner.
const vf LANE_X = {.5f, 1.5f, 2.5f, 3.5f, .5f, 1.5f, 2.5f, 3.5f, .5f, 1.5f, 2.5f, 3.5f, .5f, 1.5f, 2.5f, 3.5f};
const vf LANE_Y = {.5f, .5f, .5f, .5f, 1.5f, 1.5f, 1.5f, 1.5f, 2.5f, 2.5f, 2.5f, 2.5f, 3.5f, 3.5f, 3.5f, 3.5f};

struct Tile {
  int32_t x, y;         // top-left pixel
  const int32_t* list;  // Gaussians, front to back
  int32_t length;
};

JG_INLINE Tile tile_at(const RasterJob& job, int32_t index) {
  const int32_t begin = job.tile_start[index], end = job.tile_start[index + 1];
  return {index % job.tiles_x * TILE_PX, index / job.tiles_x * TILE_PX, job.tile_list + begin, end - begin};
}

// Offset of a block inside its tile, px.
JG_INLINE int32_t block_x(int block) { return block % (TILE_PX / BLOCK_PX) * BLOCK_PX; }
JG_INLINE int32_t block_y(int block) { return block / (TILE_PX / BLOCK_PX) * BLOCK_PX; }

// Sixteen pixels of a plane, as four rows of four. The copies have a constant size (a variable one is a library call,
// and storing lane by lane is slow too); only blocks across the picture's border go pixel by pixel.
JG_INLINE void store_pixels(const RasterJob& job, float* planes, int plane, int32_t x, int32_t y, vf v) {
  alignas(64) float values[LANES];
  store(values, v);
  float* out = planes + ((int64_t)plane * job.height + y) * job.width + x;
  if (x + BLOCK_PX <= job.width && y + BLOCK_PX <= job.height) {
    for (int row = 0; row < BLOCK_PX; row++, out += job.width) memcpy(out, values + BLOCK_PX * row, 4 * BLOCK_PX);
    return;
  }
  for (int lane = 0; lane < LANES; lane++) {
    const int column = lane % BLOCK_PX, row = lane / BLOCK_PX;
    if (x + column < job.width && y + row < job.height) out[(int64_t)row * job.width + column] = values[lane];
  }
}

// The same backwards; zero beyond the border.
JG_INLINE vf load_pixels(const RasterJob& job, const float* planes, int plane, int32_t x, int32_t y) {
  alignas(64) float values[LANES] = {};
  const float* in = planes + ((int64_t)plane * job.height + y) * job.width + x;
  if (x + BLOCK_PX <= job.width && y + BLOCK_PX <= job.height) {
    for (int row = 0; row < BLOCK_PX; row++, in += job.width) memcpy(values + BLOCK_PX * row, in, 4 * BLOCK_PX);
    return load(values);
  }
  for (int lane = 0; lane < LANES; lane++) {
    const int column = lane % BLOCK_PX, row = lane / BLOCK_PX;
    if (x + column < job.width && y + row < job.height) values[lane] = in[(int64_t)row * job.width + column];
  }
  return load(values);
}

// A run of a tile's list, copied to the first-level cache with centers relative to the tile.
struct Chunk {
  Record records[CHUNK];
  alignas(64) float u[CHUNK], v[CHUNK], radius2[CHUNK];
  int32_t length;
};

// layer: (count, 4) of these Gaussians; null: none
JG_INLINE void load_chunk(Chunk& chunk, const RasterJob& job, const Tile& tile, int32_t begin,
                          const float* layer = nullptr) {
  chunk.length = tile.length - begin < CHUNK ? tile.length - begin : CHUNK;
  const float x = (float)tile.x, y = (float)tile.y;
  // asked for all at once, the records arrive together instead of one after the other
  for (int k = 0; k < chunk.length; k++) __builtin_prefetch(job.records + tile.list[begin + k]);
  for (int k = 0; k < chunk.length; k++) {
    Record& record = chunk.records[k];
    memcpy((void*)&record, job.records + tile.list[begin + k], sizeof record);
    if (layer) memcpy(record.layer, layer + 4 * (int64_t)tile.list[begin + k], sizeof record.layer);
    record.u -= x, record.v -= y;
    chunk.u[k] = record.u, chunk.v[k] = record.v, chunk.radius2[k] = record.radius2;
  }
  for (int k = chunk.length; k % LANES; k++) chunk.u[k] = chunk.v[k] = 0, chunk.radius2[k] = -1;
}

// For every byte the places of its set bits, lowest first: appends the hits among eight Gaussians with one store and no
// branch. (A loop over the bits of a mask cost half of blend's time, in branches that cannot be predicted.)
struct BitPlaces {
  uint8_t place[256][8];
  constexpr BitPlaces() : place() {
    for (int byte = 0; byte < 256; byte++)
      for (int bit = 0, n = 0; bit < 8; bit++)
        if (byte >> bit & 1) place[byte][n++] = (uint8_t)bit;
  }
};
constexpr BitPlaces BIT_PLACES;
static_assert(CHUNK <= 256, "hits are bytes");

// The Gaussians of a chunk that matter to a block, front to back. Up to eight bytes beyond the last hit are written.
struct Hits {
  uint8_t index[CHUNK + 8];
  int32_t count;
};

// Those whose circle reaches a pixel center of the block.
JG_INLINE void find_hits(const Chunk& chunk, int block, Hits& hits) {
  const float half = 0.5f * (BLOCK_PX - 1);  // pixel centers lie within this distance of the block's center
  const float x = block_x(block) + 0.5f * BLOCK_PX, y = block_y(block) + 0.5f * BLOCK_PX;
  int n = 0;
  for (int k = 0; k < chunk.length; k += LANES) {
    const vf dx = max(abs(load(chunk.u + k) - x) - half, vf{}), dy = max(abs(load(chunk.v + k) - y) - half, vf{});
    const uint32_t mask = bit_mask(dx * dx + dy * dy <= load(chunk.radius2 + k));
    for (int part = 0; part < LANES; part += 8) {
      const uint32_t byte = mask >> part & 255;
      uint64_t places;
      memcpy(&places, BIT_PLACES.place[byte], 8);
      places += 0x0101010101010101u * (uint64_t)(k + part);  // no carries: k + part + 7 < 256
      memcpy(hits.index + n, &places, 8);
      n += __builtin_popcount(byte);
    }
  }
  hits.count = n;
}

// A Gaussian on the sixteen pixels (x, y) of a block.
struct Coverage {
  vf dx, dy;     // pixel minus center, px
  vf uncapped;   // opacity exp(-q); meaningless where alpha is cut
  vf alpha;      // cut below alpha_min, capped at alpha_max
};

template <int SQUARINGS>
JG_INLINE Coverage cover(const Record& g, vf x, vf y, float log2_alpha_min, float alpha_max) {
  Coverage c;
  c.dx = x - g.u, c.dy = y - g.v;
  const vf exponent = (c.dx * g.xx + c.dy * g.xy) * c.dx + (c.dy * c.dy * g.yy + g.log2_opacity);
  c.uncapped = exp2_of_negative<SQUARINGS>(exponent);
  c.alpha = exponent > log2_alpha_min ? min(c.uncapped, all(alpha_max)) : vf{};
  return c;
}

// Squarings that exp2_of_negative needs down to the cut. More cost a little time and accuracy, so: as few as possible.
JG_INLINE int squarings_for(float log2_alpha_min) { return log2_alpha_min > -8 ? 3 : log2_alpha_min > -16 ? 4 : 5; }

}  // namespace jg
