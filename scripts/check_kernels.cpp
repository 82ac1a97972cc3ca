// Makes the calls of a recording with a kernel library and compares what it computes with what is recorded.
//
//   check_kernels LIBRARY RECORDING
//
// Built by scripts/check_kernels.py, which describes the recording, for systems that this machine only imitates.
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <windows.h>
#else
#include <dlfcn.h>
#endif

static FILE* file;

static void fail(const char* what, const char* which) {
  fprintf(stderr, "%s: %s\n", what, which);
  exit(1);
}

static void take(void* to, uint64_t size) {
  if (size && fread(to, 1, size, file) != size) fail("the recording ends too early", "");
}

static uint64_t number() {
  uint64_t value;
  take(&value, sizeof value);
  return value;
}

// On a cache line of its own, as Python gives memory to the kernels.
static char* memory(uint64_t size) {
  char* raw = (char*)calloc(size + 192, 1);
  return raw + (64 - (uintptr_t)raw % 64);
}

static double value_at(const char* place, uint64_t kind, uint64_t i) {
  return kind == 1 ? (double)((const float*)place)[i] : ((const double*)place)[i];
}

int main(int count, char** words) {
  if (count != 3) fail("usage", "check_kernels LIBRARY RECORDING");
#ifdef _WIN32
  HMODULE library = LoadLibraryA(words[1]);
#else
  void* library = dlopen(words[1], RTLD_NOW);
#endif
  if (!library) fail("the library cannot be loaded", words[1]);
  file = fopen(words[2], "rb");
  if (!file) fail("there is no such file", words[2]);
  uint64_t calls = number(), compared = 0;
  for (uint64_t call = 0; call < calls; call++) {
    char name[64] = {}, *blocks[64], *wanted[64];
    take(name, number());
    uint64_t arguments = number(), block_count = number(), sizes[64], kinds[64];
    for (uint64_t b = 0; b < block_count; b++) {
      sizes[b] = number(), kinds[b] = number();
      blocks[b] = memory(sizes[b]);
      take(blocks[b], sizes[b]);
      wanted[b] = kinds[b] ? memory(sizes[b]) : nullptr;
      if (kinds[b]) take(wanted[b], sizes[b]);
    }
    for (uint64_t pointers = number(); pointers; pointers--) {
      uint64_t block = number(), at = number(), target = number(), offset = number();
      char* address = blocks[target] + offset;
      memcpy(blocks[block] + at, &address, sizeof address);
    }
#ifdef _WIN32
    auto function = (void (*)(void*, void*, void*, void*, void*))GetProcAddress(library, name);
#else
    auto function = (void (*)(void*, void*, void*, void*, void*))dlsym(library, name);
#endif
    if (!function) fail("the library has no", name);
    void* given[5] = {};
    for (uint64_t i = 0; i < arguments; i++) given[i] = blocks[i];
    function(given[0], given[1], given[2], given[3], given[4]);
    for (uint64_t b = 0; b < block_count; b++) {
      for (uint64_t i = 0; kinds[b] && i < sizes[b] / (4 * kinds[b]); i++, compared++) {
        const double came = value_at(blocks[b], kinds[b], i), want = value_at(wanted[b], kinds[b], i);
        // as the self-test of the library (jghand_engine/native/selftest.py)
        if (!(fabs(came - want) <= 1e-4 * fmax(1, fabs(want))) && !(isnan(came) && isnan(want))) {
          fprintf(stderr, "%s, result %d, number %d: wanted %g, came %g\n", name, (int)b, (int)i, want, came);
          return 1;
        }
      }
    }
  }
  printf("%d calls, %d numbers\n", (int)calls, (int)compared);
  return 0;
}
