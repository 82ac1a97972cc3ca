// Trained skin in the light of a scene (docs/LIGHT.md): a world all around and lamps in it, scene-linear.
// learn/scene_light.py is the specification, but of swept light: tests/avatar/test_bounce.py.
#pragma once
#include "lamp_depth.h"

namespace jg {

// Where the numbers of a lamp stand, root-relative, meters.
enum LampNumber {
  PLACE = 0,           // of a sun the direction towards it
  AXIS = 3,            // towards what is lit
  LAMP_RGB = 6,        // W/m2 of a sun, W/sr of others
  SOFTENING = 9,       // added to the squared distance
  RADIUS2 = 10,        // squared radius of what shines
  SUN_SINE = 11,       // of half the angle of a sun
  CONE = 12,           // of a spot: cosine of half the cone
  CONE_SCALE = 13,     // of a spot: 1 / (blend (1 - cosine))
  SPREAD = 14,         // of an area: tangent of half the spread
  SPREAD_GAIN = 15,    // of an area: 1 / (tangent - angle); 0: all of the half space
  KIND = 16,
  SLOT = 17,           // of its shadow; -1: none
  ON_MATT = 18,        // 0 or 1
  ON_GLOSS = 19,       // 0 or 1
  SHADE = 20,          // how much of its shadow is drawn, 0..1
  LAMP = 21
};
constexpr int SLOTS_MAX = 32;  // LAMPS_MAX of avatar/lamp_rows.py
constexpr int LAYERS_MAX = 8;  // of native/scene_light_task.py
constexpr int APART = 5;       // numbers of light that is drawn apart
constexpr int PATCH = 4;       // neighboring anchors that throw light as one: PATCH of avatar/cast_task.py
constexpr int POSED = 9;       // numbers of a posed anchor
constexpr int THROWN = 10;     // numbers of a patch
constexpr int EVENED = 8;      // anchors whose mean is taken of the skin that they see: EVENED of avatar/cast_task.py
constexpr int SWEPT = 64, SWEEPS = 16;  // directions along which thrown light is swept, and items of work: of
                                        // native/scene_light_task.py
constexpr int AGAIN_STEP = 2;           // every second of them says what is thrown again
static_assert(SWEPT % SWEEPS == 0 && SWEPT / SWEEPS % AGAIN_STEP == 0, "every item has as many directions");
constexpr int OF_BOUNCED = 3, OF_SKY = 6;  // in a row of `reached`
constexpr float LUMINANCE[3] = {0.2126f, 0.7152f, 0.0722f};  // Rec. 709
constexpr float WIDTH2_MIN = 1e-3f;     // of a lobe of gloss, as a divisor: that of a roughness of 0.18
constexpr float FACED_MIN = 1e-6f;      // part of all that a point faces, as a divisor
constexpr float FACED_PART_MIN = 0.25f; // of what is hidden, skin is taken to be: no more is made of little
enum LampKind { SUN = 0, POINT = 1, SPOT = 2, AREA = 3 };

// Mirrored field by field in native/scene_light_task.py.
struct SceneLightTask {
  const float* material;     // (blocks, 3, 16): spread, roughness, reflectance
  const uint32_t* own;       // (blocks): bones, by their bits, that stand before none of its Gaussians
  const uint32_t* partly;    // (blocks): others that do not stand before all of them wholly
  const int32_t* hides_start;  // (blocks): where those of a block begin
  const float* hides;        // (1 + entries, 16): how much they do; the first is of those that wholly do
  const float* lamp;         // (lamps, LAMP), those of one slot together
  const float* casting;      // (slots, LAMP): those whose shadows are found
  const float* irradiance;   // (16, 3): of the world, W/m2, for `harmonics`
  const float* left;         // (slots, 16 anchor blocks): what the scene's things leave of a lamp at an anchor; null: all
  const float* baked;        // (blocks, 12, 16): W/m2 instead of lamps and world: rgb, and how it turns; null: none
  const LampDepth* depth;    // (slots): what stands before a lamp, by pictures that are taken from it; null: none
  const float* lobe;         // (lobes, 7): what the world mirrors: unit direction, sharpness / ln 2, radiance
  float* posed;              // (anchor blocks, 9, 16): place and unit normal of the anchors, W/m2 that lamps give them
  float* visible;            // (anchor blocks, 16 groups, 16): part of each cell of the world that an anchor sees
  float* skin_seen;          // (slots, 16 blocks): what of it reaches a Gaussian
  float* apart;              // (layers, blocks, APART, 16): of light that is drawn apart W/m2 rgb of skin, as far as the
                             // lamp's picture counts there; what of it reaches the Gaussian; and how far it counts
  float* layer;              // (layers, layer_stride), (16 blocks, 4) of each: rgb that this light adds, and the sum of these
                             // as far as it reaches the Gaussian
  const float* at_pixels;    // (layers): how much of it is drawn apart, 0..1
  float* thrown;             // (16 / PATCH anchor blocks, THROWN): of patches mean place, normal, W/m2 that they throw
                             // back, and mean squared distance of their anchors from their middle; of padding zeros
  const int32_t* beside;     // (16 anchor blocks, EVENED): rows of anchors whose mean is taken of the skin that they see
  float* bounced;            // (16 anchor blocks, 4): W/m2 rgb before that, and the part of directions that is hidden
                             // and drawn so
  const float* area;         // (16 anchor blocks): m2 of skin around each at rest; null: light is thrown by patches
  const float* swept;        // (SWEPT, 3): directions along which it is swept otherwise
  float* once;               // (anchor blocks, 3, 16): W/m2 that anchors throw of lamps and world
  float* sent;               // (anchor blocks, 3, 16): of what others throw, too
  float* caught;             // (SWEEPS, 16 anchor blocks, 4): W/m2 rgb times cosines
  float* sweeping;           // (SWEEPS, sweep_floats): of one direction at a time
  float* reflecting;         // (blocks, 3, 16): albedo / pi, in the pose's shade
  float* sky;                // (16 blocks): part of it that a Gaussian sees
  float* reached;            // (16 anchor blocks, columns): what the anchors say, in rows: part of the world rgb, bounced
                             // W/m2 rgb, part of the sky, and of each slot two or three; whole vectors
  float softness[3];         // half width of the rounded corner of a cosine
  float bounce[3];           // albedo of skin that throws light back
  float least[3];            // W/m2 of the world, at least
  float shade_gain;          // of the pose's shade, in logarithms of linear color
  float flesh_softness;      // edge of a lamp's shadow, as a part of a capsule's radius
  float wide_softness;       // the same for `wide_seen`
  float sine2_min;           // floor of a squared sine between ray and capsule
  float texel_m;             // of what is swept, of a hand of scale 1
  float shade;               // how much of what skin hides of the world, and throws back, is drawn, 0..1
  int32_t layer_stride;      // floats
  int32_t lamps, slots, lobes;
  int32_t layers;            // of light that is drawn apart, to be shadowed at each pixel
  int32_t keeps_pose;        // whether the light alone is new
  int32_t keeps_visible;     // and the world is not
};

// what anchors say, in rows: of the world part rgb, bounced rgb and part of the sky; of each slot what is seen, the same
// with wide edges and, where things of the scene stand in the light, what these leave
constexpr int OF_WORLD = 7, OF_SLOT_MAX = 3, COLUMNS_MAX = (OF_WORLD + OF_SLOT_MAX * SLOTS_MAX + LANES - 1) / LANES * LANES;

template <typename Number>
JG_INLINE Number luminance(const Number rgb[3]) {
  return LUMINANCE[0] * rgb[0] + LUMINANCE[1] * rgb[1] + LUMINANCE[2] * rgb[2];
}

JG_INLINE int columns_per_slot(const SceneLightTask& s) { return s.left ? OF_SLOT_MAX : OF_SLOT_MAX - 1; }

// Of a row of what anchors say; whole vectors.
JG_INLINE int columns_of(const SceneLightTask& s) {
  return (OF_WORLD + columns_per_slot(s) * s.slots + LANES - 1) / LANES * LANES;
}

JG_INLINE void store_column(float* rows, int stride, vf values) {
  for (int lane = 0; lane < LANES; lane++) rows[stride * lane] = values[lane];
}

JG_INLINE vf load_column(const float* rows, int stride) {
  vf values;
  for (int lane = 0; lane < LANES; lane++) values[lane] = rows[stride * lane];
  return values;
}

// Each for all anchors, the first at most sixteen blocks at a time, then `light_blocks`.
void anchor_lamps(const LearnedTask& t, int32_t first, int32_t end);
void anchor_world(const LearnedTask& t, int32_t anchor_block);
void anchor_bounced(const LearnedTask& t, int32_t anchor_block);
void anchor_evened(const LearnedTask& t, int32_t anchor_block);
// In place of the last two where light is swept: `sweep_some` for all items, `anchor_again`, `sweep_some`, `anchor_caught`.
void sweep_some(const LearnedTask& t, int32_t item, int32_t step);
void anchor_again(const LearnedTask& t, int32_t anchor_block);
void anchor_caught(const LearnedTask& t, int32_t anchor_block);
// Keeps what lights the skin of a block in this pose, whatever the light is.
void reflecting_block(const LearnedTask& t, int32_t block, const vf normal[3], const vf correction[CORRECTION]);
// The matt color of blocks.
void light_blocks(const LearnedTask& t, int32_t first, int32_t end);
// What a block sends to the eye.
void seen_block(const LearnedTask& t, int32_t block);

// What skin mirrors of all lamps, as one lobe of GGX: of a normal that leans by d along the skin it is `part` times
// ((width2 + |way|^2) / (width2 + |way - d|^2))^2.
struct GlossLobe {
  vf way[3];   // along the skin, how a normal leans that mirrors the most
  vf width2;
  vf part;     // 0..1 of the color, but for the world's gloss
};

// How the light of skin at sixteen posed places p, root-relative, changes with its unit normal: per unit of a change,
// over the light itself, without color. nearest, share: (ANCHORS_AROUND, 16) of the anchors around them; beside: rows of
// the Gaussians at these. Of a hand in the light that it was learned in, of its colors. gloss: null, or of a hand in the
// light of a scene what the eye sees of its lamps
void light_slope(const LearnedTask& t, const int32_t* nearest, const int32_t* beside, const float* share, const vf p[3],
                 const vf normal[3], vf slope[3], GlossLobe* gloss);

}  // namespace jg
