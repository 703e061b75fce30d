// The reconstructed points of a scene as the bottom-up routes read them: one frame, joint
// covariance, which points an edge joins, and the observations they come from.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/projection.h"
#include "server/vision/reconstruction/bundle_covariance.h"
#include "server/vision/reconstruction/calibrated_scene.h"
#include "server/vision/reconstruction/multiview_tracks.h"

namespace horopter {

// All coordinates are of one frame, centred on the points and of order one. Invariants: all values
// are finite; observations name existing points, and views with a camera.
struct SceneStructure {
  // Known up to a similarity; else up to a collineation, in a frame in which no segment between two
  // points crosses the plane at infinity. That frame may be the mirror image: where a plane
  // separates the points from the cameras, chirality leaves the orientation open.
  bool metric = false;
  std::vector<Eigen::Vector3d> points;
  // Joint, 3 n x 3 n of the stacked points, in some gauge: right for whatever is invariant under
  // collineations (under similarities, when metric).
  Eigen::MatrixXd covariance;
  std::vector<std::array<int, 2>> edges;  // pairs of points that a straight edge joins
  std::vector<PluckerLine> lines;
  std::vector<std::optional<CameraMatrix>> cameras;  // undistorted pixels from this frame
  std::vector<PointObservation> point_observations;  // inliers
  std::vector<LineObservation> line_observations;
  double sigma_factor = 1.0;  // of the observations' stated deviations, from the residuals
  std::vector<int> point_track, line_track;  // which track each point and line is

  Eigen::MatrixXd CovarianceOf(std::span<const int> of_points) const;
};

// Of the tracks' points seen in `min_views` views or more. edges: pairs of point tracks. Errors:
// FAILED_PRECONDITION (fewer than five such points, no frame in which they are finite, no
// covariance), INVALID_ARGUMENT (sizes, more than kMaxStructurePoints points).
inline constexpr int kMaxStructurePoints = 400;
absl::StatusOr<SceneStructure> ProjectiveStructure(const MultiviewTracks& tracks,
                                                   const ProjectiveScene& scene,
                                                   std::span<const std::array<int, 2>> edges,
                                                   int min_views = 3);

// The same of a calibrated scene; inliers: the projective scene's marks; covariance: of the
// calibrated bundle.
absl::StatusOr<SceneStructure> MetricStructure(const MultiviewTracks& tracks,
                                               const ProjectiveScene& inliers,
                                               const CalibratedScene& scene,
                                               const BundleCovariance& covariance,
                                               std::span<const std::array<int, 2>> edges,
                                               int min_views = 3);

struct ComponentOptions {
  // Points that edges join to fewer than `min_points` go to every larger component whose nearest
  // point is within this share of that component's extent. Raising it gathers more of a part, and
  // more clutter.
  double reach = 1.0;
  int min_points = 5;
  // Unions of two components of at least `min_points`, nearest ones first, that are given beside
  // them: where an edge is not seen, a part falls into two. More cost time.
  int unions = 0;
};

// Points that may be one object's: joined by edges, or near enough; largest first. A point may be
// in several components.
std::vector<std::vector<int>> StructureComponents(const SceneStructure& structure,
                                                  const ComponentOptions& options = {});

}  // namespace horopter
