// From positions to ellipses on the picture (RENDERING 3), sixteen Gaussians at a time. Used forwards and by the chain
// rule, so that both see the same numbers. Gaussians are spheres or, when the job has covariances, ellipsoids: what
// differs is written twice, as overloads on the shape.
#pragma once
#include "raster.h"
#include "vec.h"

namespace jg {

struct Projection {
  vf x, y, z;         // camera frame, m
  vf inverse_z;       // of parallel rays: 1
  vf u, v;            // center relative to the principal point, px
  vf jx, jy;          // du/dx, dv/dy, px/m
  vf jxz, jyz;        // du/dz, dv/dz, px/m
  vf a, b, c;         // covariance on the picture with the low pass added, px^2
  vf inverse_det;
};

// Sixteen consecutive Gaussians; fewer are filled up with zeros, which are culled.
struct Inputs {
  vf px, py, pz, opacity, r, g, b, front;
};
struct Spheres {
  vf sigma;
};
struct Ellipsoids {
  vf xx, xy, xz, yy, yz, zz;
};

JG_INLINE Inputs load_inputs(const RasterJob& job, int64_t first, int n) {
  Inputs in;
  if (n == LANES) {
    load_triples(job.position + 3 * first, in.px, in.py, in.pz);
    load_triples(job.rgb + 3 * first, in.r, in.g, in.b);
    in.opacity = load(job.opacity + first);
    in.front = job.front ? load(job.front + first) : all(1.f);
    return in;
  }
  float position[3 * LANES] = {}, rgb[3 * LANES] = {}, opacity[LANES] = {}, front[LANES] = {};
  memcpy(position, job.position + 3 * first, 12 * n), memcpy(rgb, job.rgb + 3 * first, 12 * n);
  memcpy(opacity, job.opacity + first, 4 * n);
  if (job.front) memcpy(front, job.front + first, 4 * n);
  load_triples(position, in.px, in.py, in.pz), load_triples(rgb, in.r, in.g, in.b);
  in.opacity = load(opacity);
  in.front = job.front ? load(front) : all(1.f);
  return in;
}

JG_INLINE void load_shapes(const RasterJob& job, int64_t first, int n, Spheres& shapes) {
  if (n == LANES) {
    shapes.sigma = load(job.sigma + first);
    return;
  }
  float sigma[LANES] = {};
  memcpy(sigma, job.sigma + first, 4 * n);
  shapes.sigma = load(sigma);
}

JG_INLINE void load_shapes(const RasterJob& job, int64_t first, int n, Ellipsoids& shapes) {
  vf rows[6];
  if (n == LANES) {
    load_sixes(job.covariance + 6 * first, rows);
  } else {
    float covariance[6 * LANES] = {};
    memcpy(covariance, job.covariance + 6 * first, 24 * n);
    load_sixes(covariance, rows);
  }
  shapes = {rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]};
}

// One row of camera_from_position. In double precision: a hand far from the origin then loses nothing, and depths,
// which decide the order, are the correctly rounded ones, whatever the frame the positions came in.
JG_INLINE vf to_camera(const double* row, vf x, vf y, vf z) {
  return narrow(wide(x) * row[0] + wide(y) * row[1] + wide(z) * row[2] + row[3]);
}

// The low pass: that of a pixel, and never less than the pictures had that the Gaussians were learned from, for what
// overlaps there leaves gaps where it is drawn sharper. px^2
JG_INLINE vf low_pass(const RasterJob& job, const Projection& p) {
  return max(p.jx * p.jy * job.low_pass_m2, all(BLUR_PX2));
}

JG_INLINE void spread(const RasterJob& job, const Spheres& shapes, Projection& p) {
  // sigma first, then the squares: sigma^2 alone may underflow where the product does not
  const vf s = shapes.sigma, sx = s * p.jx, sy = s * p.jy, sxz = s * p.jxz, syz = s * p.jyz;
  const vf xx = sx * sx, yy = sy * sy, xz = sxz * sxz, yz = syz * syz, low = low_pass(job, p);
  p.a = xx + xz + low, p.c = yy + yz + low, p.b = sxz * syz;
  // a c - b^2 multiplied out: only positive terms remain, nothing cancels for long thin ellipses
  const vf det = xx * yy + xx * yz + xz * yy + (xx + xz + yy + yz) * low + low * low;
  p.inverse_det = 1.0f / det;
}

// A vector of the frame of the positions, per lane.
struct Vector {
  vd x, y, z;
};
JG_INLINE vd dot(const Vector& a, const Vector& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Row of the Jacobian of the picture by the position: j times one row of the rotation plus jz times the last.
JG_INLINE Vector jacobian_row(const RasterJob& job, int row, vf j, vf jz) {
  const double *r = job.camera_from_position + 4 * row, *last = job.camera_from_position + 8;
  const vd wj = wide(j), wz = wide(jz);
  return {wj * r[0] + wz * last[0], wj * r[1] + wz * last[1], wj * r[2] + wz * last[2]};
}

JG_INLINE Vector times(const Ellipsoids& s, const Vector& t) {
  const vd xx = wide(s.xx), xy = wide(s.xy), xz = wide(s.xz), yy = wide(s.yy), yz = wide(s.yz), zz = wide(s.zz);
  return {xx * t.x + xy * t.y + xz * t.z, xy * t.x + yy * t.y + yz * t.z, xz * t.x + yz * t.y + zz * t.z};
}

// In double precision: a c - b^2 cannot be multiplied out here, and cancels for long thin ellipses.
JG_INLINE void spread(const RasterJob& job, const Ellipsoids& shapes, Projection& p) {
  const Vector tu = jacobian_row(job, 0, p.jx, p.jxz), tv = jacobian_row(job, 1, p.jy, p.jyz);
  const Vector mu = times(shapes, tu), mv = times(shapes, tv);
  vd a = dot(tu, mu), b = dot(tu, mv), c = dot(tv, mv);
  // flat Gaussians may be a rounding error beyond flat: the nearest ellipse that exists. A NaN stays one
  a = a < 0 ? vd{} : a, c = c < 0 ? vd{} : c;
  const vf low = low_pass(job, p), longest = sqrt(narrow(a * c));
  const vd flat = a * c - b * b, det = (flat < 0 ? vd{} : flat) + (a + c + wide(low)) * wide(low);
  p.a = narrow(a) + low, p.c = narrow(c) + low, p.b = max(min(narrow(b), longest), -longest);
  p.inverse_det = 1.0f / narrow(det);
}

template <class Shapes>
JG_INLINE Projection project(const RasterJob& job, const Inputs& in, const Shapes& shapes) {
  Projection p;
  p.x = to_camera(job.camera_from_position, in.px, in.py, in.pz);
  p.y = to_camera(job.camera_from_position + 4, in.px, in.py, in.pz);
  p.z = to_camera(job.camera_from_position + 8, in.px, in.py, in.pz);
  p.inverse_z = job.orthographic ? all(1.0f) : 1.0f / p.z;
  p.jx = p.inverse_z * job.fx, p.jy = p.inverse_z * job.fy;
  p.u = p.jx * p.x, p.v = p.jy * p.y;
  p.jxz = job.orthographic ? vf{} : -p.u * p.inverse_z, p.jyz = job.orthographic ? vf{} : -p.v * p.inverse_z;
  spread(job, shapes, p);
  return p;
}

}  // namespace jg
