// Lists of Gaussians per tile. Each part counts and fills its own range of the depth-ordered Gaussians; cursors laid
// out by tile, then part, make every list come out in depth order without sorting it.
#include <string.h>

#include "raster.h"

namespace jg {
namespace {

// The counts of a part are a grid with one more row and column than there are tiles: count_part writes the corners of
// rectangles there, and one running sum in x and y turns corners into counts. Four additions per Gaussian and no loop
// whose length the processor cannot guess.
int32_t* grid_of(const RasterJob& job, int32_t part) {
  return job.part_cursors + (int64_t)part * (job.tiles_x + 1) * (job.tiles_y + 1);
}

}  // namespace

void count_part(const RasterJob& job, int32_t part) {
  const int32_t pitch = job.tiles_x + 1;
  int32_t* grid = grid_of(job, part);
  memset(grid, 0, sizeof(int32_t) * pitch * (job.tiles_y + 1));
  const Range range = part_of(job.visible, part, job.parts);
  for (int64_t slot = range.begin; slot < range.end; slot++) {
    const TileRect rect = job.rects[job.order[slot]];
    int32_t *top = grid + rect.y0 * pitch, *below = grid + (rect.y1 + 1) * pitch;
    top[rect.x0]++, top[rect.x1 + 1]--, below[rect.x0]--, below[rect.x1 + 1]++;
  }
  for (int32_t y = 0; y < job.tiles_y; y++) {
    int32_t* row = grid + y * pitch;
    for (int32_t x = 0, sum = 0; x < job.tiles_x; x++) {
      sum += row[x];
      row[x] = sum + (y ? row[x - pitch] : 0);
    }
  }
}

void lay_out_lists(RasterJob& job) {
  int64_t sum = 0;
  job.status = DONE;
  for (int32_t y = 0, tile = 0; y < job.tiles_y; y++) {
    for (int32_t x = 0; x < job.tiles_x; x++, tile++) {
      job.tile_start[tile] = (int32_t)sum;
      for (int32_t part = 0; part < job.parts; part++) {
        int32_t& cursor = grid_of(job, part)[y * (job.tiles_x + 1) + x];
        const int32_t n = cursor;
        cursor = (int32_t)sum, sum += n;
      }
      if (sum > INT32_MAX) {  // one tile adds less than 2^31, so nothing has overflowed before this is seen
        job.status = TOO_MANY_PAIRS;
        return;
      }
    }
  }
  job.tile_start[job.tiles_x * job.tiles_y] = (int32_t)sum;
  job.pairs = sum;
  if (sum > job.list_capacity) job.status = LIST_TOO_SMALL;
}

void fill_part(const RasterJob& job, int32_t part) {
  const int32_t pitch = job.tiles_x + 1;
  int32_t *grid = grid_of(job, part), *list = job.tile_list;
  const Range range = part_of(job.visible, part, job.parts);
  for (int64_t slot = range.begin; slot < range.end; slot++) {
    const int32_t gaussian = job.order[slot];
    const TileRect rect = job.rects[gaussian];
    for (int32_t y = rect.y0; y <= rect.y1; y++)
      for (int32_t x = rect.x0; x <= rect.x1; x++) list[grid[y * pitch + x]++] = gaussian;
  }
}

}  // namespace jg
