// Where a posed hand is before a camera, before any skin is found: of the corners of the boxes that its bones move, and of
// its joints. In double, and one pass: a plan of every frame waits for it.
#include <math.h>
#include <stdint.h>

#include "export.h"

namespace {

constexpr int JOINTS = 21, CORNERS = 8;

struct Range {
  double low = INFINITY, high = -INFINITY;
  void take(double x) {
    low = x < low ? x : low;
    high = x > high ? x : high;
  }
};

// Of points in the axes of a camera: along these, and on the plane at depth 1 (of parallel rays, on any).
struct Seen {
  Range axis[3], slope[2];
  void take(const double p[3], bool orthographic) {
    const double inverse = orthographic ? 1.0 : 1.0 / p[2];
    for (int i = 0; i < 3; i++) axis[i].take(p[i]);
    for (int i = 0; i < 2; i++) slope[i].take(p[i] * inverse);
  }
};

}  // namespace

// boxes: how many, of these map[k] carries corner[k], (4, 8) with ones below, root-relative · frames: (21, 3, 3) of the
// canonical bones · linear_offset: of `Bones`, (21 and slices, 3, 4) · joints: (21, 3) world · camera: (3, 4) of the map
// from the world. found: lows and highs of the corners along the axes; lows and highs of their slopes; the longest that
// a bone makes of a unit of its frame; depth of the nearest joint; how far apart slopes of joints are. All NaN when any
// is no finite number.
JG_API void jg_view(int32_t boxes, const int32_t* map, const double* corner, const double* frames,
                    const float* linear_offset, const double* joints, const double* camera, int32_t orthographic,
                    double found[14]) {
  Seen skin, bones;
  double stretch2 = 0, sum = 0;
  const auto turned = [&](const double p[3], const double from[3], double out[3]) {
    for (int i = 0; i < 3; i++)
      out[i] = camera[4 * i] * p[0] + camera[4 * i + 1] * p[1] + camera[4 * i + 2] * p[2] + from[i];
  };
  const double origin[3] = {camera[3], camera[7], camera[11]};
  double root[3];
  turned(joints, origin, root);
  for (int k = 0; k < boxes; k++, corner += 4 * CORNERS) {
    float m[12];
    for (int i = 0; i < 12; i++)
      m[i] = linear_offset[12 * map[k] + i] + (map[k] < JOINTS ? 0.f : linear_offset[i]);  // slices turn the palm's map
    for (int c = 0; c < CORNERS; c++) {
      double p[3], q[3];
      for (int i = 0; i < 3; i++) {
        p[i] = 0;
        for (int j = 0; j < 4; j++) p[i] += m[4 * i + j] * corner[CORNERS * j + c];
      }
      turned(p, root, q);
      skin.take(q, orthographic);
      sum += q[0] + q[1] + q[2];
    }
  }
  for (int b = 0; b < JOINTS; b++) {
    for (int k = 0; k < 3; k++) {
      double square = 0;
      for (int i = 0; i < 3; i++) {
        double along = 0;
        for (int j = 0; j < 3; j++) along += linear_offset[12 * b + 4 * i + j] * frames[9 * b + 3 * j + k];
        square += along * along;
      }
      stretch2 = square > stretch2 ? square : stretch2;
      sum += square;
    }
    double q[3];
    turned(joints + 3 * b, origin, q);
    bones.take(q, orthographic);
    sum += q[0] + q[1] + q[2];
  }
  for (int i = 0; i < 3; i++) found[i] = skin.axis[i].low, found[3 + i] = skin.axis[i].high;
  for (int i = 0; i < 2; i++) found[6 + i] = skin.slope[i].low, found[8 + i] = skin.slope[i].high;
  found[10] = sqrt(stretch2);
  found[11] = bones.axis[2].low;
  for (int i = 0; i < 2; i++) found[12 + i] = bones.slope[i].high - bones.slope[i].low;
  if (!isfinite(sum))
    for (int i = 0; i < 14; i++) found[i] = NAN;
}
