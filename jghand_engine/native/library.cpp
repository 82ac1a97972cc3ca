// What the library says about itself.
#include <stdint.h>

#include "export.h"

#if defined(__FAST_MATH__) || defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "the native library must not be compiled with -ffast-math: see RENDERING 4.3"
#endif

namespace {
const char STAMP[] __attribute__((used)) = JG_BUILD_STAMP;
}

// Raised whenever a signature or a shared structure changes; native/binding.py holds the number it expects.
JG_API int32_t jg_abi() { return 16; }
JG_API const char* jg_stamp() { return STAMP; }
JG_API const char* jg_variant() { return JG_VARIANT; }
