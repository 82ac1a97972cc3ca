// Which x86-64 variant this processor and this operating system can run: 4 (AVX-512), 3 (AVX2) or 0.
//
// Compiled for the x86-64 baseline, so that it can be called before anything newer. It asks the processor itself:
// __builtin_cpu_supports needs a compiler run-time that is not everywhere.
#include <cpuid.h>

#if defined(_WIN32)
#define JG_API extern "C" __declspec(dllexport)
#else
#define JG_API extern "C" __attribute__((visibility("default")))
#endif

namespace {

const char STAMP[] __attribute__((used)) = JG_BUILD_STAMP;

struct Registers {
  unsigned a, b, c, d;
};

Registers cpuid(unsigned leaf) {
  Registers r = {0, 0, 0, 0};
  if (!__get_cpuid_count(leaf, 0, &r.a, &r.b, &r.c, &r.d)) r = {0, 0, 0, 0};
  return r;
}

// Register sets that the operating system saves when it switches threads.
unsigned long long saved_state() {
  unsigned low, high;
  __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  return (unsigned long long)high << 32 | low;
}

bool has(unsigned word, unsigned wanted) { return (word & wanted) == wanted; }

}  // namespace

JG_API const char* jg_detector_stamp() { return STAMP; }

JG_API int jg_x86_64_level() {
  const unsigned fma = 1u << 12, movbe = 1u << 22, osxsave = 1u << 27, avx = 1u << 28, f16c = 1u << 29;
  const unsigned bmi1 = 1u << 3, avx2 = 1u << 5, bmi2 = 1u << 8, lzcnt = 1u << 5;
  const unsigned avx512f = 1u << 16, avx512dq = 1u << 17, avx512cd = 1u << 28, avx512bw = 1u << 30, avx512vl = 1u << 31;
  const unsigned long long ymm_state = 0x6, zmm_state = 0xe6;

  const unsigned basic = cpuid(1).c;
  if (!has(basic, fma | movbe | osxsave | avx | f16c)) return 0;
  const unsigned extended = cpuid(7).b;
  if (!has(extended, bmi1 | avx2 | bmi2) || !has(cpuid(0x80000001u).c, lzcnt)) return 0;
  const unsigned long long state = saved_state();
  if ((state & ymm_state) != ymm_state) return 0;
  const bool wide = has(extended, avx512f | avx512dq | avx512cd | avx512bw | avx512vl);
  return wide && (state & zmm_state) == zmm_state ? 4 : 3;
}
