// Projection and culling. No branches per Gaussian: validity tests are combined with &, and since every comparison with
// a NaN is false, a NaN ends as culled.
#include <math.h>

#include "projection.h"

namespace jg {
namespace {

// Lanes 0 .. n - 1.
JG_INLINE vi first_lanes(int n) {
  const vi lane = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  return lane < n;
}

JG_INLINE vi within(vf x, float limit) { return (x <= limit) & (x >= -limit); }

JG_INLINE vi valid_input(const Inputs& in) {
  return within(in.px, POSITION_MAX_M) & within(in.py, POSITION_MAX_M) & within(in.pz, POSITION_MAX_M) &
         (in.opacity >= 0) & (in.opacity <= 1) &  //
         within(in.r, RGB_MAX) & within(in.g, RGB_MAX) & within(in.b, RGB_MAX);
}

JG_INLINE vi valid_shapes(const Spheres& shapes) { return (shapes.sigma > 0) & (shapes.sigma < INFINITY); }

// Finite, not zero, and positive semi-definite up to rounding: with a little of the trace added to the diagonal, all
// leading minors are positive (Sylvester; then the trace is too). Flat Gaussians pass, however they were rounded.
JG_INLINE vi valid_shapes(const Ellipsoids& shapes) {
  const vd xy = wide(shapes.xy), xz = wide(shapes.xz), yz = wide(shapes.yz);
  const vd trace = wide(shapes.xx) + wide(shapes.yy) + wide(shapes.zz), slack = trace * COVARIANCE_SLACK;
  const vd xx = wide(shapes.xx) + slack, yy = wide(shapes.yy) + slack, zz = wide(shapes.zz) + slack;
  const vd two = xx * yy - xy * xy;
  const vd three = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
  return __builtin_convertvector((trace < INFINITY) & (xx > 0) & (two > 0) & (three > 0), vi);
}

JG_INLINE void store_records(Record* out, int n, const Projection& p, const Inputs& in, vf u, vf v, vf log2_opacity,
                             vf radius2) {
  const float half_log2e = 0.5f * LOG2E;
  vf rows[LANES] = {u,
                    v,
                    p.c * p.inverse_det * -half_log2e,
                    p.b * p.inverse_det * (2 * half_log2e),
                    p.a * p.inverse_det * -half_log2e,
                    log2_opacity,
                    in.r,
                    in.g,
                    in.b,
                    p.z,
                    radius2,
                    in.front};
  transpose(rows);
  memcpy((void*)out, rows, n * sizeof(Record));
}

// The tiles that the box u +- rx, v +- ry of a visible Gaussian reaches. Clamped before the conversion: floats beyond
// int range are undefined.
JG_INLINE void store_rects(TileRect* out, int n, const RasterJob& job, vi seen, vf u, vf v, vf rx, vf ry) {
  const vf right = all((float)(job.width - 1)), bottom = all((float)(job.height - 1));
  auto tile = [](vf px, vf last) __attribute__((always_inline)) {
    return __builtin_convertvector(min(max(px, vf{}), last) * (1.0f / TILE_PX), vi);
  };
  const vi x0 = tile(u - rx, right), x1 = tile(u + rx, right), y0 = tile(v - ry, bottom), y1 = tile(v + ry, bottom);
  const vi x = seen ? x0 | x1 << 16 : all(-1), y = y0 | y1 << 16;
  int32_t xs[LANES], ys[LANES];
  store(xs, x), store(ys, y);
  for (int i = 0; i < n; i++) {
    memcpy((char*)(out + i), xs + i, 4);
    memcpy((char*)(out + i) + 4, ys + i, 4);
  }
}

template <class Shapes>
void project_range(const RasterJob& job, int32_t part) {
  const Range range = part_of(job.count, part, job.parts);
  uint64_t* keys = job.sort_a + range.begin;
  PartSummary summary = {0, 0, UINT32_MAX, 0};
  for (int64_t i = range.begin; i < range.end; i += LANES) {
    const int n = range.end - i < LANES ? (int)(range.end - i) : LANES;
    const Inputs in = load_inputs(job, i, n);
    Shapes shapes;
    load_shapes(job, i, n, shapes);
    const Projection p = project(job, in, shapes);
    const vf u = p.u + job.cx, v = p.v + job.cy, log2_opacity = log2(in.opacity);
    // alpha reaches the cut on the ellipse q = ln(opacity / alpha_min), whose box is sqrt(k a), sqrt(k c)
    const vf k = (log2_opacity - job.log2_alpha_min) * (2 * LN2), reach = max(k, vf{});
    const vf rx = sqrt(reach * p.a), ry = sqrt(reach * p.c);

    const vi present = first_lanes(n), valid = valid_input(in) & valid_shapes(shapes), in_front = p.z > job.z_near;
    const vi sized = (p.a < VAR_MAX_PX2) & (p.c < VAR_MAX_PX2);
    const vi on_picture = (u + rx > 0) & (u - rx < (float)job.width) & (v + ry > 0) & (v - ry < (float)job.height);
    const vi seen = present & valid & in_front & sized & (k > 0) & on_picture & (in.front >= 0);
    summary.invalid += __builtin_popcount(bit_mask(present & (~valid | (in_front & ~sized))));

    store_records(job.records + i, n, p, in, u, v, log2_opacity, reach * (max(p.a, p.c) + abs(p.b)));
    store_rects(job.rects + i, n, job, seen, u, v, rx, ry);
    uint32_t depth_bits[LANES];  // z > 0: the bit pattern orders like the value
    memcpy(depth_bits, &p.z, sizeof depth_bits);
    for (uint32_t mask = bit_mask(seen); mask; mask &= mask - 1) {
      const int lane = __builtin_ctz(mask);
      const uint32_t key = depth_bits[lane];
      if (key < summary.key_min) summary.key_min = key;
      if (key > summary.key_max) summary.key_max = key;
      keys[summary.visible++] = (uint64_t)key << 32 | (uint32_t)(i + lane);
    }
  }
  job.summaries[part] = summary;
}

}  // namespace

void project_part(const RasterJob& job, int32_t part) {
  if (job.covariance) return project_range<Ellipsoids>(job, part);
  project_range<Spheres>(job, part);
}

}  // namespace jg
