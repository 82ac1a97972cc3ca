// Skin in the light of a scene. Lamps are computed at every Gaussian, their shadows, those of the world and what skin
// throws back onto skin at the anchors of the cast shadow.
#include "scene_light.h"

#include "capsule.h"
#include "constants.h"
#include "export.h"

namespace jg {
namespace {

constexpr float PI = 3.14159265358979f;
constexpr float DISTANCE2_MIN = 1e-12f;                   // m2, of a point at a lamp
constexpr float CORNER_MIN = 0.02f, CORNER_MAX = 0.95f;   // of a cosine's rounded corner
constexpr float FACING_MIN = 1e-3f;                       // cosine to the eye, as a divisor
constexpr float AWAY_FROM = -0.7f, AWAY_WIDTH = 0.5f;     // cosines over which skin that faces away fades out
constexpr float GRAZING_GAIN = 0.5f;                      // of Fresnel's rise, on skin
constexpr float GRAZING_FROM = 50.f;                      // what reflects less than 1 / 50 does not rise to all of it
constexpr float FAR_COSINE_MIN = 1e-4f;                   // of an area's axis, as a divisor
constexpr float MASKED_MIN = 1e-6f;                       // of rows without skin, whose roughness is 0
constexpr float EDGE_GAIN = 100.f;                        // how fast anchors stop counting where an edge is near
constexpr int POSED = 9, REACHED = 8, MATERIAL = 3, BAKED = 12;

JG_INLINE vf smooth(vf x) {
  const vf t = clamped(x);
  return t * t * (3.f - 2.f * t);
}

// mu above w, 0 below -w, smooth between (C1): light does not leak to the far side.
JG_INLINE vf soft_cosine(vf mu, vf w) {
  const vf part = mu + w;
  return select(mu >= w, mu, select(mu <= -w, vf{}, part * part / (4.f * w)));
}

// A lamp from sixteen points: direction towards it, irradiance of what faces it over its rgb, sine of its half angle.
JG_INLINE void lamp_at(const float* lamp, const vf p[3], vf direction[3], vf& strength, vf& sine) {
  const int kind = (int)lamp[KIND];
  if (kind == SUN) {
    for (int i = 0; i < 3; i++) direction[i] = all(lamp[PLACE + i]);
    strength = all(1.f), sine = all(lamp[SUN_SINE]);
    return;
  }
  for (int i = 0; i < 3; i++) direction[i] = lamp[PLACE + i] - p[i];
  const vf distance2 = max(dot(direction, direction), all(DISTANCE2_MIN)), inverse = 1.f / sqrt(distance2);
  for (int i = 0; i < 3; i++) direction[i] *= inverse;
  strength = 1.f / (distance2 + lamp[SOFTENING]);
  sine = sqrt(lamp[RADIUS2] / (distance2 + lamp[RADIUS2]));
  if (kind == POINT) return;
  const vf cosine = -(direction[0] * lamp[AXIS] + direction[1] * lamp[AXIS + 1] + direction[2] * lamp[AXIS + 2]);
  if (kind == SPOT) {
    strength *= smooth((cosine - lamp[CONE]) * lamp[CONE_SCALE]);
  } else {
    strength *= max(cosine, vf{});
    if (lamp[SPREAD_GAIN] > 0) {
      const vf tangent = sqrt(max(1.f - cosine * cosine, vf{})) / max(cosine, all(FAR_COSINE_MIN));
      strength *= max(lamp[SPREAD] - tangent, vf{}) * lamp[SPREAD_GAIN];
    }
  }
}

// What of a lamp sixteen anchors see past one capsule.
template <bool far>
JG_INLINE bool lamp_past(const CastTask& c, const SceneLightTask& s, int k, const vf p[3], const vf direction[3], vf sine,
                         float softness, vf& part) {
  const float *capsule = c.capsule + CAPSULE * k, *axis = capsule + 3;
  const float length2 = 1.f / capsule[6];
  vf from_start[3];
  for (int i = 0; i < 3; i++) from_start[i] = p[i] - capsule[i];
  const vf axis_along = direction[0] * axis[0] + direction[1] * axis[1] + direction[2] * axis[2];
  const vf inverse_sine2 = 1.f / max(length2 - axis_along * axis_along, all(s.sine2_min * length2));
  return past_capsule<far>(c, capsule, from_start, direction, axis_along, inverse_sine2, softness, sine, part);
}

// And past all capsules; `past_capsules` in learn/scene_light.py.
vf lamp_seen(const CastTask& c, const SceneLightTask& s, const float* foreign, const vf p[3], const vf direction[3],
             vf sine, float softness) {
  vf visible = all(1.f), part;
  for (int bone = 0; bone < BONES; bone++) {
    const vf hides = load(foreign + LANES * bone);
    if (bit_mask(hides > 0) && lamp_past<false>(c, s, bone, p, direction, sine, softness, part))
      visible *= 1.f - hides * (1.f - part);
  }
  for (int k = BONES; k < c.capsules; k++)
    if (lamp_past<true>(c, s, k, p, direction, sine, softness, part))
      visible *= 1.f - c.other[OTHER * (k - BONES)] * (1.f - part);
  return visible;
}

JG_INLINE void world_irradiance(const SceneLightTask& s, const vf normal[3], vf out[3]) {
  vf waves[HARMONICS];
  harmonics(normal, waves);
  for (int i = 0; i < 3; i++) {
    vf sum = waves[0] * s.irradiance[i];
    for (int k = 1; k < HARMONICS; k++) sum += waves[k] * s.irradiance[3 * k + i];
    out[i] = max(sum, all(s.least[i]));
  }
}

// The anchors around sixteen Gaussians: sums of shares times values, `columns` of them, `stride` apart.
template <int COLUMNS>
JG_INLINE void spread(const LearnedTask& t, int32_t block, const float* values, int stride, vf out[COLUMNS]) {
  const int64_t first = ANCHORS_AROUND * LANES * (int64_t)block;
  for (int i = 0; i < COLUMNS; i++) out[i] = vf{};
  for (int k = 0; k < ANCHORS_AROUND; k++) {
    const int32_t* nearest = t.nearest + first + LANES * k;
    const vf share = load(t.share + first + LANES * k);
    float columns[COLUMNS][LANES];
    for (int lane = 0; lane < LANES; lane++)
      for (int i = 0; i < COLUMNS; i++) columns[i][lane] = values[stride * (int64_t)nearest[lane] + i];
    for (int i = 0; i < COLUMNS; i++) out[i] += share * load(columns[i]);
  }
}

// Half width of the rounded corner of a cosine, of one channel.
JG_INLINE vf corner_of(const SceneLightTask& s, int channel, vf spread, vf sine) {
  const vf own = spread * s.softness[channel];
  return min(max(sqrt(own * own + sine * sine), all(CORNER_MIN)), all(CORNER_MAX));
}

// The same values where light of the lamps of a shadow falls on sixteen Gaussians, 0 where they face away from all.
JG_INLINE vf where_lit(const SceneLightTask& s, int slot, const vf p[3], const vf normal[3], vf spread, vf values) {
  vf lit = {};
  for (int j = 0; j < s.lamps; j++) {
    const float* lamp = s.lamp + LAMP * j;
    if ((int)lamp[SLOT] != slot) continue;
    vf direction[3], strength, sine;
    lamp_at(lamp, p, direction, strength, sine);
    const vf cosine = dot(normal, direction);
    for (int i = 0; i < 3; i++) lit = select(cosine > -corner_of(s, i, spread, sine), values, lit);
  }
  return lit;
}

// What of each lamp reaches sixteen Gaussians: the mean of what the anchors around them see, and near the edge of a
// shadow, which is sharper than anchors are apart, what is found for each.
JG_INLINE void lamps_seen(const LearnedTask& t, const SceneLightTask& s, int32_t block, const vf p[3],
                          const vf normal[3], vf spread_of_skin) {
  const CastTask& c = t.cast;
  const int64_t first = ANCHORS_AROUND * LANES * (int64_t)block;
  float foreign[BONES * LANES];
  bool has_foreign = false;
  for (int j = 0; j < s.slots; j++) {
    vf part[1], wide[1];
    spread<1>(t, block, s.seen + LANES * (int64_t)c.blocks * j, 1, part);
    spread<1>(t, block, s.wide_seen + LANES * (int64_t)c.blocks * j, 1, wide);
    vf edge = min(EDGE_GAIN * max(wide[0] * (1.f - wide[0]), vf{}), all(1.f));
    if (bit_mask(edge > 0)) edge = where_lit(s, j, p, normal, spread_of_skin, edge);
    if (bit_mask(edge > 0)) {
      for (int bone = 0; bone < BONES && !has_foreign; bone++) {
        vf sum = {};
        for (int k = 0; k < ANCHORS_AROUND; k++) {
          const int32_t* nearest = t.nearest + first + LANES * k;
          float of_anchor[LANES];
          for (int lane = 0; lane < LANES; lane++)
            of_anchor[lane] = c.foreign[LANES * (BONES * (int64_t)(nearest[lane] / LANES) + bone) + nearest[lane] % LANES];
          sum += load(t.share + first + LANES * k) * load(of_anchor);
        }
        store(foreign + LANES * bone, sum);
      }
      has_foreign = true;
      vf direction[3], strength, sine;
      lamp_at(s.casting + LAMP * j, p, direction, strength, sine);
      part[0] += edge * (lamp_seen(c, s, foreign, p, direction, sine, s.flesh_softness) - part[0]);
    }
    vf left[1] = {all(1.f)};
    if (s.left) spread<1>(t, block, s.left + LANES * (int64_t)c.blocks * j, 1, left);
    const vf reaches = 1.f - s.casting[LAMP * j + SHADE] * (1.f - part[0] * left[0]);
    store(s.skin_seen + LANES * ((int64_t)t.skin.blocks * j + block), reaches);
  }
}

JG_INLINE vf slot_seen(const LearnedTask& t, const SceneLightTask& s, int32_t block, const float* lamp) {
  if (lamp[SLOT] < 0) return all(1.f);
  return load(s.skin_seen + LANES * ((int64_t)t.skin.blocks * (int)lamp[SLOT] + block));
}

}  // namespace

void anchor_lamps(const LearnedTask& t, int32_t block) {
  const SceneLightTask& s = *t.scene;
  float* posed = s.posed + POSED * LANES * (int64_t)block;
  vf p[3], normal[3], given[3] = {};
  if (s.keeps_pose) {
    for (int i = 0; i < 3; i++) p[i] = load(posed + LANES * i), normal[i] = load(posed + LANES * (3 + i));
  } else {
    posed_anchors(t.cast, t.skin, t.volume_min, t.length2_min, block, p, normal);
    for (int i = 0; i < 3; i++) store(posed + LANES * i, p[i]), store(posed + LANES * (3 + i), normal[i]);
  }
  float* seen = s.seen + LANES * (int64_t)block;
  const int64_t rows = LANES * (int64_t)t.cast.blocks;
  vf direction[3], strength, sine;
  for (int j = 0; j < s.slots; j++) {
    lamp_at(s.casting + LAMP * j, p, direction, strength, sine);
    const float* foreign = t.cast.foreign + BONES * LANES * (int64_t)block;
    store(seen + rows * j, lamp_seen(t.cast, s, foreign, p, direction, sine, s.flesh_softness));
    store(s.wide_seen + LANES * (int64_t)block + rows * j,
          lamp_seen(t.cast, s, foreign, p, direction, sine, s.wide_softness));
  }
  for (int j = 0; j < s.lamps; j++) {
    const float* lamp = s.lamp + LAMP * j;
    lamp_at(lamp, p, direction, strength, sine);
    const int64_t slot = rows * (int)lamp[SLOT];
    vf part = lamp[SLOT] < 0 ? all(1.f) : load(seen + slot);
    if (s.left && lamp[SLOT] >= 0) part *= load(s.left + LANES * (int64_t)block + slot);
    part = 1.f - lamp[SHADE] * (1.f - part);
    const vf got = max(dot(normal, direction), vf{}) * strength * part * lamp[ON_MATT];
    for (int i = 0; i < 3; i++) given[i] += got * lamp[LAMP_RGB + i];
  }
  for (int i = 0; i < 3; i++) store(posed + LANES * (6 + i), given[i]);
}

void thrown_back(const LearnedTask& t, int32_t group) {
  const SceneLightTask& s = *t.scene;
  if (!(s.shade > 0)) return;
  const float* towards = t.cast.lamp + 6 * LANES * group;
  vf away[3], back[3], weights = all(DISTANCE2_MIN), sums[3] = {};
  for (int i = 0; i < 3; i++) away[i] = -load(towards + LANES * i);
  world_irradiance(s, away, back);
  for (int32_t block = 0; block < t.cast.blocks; block++) {
    const float* posed = s.posed + POSED * LANES * (int64_t)block;
    for (int lane = 0; lane < LANES; lane++) {
      const float* one = posed + lane;
      const vf turned = max(away[0] * one[3 * LANES] + away[1] * one[4 * LANES] + away[2] * one[5 * LANES], vf{});
      const vf weight = turned * turned;
      weights += weight;
      for (int i = 0; i < 3; i++) sums[i] += weight * one[(6 + i) * LANES];
    }
  }
  for (int i = 0; i < 3; i++)
    store(s.thrown + 3 * LANES * (int64_t)group + LANES * i, (back[i] + sums[i] / weights) * s.bounce[i]);
}

void anchor_world(const LearnedTask& t, int32_t block) {
  const SceneLightTask& s = *t.scene;
  const float* posed = s.posed + POSED * LANES * (int64_t)block;
  for (int lane = 0; lane < LANES; lane++) {
    float point[3], normal[3], *out = s.reached + REACHED * (LANES * (int64_t)block + lane);
    if (!(s.shade > 0)) {
      for (int i = 0; i < REACHED; i++) out[i] = i < 3 || i == 6;
      continue;
    }
    for (int i = 0; i < 3; i++) point[i] = posed[LANES * i + lane], normal[i] = posed[LANES * (3 + i) + lane];
    const float* foreign = t.cast.foreign + BONES * LANES * (int64_t)block + lane;
    vf open[3] = {}, seen[3] = {}, bounced[3] = {}, sky = {}, open_sky = {};
    for (int g = 0; g < t.cast.groups; g++) {
      float* kept = s.visible + LANES * (t.cast.groups * (LANES * (int64_t)block + lane) + g);
      vf cosine, visible;
      if (!distant_seen(t.cast, foreign, point, normal, g, s.keeps_visible ? kept : nullptr, cosine, visible)) continue;
      store(kept, visible);
      const float *cell = t.cast.lamp + 6 * LANES * g, *back = s.thrown + 3 * LANES * g;
      const vf hidden = cosine * (1.f - visible);
      for (int i = 0; i < 3; i++) {
        const vf light = cosine * load(cell + LANES * (3 + i));
        open[i] += light, seen[i] += light * visible, bounced[i] += hidden * load(back + LANES * i);
      }
      sky += cosine, open_sky += cosine * visible;
    }
    for (int i = 0; i < 3; i++) {
      const float whole = sum_of(open[i]) + s.ambient[i];
      out[i] = 1.f - s.shade * (1.f - (sum_of(seen[i]) + s.ambient[i]) / whole);
      out[3 + i] = s.shade * sum_of(bounced[i]);
    }
    out[6] = 1.f - s.shade * (1.f - sum_of(open_sky) / (sum_of(sky) + DISTANCE2_MIN));
  }
}

void reflecting_block(const LearnedTask& t, int32_t block, const vf normal[3], const vf correction[CORRECTION]) {
  const SceneLightTask& s = *t.scene;
  const float* look = t.look + LOOK * LANES * (int64_t)block;
  float *matt = t.matt + MATT * LANES * (int64_t)block, *reflecting = s.reflecting + 3 * LANES * (int64_t)block;
  for (int i = 0; i < 3; i++) {
    const vf shade = min(max(correction[3 + i] * s.shade_gain, all(-t.exponent_max)), all(t.exponent_max));
    store(matt + LANES * i, normal[i]);
    store(reflecting + LANES * i, load(look + LANES * (3 + i)) * (1.f / PI) * exp2(shade * LOG2E));
  }
}

void light_block(const LearnedTask& t, int32_t block) {
  const SceneLightTask& s = *t.scene;
  const int64_t row = LANES * (int64_t)block;
  float* matt = t.matt + MATT * row;
  const vf spread_of_skin = load(s.material + MATERIAL * row);
  vf p[3], normal[3], light[3], reached[6];
  load_triples(t.skin.position + 3 * row, p[0], p[1], p[2]);
  for (int i = 0; i < 3; i++) p[i] -= t.skin.shift[i], normal[i] = load(matt + LANES * i);
  lamps_seen(t, s, block, p, normal, spread_of_skin);
  if (s.baked) {
    vf field[BAKED];
    spread<BAKED>(t, block, s.baked, BAKED, field);
    for (int i = 0; i < 3; i++)
      light[i] = max(field[i] + normal[0] * field[3 + i] + normal[1] * field[6 + i] + normal[2] * field[9 + i], vf{});
  } else {
    world_irradiance(s, normal, light);
    spread<6>(t, block, s.reached, REACHED, reached);
    for (int i = 0; i < 3; i++) light[i] = light[i] * reached[i] + reached[3 + i];
  }
  for (int j = 0; j < s.lamps; j++) {
    const float* lamp = s.lamp + LAMP * j;
    if (!(lamp[ON_MATT] > 0)) continue;
    vf direction[3], strength, sine;
    lamp_at(lamp, p, direction, strength, sine);
    const vf cosine = dot(normal, direction), got = strength * slot_seen(t, s, block, lamp);
    for (int i = 0; i < 3; i++) {
      light[i] += soft_cosine(cosine, corner_of(s, i, spread_of_skin, sine)) * got * lamp[LAMP_RGB + i];
    }
  }
  for (int i = 0; i < 3; i++) store(matt + LANES * (3 + i), load(s.reflecting + 3 * row + LANES * i) * light[i]);
}

void seen_block(const LearnedTask& t, int32_t block) {
  const SceneLightTask& s = *t.scene;
  const int64_t row = LANES * (int64_t)block;
  const float *matt = t.matt + MATT * row, *material = s.material + MATERIAL * row;
  const vf rough = load(material + LANES), reflectance = load(material + 2 * LANES), alpha = rough * rough;
  const vf rise = GRAZING_GAIN * min(GRAZING_FROM * reflectance, all(1.f));
  vf p[3], n[3], eye[3], rgb[3], mirrored[3];
  load_triples(t.skin.position + 3 * row, p[0], p[1], p[2]);
  for (int i = 0; i < 3; i++) {
    n[i] = load(matt + LANES * i), rgb[i] = load(matt + LANES * (3 + i));
    eye[i] = t.eye[i] - p[i], p[i] -= t.skin.shift[i];
  }
  make_unit(eye, t.length2_min);
  const vf facing = dot(n, eye), cosine_eye = max(facing, all(FACING_MIN)), k = 0.5f * alpha;
  for (int j = 0; j < s.lamps; j++) {
    const float* lamp = s.lamp + LAMP * j;
    if (!(lamp[ON_GLOSS] > 0)) continue;
    vf direction[3], strength, sine, half[3];
    lamp_at(lamp, p, direction, strength, sine);
    for (int i = 0; i < 3; i++) half[i] = direction[i] + eye[i];
    make_unit(half, t.length2_min);
    const vf cosine = clamped(dot(n, direction)), middle = clamped(dot(n, half));
    const vf wide = min(alpha + 0.5f * sine, all(1.f)), wide2 = wide * wide;
    const vf bell = middle * middle * (wide2 - 1.f) + 1.f, grazing = 1.f - clamped(dot(direction, half));
    const vf square = grazing * grazing;
    const vf fresnel = reflectance + (1.f - reflectance) * (rise * square * square * grazing);
    const vf masked = max((cosine * (1.f - k) + k) * (cosine_eye * (1.f - k) + k), all(MASKED_MIN));
    const vf shine = wide2 / (PI * bell * bell) * fresnel * 0.25f * cosine / masked * strength * slot_seen(t, s, block, lamp);
    for (int i = 0; i < 3; i++) rgb[i] += shine * lamp[LAMP_RGB + i];
  }
  if (s.lobes) {
    for (int i = 0; i < 3; i++) mirrored[i] = 2.f * facing * n[i] - eye[i];
    vf sky[7], lobes[3] = {};
    spread<7>(t, block, s.reached, REACHED, sky);
    for (int j = 0; j < s.lobes; j++) {
      const float* lobe = s.lobe + LOBE * j;
      const vf cosine = mirrored[0] * lobe[0] + mirrored[1] * lobe[1] + mirrored[2] * lobe[2];
      const vf strength = exp2((cosine - 1.f) * lobe[3]);
      for (int i = 0; i < 3; i++) lobes[i] += strength * lobe[4 + i];
    }
    // how much of an even light GGX mirrors: Karis, "Physically Based Shading on Mobile", 2014
    const vf r0 = 1.f - rough, r1 = 0.0425f - 0.0275f * rough, r2 = 1.04f - 0.572f * rough, r3 = 0.022f * rough - 0.04f;
    const vf base = min(r0 * r0, exp2(-9.28f * cosine_eye)) * r0 + r1;
    const vf gain = (reflectance * (r2 - 1.04f * base) + rise * (r3 + 1.04f * base)) * sky[6];
    for (int i = 0; i < 3; i++) rgb[i] += lobes[i] * gain;
  }
  // skin that faces away is seen through gaps only: in back light it would shine through them
  const vf fade = smooth((facing - AWAY_FROM) / AWAY_WIDTH);
  for (int i = 0; i < 3; i++) rgb[i] *= fade;
  store_triples(t.rgb + 3 * row, rgb[0], rgb[1], rgb[2]);
}

}  // namespace jg

JG_API int32_t jg_scene_light_task_bytes() { return sizeof(jg::SceneLightTask); }
