#include "server/vision/reconstruction/few_features.h"

#include <Eigen/Geometry>
#include <algorithm>

#include "server/vision/reconstruction/alternation.h"

namespace horopter {
namespace {

// Every k-th feature, then the ones beside them: what few of them are taken lies all over the list.
std::vector<int> Spread(int count) {
  constexpr int kStride = 7;
  std::vector<int> order;
  for (int first = 0; first < std::min(kStride, count); ++first) {
    for (int k = first; k < count; k += kStride) order.push_back(k);
  }
  return order;
}

// Of each feature the views with an inlier observation of it.
template <typename Observation>
std::vector<std::vector<int>> ViewsOf(int features,
                                      const std::vector<Observation>& observations,
                                      int Observation::*feature,
                                      const std::vector<bool>& inlier) {
  std::vector<std::vector<int>> views(features);
  for (size_t k = 0; k < observations.size(); ++k) {
    if (inlier[k]) views[observations[k].*feature].push_back(observations[k].view);
  }
  return views;
}

// Counts the observations taken in the views; one of a view that has not enough yet is wanted.
class Quota {
 public:
  Quota(size_t views, int of_view) : taken_(views, 0), of_view_(of_view) {}

  bool Take(const std::vector<int>& views) {
    const bool wanted =
        std::any_of(views.begin(), views.end(), [&](int v) { return taken_[v] < of_view_; });
    if (!wanted) return false;
    for (const int v : views) ++taken_[v];
    return true;
  }

 private:
  std::vector<int> taken_;
  int of_view_;
};

}  // namespace

CalibratedScene OnFewFeatures(const MultiviewTracks& tracks,
                              const ProjectiveScene& inliers,
                              int of_view,
                              const CalibratedScene& scene) {
  CalibratedScene few = scene;
  const auto points = ViewsOf(
      tracks.points, tracks.point_observations, &PointObservation::point, inliers.point_inlier);
  const auto lines =
      ViewsOf(tracks.lines, tracks.line_observations, &LineObservation::line, inliers.line_inlier);
  // Points first up to a half: lines alone say little where they are few or parallel.
  Quota quota_points(tracks.sizes.size(), (of_view + 1) / 2), quota(tracks.sizes.size(), of_view);
  std::vector<bool> keep_point(tracks.points, false);
  for (const int j : Spread(tracks.points)) {
    if (!scene.points[j] || points[j].size() < 2 || !quota_points.Take(points[j])) continue;
    keep_point[j] = true;
    quota.Take(points[j]);
  }
  for (const int j : Spread(tracks.lines)) {
    const bool keep = scene.lines[j] && lines[j].size() >= 3 && quota.Take(lines[j]);
    if (!keep) few.lines[j].reset();
  }
  for (const int j : Spread(tracks.points)) {  // where lines are few
    if (!scene.points[j] || keep_point[j] || points[j].size() < 2) continue;
    keep_point[j] = quota.Take(points[j]);
  }
  for (int j = 0; j < tracks.points; ++j) {
    if (!keep_point[j]) few.points[j].reset();
  }
  return few;
}

void TriangulateOthers(const MultiviewTracks& tracks,
                       const ProjectiveScene& projective,
                       CalibratedScene* scene) {
  const MultiviewTracks normalized = NormalizeTracks(tracks);
  const TrackIndex index = IndexTracks(normalized);
  ProjectiveScene cameras = projective;
  for (size_t v = 0; v < scene->views.size(); ++v) {
    cameras.cameras[v].reset();
    if (!scene->views[v]) continue;
    const auto& [camera, pose] = static_cast<const CalibratedCamera&>(*scene->views[v]);
    CameraMatrix P;
    P << pose.R, pose.t;
    cameras.cameras[v] = (NormalizedFromPixels(tracks.sizes[v]) * camera.K() * P).normalized();
  }
  for (int j = 0; j < tracks.points; ++j) {
    if (scene->points[j] || !projective.points[j]) continue;
    const auto X = TriangulatePoint(normalized, index.of_point[j], cameras, 2);
    if (X && X->hnormalized().allFinite()) scene->points[j] = X->hnormalized();
  }
  for (int j = 0; j < tracks.lines; ++j) {
    if (scene->lines[j] || !projective.lines[j]) continue;
    scene->lines[j] = TriangulateLine(normalized, index.of_line[j], cameras, 3);
  }
}

}  // namespace horopter
