// The two calls. Every thread of a pool makes the same one; team.h shares the steps' items between them.
#include "raster.h"

#include "export.h"

using namespace jg;

JG_API int32_t jg_raster_job_bytes() { return sizeof(RasterJob); }
JG_API int32_t jg_team_bytes() { return sizeof(Team); }

namespace {

// The lists of all tiles, front to back. Whether they are there: `status` tells when they did not fit.
bool make_lists(RasterJob& job) {
  Team& team = *job.team;
  share(team, 0, job.parts, [&](int32_t part) { project_part(job, part); });
  share(team, 1, 1, [&](int32_t) { sort_visible(job); });
  share(team, 2, job.parts, [&](int32_t part) { count_part(job, part); });
  share(team, 3, 1, [&](int32_t) { lay_out_lists(job); });
  if (job.status != DONE) return false;
  share(team, 4, job.parts, [&](int32_t part) { fill_part(job, part); });
  return true;
}

}  // namespace

// Gaussians to records and lists, for who blends elsewhere. `status` tells when the lists did not fit: give more room
// (`pairs`) and call again.
JG_API void jg_raster_lists(RasterJob* job) { make_lists(*job); }

// Gaussians to planes; `status` as above.
JG_API void jg_raster_forward(RasterJob* job) {
  if (!make_lists(*job)) return;
  share(*job->team, 5, job->tiles_x * job->tiles_y, [job](int32_t tile) { blend_tile(*job, tile); });
}

// Gradient of planes to gradients of the Gaussians, after a forward call with the same job.
JG_API void jg_raster_backward(RasterJob* job) {
  Team& team = *job->team;
  const Stripes stripes = cut_stripes(*job);
  share(team, 0, GRADIENT_STRIPES, [&](int32_t stripe) { blend_backward_stripe(*job, stripes, stripe); });
  share(team, 1, job->parts, [&](int32_t part) { chain_rule_part(*job, stripes, part); });
}
