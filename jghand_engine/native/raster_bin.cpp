// Lists of Gaussians per tile. Each part counts and fills its own range of the depth-ordered Gaussians; cursors laid out
// by tile, then part, make every list come out in depth order without sorting it.
#include <string.h>

#include "raster.h"

namespace jg {
namespace {

template <class Visit>
inline void for_each_tile(const RasterJob& job, int32_t part, Visit visit) {
  const Range range = part_of(job.visible, part, job.parts);
  for (int64_t slot = range.begin; slot < range.end; slot++) {
    const int32_t gaussian = job.order[slot];
    const TileRect rect = job.rects[gaussian];
    for (int y = rect.y0; y <= rect.y1; y++)
      for (int x = rect.x0; x <= rect.x1; x++) visit(y * job.tiles_x + x, gaussian);
  }
}

int32_t* cursors_of(const RasterJob& job, int32_t part) {
  return job.part_cursors + (int64_t)part * job.tiles_x * job.tiles_y;
}

}  // namespace

void count_part(const RasterJob& job, int32_t part) {
  int32_t* count = cursors_of(job, part);
  memset(count, 0, sizeof(int32_t) * job.tiles_x * job.tiles_y);
  for_each_tile(job, part, [count](int32_t tile, int32_t) { count[tile]++; });
}

void lay_out_lists(RasterJob& job) {
  const int32_t tiles = job.tiles_x * job.tiles_y;
  int64_t sum = 0;
  job.status = DONE;
  for (int32_t tile = 0; tile < tiles; tile++) {
    job.tile_start[tile] = (int32_t)sum;
    for (int32_t part = 0; part < job.parts; part++) {
      int32_t& cursor = cursors_of(job, part)[tile];
      const int32_t n = cursor;
      cursor = (int32_t)sum, sum += n;
    }
    if (sum > INT32_MAX) {  // one tile adds less than 2^31, so the sum itself is still right here
      job.status = TOO_MANY_PAIRS;
      return;
    }
  }
  job.tile_start[tiles] = (int32_t)sum;
  job.pairs = sum;
  if (sum > job.list_capacity) job.status = LIST_TOO_SMALL;
}

void fill_part(const RasterJob& job, int32_t part) {
  int32_t* cursor = cursors_of(job, part);
  int32_t* list = job.tile_list;
  for_each_tile(job, part, [cursor, list](int32_t tile, int32_t gaussian) { list[cursor[tile]++] = gaussian; });
}

}  // namespace jg
