// What the forward and the backward pass of the self-shadow share: the task, and one block of 16 pixels of a row.
//
// The torch form in learn/shadow.py is the specification (METHOD 5.2). Depth lies in a padded plane. A pixel without
// depth holds SHADOW_FAR_M: it is farther than the radius from everything, so it occludes nothing and needs no test of
// its own. The padding is at least the largest sample offset plus one, so that every read of a block is legal.
#pragma once
#include <stdint.h>

#include "constants.h"
#include "vec.h"

namespace jg {

// Mirrored field by field in native/tasks.py.
struct ShadeTask {
  int32_t width, height;
  int32_t samples;  // 0: no shadow, only compose
  int32_t stride;   // floats from row to row of the padded depth; a multiple of 16
  int32_t pad_rows;
  int32_t orthographic;  // 1: parallel rays; fx and fy are px per meter then
  float fx, fy, cx, cy;
  float origin;  // m; depths are kept relative to it, so that the rounding of 0.6 m does not tilt the normals
  float radius, bias, softness, gain;
  float alpha_min, reach_min_px, reach_max_px, length_eps, normal_reach, height_min, agree, agree_floor, normal_min2;
  float darkness[3];      // strength * tint per channel
  const float* disc_x;    // samples, zero-padded to a multiple of 16
  const float* disc_y;
  const float* picture;   // (5, H, W) premultiplied R G B, alpha, sum of weight * z
  float* depth;           // pixel (0, 0) of the padded plane
  int32_t* row_valid;     // (H) pixels with a depth
  float* visibility;      // (H, W) or null
  float* rgba;            // (H, W, 4) premultiplied, or null
  float* depth_out;       // (H, W) meters, 0 where there is none, or null
};

#if defined(__clang__)
JG_INLINE vf round_even(vf a) { return __builtin_elementwise_rint(a); }
#else
JG_INLINE vf round_even(vf a) {
  for (int i = 0; i < LANES; i++) a[i] = __builtin_rintf(a[i]);
  return a;
}
#endif
JG_INLINE vi to_int(vf a) { return __builtin_convertvector(a, vi); }
JG_INLINE vf to_float(vi a) { return __builtin_convertvector(a, vf); }

#if defined(__AVX512F__)
JG_INLINE vf gather(const float* p, vi index) { return (vf)_mm512_i32gather_ps((__m512i)index, p, 4); }
#else
JG_INLINE vf gather(const float* p, vi index) {
  vf r;
  for (int i = 0; i < LANES; i++) r[i] = p[index[i]];
  return r;
}
#endif

// 2^-32 is nothing to a shadow, and as far as exp2_of_negative<5> goes without AVX-512.
constexpr float EXPONENT_MIN = -32.f;

// log2(1 + 2^e), error 7e-5, which is 3e-5 of visibility at most: the part of |e| as the eighth power of a polynomial.
JG_INLINE vf log2_of_one_plus_exp2(vf e) {
  const float reach = 14.f;  // of the polynomial; the part is below its error beyond
  const vf x = min(abs(e), all(reach));
  vf p = x * 1.1008914e-6f - 5.1000613e-5f;
  p = p * x + 7.8422198e-4f;
  p = p * x - 3.2166585e-3f;
  p = p * x - 6.2351362e-2f;
  p = p * x + 9.9999131e-1f;
  p = p * p, p = p * p;
  return p * p + max(e, vf{});
}

JG_INLINE float lowest(vf a) {
  a = min(a, JG_SHUFFLE(a, a, 8, 9, 10, 11, 12, 13, 14, 15, 0, 1, 2, 3, 4, 5, 6, 7));
  a = min(a, JG_SHUFFLE(a, a, 4, 5, 6, 7, 0, 1, 2, 3, 12, 13, 14, 15, 8, 9, 10, 11));
  a = min(a, JG_SHUFFLE(a, a, 2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13));
  return a[0] < a[1] ? a[0] : a[1];
}
JG_INLINE float highest(vf a) { return -lowest(-a); }

// Constants of the occlusion curve: softplus argument in powers of two is slope * cosine + shift.
struct Curve {
  float eps2, radius2, inverse_radius, slope, shift, height_min;  // height_min: times slope
  float exponent;  // visibility = 2^(exponent * sum of the taps)
};
JG_INLINE Curve curve_of(const ShadeTask& s) {
  const float log2e = 1.4426950408889634f, eps = s.length_eps * s.radius;
  return {eps * eps, s.radius * s.radius, 1.f / s.radius, log2e / s.softness, -log2e * s.bias / s.softness,
          s.height_min * log2e / s.softness, -s.gain * s.softness / (float)s.samples};
}

// 16 pixels of one row: depth relative to the origin, ray (x/z, y/z; zero where rays are parallel), unit normal times
// the curve's slope; and its taps. Where the offset is the same for all pixels of the block (four of five and more) the
// tap is one contiguous load, elsewhere a gather.
struct Block {
  vf z, ray_x, ray_y, nx, ny, nz;
  vi valid;
  vf reach_x, reach_y;  // px
  int same_count, mixed_count;
  int32_t same[SHADOW_SAMPLES_MAX + LANES], mixed[SHADOW_SAMPLES_MAX + LANES];  // sample numbers
  alignas(64) float shift_x[SHADOW_SAMPLES_MAX], shift_y[SHADOW_SAMPLES_MAX];   // of the ray, when same
  alignas(64) float base_x[SHADOW_SAMPLES_MAX], base_y[SHADOW_SAMPLES_MAX];     // shift times origin, when same
  alignas(64) int32_t offset[SHADOW_SAMPLES_MAX];                               // in the padded plane, when same
};

// Difference of the point along one image axis: in depth, and along the axis.
struct Slope {
  vf dz, along;
  vi any;
};
JG_INLINE Slope slope_of(vf z, vf ahead, vf behind, vf ray_ahead, vf ray_behind, vf flat, const ShadeTask& s) {
  const vi has_f = ahead < SHADOW_FAR_M, has_b = behind < SHADOW_FAR_M;
  const vf f = ahead - z, b = z - behind, size_f = abs(f), size_b = abs(b);
  const vi mean = has_f & has_b & (abs(size_f - size_b) < s.agree * min(size_f, size_b) + s.agree_floor);
  const vi forward = has_f & (~has_b | (size_f < size_b));
  const vf one = select(forward, f, b), one_ray = select(forward, f * ray_ahead, b * ray_behind);
  const vf dz = select(mean, 0.5f * (f + b), one);
  return {dz, flat + select(mean, 0.5f * (f * ray_ahead + b * ray_behind), one_ray), has_f | has_b};
}

// The depth `step` elements away from each pixel of the block: one load where the step is the same for all.
JG_INLINE vf load_at(const float* c, vi step, bool same) {
  const vi lane = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  return same ? load(c + step[0]) : gather(c, step + lane);
}

JG_INLINE Slope slope_along(const Block& b, vf z, const float* c, vf ray, float focal, int stride, const ShadeTask& s) {
  vf step = round_even(min(max(focal * s.normal_reach / z, all(s.reach_min_px)), all(s.reach_max_px)));
  // pixels without depth go along with the others
  const float most = highest(select(b.valid, step, vf{}));
  step = select(b.valid, step, all(most));
  const bool same = !bit_mask(step != all(most));
  const vi offset = to_int(step) * stride;
  const vf change = step / focal, turn = s.orthographic ? vf{} : change;
  return slope_of(b.z, load_at(c, offset, same), load_at(c, -offset, same), ray + turn, ray - turn, change * z, s);
}

JG_INLINE void set_normal(Block& b, const Curve& curve, vf z, const float* c, const ShadeTask& s) {
  const Slope h = slope_along(b, z, c, b.ray_x, s.fx, 1, s), v = slope_along(b, z, c, b.ray_y, s.fy, s.stride, s);
  // a pixel without neighbors along an axis takes the axis itself
  const vf hx = select(h.any, h.along, all(1.f)), hz = select(h.any, h.dz, vf{}), hy = hz * b.ray_y;
  const vf vy = select(v.any, v.along, all(1.f)), vz = select(v.any, v.dz, vf{}), vx = vz * b.ray_x;
  b.nx = vy * hz - vz * hy;
  b.ny = vz * hx - vx * hz;
  b.nz = vx * hy - vy * hx;
  vf scale = inverse_sqrt(max(b.nx * b.nx + (b.ny * b.ny + b.nz * b.nz), all(s.normal_min2)));
  scale = curve.slope * select(b.nx * b.ray_x + (b.ny * b.ray_y + b.nz) > 0, -scale, scale);
  b.nx *= scale;
  b.ny *= scale;
  b.nz *= scale;
}

JG_INLINE int append(int32_t* list, int count, int first, uint32_t mask) {
#if defined(__AVX512F__)
  const __m512i lane = _mm512_set_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0);
  const __m512i number = _mm512_add_epi32(lane, _mm512_set1_epi32(first));
  _mm512_storeu_si512(list + count, _mm512_maskz_compress_epi32((__mmask16)mask, number));
  return count + __builtin_popcount(mask);
#else
  for (; mask; mask &= mask - 1) list[count++] = first + __builtin_ctz(mask);
  return count;
#endif
}

