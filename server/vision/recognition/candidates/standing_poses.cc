#include "server/vision/recognition/candidates/standing_poses.h"

#include <algorithm>
#include <cmath>

#include "absl/container/inlined_vector.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/recognition/candidates/image_paths.h"

namespace horopter {
namespace {

constexpr double kMinRadiusPx = 10.0;   // projected, working pixels
constexpr double kMaxRadiusPx = 420.0;  // projected, working px; larger ones fill the image
constexpr double kDistinctPx = 14.0;    // working pixels, all views

// Largest displacement in any view, over the symmetry that makes it smallest.
double LargestShift(const PreparedObject& object,
                    std::span<const KnownView> views,
                    const PooledPose& a,
                    const PooledPose& b) {
  auto shift = [&](const Rigid3& turned_b) {
    double largest = 0.0;
    for (const KnownView& view : views) {
      Rigid3 of_a = view.camera_from_scene, of_b = view.camera_from_scene;
      of_a.t /= a.units_per_metre;
      of_b.t /= b.units_per_metre;
      largest = std::max(largest,
                         ProjectionDistance(object,
                                            view.camera,
                                            of_a * a.plane_from_object,
                                            view.camera,
                                            of_b * turned_b,
                                            view.maps->working_from_image));
    }
    return largest;
  };
  double smallest = shift(b.plane_from_object);
  for (const Rigid3& s : object.model.symmetries)
    smallest = std::min(smallest, shift(b.plane_from_object * s));
  return smallest;
}

}  // namespace

Rigid3 PlaceOnPlane(const StandingObject& standing, const PlaneYaw& yaw) {
  Rigid3 turn;
  turn.R << yaw.cos_yaw, -yaw.sin_yaw, 0, yaw.sin_yaw, yaw.cos_yaw, 0, 0, 0, 1;
  turn.t << yaw.position / yaw.units_per_metre, 0.0;
  return turn * standing.plane_from_object;
}

double MeanQuick(const PreparedObject& object,
                 std::span<const KnownView> views,
                 double units_per_metre,
                 const Rigid3& plane_from_object,
                 float reach_px,
                 double give_up) {
  absl::InlinedVector<QuickView, 8> seen;
  for (const KnownView& view : views) {
    Rigid3 camera_from_plane = view.camera_from_scene;
    camera_from_plane.t /= units_per_metre;
    const Rigid3 pose = camera_from_plane * plane_from_object;
    const Eigen::Vector3d c = pose * object.center;
    if (c.z() <= object.radius_m) return 0.0;
    const double radius =
        object.radius_m * view.camera.focal_px * view.maps->working_from_image / c.z();
    if (radius < kMinRadiusPx || radius > kMaxRadiusPx) return 0.0;
    const Eigen::Vector2d u = Project(view.camera, c);
    if (u.x() >= 0 && u.y() >= 0 && u.x() < view.camera.width && u.y() < view.camera.height)
      seen.push_back({view.maps, &view.camera, pose});
  }
  if (seen.size() < 2) return 0.0;
  return QuickScoreOverViews(object, seen, reach_px, static_cast<float>(give_up));
}

std::vector<PooledPose> DistinctPoses(const PreparedObject& object,
                                      std::span<const KnownView> views,
                                      std::vector<PooledPose> sorted,
                                      int kept) {
  std::vector<PooledPose> out;
  for (const PooledPose& p : sorted) {
    if (static_cast<int>(out.size()) >= kept) break;
    if (std::none_of(out.begin(), out.end(), [&](const PooledPose& o) {
          return std::abs(std::log(o.units_per_metre / p.units_per_metre)) < kDistinctScale &&
                 LargestShift(object, views, o, p) < kDistinctPx;
        })) {
      out.push_back(p);
    }
  }
  return out;
}

std::vector<PooledPose> InTurn(std::vector<PooledPose> by_quick) {
  std::vector<PooledPose> by_votes = by_quick;
  std::stable_sort(by_votes.begin(), by_votes.end(), [](const PooledPose& a, const PooledPose& b) {
    return a.votes > b.votes;
  });
  std::vector<PooledPose> out;
  for (std::size_t i = 0; i < by_quick.size(); ++i) {
    out.push_back(by_votes[i]);
    out.push_back(by_quick[i]);
  }
  return out;
}

std::vector<PooledPose> SettledPoses(const PreparedObject& object,
                                     std::span<const KnownView> views,
                                     std::vector<PooledPose> sorted,
                                     const SettleOptions& options) {
  std::vector<PooledPose> out;
  for (PooledPose& p : DistinctPoses(object, views, InTurn(std::move(sorted)), options.settled)) {
    const auto settled = RefineInScene(object, views, p.plane_from_object, options.refine);
    if (!settled) continue;
    p.plane_from_object = *settled;
    p.quick = MeanQuick(object, views, 1.0, *settled, options.settled_reach_px, 0.0);
    out.push_back(p);
  }
  std::stable_sort(out.begin(), out.end(), [](const PooledPose& a, const PooledPose& b) {
    return a.quick > b.quick;
  });
  if (static_cast<int>(out.size()) > options.kept) out.resize(options.kept);
  return out;
}

bool EdgesVisible(const PreparedObject& object,
                  const StandingObject& standing,
                  const PlaneYaw& yaw,
                  const Eigen::Vector3d& eye,
                  int first,
                  int second) {
  const double metres = 1.0 / yaw.units_per_metre;
  const Eigen::Vector2d level =
      Turned(yaw.cos_yaw, -yaw.sin_yaw, metres * (eye.head<2>() - yaw.position));
  const Eigen::Vector3d eye_at_rest(level.x(), level.y(), metres * eye.z());
  const Eigen::Vector3d to_camera =
      standing.plane_from_object.R.transpose() * (eye_at_rest - standing.plane_from_object.t) -
      object.center;
  const int aspect = AspectIndex(to_camera.cast<float>());
  return object.EdgeVisible(aspect, first) >= kMinPathVisible &&
         object.EdgeVisible(aspect, second) >= kMinPathVisible;
}

void ScorePeaks(const PreparedObject& object,
                const StandingObject& standing,
                std::span<const KnownView> views,
                const std::vector<PoseVotes::Peak>& peaks,
                float reach_px,
                PosePool* pool) {
  for (const PoseVotes::Peak& peak : peaks) {
    const Rigid3 pose = PlaceOnPlane(standing, peak.pose);
    const double quick =
        MeanQuick(object, views, peak.pose.units_per_metre, pose, reach_px, pool->floor());
    if (quick >= pool->floor()) pool->Add({pose, peak.pose.units_per_metre, quick, peak.weight});
  }
}

}  // namespace horopter
