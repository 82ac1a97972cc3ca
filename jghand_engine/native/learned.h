// The skin of a trained hand: correctives, turned normals, light, cast shadow and gloss (METHOD 2.9, 4.1), sixteen
// Gaussians at a time. learn/skinning.py, light.py, pose_net.py and cast_shadow.py are the specification.
#pragma once
#include <stdint.h>

#include "skin.h"
#include "team.h"

namespace jg {

// Shadows of the fingers, at anchors. Mirrored field by field in native/learned_tasks.py.
struct CastTask {
  const float* rest;            // (blocks, 6, 16): place as in SkinTask, unit normal; of the anchors, in blocks
  const int32_t* block_start;   // bones of the blocks, as in SkinTask
  const int32_t* bone;
  const float* weight;
  const float* foreign;         // (blocks, BONES, 16): 1 - own
  const float* lamp;            // (groups, 6, 16): direction, rgb; those that fill up the last group are black
  const float* capsule;         // (capsules, 8): start, axis, 1 / squared length, radius; root-relative, meters
  const float* capsule_lamp;    // (capsules, groups, 2, 16): axis . direction, 1 / (squared length sine^2)
  const float* other;           // (capsules - BONES): how much those of other hands count, behind the hand's own
  float* fallen;                // (16 blocks, 4): exponent per channel; the fourth is not used
  float bounced[3];             // light that reaches skin which sees no lamp
  float softness, lamp_width, width_min, distance2_min;
  float to_display;             // exponent per logarithm of light
  int32_t blocks, groups, capsules;
};

enum Correctives { NO_CORRECTION = 0, GIVEN = 1, LINEAR = 2, NETWORK = 3 };

struct SceneLightTask;

// Mirrored field by field in native/learned_tasks.py.
struct LearnedTask {
  SkinTask skin;
  CastTask cast;
  const SceneLightTask* scene;  // null: in the light that it was learned in
  const float* look;            // (blocks, 7, 16): unit normal, albedo, shine
  // correctives
  float* given;                 // (blocks, 6, 16): offset, meters, and shade; the network leaves its own there, if not null
  const int8_t* direction;      // (blocks, basis, 6, 16)
  const float* constant;        // (blocks, 8, 16): offset and shade, then one step of `direction` of either
  const float* numbers;         // (21, basis)
  const float* places;          // (blocks, hidden, 16): the first layer's view of a Gaussian's place, with its bias
  const float* features;        // (21, hidden): the first layer's view of a bone's angles
  const float* middle;          // (hidden / NETWORK_TILE, hidden, NETWORK_TILE): weights from a unit to those of a tile
  const float* middle_bias;     // (hidden)
  const float* out;             // (hidden, 6)
  // the anchors around a Gaussian
  const int32_t* nearest;       // (blocks, 3, 16); null: no shadow is cast
  const float* share;           // (blocks, 3, 16)
  // light
  const float* irradiance;      // (16, 3)
  const float* lobe;            // (lobes, 7): unit direction, sharpness / ln 2, rgb
  // results
  float* matt;                  // (blocks, 6, 16): unit normal and matt color, for the gloss; null: nothing is glossy
  float* rgb;                   // (16 blocks, 3)
  float* front;                 // (16 blocks): how much it is seen from outside, see RasterJob; null: nobody asks
  const float* hidden_from;     // (16 blocks): cosine to the eye up to which it is not drawn, as skin before it hides it;
                                // null: all is drawn
  float out_bias[6];
  float reach[2];               // of offset and shade
  float eye[3];
  float rim;
  float volume_min;             // least |det L| / s_g^3 by which attached vectors are scaled
  float exponent_max, length2_min;
  int32_t correctives;
  int32_t world_offsets;        // 0: offsets turn with the hand; 1: in world axes; -1: those of a left hand, mirrored
  int32_t basis, hidden, lobes;
  float from_behind;            // 0..1, how much the eye sees of the cap at the end of the hand: the less that faces away
                                // is drawn, which would be black before the hand
};

constexpr int CORRECTION = 6, LOOK = 7, MATT = 6, LOBE = 7, CAPSULE = 8;
constexpr float LOBE_LOG2_MIN = -31.f;  // of a lobe's strength: less than 2^-31 of it is not seen, nor computed well
constexpr int BONES = 20, ANCHORS_AROUND = 3, HARMONICS = 16;
constexpr int NETWORK_TILE = 8;   // units of the second layer computed together; native/learned_tasks.py packs them
constexpr float AWAY_FROM = -0.1f, AWAY_WIDTH = 0.2f;  // cosines over which skin that faces away fades out
constexpr int HIDDEN_MAX = 256;   // wider networks are refused: two layers of two blocks lie on the stack

// One block's offset (canonical axes, meters) and shade by the linear tier.
void linear_correction(const LearnedTask& t, int32_t block, vf out[CORRECTION]);
// Of `count` blocks (1 or NETWORK_BLOCKS) from the first one on by the network.
#if defined(__AVX512F__)
constexpr int NETWORK_BLOCKS = 2;  // 16 sums of 16 floats in 32 registers
#else
constexpr int NETWORK_BLOCKS = 1;
#endif
void network_correction(const LearnedTask& t, int32_t block, int count, vf out[][CORRECTION]);

// Places and unit normals of the anchors of one block.
void posed_anchors(const CastTask& t, const SkinTask& skin, float volume_min, float length2_min, int32_t block, vf p[3],
                   vf normal[3]);

// The shadow at the anchors of one block.
void cast_block(const CastTask& t, const SkinTask& skin, float volume_min, float length2_min, int32_t block);

// v / |v|; a zero vector stays zero.
JG_INLINE void make_unit(vf v[3], float length2_min) {
  const vf shorter = inverse_sqrt(max(v[0] * v[0] + v[1] * v[1] + v[2] * v[2], all(length2_min)));
  for (int i = 0; i < 3; i++) v[i] *= shorter;
}

// The blended rotation up to shear, L / |det L|^(1/3), row by row; what has collapsed counts as having some volume.
JG_INLINE void turning(const SkinTask& s, float volume_min, const vf m[MAP_ENTRIES], vf volume, vf turn[9]) {
  const vf inverse = exp2(log2(max(volume, all(volume_min))) * (-1.f / 3.f)) * s.inverse_scale;
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) turn[3 * i + j] = m[4 * i + j] * inverse;
}

