#include "server/vision/reconstruction/bundle_observations.h"

#include <algorithm>

namespace horopter {
namespace {

// Observations of every feature that enough known views see, views ascending.
template <typename List, typename FeatureOf>
std::vector<std::vector<int>> Enough(const List& list,
                                     const std::vector<bool>& inlier,
                                     const std::vector<bool>& known_views,
                                     const std::vector<bool>& known_features,
                                     size_t min_views,
                                     const FeatureOf& feature_of) {
  std::vector<std::vector<int>> of_feature(known_features.size());
  for (size_t k = 0; k < list.size(); ++k) {
    const int f = feature_of(list[k]);
    if (inlier[k] && known_views[list[k].view] && known_features[f]) {
      of_feature[f].push_back(static_cast<int>(k));
    }
  }
  for (std::vector<int>& observations : of_feature) {
    if (observations.size() < min_views) observations.clear();
    std::sort(observations.begin(), observations.end(), [&](int a, int b) {
      return list[a].view < list[b].view;
    });
  }
  return of_feature;
}

}  // namespace

BundleObservations SelectObservations(const MultiviewTracks& tracks,
                                      const ProjectiveScene& inliers,
                                      const KnownScene& known) {
  const auto points = Enough(tracks.point_observations,
                             inliers.point_inlier,
                             known.views,
                             known.points,
                             2,
                             [](const PointObservation& o) { return o.point; });
  const auto lines = Enough(tracks.line_observations,
                            inliers.line_inlier,
                            known.views,
                            known.lines,
                            3,
                            [](const LineObservation& o) { return o.line; });
  BundleObservations out;
  out.points = tracks.points;
  std::vector<int> views;  // per observation
  const auto append = [&](const auto& of_feature, const auto& list) {
    for (const std::vector<int>& observations : of_feature) {
      for (const int k : observations) {
        out.observation.push_back(k);
        views.push_back(list[k].view);
      }
      out.layout.first.push_back(static_cast<int>(views.size()));
    }
  };
  append(points, tracks.point_observations);
  append(lines, tracks.line_observations);
  out.view = views;
  std::sort(out.view.begin(), out.view.end());
  out.view.erase(std::unique(out.view.begin(), out.view.end()), out.view.end());
  std::vector<int> camera_of(known.views.size(), -1);
  for (size_t c = 0; c < out.view.size(); ++c) camera_of[out.view[c]] = static_cast<int>(c);
  out.layout.cameras = static_cast<int>(out.view.size());
  for (const int v : views) out.layout.camera.push_back(camera_of[v]);
  return out;
}

}  // namespace horopter
