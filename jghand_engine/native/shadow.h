// What the forward and the backward pass of the self-shadow share: the task, and one block of 16 pixels of a row.
//
// The torch form in learn/shadow.py is the specification (METHOD 5.2). Depth lies in a padded plane. A pixel without
// depth holds SHADOW_FAR_M: it is farther than the radius from everything, so it occludes nothing and needs no test of
// its own. The padding is at least the largest sample offset plus one, so that every read of a block is legal.
#pragma once
#include <stdint.h>

#if defined(__AVX2__)
#include <immintrin.h>
#endif

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
  const float* surface;   // (H, W), rows surface_stride apart, with a margin: see native/raster.h; or null
  int32_t surface_stride;
  float edge_step, edge_steepness;  // skin that lies deeper than that of the next pixel by so many meters, and so many
                                    // widths of a pixel, is behind its edge
  float edge_part;        // 0..1: how much edges of skin before other skin are smoothed
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

// 2^-32 is nothing to a shadow, and as far as exp2_of_negative<5> goes without AVX-512.
constexpr float EXPONENT_MIN = -32.f;

// The smaller one of |a| and b; b where a is NaN.
JG_INLINE vf least_size(vf a, vf b) {
#if defined(__AVX512DQ__)
  return (vf)_mm512_range_ps((__m512)a, (__m512)b, 8 + 2);  // the smaller size, without a sign
#else
  return min(abs(a), b);
#endif
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
  const float eps = s.length_eps * s.radius;
  return {eps * eps, s.radius * s.radius, 1.f / s.radius, LOG2E / s.softness, -LOG2E * s.bias / s.softness,
          s.height_min * LOG2E / s.softness, -s.gain * s.softness / (float)s.samples};
}

// Taps that are found step by step together, so that none waits for its own last step; where registers are few, one.
#if defined(__AVX512F__)
constexpr int TOGETHER = 4, SPLIT_TOGETHER = 2;
#else
constexpr int TOGETHER = 1, SPLIT_TOGETHER = 1;
#endif
constexpr int NOWHERE = SHADOW_SAMPLES_MAX;  // a sample that reaches nothing fills up the last of them

// 16 pixels of one row: depth relative to the origin, ray (x/z, y/z; zero where rays are parallel), unit normal times
// the curve's slope. And taps of those of them whose reaches are less than a pixel apart: a tap has the same offset for
// all of them (four of five and more), or along an axis a near and a far one, a pixel apart.
struct Block {
  vf z, ray_x, ray_y, nx, ny, nz;
  vf reach, reach_x, reach_y;    // where focal lengths are 1; px
  vi valid, left, lanes;         // pixels with a depth; of them, those without taps so far; those of the taps
  float reach_lo, reach_hi;      // of those that are left
  float x_lo, x_hi, y_lo, y_hi;  // least and greatest reach of the taps, px
  int same_count, split_count;
  int32_t same[SHADOW_SAMPLES_MAX + LANES], split[SHADOW_SAMPLES_MAX + LANES];  // sample numbers
  // of a sample's near offset: change of the ray, the same times the origin, place in the padded plane, and up to how
  // many px it is taken
  alignas(64) float turn_x[NOWHERE + 1], turn_y[NOWHERE + 1], base_x[NOWHERE + 1], base_y[NOWHERE + 1];
  alignas(64) int32_t offset[NOWHERE + 1];
  alignas(64) float edge_x[NOWHERE + 1], edge_y[NOWHERE + 1];
  // in all blocks: part of the reach, positive, and 1 or -1, away from the pixel
  alignas(64) float span_x[NOWHERE + 1], span_y[NOWHERE + 1], way_x[NOWHERE + 1], way_y[NOWHERE + 1];
  // a step of one pixel is (turn z + base) long at the relative depth z: along rays that spread it grows with depth,
  // along parallel ones it does not
  float pixel_turn_x, pixel_turn_y, pixel_base_x, pixel_base_y;
};