// A step of the picture is so many times (turn z + base) long at the relative depth z: along rays that spread it grows
// with depth, along parallel ones it does not.
struct Reach {
  float turn, base;
};
JG_INLINE Reach reach_of(const ShadeTask& s) { return s.orthographic ? Reach{0.f, 1.f} : Reach{1.f, s.origin}; }

// Rounding is monotonous: when the least and the greatest reach in the block land on the same pixel, all do.
JG_INLINE void sort_taps(Block& b, float step_x, float step_y, const ShadeTask& s) {
  const vf least = all(s.reach_min_px), most = all(s.reach_max_px);
  const float x_lo = lowest(select(b.valid, b.reach_x, most)), x_hi = highest(select(b.valid, b.reach_x, least));
  const float y_lo = lowest(select(b.valid, b.reach_y, most)), y_hi = highest(select(b.valid, b.reach_y, least));
  const Reach reach = reach_of(s);
  b.same_count = b.mixed_count = 0;
  for (int k = 0; k < s.samples; k += LANES) {
    const vf dx = load(s.disc_x + k), dy = load(s.disc_y + k);
    const vf x = round_even(dx * x_lo), y = round_even(dy * y_lo);
    store(b.shift_x + k, x * step_x * reach.turn);
    store(b.shift_y + k, y * step_y * reach.turn);
    store(b.base_x + k, x * step_x * reach.base);
    store(b.base_y + k, y * step_y * reach.base);
    store(b.offset + k, to_int(y) * s.stride + to_int(x));
    const uint32_t wanted = s.samples - k >= LANES ? 0xffffu : (1u << (s.samples - k)) - 1;
    const uint32_t same = bit_mask((x == round_even(dx * x_hi)) & (y == round_even(dy * y_hi)));
    b.same_count = append(b.same, b.same_count, k, same & wanted);
    b.mixed_count = append(b.mixed, b.mixed_count, k, ~same & wanted);
  }
}

