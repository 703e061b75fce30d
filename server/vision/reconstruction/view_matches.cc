#include "server/vision/reconstruction/view_matches.h"

#include <cmath>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

std::vector<ViewMatches> CountViewMatches(std::span<const ReconstructedPoint> points,
                                          std::span<const std::optional<CalibratedView>> views,
                                          std::span<const ImageFeatures> features,
                                          double rms_px) {
  std::vector<ViewMatches> out(views.size());
  std::vector<int> corners(views.size(), 0);
  std::vector<double> squares(views.size(), 0.0);
  for (const ReconstructedPoint& point : points) {
    for (const auto& [view, junction] : point.observations) {
      if (!views[view]) continue;
      ++out[view].matches;
      if (junction < 0) {
        squares[view] += rms_px * rms_px;
        continue;
      }
      ++corners[view];
      const Eigen::Vector3d in_camera = views[view]->camera_from_scene * point.point_in_world;
      squares[view] +=
          (Project(views[view]->camera, in_camera) - features[view].junctions[junction].point)
              .squaredNorm();
    }
  }
  for (size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    out[v].source =
        2 * corners[v] >= out[v].matches ? MatchSource::kFeatures : MatchSource::kTexture;
    if (out[v].matches > 0) out[v].rms_px = std::sqrt(squares[v] / out[v].matches);
  }
  return out;
}

}  // namespace horopter