// Before the first block: what all share.
JG_INLINE void start(Block& b, const ShadeTask& s) {
  const float turn = s.orthographic ? 0.f : 1.f, base = s.orthographic ? 1.f : s.origin;
  b.pixel_turn_x = turn / s.fx, b.pixel_turn_y = turn / s.fy;
  b.pixel_base_x = base / s.fx, b.pixel_base_y = base / s.fy;
  for (int k = 0; k < s.samples; k += LANES) {
    const vf x = load(s.disc_x + k), y = load(s.disc_y + k);
    store(b.span_x + k, abs(x));
    store(b.span_y + k, abs(y));
    store(b.way_x + k, select(x < 0, all(-1.f), all(1.f)));
    store(b.way_y + k, select(y < 0, all(-1.f), all(1.f)));
  }
  b.x_lo = -1.f;  // the reach of no pixel
  b.turn_x[NOWHERE] = b.turn_y[NOWHERE] = b.edge_x[NOWHERE] = b.edge_y[NOWHERE] = 0.f;
  b.span_x[NOWHERE] = b.span_y[NOWHERE] = b.way_x[NOWHERE] = b.way_y[NOWHERE] = 0.f;
  b.base_x[NOWHERE] = b.base_y[NOWHERE] = SHADOW_FAR_M;
  b.offset[NOWHERE] = 0;
}

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
  const float pixel = 1.f / focal, scale = focal * s.normal_reach / s.radius;
  const auto step_of = [&](vf reach) __attribute__((always_inline)) {
    return round_even(min(max(scale * reach, all(s.reach_min_px)), all(s.reach_max_px)));
  };
  // rounding is monotonous: when the farthest and the nearest pixel have the same step, all have
  vf step = step_of(all(b.reach_lo));
  const bool same = step[0] == step_of(all(b.reach_hi))[0];
  if (!same) step = step_of(b.reach);
  const vi offset = to_int(step) * stride;
  const vf change = step * pixel, turn = s.orthographic ? vf{} : change;
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

JG_INLINE void set_range(Block& b) {
  b.reach_lo = lowest(select(b.left, b.reach, all(__builtin_inff())));
  b.reach_hi = highest(select(b.left, b.reach, vf{}));
}

