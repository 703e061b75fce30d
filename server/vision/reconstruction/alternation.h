// The thesis's reconstruction methods: decomposition of the projective depths, and alternating
// intersection and resection of points and lines (thesis 3.2, 3.3).
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/reconstruction/multiview_tracks.h"
#include "server/vision/reconstruction/reconstruction_options.h"
#include "server/vision/reconstruction/robust_loss.h"

namespace horopter {

// All functions here work in normalised coordinates (NormalizeTracks).

// Which observations belong to which feature or view: indices into the tracks' lists.
struct TrackIndex {
  std::vector<std::vector<int>> of_point, of_line;
  std::vector<std::vector<int>> points_in_view, lines_in_view;
};
TrackIndex IndexTracks(const MultiviewTracks& tracks);

// Factorises the matrix of depths times image points into cameras and points of rank 4 (Sturm,
// Triggs 1996; balanced, missing entries filled in by the current product). Points only. Nullopt
// with fewer than 2 views or 7 points. An initialiser: with missing data it does not reach the
// least-squares optimum.
std::optional<ProjectiveScene> DecomposeDepths(const MultiviewTracks& tracks,
                                               const DepthDecompositionOptions& options = {});

// Improves the scene in place: features with two or more inlier observations in known cameras are
// intersected (again), then every known camera is resected. Features that cannot be determined
// become empty. Keeps the gauge sum X X^T = I.
void Alternate(const MultiviewTracks& tracks,
               const TrackIndex& index,
               const AlternationOptions& options,
               ProjectiveScene* scene);

// One feature from its inlier observations in known cameras, two rounds of depth reweighting.
// Nothing when fewer than `min_views` see it.
std::optional<Eigen::Vector4d> TriangulatePoint(const MultiviewTracks& tracks,
                                                std::span<const int> observations,
                                                const ProjectiveScene& scene,
                                                int min_views);
std::optional<PluckerLine> TriangulateLine(const MultiviewTracks& tracks,
                                           std::span<const int> observations,
                                           const ProjectiveScene& scene,
                                           int min_views);

// Moves the scene to the gauge sum X X^T = I over its points (and two points of each line when
// there are fewer than 8 points). A degenerate set is left as it is.
void BalanceGauge(ProjectiveScene* scene);

}  // namespace horopter
