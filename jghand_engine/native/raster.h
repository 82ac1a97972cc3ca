// The rasterizer: Gaussians to pictures and back. RENDERING 3 is the contract, RENDERING 4 the design.
//
//   project   every Gaussian: center, conic, footprint in tiles, depth key; what cannot be seen is culled
//   sort      the visible ones by camera depth, ties by index
//   bin       a list per 16 x 16 tile, in depth order
//   blend     per tile, front to back, a 4 x 4 block of pixels per vector
//   backward  the same walk with the gradient of the picture, then the chain rule to the inputs
//
// One RasterJob describes a picture; native/rasterizer.py owns its memory and mirrors it field by field.
#pragma once
#include <stdint.h>

#include "constants.h"
#include "team.h"

namespace jg {

// A projected Gaussian: log2(alpha) = xx dx^2 + xy dx dy + yy dy^2 + log2_opacity, with (dx, dy) from its center in px.
struct alignas(64) Record {
  float u, v;                // center, px
  float xx, xy, yy;          // conic times -1/2 log2(e), 1/px^2
  float log2_opacity;
  float r, g, b;
  float z;                   // camera depth, m
  float radius2;             // beyond this squared distance (px^2) alpha is below the cut
  float front;
  float layer[4];            // of the layer that is blended; set in a chunk
};

// Gradients of one Gaussian's record, summed over pixels; the moments are of g = dL/d(alpha) alpha.
struct alignas(64) RecordGradient {
  float m, mx, my, mxx, mxy, myy;  // sums of g, g dx, g dy, g dx^2, g dx dy, g dy^2
  float r, g, b;
  float z;
  float unused[6];
};

// Tiles touched, both ends included.
struct TileRect {
  int16_t x0, x1, y0, y1;
};

// What a part of the Gaussians found out while projecting.
struct PartSummary {
  int32_t visible, invalid;
  uint32_t key_min, key_max;
};

enum Status : int32_t { DONE = 0, LIST_TOO_SMALL = 1, TOO_MANY_PAIRS = 2 };

struct RasterJob {
  // the Gaussians, float32
  const float* position;  // (count, 3) m
  const float* sigma;     // (count) m; not read when there are covariances
  const float* covariance;  // (count, 6) m^2, xx xy xz yy yz zz in the frame of the positions; null: spheres
  const float* opacity;   // (count)
  const float* rgb;       // (count, 3)
  const float* front;     // (count) part of it that is seen from outside, by which rgb is multiplied already: pixels get
                          // the color that these parts have, as if none were seen from inside, through gaps between
                          // others, nor what stands beneath a layer; and outlines are sharper, see store_block.
                          // Below 0: it is not drawn. null: all of all, as blended. There is no backward pass of such
                          // a picture
  const float* layer;       // (layers, count, 4) colors that are drawn beside rgb, in the same way, where there is a `front`
  float* layer_planes;      // (layers, 4, height, width) of these
  const float* surface;     // (height, width), rows surface_stride apart, with a margin of nothing on
                            // each side (SURFACE_MARGIN_PX of native/rasterizer.py): how near the skin is, 1/z or, of parallel rays, -z, NOT_NEAR where there is none;
                            // where there is some, Gaussians with a `front` that are not its own count less, see `Own`.
                            // null: all count
  // scratch that forward leaves for backward
  Record* records;          // (count)
  TileRect* rects;          // (count): of culled ones x1 is -1
  uint64_t* sort_a;         // (count)
  uint64_t* sort_b;         // (count)
  int32_t* order;           // (count): the visible Gaussians, front to back
  PartSummary* summaries;   // (parts)
  int32_t* part_cursors;    // (parts, tiles_y + 1, tiles_x + 1)
  int32_t* tile_start;      // (tiles + 1): where each tile's list begins
  int32_t* tile_list;       // (list_capacity): Gaussians, front to back per tile
  int32_t* tile_work;       // (tiles): work done by blend, for sharing backward evenly; 0 where nothing is
  float* planes;            // (5, height, width): premultiplied R G B, alpha, sum of weight times depth
  // backward only
  const float* plane_gradients;       // (5, height, width)
  RecordGradient* record_gradients;   // (GRADIENT_STRIPES, count)
  float* position_gradient;           // (count, 3)
  float* sigma_gradient;              // (count); not written when there are covariances
  float* covariance_gradient;         // (count, 6); written when there are covariances
  float* opacity_gradient;            // (count)
  float* rgb_gradient;                // (count, 3)
  Team* team;
  int64_t list_capacity;
  int64_t pairs;                      // out: entries of all lists
  double camera_from_position[12];    // (3, 4), row by row
  float fx, fy, cx, cy;               // px
  float z_near;                       // m
  float low_pass_m2;                  // squared width of the low pass where the Gaussians are, at least
  float log2_alpha_min, alpha_max, t_stop;
  float own_before, own_behind, own_steepest, others_part;  // of that surface, see `Own`
  int32_t count, width, height, tiles_x, tiles_y;
  int32_t parts;                      // how finely the Gaussians are shared between threads; does not change the result
  int32_t visible, invalid;           // out
  int32_t status;                     // out
  int32_t orthographic;               // 1: parallel rays; fx and fy are px per meter then
  int32_t keeps_empty;                // 1: planes and tile_work are those of the last picture, or zeros
  int32_t layers, surface_stride;
};

// Steps of the forward call. Ranges of Gaussians or of tiles are given as the item of a step.
void project_part(const RasterJob& job, int32_t part);
void sort_visible(RasterJob& job);
void count_part(const RasterJob& job, int32_t part);
void lay_out_lists(RasterJob& job);
void fill_part(const RasterJob& job, int32_t part);
void blend_tile(const RasterJob& job, int32_t tile);

// Steps of the backward call.
struct Stripes {
  int32_t cut[GRADIENT_STRIPES + 1];  // stripe i is tiles cut[i] .. cut[i + 1]
};
Stripes cut_stripes(const RasterJob& job);
void blend_backward_stripe(const RasterJob& job, const Stripes& stripes, int32_t stripe);
void chain_rule_part(const RasterJob& job, const Stripes& stripes, int32_t part);

// Whether any tile of the `rect` of a visible Gaussian lies between tiles begin and end in memory order, or might: only
// such stripes have to be cleared before, and added after, the backward pass.
inline bool may_touch(const RasterJob& job, const TileRect& rect, int32_t begin, int32_t end) {
  return rect.x1 >= 0 && rect.y0 * job.tiles_x + rect.x0 < end && rect.y1 * job.tiles_x + rect.x1 >= begin;
}

}  // namespace jg
