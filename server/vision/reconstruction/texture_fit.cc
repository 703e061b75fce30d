#include "server/vision/reconstruction/texture_fit.h"

#include <algorithm>

#include "absl/strings/str_format.h"

namespace horopter {

std::vector<ViewCount> CountViews(const MultiviewTracks& tracks, const AdjustedTexture& adjusted) {
  std::vector<ViewCount> counts(tracks.sizes.size());
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    ViewCount& count = counts[o.view];
    ++count.seen;
    const auto& view = adjusted.scene.views[o.view];
    const auto& X = adjusted.scene.points[o.point];
    if (!view || !X || !adjusted.inliers.point_inlier[k]) continue;
    ++count.agree;
    count.squared_px +=
        (Project(view->camera, view->camera_from_scene * *X) - o.pixel).squaredNorm();
  }
  return counts;
}

std::pair<int, std::string> WorstView(const MultiviewTracks& tracks,
                                      const AdjustedTexture& adjusted,
                                      const TextureRouteOptions& options) {
  const std::vector<ViewCount> counts = CountViews(tracks, adjusted);
  int worst = -1;
  double least = 2.0;
  for (size_t v = 0; v < counts.size(); ++v) {
    if (!adjusted.scene.views[v]) continue;
    const double share = static_cast<double>(counts[v].agree) / std::max(1, counts[v].seen);
    const bool belongs =
        counts[v].agree >= options.min_points_of_view && share >= options.min_share_of_view;
    if (belongs || share >= least) continue;
    least = share;
    worst = static_cast<int>(v);
  }
  if (worst < 0) return {worst, ""};
  return {worst,
          absl::StrFormat(
              "%d of %d matched texture points agree with the other views, need %d and %.0f %%",
              counts[worst].agree,
              counts[worst].seen,
              options.min_points_of_view,
              100.0 * options.min_share_of_view)};
}

double UnexplainedShare(const MultiviewTracks& tracks,
                        const CalibratedScene& scene,
                        double outlier_chi2) {
  const auto all = static_cast<double>(tracks.point_observations.size());
  const auto others = static_cast<double>(
      std::count_if(tracks.point_observations.begin(),
                    tracks.point_observations.end(),
                    [&](const PointObservation& o) { return !scene.views[o.view]; }));
  return (UnexplainedCost(tracks, scene, outlier_chi2) / outlier_chi2 - others) /
         std::max(1.0, all - others);
}

double ShareBesidePlane(const TextureMatching& texture,
                        const CalibratedScene& scene,
                        double plane_share) {
  double beside = 0.0, all = 0.0;
  for (const TexturePair& pair : texture.pairs) {
    if (!scene.views[pair.view_a] || !scene.views[pair.view_b]) continue;
    const double n = static_cast<double>(pair.matches.size());
    all += 1.0;
    beside += pair.on_homography <= plane_share * n ? 1.0 : 0.0;
  }
  return all > 0.0 ? beside / all : 0.0;
}

}  // namespace horopter