JG_INLINE void turn_by(const vf turn[9], const vf v[3], vf out[3]) {
  for (int i = 0; i < 3; i++) out[i] = turn[3 * i] * v[0] + turn[3 * i + 1] * v[1] + turn[3 * i + 2] * v[2];
}

JG_INLINE vf dot(const vf a[3], const vf b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Skin that faces away is seen through gaps only: in back light it would shine through them. `facing`: cosines to the eye
JG_INLINE vf seen_from_outside(const LearnedTask& t, int64_t row, vf facing) {
  const vf fade = smooth((facing - AWAY_FROM) / AWAY_WIDTH);
  vf drawn = fade;
  if (t.hidden_from) {
    const vf hidden = load(t.hidden_from + row), is_cap = all(t.from_behind > 0 ? 0.f : 2.f);
    drawn = select(facing > select(hidden > 1, is_cap, hidden * (1.f - t.from_behind)), fade, all(-1.f));
  }
  if (t.front) store(t.front + row, drawn);
  return fade;
}

// Real spherical harmonics of degrees 0 to 3, without constants; `harmonics` in learn/light.py.
JG_INLINE void harmonics(const vf n[3], vf out[HARMONICS]) {
  const vf x = n[0], y = n[1], z = n[2], xx = x * x, yy = y * y, zz = z * z;
  const vf values[HARMONICS] = {all(1.f),
                                x,
                                y,
                                z,
                                x * y,
                                y * z,
                                z * x,
                                xx - yy,
                                3.f * zz - 1.f,
                                y * (3.f * xx - yy),
                                x * y * z,
                                y * (5.f * zz - 1.f),
                                z * (5.f * zz - 3.f),
                                x * (5.f * zz - 1.f),
                                z * (xx - yy),
                                x * (xx - 3.f * yy)};
  memcpy(out, values, sizeof values);
}

// What lights in lobes (count, LOBE) shine from sixteen directions.
JG_INLINE void add_lobes(const float* lobe, int32_t count, const vf direction[3], vf rgb[3]) {
  for (int32_t k = 0; k < count; k++, lobe += LOBE) {
    const vf cosine = direction[0] * lobe[0] + direction[1] * lobe[1] + direction[2] * lobe[2];
    const vf strength = exp2_of_negative<5>(max((cosine - 1.f) * lobe[3], all(LOBE_LOG2_MIN)));
    for (int i = 0; i < 3; i++) rgb[i] += strength * lobe[4 + i];
  }
}

}  // namespace jg
