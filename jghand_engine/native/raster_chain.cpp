// The chain rule from a projected Gaussian back to its position, sigma or covariance, opacity and color.
#include "projection.h"

namespace jg {
namespace {

// Gradients of sixteen records, stripes added in fixed order. Culled Gaussians get zeros.
struct RecordGradients {
  vf m, mx, my, mxx, mxy, myy, r, g, b, z;
};

JG_INLINE RecordGradients gather(const RasterJob& job, const Stripes& stripes, int64_t first, int n, vi& seen) {
  vf rows[LANES] = {};
  for (int lane = 0; lane < n; lane++) {
    const TileRect rect = job.rects[first + lane];
    seen[lane] = rect.x1 < 0 ? 0 : -1;
    for (int stripe = 0; stripe < GRADIENT_STRIPES; stripe++)
      if (may_touch(job, rect, stripes.cut[stripe], stripes.cut[stripe + 1]))
        rows[lane] += load(&job.record_gradients[(int64_t)stripe * job.count + first + lane].m);
  }
  transpose(rows);
  return {rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6], rows[7], rows[8], rows[9]};
}

// Gradients of what `spread` of projection.h makes of sixteen shapes and of the Jacobian.
struct SpreadGradients {
  vf a, b, c;
};
struct JacobianGradients {
  vf jx, jy, jxz, jyz;
};

// a = (s jx)^2 + (s jxz)^2 + blur, c alike, b = (s jxz)(s jyz)
JG_INLINE JacobianGradients spread_backward(const RasterJob&, const Projection& p, const Spheres& shapes,
                                            const SpreadGradients& grad, Spheres& out) {
  const vf s = shapes.sigma, sx = s * p.jx, sy = s * p.jy, sxz = s * p.jxz, syz = s * p.jyz;
  const vf d_sx = grad.a * sx * 2.0f, d_sy = grad.c * sy * 2.0f;
  const vf d_sxz = grad.a * sxz * 2.0f + grad.b * syz, d_syz = grad.c * syz * 2.0f + grad.b * sxz;
  out.sigma = d_sx * p.jx + d_sy * p.jy + d_sxz * p.jxz + d_syz * p.jyz;
  return {d_sx * s, d_sy * s, d_sxz * s, d_syz * s};
}

// a = tu S tu + blur, b = tu S tv, c = tv S tv + blur with the rows tu, tv of the Jacobian by the position. An entry
// beside the diagonal of the covariance S stands for both places.
JG_INLINE JacobianGradients spread_backward(const RasterJob& job, const Projection& p, const Ellipsoids& shapes,
                                            const SpreadGradients& grad, Ellipsoids& out) {
  const Vector tu = jacobian_row(job, 0, p.jx, p.jxz), tv = jacobian_row(job, 1, p.jy, p.jyz);
  const vd a = wide(grad.a), b = wide(grad.b), c = wide(grad.c);
  const Vector au = {a * tu.x + b * tv.x * 0.5, a * tu.y + b * tv.y * 0.5, a * tu.z + b * tv.z * 0.5};
  const Vector cv = {c * tv.x + b * tu.x * 0.5, c * tv.y + b * tu.y * 0.5, c * tv.z + b * tu.z * 0.5};
  out.xx = narrow(tu.x * au.x + tv.x * cv.x), out.xy = narrow((tu.y * au.x + tv.y * cv.x) * 2.0);
  out.yy = narrow(tu.y * au.y + tv.y * cv.y), out.xz = narrow((tu.z * au.x + tv.z * cv.x) * 2.0);
  out.zz = narrow(tu.z * au.z + tv.z * cv.z), out.yz = narrow((tu.z * au.y + tv.z * cv.y) * 2.0);
  // d(tu) = 2 S (a tu + b/2 tv), d(tv) alike; tu = jx R_0 + jxz R_2, tv = jy R_1 + jyz R_2
  const Vector d_tu = times(shapes, au), d_tv = times(shapes, cv);
  auto along = [&](const Vector& t, int row) __attribute__((always_inline)) {
    const double* r = job.camera_from_position + 4 * row;
    return narrow((t.x * r[0] + t.y * r[1] + t.z * r[2]) * 2.0);
  };
  return {along(d_tu, 0), along(d_tv, 1), along(d_tu, 2), along(d_tv, 2)};
}

struct InputGradients {
  vf px, py, pz, opacity;
};

template <class Shapes>
JG_INLINE InputGradients chain_rule(const RasterJob& job, const Inputs& in, const Shapes& shapes,
                                    const RecordGradients& grad, Shapes& d_shapes) {
  const Projection p = project(job, in, shapes);
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
  const JacobianGradients d = spread_backward(job, p, shapes, {d_a, d_b, d_c}, d_shapes);
  InputGradients out;
  // jx = fx/z, u = jx x, jxz = -u/z, so d(jx)/dz = -jx/z, du/dz = jxz, d(jxz)/dz = -2 jxz/z, d(jxz)/dx = -jx/z; in this
  // form nothing is multiplied by z or x before it is divided by z, which could overflow for far Gaussians
  const vf iz = p.inverse_z;
  vf d_x = (d_u - d.jxz * iz) * p.jx, d_y = (d_v - d.jyz * iz) * p.jy;
  vf d_z = grad.z + d_u * p.jxz + d_v * p.jyz -
           iz * (d.jx * p.jx + d.jy * p.jy + (d.jxz * p.jxz + d.jyz * p.jyz) * 2.0f);
  if (job.orthographic) d_x = d_u * p.jx, d_y = d_v * p.jy, d_z = grad.z;  // jx is a constant
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

// Stores the first n of sixteen gradients of shapes; culled Gaussians may be poisoned: theirs are thrown away, not
// multiplied by zero.
JG_INLINE void store_shapes(const RasterJob& job, int64_t first, int n, vi seen, const Spheres& shapes) {
  const vf sigma = seen ? shapes.sigma : vf{};
  memcpy(job.sigma_gradient + first, &sigma, 4 * n);
}

JG_INLINE void store_shapes(const RasterJob& job, int64_t first, int n, vi seen, const Ellipsoids& s) {
  vf rows[LANES] = {s.xx, s.xy, s.xz, s.yy, s.yz, s.zz};
  for (int k = 0; k < 6; k++) rows[k] = seen ? rows[k] : vf{};
  transpose(rows);
  float* out = job.covariance_gradient + 6 * first;
  for (int lane = 0; lane < n; lane++) memcpy(out + 6 * lane, &rows[lane], 24);
}

template <class Shapes>
void chain_rule_range(const RasterJob& job, const Stripes& stripes, int32_t part) {
  const Range range = part_of(job.count, part, job.parts);
  for (int64_t i = range.begin; i < range.end; i += LANES) {
    const int n = range.end - i < LANES ? (int)(range.end - i) : LANES;
    vi seen = {};
    const RecordGradients grad = gather(job, stripes, i, n, seen);
    Shapes shapes, d_shapes;
    load_shapes(job, i, n, shapes);
    const InputGradients out = chain_rule(job, load_inputs(job, i, n), shapes, grad, d_shapes);
    auto if_seen = [seen](vf v) __attribute__((always_inline)) { return seen ? v : vf{}; };
    const vf opacity = if_seen(out.opacity);
    store_some_triples(job.position_gradient + 3 * i, n, if_seen(out.px), if_seen(out.py), if_seen(out.pz));
    store_some_triples(job.rgb_gradient + 3 * i, n, grad.r, grad.g, grad.b);
    memcpy(job.opacity_gradient + i, &opacity, 4 * n);
    store_shapes(job, i, n, seen, d_shapes);
  }
}

}  // namespace

void chain_rule_part(const RasterJob& job, const Stripes& stripes, int32_t part) {
  if (job.covariance) return chain_rule_range<Ellipsoids>(job, stripes, part);
  chain_rule_range<Spheres>(job, stripes, part);
}

}  // namespace jg
