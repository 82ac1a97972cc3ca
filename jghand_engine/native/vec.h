// Sixteen floats at a time: clang and gcc vector extensions, which become AVX-512, AVX2 or NEON instructions.
#pragma once
#include <stdint.h>
#include <string.h>
#if defined(__AVX512F__)
#include <immintrin.h>
#endif

#define JG_INLINE static inline __attribute__((always_inline))

namespace jg {

typedef float vf __attribute__((vector_size(64)));
typedef int32_t vi __attribute__((vector_size(64)));

constexpr int LANES = 16;

JG_INLINE vf all(float x) { return vf{} + x; }
JG_INLINE vi all(int32_t x) { return vi{} + x; }
// A NaN in `a` gives `b`: comparisons with NaN are false.
JG_INLINE vf max(vf a, vf b) { return a > b ? a : b; }
JG_INLINE vf min(vf a, vf b) { return a < b ? a : b; }
JG_INLINE vf abs(vf a) { return a < 0 ? -a : a; }
JG_INLINE vf select(vi condition, vf yes, vf no) { return condition ? yes : no; }
JG_INLINE vf sqrt(vf a) { return __builtin_elementwise_sqrt(a); }

// memcpy is how an unaligned load is written without breaking aliasing rules; it becomes one instruction.
JG_INLINE vf load(const float* p) {
  vf v;
  memcpy(&v, p, sizeof v);
  return v;
}
JG_INLINE void store(float* p, vf v) { memcpy(p, &v, sizeof v); }
JG_INLINE void store(int32_t* p, vi v) { memcpy(p, &v, sizeof v); }
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

// Rounds towards minus infinity. By conversion, not by the (x + M) - M trick, which fast-math folds away.
JG_INLINE vi floor_to_int(vf x) {
  vi n = __builtin_convertvector(x, vi);
  return n + (__builtin_convertvector(n, vf) > x);  // a true comparison is -1
}

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

}  // namespace jg
