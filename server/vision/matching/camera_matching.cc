#include "server/vision/matching/camera_matching.h"

#include <Eigen/Dense>
#include <string>
#include <utility>
#include <vector>

#include "server/base/parallel_for.h"
#include "server/vision/geometry/fundamental_matrix.h"
#include "server/vision/matching/feature_tracks.h"
#include "server/vision/matching/pair_geometry.h"

namespace horopter {
namespace {

// Junctions and segments as a lens without distortion would show them.
ImageFeatures Undistorted(const ImageFeatures& features, const PinholeCamera& camera) {
  ImageFeatures out = features;
  if (camera.k1 == 0.0) return out;
  const auto undo = [&](const Eigen::Vector2d& x) {
    return Eigen::Vector2d(camera.focal_px * NormalizedPoint(camera, x) +
                           Eigen::Vector2d(camera.cx, camera.cy));
  };
  for (Junction& junction : out.junctions) junction.point = undo(junction.point);
  for (Segment& segment : out.segments) {
    segment.start = undo(segment.start);
    segment.end = undo(segment.end);
  }
  return out;
}

}  // namespace

CameraMatrix MatrixOf(const CalibratedCamera& view) {
  CameraMatrix P;
  P << view.camera_from_scene.R, view.camera_from_scene.t;
  return view.camera.K() * P;
}

absl::StatusOr<MatchingResult> MatchViewsOfCameras(
    std::span<const cv::Mat> images,
    std::span<const ImageFeatures> features,
    std::span<const std::optional<CalibratedCamera>> cameras,
    const MatchingOptions& options,
    const StopRequested& stop) {
  const int views = static_cast<int>(images.size());
  if (features.size() != images.size() || cameras.size() != images.size()) {
    return absl::InvalidArgumentError("matching: " + std::to_string(images.size()) + " images, " +
                                      std::to_string(features.size()) + " feature sets and " +
                                      std::to_string(cameras.size()) + " cameras");
  }
  std::vector<ImageFeatures> undistorted(views);
  std::vector<MatchingView> prepared(views);
  ParallelFor(views, options.threads, [&](int v) {
    if (IsStopRequested(stop) || !cameras[v]) return;
    prepared[v] = PrepareMatchingView(images[v], features[v], options.graph);
    undistorted[v] = Undistorted(features[v], cameras[v]->camera);
    prepared[v].features = &undistorted[v];
  });
  MatchingResult result;
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views; ++b) {
      if (!cameras[a] || !cameras[b]) continue;
      PairGeometry pair;
      pair.view_a = a;
      pair.view_b = b;
      pair.F = FundamentalFromCameras(MatrixOf(*cameras[a]), MatrixOf(*cameras[b]));
      result.pairs.push_back(std::move(pair));
    }
  }
  ParallelFor(static_cast<int>(result.pairs.size()), options.threads, [&](int k) {
    PairGeometry& pair = result.pairs[k];
    if (IsStopRequested(stop)) return;
    MatchAlongEpipolarLines(
        prepared[pair.view_a], prepared[pair.view_b], std::nullopt, &pair, options.features);
  });
  if (IsStopRequested(stop)) return absl::CancelledError("matching: cancelled");
  result.component.assign(views, -1);
  result.view_from_plane.assign(views, Eigen::Matrix3d::Identity());
  for (const ImageFeatures& of_view : features)
    result.segment_on_plane.emplace_back(of_view.segments.size(), false);
  result.counts["pairs_compared"] = static_cast<double>(result.pairs.size());
  JoinAllTracks(&result);
  return result;
}

}  // namespace horopter