// Everything about the block at (x0, y) that does not depend on the sample; c points at its depth in the padded plane.
// False when no pixel of it has a depth.
JG_INLINE bool set_block(Block& b, const Curve& curve, const float* c, int x0, int y, const ShadeTask& s) {
  const vf lane = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  b.z = load(c);
  b.valid = b.z < SHADOW_FAR_M;
  if (!bit_mask(b.valid)) return false;
  const float step_x = 1.f / s.fx, step_y = 1.f / s.fy;
  b.ray_x = s.orthographic ? vf{} : (lane + ((float)x0 + 0.5f - s.cx)) * step_x;
  b.ray_y = s.orthographic ? vf{} : all(((float)y + 0.5f - s.cy) * step_y);
  const vf z = s.orthographic ? all(1.f) : b.z + s.origin;
  set_normal(b, curve, z, c, s);
  const vf reach = s.radius / z, least = all(s.reach_min_px), most = all(s.reach_max_px);
  b.reach_x = min(max(s.fx * reach, least), most);
  b.reach_y = min(max(s.fy * reach, least), most);
  sort_taps(b, step_x, step_y, s);
  return true;
}

// One tap of a block: the vector to the sample, and its part of the sum; steep: the cosine times the curve's slope.
// Lanes outside the radius or without a depth are not inside, even when the arithmetic overflowed: a comparison with NaN
// is false. (Of parallel rays a pixel without a depth may find another one; its sum is nobody's.)
struct Tap {
  vf vx, vy, vz, d2, inverse, steep, soft, fall;
  vi inside;
};
// shift: change of the ray from the pixel to the sample; base: shift times the origin of depth.
struct Shift {
  vf x, y, base_x, base_y;
};
// False when no lane is inside: a fifth to a quarter of the taps of a hand go beside it or to another depth.
JG_INLINE bool aim(Tap& t, const Block& b, const Curve& c, vf z, const Shift& shift) {
  // (ray + shift) z_sample - ray z, without cancellation
  t.vz = z - b.z;
  t.vx = z * shift.x + shift.base_x + b.ray_x * t.vz;
  t.vy = z * shift.y + shift.base_y + b.ray_y * t.vz;
  t.d2 = t.vx * t.vx + (t.vy * t.vy + (t.vz * t.vz + c.eps2));
  t.inside = t.d2 < c.radius2;
  return bit_mask(t.inside);
}
template <bool EXACT>
JG_INLINE void occlude(Tap& t, const Block& b, const Curve& c) {
  t.inverse = EXACT ? inverse_sqrt(t.d2) : rough_inverse_sqrt(t.d2);
  t.steep = (t.vx * b.nx + (t.vy * b.ny + (t.vz * b.nz - c.height_min))) * t.inverse;
  t.soft = log2_of_one_plus_exp2(t.steep + c.shift);
  t.fall = 1.f - t.d2 * t.inverse * c.inverse_radius;
}

