// How a function is made visible to ctypes. Everything else stays inside the library.
#pragma once
#if defined(_WIN32)
#define JG_API extern "C" __declspec(dllexport)
#else
#define JG_API extern "C" __attribute__((visibility("default")))
#endif
