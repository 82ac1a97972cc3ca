// From positions to ellipses on the picture (RENDERING 3), sixteen Gaussians at a time. Used forwards and by the chain
// rule, so that both see the same numbers.
#pragma once
#include "raster.h"
#include "vec.h"

namespace jg {

struct Projection {
  vf x, y, z;         // camera frame, m
  vf inverse_z;
  vf u, v;            // centre relative to the principal point, px
  vf jx, jy;          // du/dx, dv/dy, px/m
  vf jxz, jyz;        // du/dz, dv/dz, px/m
  vf a, b, c;         // covariance on the picture with the low pass added, px^2
  vf inverse_det;
};

// Sixteen consecutive Gaussians; fewer are filled up with zeros, which are culled.
struct Inputs {
  vf px, py, pz, sigma, opacity, r, g, b;
};

JG_INLINE Inputs load_inputs(const RasterJob& job, int64_t first, int n) {
  Inputs in;
  if (n == LANES) {
    load_triples(job.position + 3 * first, in.px, in.py, in.pz);
    load_triples(job.rgb + 3 * first, in.r, in.g, in.b);
    in.sigma = load(job.sigma + first), in.opacity = load(job.opacity + first);
    return in;
  }
  float position[3 * LANES] = {}, rgb[3 * LANES] = {}, sigma[LANES] = {}, opacity[LANES] = {};
  memcpy(position, job.position + 3 * first, 12 * n), memcpy(rgb, job.rgb + 3 * first, 12 * n);
  memcpy(sigma, job.sigma + first, 4 * n), memcpy(opacity, job.opacity + first, 4 * n);
  load_triples(position, in.px, in.py, in.pz), load_triples(rgb, in.r, in.g, in.b);
  in.sigma = load(sigma), in.opacity = load(opacity);
  return in;
}

// One row of camera_from_position. In double precision: a hand far from the origin then loses nothing, and depths,
// which decide the order, are the correctly rounded ones, whatever the frame the positions came in.
JG_INLINE vf to_camera(const double* row, vf x, vf y, vf z) {
  typedef double vd __attribute__((vector_size(128)));
  const vd dx = __builtin_convertvector(x, vd), dy = __builtin_convertvector(y, vd);
  const vd dz = __builtin_convertvector(z, vd);
  return __builtin_convertvector(dx * row[0] + dy * row[1] + dz * row[2] + row[3], vf);
}

JG_INLINE Projection project(const RasterJob& job, const Inputs& in) {
  Projection p;
  p.x = to_camera(job.camera_from_position, in.px, in.py, in.pz);
  p.y = to_camera(job.camera_from_position + 4, in.px, in.py, in.pz);
  p.z = to_camera(job.camera_from_position + 8, in.px, in.py, in.pz);
  p.inverse_z = 1.0f / p.z;
  p.jx = p.inverse_z * job.fx, p.jy = p.inverse_z * job.fy;
  p.u = p.jx * p.x, p.v = p.jy * p.y;
  p.jxz = -p.u * p.inverse_z, p.jyz = -p.v * p.inverse_z;
  // sigma first, then the squares: sigma^2 alone may underflow where the product does not
  const vf sx = in.sigma * p.jx, sy = in.sigma * p.jy, sxz = in.sigma * p.jxz, syz = in.sigma * p.jyz;
  const vf xx = sx * sx, yy = sy * sy, xz = sxz * sxz, yz = syz * syz;
  p.a = xx + xz + BLUR_PX2, p.c = yy + yz + BLUR_PX2, p.b = sxz * syz;
  // a c - b^2 multiplied out: only positive terms remain, nothing cancels for long thin ellipses
  const vf det = xx * yy + xx * yz + xz * yy + (xx + xz + yy + yz) * BLUR_PX2 + BLUR_PX2 * BLUR_PX2;
  p.inverse_det = 1.0f / det;
  return p;
}

}  // namespace jg
