// One hand: 21 joints to the 21 bone transforms, in double. The same formulas, thresholds and fallbacks as
// jghand_engine/learn/frames.py and skeleton.py (METHOD 2.4 to 2.10); a test compares the two on ordinary and
// degenerate hands. Values only: there are no gradients here, hence no damping.
#include <math.h>
#include <stdint.h>

#include "export.h"

namespace {

constexpr int JOINTS = 21, BONES = 20, PHALANGES = 15, FINGERS = 5, PLANES = 4;
constexpr int ANGLES = 2 * PHALANGES + PLANES + PLANES - 1;
constexpr double PI = 3.141592653589793;

enum Flag { ZERO_BONE = 1, PALM_CLAMPED = 2, SWING_POLE = 4, NO_PALM = 8, NOT_FINITE = 16 };

struct Vec {
  double x, y, z;
};

// Columns, because every matrix here is a frame: x, y, z axes.
struct Mat {
  Vec x, y, z;
};

Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vec operator*(double s, Vec a) { return {s * a.x, s * a.y, s * a.z}; }
double dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vec cross(Vec a, Vec b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }

Vec operator*(const Mat& m, Vec v) { return v.x * m.x + v.y * m.y + v.z * m.z; }
Mat operator*(const Mat& a, const Mat& b) { return {a * b.x, a * b.y, a * b.z}; }
Vec transposed_times(const Mat& m, Vec v) { return {dot(m.x, v), dot(m.y, v), dot(m.z, v)}; }
Mat transposed(const Mat& m) { return {{m.x.x, m.y.x, m.z.x}, {m.x.y, m.y.y, m.z.y}, {m.x.z, m.y.z, m.z.z}}; }

// What the transform knows before a pose comes, as packed by hand/skeleton.py: doubles only, in this order.
struct Skeleton {
  double zero_bone, palm_clamp, palm_prior, swing_pole;
  double turn_cosine, turn, pole_y, pole_z, near_pole;  // of the minimal swing
  double flexion_cut, flexion_axis_min, palm_normal_min, scale_ratio_min;
  double size_min;   // floor of the hand's size
  double exponent;   // of the scale mode
  double euler;      // 1: euler swing, 0: minimal
  double mirror;     // -1 for a left hand, else 1
  Vec joint[JOINTS];  // root-centered canonical joints
  double length[BONES];
  Vec direction[BONES];
  Mat frame[BONES];
  Mat palm;
  Vec u[PHALANGES];
  Mat swing[PHALANGES];
  Vec palm_normal[PLANES];
  Mat palm_flip, metacarpal_flip[FINGERS];
};

// v / |v| where |v| > threshold, else the fallback.
bool unit(Vec v, Vec fallback, double threshold, Vec& result) {
  const double square = dot(v, v);
  const bool good = square > threshold * threshold;
  result = good ? (1 / sqrt(square)) * v : fallback;
  return good;
}

double smooth_floor(double value, double floor) {
  if (value >= 2 * floor) return value;
  return value > 0 ? floor + value * value / (4 * floor) : floor;
}

// Smallest rotation from a to b; `opposite` is the answer at b = -a.
Mat minimal_rotation(Vec a, Vec b, const Mat& opposite) {
  constexpr double EPS = 2.220446049250313e-16;
  const double c = dot(a, b);
  const Vec v = cross(a, b);
  const double sine2 = dot(v, v);
  if (c < 0 && !(sine2 > 64 * EPS * EPS)) return opposite;
  const double k = c < 0 ? (1 - c) / sine2 : 1 / (1 + c);
  const Vec kv = k * v;
  return {{c + kv.x * v.x, kv.y * v.x + v.z, kv.z * v.x - v.y},
          {kv.x * v.y - v.z, c + kv.y * v.y, kv.z * v.y + v.x},
          {kv.x * v.z + v.y, kv.y * v.z - v.x, c + kv.z * v.z}};
}

bool swing_euler(Vec u, double pole, Mat& Q) {
  const double square = u.x * u.x + u.z * u.z;
  if (square > pole * pole) {
    const double ca = sqrt(square), cf = u.z / ca, sf = u.x / ca, sa = -u.y;
    Q = {{cf, 0, -sf}, {sf * sa, ca, cf * sa}, u};
    return true;
  }
  const double sa = u.y > 0 ? -1 : u.y < 0 ? 1 : 0;
  Q = {{1, 0, 0}, {0, 0, sa}, {0, -sa, 0}};
  return false;
}

// Smallest rotation from the canonical direction, and behind the hand flexion: `swing_minimal` in learn/rotations.py.
bool swing_minimal(Vec u, const Skeleton& s, const Mat& canonical, Mat& Q) {
  const Vec v = transposed_times(canonical, u);
  const double x = v.x, y = v.y, z = v.z;
  if (z >= 0) {
    const double k = 1 / (1 + z);
    Q = canonical * Mat{{1 - k * x * x, -k * x * y, -x}, {-k * x * y, 1 - k * y * y, -y}, v};
  } else {
    const double k = 1 / (1 - z), back = fmax((s.turn_cosine - z) / (s.turn_cosine + 1), 0);
    const double re = s.turn * back * back + k * k * (x * x - y * y), im = -2 * k * k * x * y;
    const double square = re * re + im * im;
    const bool good = square > s.swing_pole * s.swing_pole;
    const double cosine = good ? re / sqrt(square) : 1, sine = good ? im / sqrt(square) : 0;
    const Vec bent = {k * x * x - 1, k * x * y, -x}, across = {-k * x * y, 1 - k * y * y, y};
    Q = canonical * Mat{cosine * bent + sine * across, cosine * across - sine * bent, v};
  }
  return s.pole_y * fabs(y) + s.pole_z * z < s.near_pole;
}

struct Frames {
  Mat frame[BONES], palm;
  Vec direction[BONES], palm_normal[PLANES], u[PHALANGES];
  double relative_length[BONES], size;
  int flags;
};

// S0: twist from the area vector of the metacarpals' fan, else from the smallest rotation of the canonical palm.
bool palm_frame(const Skeleton& s, const Vec bone[BONES], Mat& palm) {
  Vec axis = bone[1], area = {0, 0, 0}, z, x;
  for (int f = 2; f < FINGERS; f++) axis = axis + bone[f], area = area + cross(bone[f - 1], bone[f]);
  const bool has_axis = unit(axis, s.palm.z, s.zero_bone, z);
  const Vec fallback = minimal_rotation(s.palm.z, z, s.palm_flip) * s.palm.x;
  const bool has_normal = unit(area - dot(area, z) * z, fallback, s.palm_normal_min, x);
  palm = {x, cross(z, x), z};
  return has_axis && has_normal;
}

// Directions and frames of the metacarpals; returns flags.
int metacarpal_frames(const Skeleton& s, const Vec bone[BONES], Frames& frames) {
  const Mat turn = frames.palm * transposed(s.palm);
  Vec* const normal = frames.palm_normal;
  Vec finger_normal[FINGERS];
  int flags = 0;
  for (int f = 0; f < FINGERS; f++)
    if (!unit(bone[f], turn * s.direction[f], s.zero_bone, frames.direction[f])) flags |= ZERO_BONE;
  for (int k = 0; k < PLANES; k++) {
    const Vec plane = cross(frames.direction[k], frames.direction[k + 1]), expected = turn * s.palm_normal[k];
    const double height = dot(plane, expected);
    if (height < 2 * s.palm_clamp) flags |= PALM_CLAMPED;
    const Vec lifted = plane + (s.palm_prior + smooth_floor(height, s.palm_clamp) - height) * expected;
    normal[k] = (1 / sqrt(dot(lifted, lifted))) * lifted;
  }
  finger_normal[0] = normal[0], finger_normal[1] = normal[1], finger_normal[4] = normal[3];
  finger_normal[2] = 0.5 * (normal[1] + normal[2]), finger_normal[3] = 0.5 * (normal[2] + normal[3]);
  for (int f = 0; f < FINGERS; f++) {
    const Vec z = frames.direction[f];
    const Vec fallback = minimal_rotation(s.direction[f], z, s.metacarpal_flip[f]) * s.frame[f].y;
    Vec y;
    unit(cross(z, finger_normal[f]), fallback, s.flexion_axis_min, y);
    frames.frame[f] = {cross(y, z), y, z};
  }
  return flags;
}

int phalanx_frames(const Skeleton& s, const Vec bone[BONES], Frames& frames) {
  int flags = 0;
  for (int i = FINGERS; i < BONES; i++) {
    const Mat& parent = frames.frame[i - FINGERS];
    const int phalanx = i - FINGERS;
    Vec& u = frames.u[phalanx];
    Mat Q;
    if (!unit(bone[i], parent * s.u[phalanx], s.zero_bone, frames.direction[i])) flags |= ZERO_BONE;
    unit(transposed_times(parent, frames.direction[i]), s.u[phalanx], s.zero_bone, u);
    const bool off_pole = s.euler != 0 ? swing_euler(u, s.swing_pole, Q) : swing_minimal(u, s, s.swing[phalanx], Q);
    if (!off_pole) flags |= SWING_POLE;
    frames.frame[i] = parent * Q;
  }
  return flags;
}

Frames compute_frames(const Skeleton& s, const Vec joint[JOINTS]) {
  Frames frames;
  Vec bone[BONES];
  frames.size = s.size_min;
  frames.flags = 0;
  for (int i = 0; i < BONES; i++) {
    bone[i] = joint[i + 1] - joint[i < FINGERS ? 0 : i - 4];
    frames.size = fmax(frames.size, fmax(fabs(bone[i].x), fmax(fabs(bone[i].y), fabs(bone[i].z))));
  }
  for (int i = 0; i < BONES; i++) {
    bone[i] = (1 / frames.size) * bone[i];
    const double square = dot(bone[i], bone[i]);
    frames.relative_length[i] = square > s.zero_bone * s.zero_bone ? sqrt(square) : 0;
  }
  if (!palm_frame(s, bone, frames.palm)) frames.flags |= NO_PALM;
  frames.flags |= metacarpal_frames(s, bone, frames);
  frames.flags |= phalanx_frames(s, bone, frames);
  return frames;
}

double radial_scale(const Skeleton& s, double along, double whole) {
  if (s.exponent == 0) return whole;
  if (s.exponent == 1) return along;
  const double ratio = whole > 0 ? along / whole : 0;
  return whole * pow(fmax(ratio, s.scale_ratio_min), s.exponent);
}

// atan2, 0 where both are within the threshold.
double safe_angle(double y, double x, double threshold) {
  return fabs(x) > threshold || fabs(y) > threshold ? atan2(y, x) : 0;
}

// The angles of METHOD 2.4, radians: flexion and abduction of bones 6..20, then those between neighboring palm bones
// and those between neighboring palm planes; `HandFrames` in learn/frames.py.
void store_angles(const Skeleton& s, const Frames& frames, double* out) {
  for (const Vec& u : frames.u) {
    const double square = u.x * u.x + u.z * u.z;
    const bool far = square > s.swing_pole * s.swing_pole;
    const double flexion = far ? atan2(u.x, u.z) : 0;
    *out++ = flexion < s.flexion_cut ? flexion + 2 * PI : flexion;
    *out++ = atan2(-u.y, far ? sqrt(square) : s.swing_pole);
  }
  for (int k = 0; k < PLANES; k++) {
    const Vec a = frames.direction[k], b = frames.direction[k + 1], normal = cross(a, b);
    const double square = dot(normal, normal);
    *out++ = safe_angle(square > s.zero_bone * s.zero_bone ? sqrt(square) : 0, dot(a, b), 0);
  }
  for (int k = 0; k + 1 < PLANES; k++) {
    const Vec a = frames.palm_normal[k], b = frames.palm_normal[k + 1];
    *out++ = safe_angle(dot(cross(a, b), frames.direction[k + 1]), dot(a, b), s.zero_bone);
  }
}

// [L | offset] as 3 x 4, row by row; x is negated for a left hand.
void store(const Skeleton& s, const Mat& L, Vec posed_pivot, Vec canonical_pivot, double* out) {
  const Vec offset = posed_pivot - L * canonical_pivot;
  const Vec column[4] = {L.x, L.y, L.z, offset};
  for (int k = 0; k < 4; k++) {
    out[k] = s.mirror * column[k].x;
    out[4 + k] = column[k].y;
    out[8 + k] = column[k].z;
  }
}

}  // namespace

