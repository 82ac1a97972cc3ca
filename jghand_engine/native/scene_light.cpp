// Skin in the light of a scene. Lamps are computed at every Gaussian, their shadows, those of the world and what skin
// throws back onto skin at the anchors of the cast shadow.
#include "scene_light.h"

#include "capsule.h"
#include "constants.h"
#include "export.h"

namespace jg {
namespace {

constexpr float PI = 3.14159265358979f;
constexpr float DISTANCE2_MIN = 1e-12f;                   // m2, of a point at a lamp or at skin
constexpr float CORNER_MIN = 0.02f, CORNER_MAX = 0.95f;   // of a cosine's rounded corner
constexpr float FACING_MIN = 1e-3f;                       // cosine to the eye, as a divisor
constexpr float GRAZING_FROM = 50.f;                      // what reflects less than 1 / 50 does not rise to all of it
constexpr float FAR_COSINE_MIN = 1e-4f;                   // of an area's axis, as a divisor
constexpr float MASKED_MIN = 1e-6f;                       // of rows without skin, whose roughness is 0
constexpr float EDGE_GAIN = 100.f;                        // how fast anchors stop counting where an edge is near
constexpr float FACING_SUM_MIN = 1e-9f;                   // of cosines to all directions, as a divisor
constexpr float CAUGHT_MIN = 0.01f;                       // of light among skin that throws back all, as a divisor
constexpr float OPEN_MIN = 1e-12f;                        // W/m2 of the world, as a divisor
constexpr float CORNER_MIN2 = CORNER_MIN * CORNER_MIN, CORNER_MAX2 = CORNER_MAX * CORNER_MAX;
constexpr float LIT_MIN = 1e-9f;                          // W/m2, as a divisor
constexpr float GRAZED_MIN = 0.1f;                        // of light that faces skin, as a divisor: slopes stay steady
constexpr float SHINE_MIN = 1e-9f;                        // W/(m2 sr), as a divisor
constexpr int MATERIAL = 3, BAKED = 12;

// mu above w, 0 below -w, smooth between (C1): light does not leak to the far side. Takes w^2.
JG_INLINE vf soft_cosine(vf mu, vf w2) {
  const vf over_w = inverse_sqrt(w2), w = w2 * over_w, part = mu + w;
  return select(part <= 0, vf{}, select(mu >= w, mu, part * part * (0.25f * over_w)));
}

// A lamp from sixteen points: direction towards it, irradiance of what faces it over its rgb, squared sine of its half
// angle.
JG_INLINE void lamp_at(const float* lamp, const vf p[3], vf direction[3], vf& strength, vf& sine2) {
  const int kind = (int)lamp[KIND];
  if (kind == SUN) {
    for (int i = 0; i < 3; i++) direction[i] = all(lamp[PLACE + i]);
    strength = all(1.f), sine2 = all(lamp[SUN_SINE] * lamp[SUN_SINE]);
    return;
  }
  for (int i = 0; i < 3; i++) direction[i] = lamp[PLACE + i] - p[i];
  const vf distance2 = max(dot(direction, direction), all(DISTANCE2_MIN)), shorter = inverse_sqrt(distance2);
  for (int i = 0; i < 3; i++) direction[i] *= shorter;
  strength = inverse(distance2 + lamp[SOFTENING]);
  // what is large is soft, but for hard points
  sine2 = lamp[RADIUS2] * (lamp[SOFTENING] == lamp[RADIUS2] ? strength : inverse(distance2 + lamp[RADIUS2]));
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

// Sixteen points that look at a lamp: where it is, what of it they see past all capsules (`past_flesh` in
// learn/scene_light.py), and what they would if edges were wider.
struct Sight {
  vf p[3], direction[3], sine, seen, wide;
};

// Sixteen sights of one lamp.
// middle, radius: of balls around their points · own: bones, by their bits, that are the points' own flesh
struct Sights {
  vf middle[3], radius;
  vi own;
  Sight each[LANES];
};

JG_INLINE void set_points(Sights& to, int sight, const vf p[3], uint32_t own) {
  const Ball ball = ball_around(p);
  for (int i = 0; i < 3; i++) to.each[sight].p[i] = p[i], to.middle[i][sight] = ball.middle[i];
  to.radius[sight] = ball.radius, to.own[sight] = (int32_t)own;
}

// All rays from their points to the lamp.
JG_INLINE Rays<vf> rays_of(const Sights& of, const float* lamp) {
  const float radius2 = lamp[RADIUS2];
  Rays<vf> rays = {{}, of.radius, {}, {}, all(lamp[SUN_SINE])};
  for (int i = 0; i < 3; i++) rays.middle[i] = of.middle[i], rays.direction[i] = all(lamp[PLACE + i]);
  if ((int)lamp[KIND] == SUN) return rays;
  for (int i = 0; i < 3; i++) rays.direction[i] -= of.middle[i];
  const vf distance = sqrt(dot(rays.direction, rays.direction)), least = distance - of.radius;
  // a lamp among the points lies in all directions
  const vi is_apart = least > of.radius;
  for (int i = 0; i < 3; i++) rays.direction[i] = select(is_apart, rays.direction[i] / distance, vf{});
  rays.turn = select(is_apart, of.radius / least, all(1.f));
  rays.half_width = select(is_apart, sqrt(radius2 / (least * least + radius2)), all(1.f));
  return rays;
}

// What capsules hide of a lamp from sights, of which `asked` has the bits; with wider edges, too, where that is wanted.
// hides: how much a capsule counts for the points of a sight, by the numbers of both
template <bool has_wide, class Hides>
JG_INLINE void look(const CastTask& c, const SceneLightTask& s, const float* lamp, uint32_t asked, Hides hides,
                    Sights& sights) {
  if (!asked) return;
  const Rays<vf> rays = rays_of(sights, lamp);
  const float softest = has_wide ? s.wide_softness : s.flesh_softness;
  // bits of four capsules together: a branch after each would keep the next from beginning
  for (int first = 0; first < c.capsules; first += FLOCK / LANES) {
    uint64_t some = 0;
    for (int i = 0; i < FLOCK / LANES && first + i < c.capsules; i++) {
      const int k = first + i;
      const uint32_t behind = k < BONES ? asked & ~bit_mask((sights.own & 1 << k) != 0) : asked;
      some |= (uint64_t)(behind & balls_behind(c, rays, k, softest)) << (LANES * i);
    }
    for (; some; some &= some - 1) {
      const int bit = __builtin_ctzll(some), sight = bit % LANES, k = first + bit / LANES;
      Sight& to = sights.each[sight];
      const float *capsule = c.capsule + CAPSULE * k, *axis = capsule + 3, over_length2 = capsule[6], radius = capsule[7];
      vf from_start[3], distance2, way;
      for (int i = 0; i < 3; i++) from_start[i] = to.p[i] - capsule[i];
      const vf axis_along = to.direction[0] * axis[0] + to.direction[1] * axis[1] + to.direction[2] * axis[2];
      const vf sine2 = max(1.f - axis_along * axis_along * over_length2, all(s.sine2_min));
      nearest_to(capsule, from_start, to.direction, axis_along, over_length2 * inverse(sine2), distance2, way);
      const vf distance = quick_sqrt(max(distance2, all(c.distance2_min))), at_capsule = to.sine * way;
      vf part = hides(sight, k);
      if (k >= BONES) part *= min(radius * inverse(max(at_capsule, all(c.width_min))), all(1.f));
      const auto behind = [&](float softness) {
        return part * (1.f - soft_edge(distance, radius, max(softness * radius + at_capsule, all(c.width_min))));
      };
      to.seen *= 1.f - behind(s.flesh_softness);
      if (has_wide) to.wide *= 1.f - behind(s.wide_softness);
    }
  }
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

// The anchors around sixteen places: sums of shares times sixteen columns of their rows, which are `stride` apart.
JG_INLINE void spread(const int32_t* nearest, const float* share, const float* rows, int stride, vf out[LANES]) {
  for (int lane = 0; lane < LANES; lane++) {
    out[lane] = vf{};
    for (int at = lane; at < ANCHORS_AROUND * LANES; at += LANES)
      out[lane] += share[at] * load(rows + stride * (int64_t)nearest[at]);
  }
  transpose(out);
}

// Squared half width of the rounded corner of a cosine.
JG_INLINE vf corner2_of(float softness, vf spread, vf sine2) {
  const vf own = spread * softness;
  return min(max(own * own + sine2, all(CORNER_MIN2)), all(CORNER_MAX2));
}

JG_INLINE vf slot_seen(const LearnedTask& t, const SceneLightTask& s, int32_t block, const float* lamp) {
  if (lamp[SLOT] < 0) return all(1.f);
  return load(s.skin_seen + LANES * ((int64_t)t.skin.blocks * (int)lamp[SLOT] + block));
}

// Skin that mirrors, towards the eye.
struct Mirror {
  vf alpha, reflectance, rise, facing, cosine_eye, eye[3];
};

JG_INLINE Mirror mirror_of(vf rough, vf reflectance, const vf normal[3], const vf eye[3]) {
  const vf facing = dot(normal, eye);
  return {rough * rough, reflectance, min(GRAZING_FROM * reflectance, all(1.f)), facing, max(facing, all(FACING_MIN)),
          {eye[0], eye[1], eye[2]}};
}

// What it mirrors of a lamp: radiance over the lamp's rgb; and of the half vector, which is the sum of two unit ones over
// a length that their angle says: the cosine to the normal, and that length; alpha^2, wider by the lamp.
struct Mirrored {
  vf shine, middle, shorter, wide2;
};

// towards: cosine between the normal and the lamp
JG_INLINE Mirrored mirrored_lamp(const Mirror& m, const vf direction[3], vf towards, vf strength, vf sine2,
                                 float length2_min) {
  const vf cosine = clamped(towards), k = 0.5f * m.alpha;
  const vf between = 1.f + dot(direction, m.eye), shorter = inverse_sqrt(max(2.f * between, all(length2_min)));
  const vf middle = clamped((towards + m.facing) * shorter), grazing = 1.f - clamped(between * shorter);
  const vf wide = min(m.alpha + 0.5f * quick_sqrt(sine2), all(1.f)), wide2 = wide * wide;
  const vf bell = middle * middle * (wide2 - 1.f) + 1.f, square = grazing * grazing;
  const vf fresnel = m.reflectance + (1.f - m.reflectance) * (m.rise * square * square * grazing);
  const vf masked = max((cosine * (1.f - k) + k) * (m.cosine_eye * (1.f - k) + k), all(MASKED_MIN));
  return {wide2 * fresnel * (cosine * strength) * inverse(4.f * PI * bell * bell * masked), middle, shorter, wide2};
}

// A block while it is lit.
struct Lit {
  vf p[3], normal[3], light[3], reached[COLUMNS_MAX];
};

// The light of the world, or what was baked.
JG_INLINE void light_of_world(const LearnedTask& t, int32_t block, Lit& lit) {
  const SceneLightTask& s = *t.scene;
  const int64_t row = LANES * (int64_t)block;
  load_triples(t.skin.position + 3 * row, lit.p[0], lit.p[1], lit.p[2]);
  for (int i = 0; i < 3; i++) lit.p[i] -= t.skin.shift[i], lit.normal[i] = load(t.matt + MATT * row + LANES * i);
  const int columns = columns_of(s);
  const int64_t around = ANCHORS_AROUND * row;
  for (int i = 0; i < columns; i += LANES)
    spread(t.nearest + around, t.share + around, s.reached + i, columns, lit.reached + i);
  store(s.sky + row, lit.reached[OF_SKY]);
  if (s.baked) {
    const float* field = s.baked + BAKED * row;
    for (int i = 0; i < 3; i++) {
      vf light = load(field + LANES * i);
      for (int a = 0; a < 3; a++) light += lit.normal[a] * load(field + LANES * (3 + 3 * a + i));
      lit.light[i] = max(light, vf{});
    }
  } else {
    world_irradiance(s, lit.normal, lit.light);
    for (int i = 0; i < 3; i++) lit.light[i] = lit.light[i] * lit.reached[i] + lit.reached[OF_BOUNCED + i];
  }
}

// W/m2 that a lamp gives skin as long as nothing stands before it, added to `own`; which of it it falls on.
JG_INLINE vi add_lamp(const SceneLightTask& s, const float* lamp, const vf normal[3], vf spread_of_skin, float softest,
                      const vf direction[3], vf strength, vf sine2, vf own[3]) {
  const vf cosine = dot(normal, direction);
  const vi at_corner = cosine * cosine < corner2_of(softest, spread_of_skin, sine2);
  const vi falls = (strength > 0) & ((cosine > 0) | at_corner);
  if (!bit_mask(falls)) return falls;
  const vf got = strength * lamp[ON_MATT];
  const bool rounded = bit_mask(at_corner);
  const vf straight = max(cosine, vf{});
  for (int i = 0; i < 3; i++) {
    const vf f = rounded ? soft_cosine(cosine, corner2_of(s.softness[i], spread_of_skin, sine2)) : straight;
    own[i] += f * got * lamp[LAMP_RGB + i];
  }
  return falls;
}

// In which a lamp's light is drawn apart; -1: in none.
JG_INLINE int layer_of(const SceneLightTask& s, int slot) {
  return s.layers && slot >= 0 && s.depth ? s.depth[slot].layer : -1;
}

JG_INLINE float* apart_of(const LearnedTask& t, int layer, int32_t block) {
  return t.scene->apart + APART * LANES * ((int64_t)t.skin.blocks * layer + block);
}

// Keeps what of a lamp's light is drawn apart. own: W/m2, as if nothing stood before it
JG_INLINE void set_apart(const LearnedTask& t, int layer, int32_t block, vf counts, vf reaches, const vf own[3]) {
  float* to = apart_of(t, layer, block);
  for (int i = 0; i < 3; i++) store(to + LANES * i, counts * own[i]);
  store(to + LANES * 3, reaches), store(to + LANES * 4, counts);
}

// The matt color of `count` blocks, lamp by lamp.
void light_some(const LearnedTask& t, int32_t first, int32_t count) {
  const SceneLightTask& s = *t.scene;
  const float softest = fmaxf(fmaxf(s.softness[0], s.softness[1]), s.softness[2]);
  const auto hides = [&](int sight, int k) {
    if (k >= BONES) return all(t.cast.other[k - BONES]);
    // the first row is of those that wholly do
    const uint32_t partly = s.partly[first + sight], bit = 1u << k;
    const int32_t row = s.hides_start[first + sight] + __builtin_popcount(partly & (bit - 1));
    return load(s.hides + LANES * (row & -(int32_t)(partly >> k & 1)));
  };
  Lit lit[LANES];
  Sights sights = {};
  vf own[LANES][3], near[LANES];
  uint32_t lit_by[LANES];
  for (int b = 0; b < count; b++) {
    light_of_world(t, first + b, lit[b]);
    set_points(sights, b, lit[b].p, s.own[first + b]);
  }
  for (int j = 0, end; j < s.lamps; j = end) {
    const int slot = (int)s.lamp[LAMP * j + SLOT];
    const float* casting = s.casting + LAMP * slot;
    const LampDepth* depth = slot >= 0 && s.depth && s.depth[slot].part > 0 ? s.depth + slot : nullptr;
    uint32_t edges = 0;
    // parts of a large lamp share a shadow
    for (end = j + 1; slot >= 0 && end < s.lamps && (int)s.lamp[LAMP * end + SLOT] == slot;) end++;
    for (int b = 0; b < count; b++) {
      Sight& of = sights.each[b];
      vf strength, sine2;
      vi falls = {};
      for (int i = 0; i < 3; i++) own[b][i] = vf{};
      const vf spread_of_skin = load(s.material + MATERIAL * LANES * (int64_t)(first + b));
      for (int part = j; part < end; part++) {
        const float* lamp = s.lamp + LAMP * part;
        lamp_at(lamp, of.p, of.direction, strength, sine2);
        falls |= add_lamp(s, lamp, lit[b].normal, spread_of_skin, softest, of.direction, strength, sine2, own[b]);
      }
      if (slot < 0) continue;
      // near the edge of a shadow, which is sharper than anchors are apart, it is found for each
      const vf wide = lit[b].reached[OF_WORLD + columns_per_slot(s) * slot + 1];
      near[b] = select(falls, clamped(EDGE_GAIN * wide * (1.f - wide)), vf{}), of.seen = all(1.f);
      lit_by[b] = bit_mask(falls);
      if (!(depth ? lit_by[b] : bit_mask(near[b] > 0))) continue;
      if (end - j > 1) lamp_at(casting, of.p, of.direction, strength, sine2);
      of.sine = quick_sqrt(sine2);
      edges |= (uint32_t)(bit_mask(near[b] > 0) != 0) << b;
    }
    look<false>(t.cast, s, casting, edges, hides, sights);
    for (int b = 0; b < count; b++) {
      vf reaches = all(1.f);
      if (slot >= 0) {
        const vf* of_slot = lit[b].reached + OF_WORLD + columns_per_slot(s) * slot;
        vf part = of_slot[0] + near[b] * (sights.each[b].seen - of_slot[0]);
        const vf left = s.left ? of_slot[2] : all(1.f);
        Past past = {};
        if (depth && lit_by[b]) past = past_surface(*depth, depth->skin, first + b, lit[b].normal, sights.each[b].sine);
        if (depth && depth->layer >= 0)
          set_apart(t, depth->layer, first + b, casting[SHADE] * left * past.counts, past.reaches, own[b]);
        part += past.counts * (past.reaches - part);
        reaches = 1.f - casting[SHADE] * (1.f - part * left);
        store(s.skin_seen + LANES * ((int64_t)t.skin.blocks * slot + first + b), reaches);
      }
      for (int i = 0; i < 3; i++) lit[b].light[i] += reaches * own[b][i];
    }
  }
  for (int b = 0; b < count; b++) {
    const int64_t row = LANES * (int64_t)(first + b);
    for (int i = 0; i < 3; i++)
      store(t.matt + MATT * row + LANES * (3 + i), load(s.reflecting + 3 * row + LANES * i) * lit[b].light[i]);
  }
}

}  // namespace

void anchor_lamps(const LearnedTask& t, int32_t first, int32_t end) {
  const SceneLightTask& s = *t.scene;
  const CastTask& c = t.cast;
  const int count = end - first, columns = columns_of(s), each = columns_per_slot(s);
  const auto hides = [&](int b, int k) {
    return k < BONES ? load(c.foreign + LANES * (BONES * (int64_t)(first + b) + k)) : all(c.other[k - BONES]);
  };
  const auto posed = [&](int b) { return s.posed + POSED * LANES * (int64_t)(first + b); };
  Sights sights = {};
  vf normal[3], direction[3], strength, sine2, seen[SLOTS_MAX][LANES];
  for (int b = 0; b < count; b++) {
    vf p[3];
    if (s.keeps_pose) {
      for (int i = 0; i < 3; i++) p[i] = load(posed(b) + LANES * i);
    } else {
      posed_anchors(c, t.skin, t.volume_min, t.length2_min, first + b, p, normal);
      for (int i = 0; i < 3; i++) store(posed(b) + LANES * i, p[i]), store(posed(b) + LANES * (3 + i), normal[i]);
    }
    uint32_t own = 0;
    for (int k = 0; k < BONES; k++) own |= (uint32_t)!bit_mask(hides(b, k) > 0) << k;
    set_points(sights, b, p, own);
  }
  for (int j = 0; j < s.slots; j++) {
    const float* lamp = s.casting + LAMP * j;
    for (int b = 0; b < count; b++) {
      Sight& of = sights.each[b];
      lamp_at(lamp, of.p, of.direction, strength, sine2);
      of.sine = quick_sqrt(sine2), of.seen = of.wide = all(1.f);
    }
    look<true>(c, s, lamp, (1u << count) - 1, hides, sights);
    for (int b = 0; b < count; b++) {
      float* row = s.reached + columns * LANES * (int64_t)(first + b) + OF_WORLD + each * j;
      seen[j][b] = sights.each[b].seen;
      if (s.depth && s.depth[j].part > 0) {
        for (int i = 0; i < 3; i++) normal[i] = load(posed(b) + LANES * (3 + i));
        const Past past = past_surface(s.depth[j], s.depth[j].anchors, first + b, normal, sights.each[b].sine);
        seen[j][b] += past.counts * (past.reaches - seen[j][b]);
      }
      store_column(row, columns, seen[j][b]), store_column(row + 1, columns, sights.each[b].wide);
      if (!s.left) continue;
      const vf left = load(s.left + LANES * (c.blocks * (int64_t)j + first + b));
      store_column(row + 2, columns, left);
      seen[j][b] *= left;
    }
  }
  for (int b = 0; b < count; b++) {
    vf given[3] = {};
    for (int i = 0; i < 3; i++) normal[i] = load(posed(b) + LANES * (3 + i));
    for (int j = 0; j < s.lamps; j++) {
      const float* lamp = s.lamp + LAMP * j;
      lamp_at(lamp, sights.each[b].p, direction, strength, sine2);
      const vf part = lamp[SLOT] < 0 ? all(1.f) : 1.f - lamp[SHADE] * (1.f - seen[(int)lamp[SLOT]][b]);
      const vf got = max(dot(normal, direction), vf{}) * strength * part * lamp[ON_MATT];
      for (int i = 0; i < 3; i++) given[i] += got * lamp[LAMP_RGB + i];
    }
    for (int i = 0; i < 3; i++) store(posed(b) + LANES * (6 + i), given[i]);
  }
}

// Of the anchors of a block, what each patch of them throws back.
JG_INLINE void store_patches(const SceneLightTask& s, int32_t block, const vf p[3], const vf normal[3], const vf thrown[3]) {
  const vf there = select(dot(normal, normal) > 0, all(1.f), vf{});
  for (int first = 0; first < LANES; first += PATCH) {
    float* to = s.thrown + THROWN * (LANES / PATCH * (int64_t)block + first / PATCH);
    const auto mean = [&](vf values) {
      float sum = 0, count = 0;
      for (int lane = first; lane < first + PATCH; lane++) sum += there[lane] * values[lane], count += there[lane];
      return sum / fmaxf(count, 1.f);
    };
    vf apart2 = {};
    for (int i = 0; i < 3; i++) {
      to[i] = mean(p[i]), to[3 + i] = mean(normal[i]), to[6 + i] = mean(thrown[i]);
      const vf apart = p[i] - to[i];
      apart2 += apart * apart;
    }
    to[9] = mean(apart2);
  }
}

void anchor_world(const LearnedTask& t, int32_t block) {
  const SceneLightTask& s = *t.scene;
  const CastTask& c = t.cast;
  const float *posed = s.posed + POSED * LANES * (int64_t)block, *foreign = c.foreign + BONES * LANES * (int64_t)block;
  const int columns = columns_of(s);
  float* rows = s.reached + columns * LANES * (int64_t)block;
  if (!(s.shade > 0)) {
    for (int i = 0; i < OF_WORLD; i++) store_column(rows + i, columns, all(i < 3 || i == OF_SKY ? 1.f : 0.f));
    return;
  }
  vf p[3], normal[3], open[3] = {}, seen[3] = {}, sky = {}, open_sky = {}, thrown[3];
  for (int i = 0; i < 3; i++) p[i] = load(posed + LANES * i), normal[i] = load(posed + LANES * (3 + i));
  const Ball ball = ball_around(p);
  Distant lamps;
  for (int g = 0; g < c.groups; g += FLOCK / LANES) {
    float* visible = s.visible + LANES * LANES * (c.groups * (int64_t)block + g);
    uint64_t faced = distant_seen(c, foreign, ball, p, normal, g, s.keeps_visible, lamps, visible);
    for (; faced; faced &= faced - 1) {
      const int lamp = __builtin_ctzll(faced);
      const float* cell = c.lamp + 6 * LANES * (g + lamp / LANES) + lamp % LANES;
      const vf cosine = lamps.cosines[lamp], part = load(visible + LANES * lamp);
      for (int i = 0; i < 3; i++) {
        const vf light = cosine * cell[LANES * (3 + i)];
        open[i] += light, seen[i] += light * part;
      }
      sky += cosine, open_sky += cosine * part;
    }
  }
  const vf hidden = 1.f - (open_sky + FACING_SUM_MIN) / (sky + FACING_SUM_MIN);
  world_irradiance(s, normal, thrown);
  for (int i = 0; i < 3; i++) {
    const vf part = (seen[i] + OPEN_MIN) / (open[i] + OPEN_MIN);
    store_column(rows + i, columns, 1.f - s.shade * (1.f - part));
    // what it sees of skin is as bright as itself, and sees as much of it in turn
    const vf again = max(1.f - s.bounce[i] * hidden, all(CAUGHT_MIN));
    const vf once = s.bounce[i] * (thrown[i] * part + load(posed + LANES * (6 + i)));
    thrown[i] = once / again;
    if (!s.area) continue;
    const int64_t at = LANES * (3 * (int64_t)block + i);
    store(s.once + at, once), store(s.sent + at, thrown[i]);
  }
  store_column(rows + OF_SKY, columns, 1.f - s.shade * hidden);
  if (!s.baked && !s.area) store_patches(s, block, p, normal, thrown);
}

void anchor_bounced(const LearnedTask& t, int32_t block) {
  const SceneLightTask& s = *t.scene;
  if (!(s.shade > 0) || s.baked) return;
  const float* posed = s.posed + POSED * LANES * (int64_t)block;
  const int columns = columns_of(s);
  const float* rows = s.reached + columns * LANES * (int64_t)block;
  vf p[3], normal[3], sum[3] = {}, faced = {};
  const vf hidden = 1.f - load_column(rows + OF_SKY, columns);
  for (int i = 0; i < 3; i++) p[i] = load(posed + LANES * i), normal[i] = load(posed + LANES * (3 + i));
  const float* end = s.thrown + THROWN * (LANES / PATCH) * (int64_t)(bit_mask(hidden > 0) ? t.cast.blocks : 0);
  for (const float* patch = s.thrown; patch < end; patch += THROWN) {
    vf way[3];
    for (int i = 0; i < 3; i++) way[i] = patch[i] - p[i];
    const vf from = -(patch[3] * way[0] + patch[4] * way[1] + patch[5] * way[2]);
    const vf over = inverse(dot(way, way) + (patch[9] + DISTANCE2_MIN));
    // a disc of twice the mean squared distance
    const vf faces = max(dot(normal, way), vf{}) * max(from, vf{}) * (over * over) * (2.f * patch[9]);
    for (int i = 0; i < 3; i++) sum[i] += faces * patch[6 + i];
    faced += faces;
  }
  const vf gain = hidden / max(max(faced, FACED_PART_MIN * hidden), all(FACED_MIN));
  float* bounced = s.bounced + 4 * LANES * (int64_t)block;
  for (int i = 0; i < 3; i++) store_column(bounced + i, 4, gain * sum[i]);
  store_column(bounced + 3, 4, hidden);
}

void anchor_evened(const LearnedTask& t, int32_t block) {
  const SceneLightTask& s = *t.scene;
  if (!(s.shade > 0) || s.baked) return;
  const int columns = columns_of(s);
  for (int64_t row = LANES * (int64_t)block; row < LANES * (int64_t)(block + 1); row++) {
    float sum[4] = {};
    for (int64_t k = EVENED * row; k < EVENED * (row + 1); k++)
      for (int i = 0; i < 4; i++) sum[i] += s.bounced[4 * (int64_t)s.beside[k] + i];
    const float share = s.bounced[4 * row + 3] / fmaxf(sum[3], FACED_MIN);
    for (int i = 0; i < 3; i++) s.reached[columns * row + OF_BOUNCED + i] = share * sum[i];
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

void light_blocks(const LearnedTask& t, int32_t first, int32_t end) {
  for (; first < end; first += LANES) light_some(t, first, end - first < LANES ? end - first : LANES);
}

void seen_block(const LearnedTask& t, int32_t block) {
  const SceneLightTask& s = *t.scene;
  const int64_t row = LANES * (int64_t)block;
  const float *matt = t.matt + MATT * row, *material = s.material + MATERIAL * row;
  const vf rough = load(material + LANES), reflectance = load(material + 2 * LANES);
  vf p[3], n[3], eye[3], rgb[3], mirrored[3];
  load_triples(t.skin.position + 3 * row, p[0], p[1], p[2]);
  for (int i = 0; i < 3; i++) {
    n[i] = load(matt + LANES * i), rgb[i] = load(matt + LANES * (3 + i));
    eye[i] = t.eye[i] - p[i], p[i] -= t.skin.shift[i];
  }
  make_unit(eye, t.length2_min);
  const Mirror skin = mirror_of(rough, reflectance, n, eye);
  const vf facing = skin.facing, cosine_eye = skin.cosine_eye;
  const vf fade = seen_from_outside(t, row, facing);
  // of light that is drawn apart
  vf glossy[LAYERS_MAX][3], rows[LAYERS_MAX][LANES];
  for (int layer = 0; layer < s.layers; layer++) {
    for (vf& sum : glossy[layer]) sum = vf{};
    for (vf& column : rows[layer]) column = vf{};
  }
  const auto store_layers = [&]() {
    for (int layer = 0; layer < s.layers; layer++) {
      transpose(rows[layer]);
      float* to = s.layer + s.layer_stride * (int64_t)layer + 4 * row;
      for (int lane = 0; lane < LANES; lane++) memcpy(to + 4 * lane, &rows[layer][lane], 4 * sizeof(float));
    }
  };
  if (!bit_mask(fade > 0)) {
    store_layers();
    return store_triples(t.rgb + 3 * row, vf{}, vf{}, vf{});
  }
  for (int j = 0; j < s.lamps; j++) {
    const float* lamp = s.lamp + LAMP * j;
    if (!(lamp[ON_GLOSS] > 0)) continue;
    vf direction[3], strength, sine2;
    lamp_at(lamp, p, direction, strength, sine2);
    const vf towards = dot(n, direction);
    if (!bit_mask(clamped(towards) * strength > 0)) continue;
    const vf open_shine = mirrored_lamp(skin, direction, towards, strength, sine2, t.length2_min).shine;
    const vf shine = open_shine * slot_seen(t, s, block, lamp);
    for (int i = 0; i < 3; i++) rgb[i] += shine * lamp[LAMP_RGB + i];
    const int layer = layer_of(s, (int)lamp[SLOT]);
    for (int i = 0; layer >= 0 && i < 3; i++) glossy[layer][i] += open_shine * lamp[LAMP_RGB + i];
  }
  if (s.lobes) {
    // rough skin mirrors most of what is between the mirrored direction and its normal: Lagarde and de Rousiers, "Moving
    // Frostbite to physically based rendering", 2014
    const vf smoothness = 1.f - rough, part = smoothness * (sqrt(smoothness) + rough);
    for (int i = 0; i < 3; i++) mirrored[i] = n[i] + part * (2.f * facing * n[i] - eye[i] - n[i]);
    make_unit(mirrored, t.length2_min);
    vf lobes[3] = {};
    add_lobes(s.lobe, s.lobes, mirrored, lobes);
    // how much of an even light GGX mirrors: Karis, "Physically Based Shading on Mobile", 2014
    const vf r0 = 1.f - rough, r1 = 0.0425f - 0.0275f * rough, r2 = 1.04f - 0.572f * rough, r3 = 0.022f * rough - 0.04f;
    const vf base = min(r0 * r0, exp2(-9.28f * cosine_eye)) * r0 + r1;
    const vf gain = (reflectance * (r2 - 1.04f * base) + skin.rise * (r3 + 1.04f * base)) * load(s.sky + row);
    for (int i = 0; i < 3; i++) rgb[i] += lobes[i] * gain;
  }
  for (int slot = 0; s.layers && slot < s.slots; slot++) {
    const int layer = layer_of(s, slot);
    if (layer < 0) continue;
    const float* of = apart_of(t, layer, block);
    const vf reaches = load(of + LANES * 3), counts = load(of + LANES * 4);
    for (int i = 0; i < 3; i++) {
      const vf matt_light = load(s.reflecting + 3 * row + LANES * i) * load(of + LANES * i);
      const vf light = s.at_pixels[layer] * (glossy[layer][i] * counts + matt_light);
      rgb[i] -= reaches * light;
      rows[layer][i] = fade * light, rows[layer][3] += rows[layer][i] * reaches;
    }
  }
  store_layers();
  for (int i = 0; i < 3; i++) rgb[i] *= fade;
  store_triples(t.rgb + 3 * row, rgb[0], rgb[1], rgb[2]);
}

void light_slope(const LearnedTask& t, const int32_t* nearest, const int32_t* beside, const float* share, const vf p[3],
                 const vf normal[3], vf slope[3], GlossLobe* gloss) {
  const vf x = normal[0], y = normal[1], z = normal[2], xx = x * x, yy = y * y, zz = z * z;
  // of `harmonics`, by x, y and z
  const vf by_x[HARMONICS] = {vf{},          all(1.f), vf{}, vf{}, y, vf{}, z,           2.f * x, vf{}, 6.f * x * y, y * z,
                              vf{},          vf{},     5.f * zz - 1.f, 2.f * x * z, 3.f * (xx - yy)};
  const vf by_y[HARMONICS] = {vf{},          vf{},     all(1.f), vf{}, x, z, vf{},       -2.f * y, vf{}, 3.f * (xx - yy),
                              x * z,         5.f * zz - 1.f, vf{}, vf{}, -2.f * y * z, -6.f * x * y};
  const vf by_z[HARMONICS] = {vf{},          vf{},     vf{}, all(1.f), vf{}, y, x,       vf{}, 6.f * z, vf{}, x * y,
                              10.f * y * z,  15.f * zz - 3.f, 10.f * x * z, xx - yy, vf{}};
  const auto along_skin = [&]() __attribute__((always_inline)) {
    const vf out = dot(slope, normal);
    for (int i = 0; i < 3; i++) slope[i] -= out * normal[i];
  };
  if (!t.scene) {
    for (int i = 0; i < 3; i++) slope[i] = vf{};
    for (int k = 0; k < HARMONICS; k++) {
      const float mean = (t.irradiance[3 * k] + t.irradiance[3 * k + 1] + t.irradiance[3 * k + 2]) * (1.f / 3);
      slope[0] += mean * by_x[k], slope[1] += mean * by_y[k], slope[2] += mean * by_z[k];
    }
    return along_skin();
  }
  const SceneLightTask& s = *t.scene;
  vf reached[COLUMNS_MAX], waves[HARMONICS], sum = {}, facing = {};
  const int columns = columns_of(s);
  for (int i = 0; i < columns; i += LANES) spread(nearest, share, s.reached + i, columns, reached + i);
  // of the Gaussians beside, `count` numbers in blocks
  const auto mean_beside = [&](const float* blocks, int count, vf mean[]) __attribute__((always_inline)) {
    for (int k = 0; k < ANCHORS_AROUND; k++) {
      vi row;
      memcpy(&row, beside + LANES * k, sizeof row);
      const vf of_anchor = load(share + LANES * k);
      const vi at = (row >> 4) * (count * LANES) + (row & (LANES - 1));
      for (int i = 0; i < count; i++) mean[i] += of_anchor * gather(blocks + LANES * i, at);
    }
  };
  for (int i = 0; i < 3; i++) slope[i] = vf{};
  if (s.baked) {
    vf field[BAKED] = {};
    mean_beside(s.baked, BAKED, field);
    for (int a = 0; a < 3; a++) slope[a] = luminance(field + 3 * (a + 1));
    const vf all_around = luminance(field);
    sum = all_around + dot(slope, normal), facing = all_around + sqrt(dot(slope, slope));
  } else {
    const vf part = luminance(reached);
    harmonics(normal, waves);
    for (int k = 0; k < HARMONICS; k++) {
      const vf lit = part * luminance(s.irradiance + 3 * k);
      sum += lit * waves[k], slope[0] += lit * by_x[k], slope[1] += lit * by_y[k], slope[2] += lit * by_z[k];
    }
    sum = max(sum, part * luminance(s.least)) + luminance(reached + OF_BOUNCED);
    // what comes from all around has no more of it along the normal
    along_skin();
  }
  Mirror skin;
  vf shine = {}, over_bell = {}, way[3] = {}, reflecting[3] = {};
  if (gloss) {
    vf material[MATERIAL] = {}, eye[3];
    mean_beside(s.material, MATERIAL, material), mean_beside(s.reflecting, 3, reflecting);
    for (int i = 0; i < 3; i++) eye[i] = t.eye[i] - t.skin.shift[i] - p[i];
    make_unit(eye, t.length2_min);
    skin = mirror_of(material[1], material[2], normal, eye);
  }
  for (int j = 0; j < s.lamps; j++) {
    const float* lamp = s.lamp + LAMP * j;
    const int slot = (int)lamp[SLOT];
    vf direction[3], strength, sine2;
    lamp_at(lamp, p, direction, strength, sine2);
    if (slot >= 0) {
      const vf* of_slot = reached + OF_WORLD + columns_per_slot(s) * slot;
      strength *= 1.f - lamp[SHADE] * (1.f - (s.left ? of_slot[0] * of_slot[2] : of_slot[0]));
    }
    strength *= luminance(lamp + LAMP_RGB);
    const vf cosine = dot(normal, direction);
    if (gloss && lamp[ON_GLOSS] > 0) {
      const Mirrored own = mirrored_lamp(skin, direction, cosine, strength, sine2, t.length2_min);
      const vf square = own.middle * own.middle, counts = own.shine * inverse(1.f + square * (own.wide2 - 1.f));
      shine += own.shine, over_bell += counts;
      for (int i = 0; i < 3; i++)
        way[i] += counts * ((direction[i] + skin.eye[i]) * own.shorter - own.middle * normal[i]);
    }
    strength *= lamp[ON_MATT];
    const vf corner2 = corner2_of(s.softness[1], all(1.f), sine2);
    const vf corner = sqrt(corner2), falls = strength * clamped((cosine + corner) / (2.f * corner));
    sum += strength * soft_cosine(cosine, corner2), facing += strength;
    for (int i = 0; i < 3; i++) slope[i] += falls * direction[i];
  }
  const vf inverse = 1.f / max(sum, max(GRAZED_MIN * facing, all(LIT_MIN)));
  for (int i = 0; i < 3; i++) slope[i] *= inverse;
  if (!gloss) return;
  // of several lamps the lobe whose logarithm changes as that of their sum does
  const vf over = 1.f / max(over_bell, all(SHINE_MIN));
  vf way2 = {};
  for (int i = 0; i < 3; i++) gloss->way[i] = over * way[i], way2 += gloss->way[i] * gloss->way[i];
  // beside skin that mirrors no lamp it is wide: what lies between changes little
  gloss->width2 = select(over_bell > SHINE_MIN, max(shine * over - way2, all(WIDTH2_MIN)), all(1.f));
  gloss->part = select(skin.facing > 0, shine / max(shine + luminance(reflecting) * sum, all(LIT_MIN)), vf{});
}

}  // namespace jg

JG_API int32_t jg_scene_light_task_bytes() { return sizeof(jg::SceneLightTask); }
JG_API int32_t jg_lamp_depth_bytes() { return sizeof(jg::LampDepth); }