// Everything about the pixels from (x0, y) on that does not depend on the sample; c points at their depth in the padded
// plane.
JG_INLINE void set_block(Block& b, const Curve& curve, const float* c, int x0, int y, const ShadeTask& s) {
  const vf lane = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  b.z = load(c);
  b.valid = b.left = b.z < SHADOW_FAR_M;
  if (!bit_mask(b.valid)) return;
  const float step_x = 1.f / s.fx, step_y = 1.f / s.fy;
  b.ray_x = s.orthographic ? vf{} : (lane + ((float)x0 + 0.5f - s.cx)) * step_x;
  b.ray_y = s.orthographic ? vf{} : all(((float)y + 0.5f - s.cy) * step_y);
  const vf z = s.orthographic ? all(1.f) : b.z + s.origin;
  b.reach = s.radius / z;
  set_range(b);
  set_normal(b, curve, z, c, s);
  const vf least = all(s.reach_min_px), most = all(s.reach_max_px);
  b.reach_x = min(max(s.fx * b.reach, least), most);
  b.reach_y = min(max(s.fy * b.reach, least), most);
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

// The greatest size of what rounds to x or nearer to 0: what lies in the middle goes to the even one.
JG_INLINE vf edge_of(vf x) { return float_of(bits_of(abs(x) + 0.5f) - (to_int(x) & 1)); }

// Taps of the pixels that are left, or of those of them with the least reach; false when there are none.
JG_INLINE bool next_taps(Block& b, const ShadeTask& s) {
  if (!bit_mask(b.left)) return false;
  if (bit_mask(b.left != b.valid)) set_range(b);
  const auto px_of = [&](float focal, float reach) {
    const float px = focal * reach, most = px < s.reach_max_px ? px : s.reach_max_px;
    return most > s.reach_min_px ? most : s.reach_min_px;
  };
  const float x_lo = px_of(s.fx, b.reach_lo), x_end = x_lo + 1.f, x_most = px_of(s.fx, b.reach_hi);
  const float y_lo = px_of(s.fy, b.reach_lo), y_end = y_lo + 1.f, y_most = px_of(s.fy, b.reach_hi);
  b.lanes = b.left;
  if (x_most >= x_end || y_most >= y_end) {
    b.lanes &= (b.reach_x < x_end) & (b.reach_y < y_end);
    if (!bit_mask(b.lanes)) return false;  // depths that are no numbers
  }
  b.left &= ~b.lanes;
  const float x_hi = x_most < x_end ? x_most : x_end, y_hi = y_most < y_end ? y_most : y_end;
  if (x_lo == b.x_lo && x_hi == b.x_hi && y_lo == b.y_lo && y_hi == b.y_hi) return true;  // they are still here
  b.x_lo = x_lo, b.x_hi = x_hi, b.y_lo = y_lo, b.y_hi = y_hi;
  b.same_count = b.split_count = 0;
  for (int k = 0; k < s.samples; k += LANES) {
    const vf dx = load(s.disc_x + k), dy = load(s.disc_y + k);
    const vf x = round_even(dx * x_lo), y = round_even(dy * y_lo);
    store(b.turn_x + k, x * b.pixel_turn_x);
    store(b.turn_y + k, y * b.pixel_turn_y);
    store(b.base_x + k, x * b.pixel_base_x);
    store(b.base_y + k, y * b.pixel_base_y);
    store(b.offset + k, to_int(y) * s.stride + to_int(x));
    store(b.edge_x + k, edge_of(x));
    store(b.edge_y + k, edge_of(y));
    // rounding is monotonous: when the least and the greatest reach land on the same pixel, all do
    const uint32_t same = bit_mask((x == round_even(dx * x_hi)) & (y == round_even(dy * y_hi)));
    const uint32_t wanted = s.samples - k >= LANES ? 0xffffu : (1u << (s.samples - k)) - 1;
    b.same_count = append(b.same, b.same_count, k, same & wanted);
    b.split_count = append(b.split, b.split_count, k, ~same & wanted);
  }
  while (b.same_count % TOGETHER) b.same[b.same_count++] = NOWHERE;
  while (b.split_count % SPLIT_TOGETHER) b.split[b.split_count++] = NOWHERE;
  return true;
}

// 1 / sqrt(a): to 14 bits at least, which is enough for pictures, or EXACT, rounded as floats are, for gradients.
template <bool EXACT>
JG_INLINE vf inverse_length(vf a) {
  if (EXACT) return inverse_sqrt(a);
#if defined(__AVX2__) && !defined(__AVX512F__)
  __m256 half[2];  // 11 bits, and a step of Newton's: half the time of a root and a quotient
  memcpy(half, &a, sizeof half);
  for (__m256& h : half) h = _mm256_rsqrt_ps(h);
  vf y;
  memcpy(&y, half, sizeof half);
  return y * (1.5f - 0.5f * a * y * y);
#else
  return rough_inverse_sqrt(a);
#endif
}

// One tap: the vectors to the samples, and their parts of the sum; steep: the cosine times the curve's slope. fall is 0
// beyond the radius and without a depth, also where the arithmetic overflowed: max(NaN, 0) is 0. (Of parallel rays a
// pixel without a depth may find another one; its sum is nobody's.)
struct Tap {
  vf vx, vy, vz, d2, inverse, steep, soft, fall;
};
// Where it goes: the offset in the padded plane, when split that of the near sample, and the steps to the far one for
// lanes that take it; the change of the ray, and the same times the origin of depth.
struct Aim {
  bool split;
  int32_t offset, right, down;
  vi far_x, far_y;
  vf turn_x, turn_y, base_x, base_y;
};

#define JG_EACH for (int j = 0; j < N; j++)
template <int N>
JG_INLINE void aim(Tap (&t)[N], const Block& b, const Curve& c, const vf (&z)[N], const Aim (&a)[N]) {
  // (ray + turn) z_sample - ray z, without cancellation
  JG_EACH t[j].vz = z[j] - b.z;
  JG_EACH t[j].vx = z[j] * a[j].turn_x + a[j].base_x;
  JG_EACH t[j].vy = z[j] * a[j].turn_y + a[j].base_y;
  JG_EACH t[j].vx += b.ray_x * t[j].vz;
  JG_EACH t[j].vy += b.ray_y * t[j].vz;
  JG_EACH t[j].d2 = t[j].vz * t[j].vz + c.eps2;
  JG_EACH t[j].d2 += t[j].vy * t[j].vy;
  JG_EACH t[j].d2 += t[j].vx * t[j].vx;
}
// log2(1 + 2^e), error 7e-5, which is 3e-5 of visibility at most: the part of |e| as the eighth power of a polynomial.
template <int N>
JG_INLINE void soften(Tap (&t)[N], float shift) {
  const float reach = 14.f;  // of the polynomial; the part is below its error beyond
  vf e[N], x[N], p[N];
  JG_EACH e[j] = t[j].steep + shift;
  JG_EACH x[j] = least_size(e[j], all(reach));
  JG_EACH p[j] = x[j] * 1.1008914e-6f - 5.1000613e-5f;
  JG_EACH p[j] = p[j] * x[j] + 7.8422198e-4f;
  JG_EACH p[j] = p[j] * x[j] - 3.2166585e-3f;
  JG_EACH p[j] = p[j] * x[j] - 6.2351362e-2f;
  JG_EACH p[j] = p[j] * x[j] + 9.9999131e-1f;
  JG_EACH p[j] *= p[j];
  JG_EACH p[j] *= p[j];
  JG_EACH t[j].soft = p[j] * p[j] + max(e[j], vf{});
}
template <bool EXACT, int N>
JG_INLINE void occlude(Tap (&t)[N], const Block& b, const Curve& c) {
  JG_EACH t[j].inverse = inverse_length<EXACT>(t[j].d2);
  JG_EACH t[j].steep = t[j].vz * b.nz - c.height_min;
  JG_EACH t[j].steep += t[j].vy * b.ny;
  JG_EACH t[j].steep += t[j].vx * b.nx;
  JG_EACH t[j].steep *= t[j].inverse;
  soften(t, c.shift);
  JG_EACH t[j].fall = max(1.f - t[j].d2 * t[j].inverse * c.inverse_radius, vf{});
}

// Where sample k goes, and the depths there.
template <bool SPLIT>
JG_INLINE vf aim_at(Aim& a, int k, const Block& b, const float* c, int stride) {
  const float* near = c + b.offset[k];
  if (!SPLIT) {
    a = {false, b.offset[k], 0, 0, {}, {}, all(b.turn_x[k]), all(b.turn_y[k]), all(b.base_x[k]), all(b.base_y[k])};
    return load(near);
  }
  const int right = (int)b.way_x[k], down = (int)b.way_y[k] * stride;
  const vi far_x = b.reach_x * b.span_x[k] > b.edge_x[k], far_y = b.reach_y * b.span_y[k] > b.edge_y[k];
  const vf way_x = select(far_x, all(b.way_x[k]), vf{}), way_y = select(far_y, all(b.way_y[k]), vf{});
  a = {true, b.offset[k], right, down, far_x, far_y,
       way_x * b.pixel_turn_x + b.turn_x[k], way_y * b.pixel_turn_y + b.turn_y[k],
       way_x * b.pixel_base_x + b.base_x[k], way_y * b.pixel_base_y + b.base_y[k]};
  return select(far_y, select(far_x, load(near + down + right), load(near + down)),
                select(far_x, load(near + right), load(near)));
}

// Calls use(aim, tap) for the taps of a list, N at a time, but for those of which none reaches anything.
template <bool EXACT, bool SPLIT, class Use>
JG_INLINE void for_list(const int32_t* list, int count, const Block& b, const Curve& curve, const float* c,
                        const ShadeTask& s, Use use) {
  constexpr int N = EXACT ? 1 : SPLIT ? SPLIT_TOGETHER : TOGETHER;
  for (int i = 0; i < count; i += N) {
    Tap t[N];
    Aim a[N];
    vf z[N], nearest = all(curve.radius2);
    JG_EACH z[j] = aim_at<SPLIT>(a[j], list[i + j], b, c, s.stride);
    aim(t, b, curve, z, a);
    JG_EACH nearest = min(t[j].d2, nearest);
    if (!SPLIT && !bit_mask(nearest < curve.radius2)) continue;
    occlude<EXACT>(t, b, curve);
    JG_EACH use(a[j], t[j]);
  }
}
template <bool EXACT, class Use>
JG_INLINE void for_taps(const Block& b, const Curve& curve, const float* c, const ShadeTask& s, Use use) {
  for_list<EXACT, false>(b.same, b.same_count, b, curve, c, s, use);
  for_list<EXACT, true>(b.split, b.split_count, b, curve, c, s, use);
}

#undef JG_EACH

// Depth of row y of the picture into the padded plane.
void prepare_depth(const ShadeTask& s, int y);

}  // namespace jg
