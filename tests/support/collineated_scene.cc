#include "tests/support/collineated_scene.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>

#include "server/vision/geometry/collineation.h"
#include "tests/support/synthetic_tracks.h"

namespace horopter {

std::optional<CollineatedScene> MakeCollineatedScene(unsigned seed,
                                                     int parts,
                                                     int views,
                                                     double sigma_px) {
  SyntheticTracksOptions options;
  options.seed = seed;
  options.parts = parts;
  options.views = views;
  const SyntheticTracks truth = MakeSyntheticTracks(options, {seed, sigma_px, 0.2});
  const auto result = ReconstructProjective(truth.tracks, {});
  if (!result.ok() || result->outcome != ProjectiveOutcome::kReconstructed) return std::nullopt;
  CollineatedScene scene;
  scene.cameras = result->scene.cameras;
  for (const PinholeCamera& c : truth.cameras) scene.sizes.emplace_back(c.width, c.height);
  std::mt19937 rng(seed);
  std::normal_distribution<double> normal;
  std::vector<std::vector<int>> points_of(parts);
  for (std::size_t i = 0; i < truth.points.size(); ++i) {
    points_of[truth.part_of_point[i]].push_back(static_cast<int>(i));
  }
  for (int k = 0; k < parts; ++k) {
    Rigid3 pose;
    pose.R = Eigen::Quaterniond(normal(rng), normal(rng), normal(rng), normal(rng))
                 .normalized()
                 .toRotationMatrix();
    for (const int i : points_of[k]) {
      pose.t += truth.points[i] / static_cast<double>(points_of[k].size());
    }
    scene.world_from_object.push_back(pose);
    CollineatedObject object;
    std::vector<PointPair3> pairs;
    constexpr double kUnit = 0.05;  // coordinates of order one for the linear estimate
    for (const int i : points_of[k]) {
      if (!result->scene.points[i]) continue;
      const Eigen::Vector3d x = pose.Inverse() * truth.points[i];
      object.points_in_object.push_back(x);
      object.points_in_scene.push_back(*result->scene.points[i]);
      PointPair3 pair;
      pair.from = Eigen::Vector3d(x / kUnit).homogeneous();
      pair.to = *result->scene.points[i];
      pairs.push_back(pair);
    }
    const auto H = FitCollineation(pairs, {});
    if (!H) return std::nullopt;
    object.scene_from_object =
        *H * Eigen::Vector4d(1 / kUnit, 1 / kUnit, 1 / kUnit, 1).asDiagonal();
    scene.objects.push_back(object);
  }
  for (std::size_t i = 0; i < truth.tracks.point_observations.size(); ++i) {
    const PointObservation& o = truth.tracks.point_observations[i];
    if (!result->scene.point_inlier[i]) continue;
    const int k = truth.part_of_point[o.point];
    scene.observations.push_back(
        {o.view, k, scene.world_from_object[k].Inverse() * truth.points[o.point], o.pixel});
  }
  for (std::size_t i = 0; i < truth.tracks.line_observations.size(); ++i) {
    const LineObservation& o = truth.tracks.line_observations[i];
    if (!result->scene.line_inlier[i]) continue;
    // Edges run between vertices.
    const auto& [a, b] = truth.lines[o.line];
    const int k = truth.part_of_point[std::find(truth.points.begin(), truth.points.end(), a) -
                                      truth.points.begin()];
    const Rigid3 object_from_world = scene.world_from_object[k].Inverse();
    scene.edge_observations.push_back(
        {o.view, k, object_from_world * a, object_from_world * b, o.start, o.end});
  }
  return scene;
}

BetweenError ErrorBetween(const CollineatedScene& scene,
                          const std::vector<Rigid3>& metric_from_object,
                          int k) {
  const Rigid3 truth = scene.world_from_object[0].Inverse() * scene.world_from_object[k];
  const Rigid3 estimate = metric_from_object[0].Inverse() * metric_from_object[k];
  return {(estimate.t - truth.t).norm(),
          Eigen::AngleAxisd(estimate.R * truth.R.transpose()).angle()};
}

}  // namespace horopter
