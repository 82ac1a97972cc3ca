// Linear blend skinning of a whole avatar whose colors stay as they are; learned.cpp has trained ones.
#include "export.h"
#include "skin.h"
#include "team.h"

namespace jg {
namespace {

constexpr int BLOCKS_PER_ITEM = 64;

void skin_block(const SkinTask& s, int32_t block) {
  vf m[MAP_ENTRIES], p[3];
  blend(s, block, m);
  posed_center(s, block, m, p);
  store_shapes(s, block, m, p, volume(s, m));
}

}  // namespace
}  // namespace jg

JG_API int32_t jg_skin_task_bytes() { return sizeof(jg::SkinTask); }

// Poses one avatar, together with the other threads of the team.
JG_API void jg_skin(jg::Team* team, const jg::SkinTask* task) {
  const jg::SkinTask s = *task;
  const int32_t items = (s.blocks + jg::BLOCKS_PER_ITEM - 1) / jg::BLOCKS_PER_ITEM;
  jg::share(*team, 0, items, [&](int32_t item) {
    const int32_t end = (item + 1) * jg::BLOCKS_PER_ITEM;
    for (int32_t b = item * jg::BLOCKS_PER_ITEM; b < end && b < s.blocks; b++) jg::skin_block(s, b);
  });
}