JG_API int32_t jg_skeleton_bytes() { return sizeof(Skeleton); }

// skeleton: `Skeleton` packed as doubles. joints: 21 x 3, meters, level order.
// matrices: 21 x 3 x 4 root-relative canonical -> posed. scale: of the whole hand. angles: 37, see `store_angles`.
// Returns the flags of the frames.
// A joint that is not finite gives NaN everywhere and the flag NOT_FINITE.
JG_API int32_t jg_bone_transforms(const double* skeleton, const double* joints, double* matrices, double* scale,
                                  double* angles) {
  const Skeleton& s = *reinterpret_cast<const Skeleton*>(skeleton);
  Vec joint[JOINTS];
  for (int i = 0; i < 3 * JOINTS; i++) {
    if (isfinite(joints[i])) continue;
    for (int k = 0; k < JOINTS * 12; k++) matrices[k] = NAN;
    for (int k = 0; k < ANGLES; k++) angles[k] = NAN;
    *scale = NAN;
    return NOT_FINITE;
  }
  for (int i = 0; i < JOINTS; i++) joint[i] = {s.mirror * joints[3 * i], joints[3 * i + 1], joints[3 * i + 2]};
  const Frames frames = compute_frames(s, joint);
  store_angles(s, frames, angles);

  double sum = 0, canonical_sum = 0;
  for (int i = 0; i < BONES; i++) sum += frames.relative_length[i], canonical_sum += s.length[i];
  const double whole = sum / canonical_sum;
  *scale = whole * frames.size;

  const Mat turn = frames.palm * transposed(s.palm);
  store(s, {*scale * turn.x, *scale * turn.y, *scale * turn.z}, {0, 0, 0}, {0, 0, 0}, matrices);
  for (int i = 0; i < BONES; i++) {
    const Mat A = frames.frame[i] * transposed(s.frame[i]);
    const Vec d = s.direction[i];
    const double relative = frames.relative_length[i] / s.length[i];
    const double along = relative * frames.size, radial = radial_scale(s, relative, whole) * frames.size;
    // the measured direction, not the turned canonical one: no round-off of the chain reaches the joints
    const Vec axial = along * frames.direction[i] - radial * (A * d);
    const Mat L = {radial * A.x + d.x * axial, radial * A.y + d.y * axial, radial * A.z + d.z * axial};
    const int parent = i < FINGERS ? 0 : i - 4;
    store(s, L, joint[parent] - joint[0], s.joint[parent], matrices + 12 * (i + 1));
  }
  return frames.flags;
}
