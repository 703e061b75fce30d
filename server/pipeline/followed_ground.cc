#include "server/pipeline/followed_ground.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>

#include "server/vision/matching/plane_following.h"

namespace horopter {
namespace {

// Of edges whose cameras a plane holds, against free ones. A flat part that its own contours gave
// focal lengths a quarter too long has 1.19, others have 1.09 and less (set W of
// tests/bench/results.md).
constexpr double kMoreRms = 1.4;
constexpr double kRmsFloorPx = 0.2;  // smaller deviations are noise
// Of a cell of the plane, PlaneCellOptions::floor_px. Mean error of focal lengths over the scenes
// of sets Y, W and X with ground to follow: .54, 1.07 and .57 % with .12 px, .48, 1.03, .51 with
// .4, .49, 1.06, .50 with .8, .59, 1.47, .53 with 1.6, and .85, 3.08, .58 without their ground.
constexpr double kFollowedFloorPx = 0.8;
// Of these deviations, median over the cells. Of 51 scenes 46 have less; of the others two have
// their parts in worse distances with it, none in much better ones. The same sets and cad-dev.
constexpr double kMostSigmas = 1.5;

}  // namespace

PlaneInViews PlaneOf(const MetricScene& scene) {
  PlaneInViews out(scene.cameras.size());
  if (!scene.plane || scene.objects.empty()) return out;
  const Eigen::Vector3d& n = scene.plane->normal;
  const Eigen::Vector3d x = n.unitOrthogonal(), y = n.cross(x);
  const Eigen::Vector3d part = scene.objects.front().scene_from_object.t;
  const Eigen::Vector3d origin = part + (scene.plane->offset_m - n.dot(part)) * n;
  for (std::size_t v = 0; v < out.size(); ++v) {
    if (!scene.cameras[v]) continue;
    const Rigid3& camera_from_scene = scene.cameras[v]->camera_from_scene;
    Eigen::Matrix3d H;
    H << camera_from_scene.R * x, camera_from_scene.R * y, camera_from_scene * origin;
    out[v] = scene.cameras[v]->camera.K() * H;
  }
  return out;
}

MatchingResult FollowGround(const SceneRequest& request,
                            const MetricScene& scene,
                            const PipelineOptions& options,
                            const StopRequested& stop) {
  MatchingResult out;
  out.planes = FollowPlane(
      request.images, PlaneOf(scene), options.matching.alignment, options.threads, stop);
  return out;
}

PipelineOptions WithFollowedGround(PipelineOptions options) {
  options.euclidean.plane.floor_px = std::max(options.euclidean.plane.floor_px, kFollowedFloorPx);
  return options;
}

bool KeepsAnswer(const MetricScene& with_plane, const MetricScene& without) {
  const auto sigmas = with_plane.counts.find("plane_sigmas");
  return sigmas != with_plane.counts.end() && sigmas->second <= kMostSigmas &&
         with_plane.objects.size() >= without.objects.size() &&
         with_plane.rms_px <= kMoreRms * std::max(without.rms_px, kRmsFloorPx);
}

}  // namespace horopter
