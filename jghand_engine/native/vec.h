// Sixteen floats at a time: clang and gcc vector extensions, which become AVX-512, AVX2 or NEON instructions.
#pragma once
#include <stdint.h>
#include <string.h>
#if defined(__AVX512F__)
#include <immintrin.h>
#endif

#define JG_INLINE static inline __attribute__((always_inline))
#define JG_SHUFFLE __builtin_shufflevector

namespace jg {

typedef float vf __attribute__((vector_size(64)));
typedef int32_t vi __attribute__((vector_size(64)));
typedef double vd __attribute__((vector_size(128)));  // where single precision does not do

constexpr int LANES = 16;

JG_INLINE vf all(float x) { return x - vf{}; }  // zero plus x would be an addition: -0 becomes 0
JG_INLINE vi all(int32_t x) { return vi{} + x; }
JG_INLINE vd wide(vf x) { return __builtin_convertvector(x, vd); }
JG_INLINE vf narrow(vd x) { return __builtin_convertvector(x, vf); }
// A NaN in `a` gives `b`: comparisons with NaN are false.
JG_INLINE vf max(vf a, vf b) { return a > b ? a : b; }
JG_INLINE vf min(vf a, vf b) { return a < b ? a : b; }
JG_INLINE vf clamped(vf x) { return min(max(x, vf{}), all(1.f)); }
JG_INLINE vf smooth(vf x) {
  const vf t = clamped(x);
  return t * t * (3.f - 2.f * t);
}
JG_INLINE vf select(vi condition, vf yes, vf no) { return condition ? yes : no; }
JG_INLINE vf sqrt(vf a) {
#if defined(__clang__)
  return __builtin_elementwise_sqrt(a);
#else
  for (int i = 0; i < LANES; i++) a[i] = __builtin_sqrtf(a[i]);
  return a;
#endif
}

// Of normal positive numbers, to 14 bits at least.
JG_INLINE vf rough_inverse_sqrt(vf a) {
#if defined(__AVX512F__)
  return (vf)_mm512_rsqrt14_ps((__m512)a);
#else
  return 1.f / sqrt(a);
#endif
}
// The same to rounding: one Newton step more.
JG_INLINE vf inverse_sqrt(vf a) {
  const vf y = rough_inverse_sqrt(a);
#if defined(__AVX512F__)
  return y * (1.5f - 0.5f * a * y * y);
#else
  return y;
#endif
}

constexpr float NORMAL_MIN = 1e-30f;  // its half is a normal number, too

// 1 / a of normal numbers and the square root of numbers from 0 on, to rounding: dividers are slow.
JG_INLINE vf inverse(vf a) {
#if defined(__AVX512F__)
  const vf y = (vf)_mm512_rcp14_ps((__m512)a);
  return y * (2.f - a * y);
#else
  return 1.f / a;
#endif
}
JG_INLINE vf quick_sqrt(vf a) {
#if defined(__AVX512F__)
  return a * inverse_sqrt(max(a, all(NORMAL_MIN)));
#else
  return sqrt(a);
#endif
}

// memcpy is how an unaligned load is written without breaking aliasing rules; it becomes one instruction.
JG_INLINE vf load(const float* p) {
  vf v;
  memcpy(&v, p, sizeof v);
  return v;
}
JG_INLINE void store(float* p, vf v) { memcpy(p, &v, sizeof v); }
JG_INLINE void store(int32_t* p, vi v) { memcpy(p, &v, sizeof v); }
// The same place, which a compiler does not know: of a vector that is chosen there in part it would store the new lanes
// alone, which takes AMD's processors without AVX-512 twenty cycles.
template <typename Number>
JG_INLINE Number* hidden(Number* p) {
  __asm__("" : "+r"(p));
  return p;
}
// The first `count` lanes from p, the others zero: never reads beyond the row.
JG_INLINE vf load_first(const float* p, int count) {
  if (count >= LANES) return load(p);
  vf v = {};
  memcpy(&v, p, sizeof(float) * (size_t)count);
  return v;
}
JG_INLINE void store_first(float* p, vf v, int count) {
  memcpy(p, &v, sizeof(float) * (size_t)(count < LANES ? count : LANES));
}
JG_INLINE vi bits_of(vf v) {
  vi b;
  memcpy(&b, &v, sizeof b);
  return b;
}
JG_INLINE vf float_of(vi b) {
  vf v;
  memcpy(&v, &b, sizeof v);
  return v;
}
JG_INLINE vf abs(vf a) { return float_of(bits_of(a) & 0x7fffffff); }

#if defined(__AVX512F__)
JG_INLINE vf gather(const float* p, vi index) { return (vf)_mm512_i32gather_ps((__m512i)index, p, 4); }
#else
JG_INLINE vf gather(const float* p, vi index) {
  // a loop puts each lane into a vector in memory, and every turn waits for the one before
  const auto at = [&](int i) __attribute__((always_inline)) { return p[index[i]]; };
  return vf{at(0), at(1), at(2),  at(3),  at(4),  at(5),  at(6),  at(7),
            at(8), at(9), at(10), at(11), at(12), at(13), at(14), at(15)};
}
#endif
// Two words that lie together, from `step` times the index on.
template <int step>
JG_INLINE void gather_pairs(const uint32_t* p, vi index, vi& first, vi& second) {
  vi low, high;
#if defined(__AVX512F__)
  low = (vi)_mm512_i32gather_epi64(_mm512_castsi512_si256((__m512i)index), p, 4 * step);
  high = (vi)_mm512_i32gather_epi64(_mm512_extracti64x4_epi64((__m512i)index, 1), p, 4 * step);
#else
  for (int i = 0; i < LANES / 2; i++) {
    memcpy((char*)&low + 8 * i, p + step * (int64_t)index[i], 8);
    memcpy((char*)&high + 8 * i, p + step * (int64_t)index[i + LANES / 2], 8);
  }
#endif
  first = JG_SHUFFLE(low, high, 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
  second = JG_SHUFFLE(low, high, 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
}

// Rounds towards minus infinity. By an instruction or by conversion, not by the (x + M) - M trick, which fast-math folds
// away; without the instruction only what an int32 holds.
JG_INLINE vf floor(vf x) {
#if defined(__clang__)
  return __builtin_elementwise_floor(x);
#else
  const vf n = __builtin_convertvector(__builtin_convertvector(x, vi), vf);
  return n > x ? n - 1.f : n;
#endif
}
JG_INLINE vi floor_to_int(vf x) { return __builtin_convertvector(floor(x), vi); }

// One bit per lane of a comparison.
JG_INLINE uint32_t bit_mask(vi condition) {
#if defined(__clang__)
  typedef bool vb __attribute__((ext_vector_type(16)));
  vb b = __builtin_convertvector(condition, vb);
  uint16_t r;
  memcpy(&r, &b, 2);
  return r;
#elif defined(__AVX512DQ__)
  return (uint32_t)_mm512_movepi32_mask((__m512i)condition);
#else
  uint32_t r = 0;
  for (int i = 0; i < LANES; i++) r |= (uint32_t)(condition[i] & 1) << i;
  return r;
#endif
}

// ---- exponential and logarithm to the base 2 ------------------------------------------------------------------------

// 2^e for e <= 0 (more than a rounding error above 0 never occurs). Below the range the value is meaningless, possibly
// infinite or NaN: callers select it away.
// AVX-512: any e, relative error 2e-7. Elsewhere there is no cheap way to add an exponent, so a polynomial on [-1, 0]
// is squared SQUARINGS times: e >= -2^SQUARINGS, relative error 7e-7 for 3 and twice that for each one more.
template <int SQUARINGS>
JG_INLINE vf exp2_of_negative(vf e) {
#if defined(__AVX512DQ__)
  const vf f = (vf)_mm512_reduce_ps((__m512)e, 1);  // e - floor(e)
  vf p = f * 0.0018775766948238015f + 0.00898933969438076f;
  p = p * f + 0.05582631751894951f;
  p = p * f + 0.24015361070632935f;
  p = p * f + 0.6931530833244324f;
  p = p * f + 1.0f;
  return (vf)_mm512_scalef_ps((__m512)p, (__m512)e);  // p 2^floor(e)
#else
  const vf t = e * (1.0f / (1 << SQUARINGS));
  vf p = t * 0.0009449032019029429f + 0.009205797106527977f;
  p = p * t + 0.0552973573756122f;
  p = p * t + 0.24018014259841872f;
  p = p * t + 0.6931437211189393f;
  p = p * t + 1.0f;
  for (int i = 0; i < SQUARINGS; i++) p = p * p;
  return p;
#endif
}

// 2^e for any e; below -126 and for NaN 2^-126, above 126 2^126. Relative error 3e-7.
JG_INLINE vf exp2(vf e) {
  const vf inside = min(max(e, all(-126.f)), all(126.f)), whole = floor(inside), f = inside - whole;
  vf p = f * 0.0018775766948238015f + 0.00898933969438076f;
  p = p * f + 0.05582631751894951f;
  p = p * f + 0.24015361070632935f;
  p = p * f + 0.6931530833244324f;
  p = p * f + 1.0f;
#if defined(__AVX512F__)
  return (vf)_mm512_scalef_ps((__m512)p, (__m512)whole);
#else
  return float_of(bits_of(p) + (__builtin_convertvector(whole, vi) << 23));
#endif
}

// log2 for x > 0, absolute error below one unit in the last place of the result. Anything below the smallest
// normal number, and NaN, counts as that number, so that the result is finite for every x but +inf.
JG_INLINE vf log2(vf x) {
  // x = m 2^n with m in [sqrt(1/2), sqrt(2)), log2(m) = 2/ln2 atanh(t)
  const vi bits = bits_of(max(x, all(1.17549435e-38f))), n = (bits - 0x3f3504f3) >> 23;
  const vf m = float_of(bits - (n << 23)), t = (m - 1.0f) / (m + 1.0f), t2 = t * t;
  vf p = t2 * 0.32059890f + 0.41219858f;
  p = p * t2 + 0.57707802f;
  p = p * t2 + 0.96179669f;
  p = p * t2 + 2.88539008f;
  return p * t + __builtin_convertvector(n, vf);
}

// ---- rows and columns -----------------------------------------------------------------------------------------------

// Sixteen (x, y, z) triples, one after the other in memory, as three vectors.
JG_INLINE void load_triples(const float* p, vf& x, vf& y, vf& z) {
  const vf a = load(p), b = load(p + 16), c = load(p + 32);
  const vf ab_x = JG_SHUFFLE(a, b, 0, 3, 6, 9, 12, 15, 18, 21, 24, 27, 30, 0, 0, 0, 0, 0);
  const vf ab_y = JG_SHUFFLE(a, b, 1, 4, 7, 10, 13, 16, 19, 22, 25, 28, 31, 0, 0, 0, 0, 0);
  const vf ab_z = JG_SHUFFLE(a, b, 2, 5, 8, 11, 14, 17, 20, 23, 26, 29, 0, 0, 0, 0, 0, 0);
  x = JG_SHUFFLE(ab_x, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 17, 20, 23, 26, 29);
  y = JG_SHUFFLE(ab_y, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 18, 21, 24, 27, 30);
  z = JG_SHUFFLE(ab_z, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 16, 19, 22, 25, 28, 31);
}

JG_INLINE void store_triples(float* p, vf x, vf y, vf z) {
  const vf a = JG_SHUFFLE(x, y, 0, 16, 0, 1, 17, 0, 2, 18, 0, 3, 19, 0, 4, 20, 0, 5);
  const vf b = JG_SHUFFLE(x, y, 21, 0, 6, 22, 0, 7, 23, 0, 8, 24, 0, 9, 25, 0, 10, 26);
  const vf c = JG_SHUFFLE(x, y, 0, 11, 27, 0, 12, 28, 0, 13, 29, 0, 14, 30, 0, 15, 31, 0);
  store(p, JG_SHUFFLE(a, z, 0, 1, 16, 3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20, 15));
  store(p + 16, JG_SHUFFLE(b, z, 0, 21, 2, 3, 22, 5, 6, 23, 8, 9, 24, 11, 12, 25, 14, 15));
  store(p + 32, JG_SHUFFLE(c, z, 26, 1, 2, 27, 4, 5, 28, 7, 8, 29, 10, 11, 30, 13, 14, 31));
}

JG_INLINE void store_sixes(float* p, const vf rows[6]) {
  float columns[6][LANES];
  for (int k = 0; k < 6; k++) store(columns[k], rows[k]);
  for (int i = 0; i < LANES; i++)
    for (int k = 0; k < 6; k++) p[6 * i + k] = columns[k][i];
}

// Sixteen rows of six, one after the other in memory, as six vectors. A row is two triples.
JG_INLINE void load_sixes(const float* p, vf out[6]) {
  vf low[3], high[3];
  load_triples(p, low[0], low[1], low[2]), load_triples(p + 3 * LANES, high[0], high[1], high[2]);
  for (int i = 0; i < 3; i++) {
    out[i] = JG_SHUFFLE(low[i], high[i], 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
    out[i + 3] = JG_SHUFFLE(low[i], high[i], 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
  }
}

// Every lane with all lanes: halves of what is left are put upon each other, four times.
template <class Join>
JG_INLINE vf folded(vf v, Join join) {
  v = join(v, JG_SHUFFLE(v, v, 8, 9, 10, 11, 12, 13, 14, 15, 0, 1, 2, 3, 4, 5, 6, 7));
  v = join(v, JG_SHUFFLE(v, v, 4, 5, 6, 7, 0, 1, 2, 3, 12, 13, 14, 15, 8, 9, 10, 11));
  v = join(v, JG_SHUFFLE(v, v, 2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13));
  return join(v, JG_SHUFFLE(v, v, 1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14));
}

// Row i, lane j becomes row j, lane i. Interleaving rows that are half the height apart, four times, transposes.
JG_INLINE void transpose(vf rows[LANES]) {
  vf other[LANES];
  for (int round = 0; round < 4; round++) {
    for (int i = 0; i < 8; i++) {
      const vf low = rows[i], high = rows[i + 8];
      other[2 * i] = JG_SHUFFLE(low, high, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
      other[2 * i + 1] = JG_SHUFFLE(low, high, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
    }
    memcpy(rows, other, sizeof other);
  }
}

}  // namespace jg
