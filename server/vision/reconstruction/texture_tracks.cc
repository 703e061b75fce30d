#include "server/vision/reconstruction/texture_tracks.h"

#include <algorithm>

namespace horopter {
namespace {

constexpr double kSameFocal = 1.02;  // ratio of hints that are one

}  // namespace

MultiviewTracks TracksOfTexture(const TextureMatching& texture, std::span<const ImageSize> sizes) {
  MultiviewTracks tracks;
  tracks.sizes.assign(sizes.begin(), sizes.end());
  for (const FeatureTrack& track : texture.tracks) {
    if (tracks.points == kMaxFeatures) break;
    for (const FeatureTrack::Feature& f : track.features) {
      tracks.point_observations.push_back({f.view,
                                           tracks.points,
                                           texture.keypoints[f.view].points[f.feature],
                                           texture.sigma_px[f.view]});
    }
    ++tracks.points;
  }
  return tracks;
}

MultiviewTracks FewTracks(const MultiviewTracks& tracks, const TrackIndex& index, int of_view) {
  std::vector<int> order(tracks.points);
  for (int j = 0; j < tracks.points; ++j) order[j] = j;
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return index.of_point[a].size() > index.of_point[b].size();
  });
  std::vector<int> taken(tracks.sizes.size(), 0);
  MultiviewTracks few;
  few.sizes = tracks.sizes;
  for (const int j : order) {
    const bool wanted = std::any_of(index.of_point[j].begin(), index.of_point[j].end(), [&](int k) {
      return taken[tracks.point_observations[k].view] < of_view;
    });
    if (!wanted) continue;
    for (const int k : index.of_point[j]) {
      PointObservation o = tracks.point_observations[k];
      ++taken[o.view];
      o.point = few.points;
      few.point_observations.push_back(o);
    }
    ++few.points;
  }
  return few;
}

std::vector<int> CamerasOfImages(std::span<const ImageSize> sizes,
                                 std::span<const ViewPrior> priors) {
  std::vector<int> camera(sizes.size(), 0);
  const auto same = [&](size_t a, size_t b) {
    if (sizes[a].width != sizes[b].width || sizes[a].height != sizes[b].height) return false;
    if (priors.empty()) return true;
    const auto &f = priors[a].focal_px, &g = priors[b].focal_px;
    return f.has_value() == g.has_value() && (!f || std::max(*f / *g, *g / *f) < kSameFocal);
  };
  int cameras = 0;
  for (size_t v = 0; v < sizes.size(); ++v) {
    camera[v] = -1;
    for (size_t other = 0; other < v && camera[v] < 0; ++other) {
      if (same(v, other)) camera[v] = camera[other];
    }
    if (camera[v] < 0) camera[v] = cameras++;
  }
  return camera;
}

}  // namespace horopter