// Calls same(offset, shift, tap) or mixed(indices, shift, tap) for every tap of a block with a lane inside. Distances are
// rounded as floats are for gradients (EXACT); 14 bits of them are enough for pictures.
template <bool EXACT, class Same, class Mixed>
JG_INLINE void for_taps(const Block& b, const Curve& curve, const float* c, const ShadeTask& s, Same same, Mixed mixed) {
  const vi lane = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  const float step_x = 1.f / s.fx, step_y = 1.f / s.fy;
  const Reach reach = reach_of(s);
  Tap t;
  for (int i = 0; i < b.same_count; i++) {
    const int k = b.same[i];
    const Shift shift = {all(b.shift_x[k]), all(b.shift_y[k]), all(b.base_x[k]), all(b.base_y[k])};
    if (!aim(t, b, curve, load(c + b.offset[k]), shift)) continue;
    occlude<EXACT>(t, b, curve);
    same(b.offset[k], shift, t);
  }
  for (int i = 0; i < b.mixed_count; i++) {
    const int k = b.mixed[i];
    const vf x = round_even(b.reach_x * s.disc_x[k]), y = round_even(b.reach_y * s.disc_y[k]);
    const vi index = to_int(y) * s.stride + to_int(x) + lane;
    const vf sx = x * step_x, sy = y * step_y;
    const Shift shift = {sx * reach.turn, sy * reach.turn, sx * reach.base, sy * reach.base};
    if (!aim(t, b, curve, gather(c, index), shift)) continue;
    occlude<EXACT>(t, b, curve);
    mixed(index, shift, t);
  }
}

// Depth of row y of the picture into the padded plane.
void prepare_depth(const ShadeTask& s, int y);

}  // namespace jg
