// What the kernels compile in of contract.py, which says why each has its value, and of tasks.py; a test compares.
#pragma once

namespace jg {

constexpr float BLUR_PX2 = 0.3f;
constexpr float VAR_MAX_PX2 = 1e9f;
constexpr float RGB_MAX = 1e6f;
constexpr float POSITION_MAX_M = 1e6f;
constexpr float FRONT_MIN = 0.04f;
constexpr float COVER_FROM = 0.15f;
constexpr float BENEATH_FROM = 0.1f;
constexpr float BENEATH_WHOLE = 0.5f;
constexpr float COVER_WHOLE = 0.9f;
constexpr float NOT_NEAR = -3e38f;
constexpr double COVARIANCE_SLACK = 1e-6;
constexpr int TILE_PX = 16;
constexpr int BLOCK_PX = 4;
constexpr int CHUNK = 128;
constexpr int GRADIENT_STRIPES = 4;
constexpr float SHADOW_FAR_M = 1e6f;
constexpr int SHADOW_SAMPLES_MAX = 256;
constexpr int SHADOW_STRIPES = 4;
constexpr int SSIM_WINDOW_PX = 11;

constexpr float LN2 = 0.6931471805599453f;
constexpr float LOG2E = 1.4426950408889634f;

}  // namespace jg
