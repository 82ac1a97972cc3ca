// The chain rule from a projected Gaussian back to its position, sigma, opacity and colour.
#include "projection.h"

namespace jg {
namespace {

// Gradients of sixteen records, stripes added in fixed order. Culled Gaussians get zeros.
struct RecordGradients {
  vf m, mx, my, mxx, mxy, myy, r, g, b, z;
};

// Slots are scattered: asks for the rows of the Gaussians after these, so that they are there when their turn comes.
JG_INLINE void prefetch_rows(const RasterJob& job, int64_t first) {
  for (int64_t i = first; i < first + LANES && i < job.count; i++) {
    const int64_t slot = job.slots[i];
    if (slot < 0) continue;
    __builtin_prefetch(job.rects + slot);
    for (int stripe = 0; stripe < GRADIENT_STRIPES; stripe++)
      __builtin_prefetch(&job.record_gradients[(int64_t)stripe * job.count + slot]);
  }
}

JG_INLINE RecordGradients gather(const RasterJob& job, const Stripes& stripes, int64_t first, int n, vi& seen) {
  vf rows[LANES] = {};
  for (int lane = 0; lane < n; lane++) {
    const int64_t slot = job.slots[first + lane];
    seen[lane] = slot < 0 ? 0 : -1;
    if (slot < 0) continue;
    const TileRect rect = job.rects[slot];
    for (int stripe = 0; stripe < GRADIENT_STRIPES; stripe++)
      if (may_touch(job, rect, stripes.cut[stripe], stripes.cut[stripe + 1]))
        rows[lane] += load(&job.record_gradients[(int64_t)stripe * job.count + slot].m);
  }
  transpose(rows);
  return {rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6], rows[7], rows[8], rows[9]};
}

struct InputGradients {
  vf px, py, pz, sigma, opacity;
};

JG_INLINE InputGradients chain_rule(const RasterJob& job, const Inputs& in, const RecordGradients& grad) {
  const Projection p = project(job, in);
  // conic of log2(alpha): xx = -K c/det, xy = 2 K b/det, yy = -K a/det
  const float K = 0.5f * LOG2E;
  const vf xx = p.c * p.inverse_det * -K, xy = p.b * p.inverse_det * (2 * K), yy = p.a * p.inverse_det * -K;
  // d(log2 alpha) from d(alpha) alpha: a factor ln 2
  const vf d_u = (xx * grad.mx * 2.0f + xy * grad.my) * -LN2, d_v = (xy * grad.mx + yy * grad.my * 2.0f) * -LN2;
  const vf d_xx = grad.mxx * LN2, d_xy = grad.mxy * LN2, d_yy = grad.myy * LN2;
  // conic to covariance
  const vf d_det = (d_xx * xx + d_xy * xy + d_yy * yy) * -p.inverse_det;
  const vf d_a = d_yy * p.inverse_det * -K + d_det * p.c, d_c = d_xx * p.inverse_det * -K + d_det * p.a;
  const vf d_b = d_xy * p.inverse_det * (2 * K) - d_det * p.b * 2.0f;
  // covariance to sigma and the Jacobian: a = (s jx)^2 + (s jxz)^2 + blur, c alike, b = (s jxz)(s jyz)
  const vf s = in.sigma, sx = s * p.jx, sy = s * p.jy, sxz = s * p.jxz, syz = s * p.jyz;
  const vf d_sx = d_a * sx * 2.0f, d_sy = d_c * sy * 2.0f;
  const vf d_sxz = d_a * sxz * 2.0f + d_b * syz, d_syz = d_c * syz * 2.0f + d_b * sxz;
  InputGradients out;
  out.sigma = d_sx * p.jx + d_sy * p.jy + d_sxz * p.jxz + d_syz * p.jyz;
  // jx = fx/z, u = jx x, jxz = -u/z, so d(jx)/dz = -jx/z, du/dz = jxz, d(jxz)/dz = -2 jxz/z, d(jxz)/dx = -jx/z; in this
  // form nothing is multiplied by z or x before it is divided by z, which could overflow for far Gaussians
  const vf d_jx = d_sx * s, d_jy = d_sy * s, d_jxz = d_sxz * s, d_jyz = d_syz * s, iz = p.inverse_z;
  const vf d_x = (d_u - d_jxz * iz) * p.jx, d_y = (d_v - d_jyz * iz) * p.jy;
  const vf d_z = grad.z + d_u * p.jxz + d_v * p.jyz -
                 iz * (d_jx * p.jx + d_jy * p.jy + (d_jxz * p.jxz + d_jyz * p.jyz) * 2.0f);
  // camera frame to the frame of the positions
  float M[12];
  for (int i = 0; i < 12; i++) M[i] = (float)job.camera_from_position[i];
  out.px = d_x * M[0] + d_y * M[4] + d_z * M[8];
  out.py = d_x * M[1] + d_y * M[5] + d_z * M[9];
  out.pz = d_x * M[2] + d_y * M[6] + d_z * M[10];
  out.opacity = grad.m / in.opacity;
  return out;
}

// Stores the first n of sixteen (x, y, z).
JG_INLINE void store_some_triples(float* out, int n, vf x, vf y, vf z) {
  float values[3 * LANES];
  store_triples(values, x, y, z);
  memcpy(out, values, 12 * n);
}

}  // namespace

void chain_rule_part(const RasterJob& job, const Stripes& stripes, int32_t part) {
  const Range range = part_of(job.count, part, job.parts);
  for (int64_t i = range.begin; i < range.end; i += LANES) {
    const int n = range.end - i < LANES ? (int)(range.end - i) : LANES;
    vi seen = {};
    prefetch_rows(job, i + LANES);
    const RecordGradients grad = gather(job, stripes, i, n, seen);
    const InputGradients out = chain_rule(job, load_inputs(job, i, n), grad);
    // culled Gaussians may be poisoned: their chain rule is thrown away, not multiplied by zero
    auto if_seen = [seen](vf v) __attribute__((always_inline)) { return seen ? v : vf{}; };
    const vf sigma = if_seen(out.sigma), opacity = if_seen(out.opacity);
    store_some_triples(job.position_gradient + 3 * i, n, if_seen(out.px), if_seen(out.py), if_seen(out.pz));
    store_some_triples(job.rgb_gradient + 3 * i, n, grad.r, grad.g, grad.b);
    memcpy(job.sigma_gradient + i, &sigma, 4 * n);
    memcpy(job.opacity_gradient + i, &opacity, 4 * n);
  }
}

}  // namespace jg
