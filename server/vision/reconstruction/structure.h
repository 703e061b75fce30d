// Points and lines of views whose cameras are known.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/plucker_line.h"
#include "server/vision/reconstruction/alternation.h"
#include "server/vision/reconstruction/calibrated_scene.h"
#include "server/vision/reconstruction/multiview_tracks.h"

namespace horopter {

struct Structure {
  std::vector<std::optional<Eigen::Vector3d>> points;  // per point of the tracks, scene frame
  std::vector<std::optional<PluckerLine>> lines;
  std::vector<bool> point_agrees;  // per point observation: its point's, within the gate
};

// From the observations in registered views that agree within gate_px; the worst of three and more
// is dropped while they do not. What is seen under less than a degree of parallax has no depth and
// stays empty. tracks: pixels, `index` of them; views: one per view of the tracks.
Structure TriangulateAll(const MultiviewTracks& tracks,
                         const TrackIndex& index,
                         std::span<const std::optional<CalibratedView>> views,
                         double gate_px = 3.0);

}  // namespace horopter
