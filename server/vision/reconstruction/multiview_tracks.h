// Points and line segments followed over several images, and the projective scene they determine
// (thesis 3). Any observation may be missing.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "server/vision/geometry/plucker_line.h"
#include "server/vision/geometry/projection.h"
#include "server/vision/reconstruction/image_size.h"

namespace horopter {

struct PointObservation {
  int view = -1;
  int point = -1;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double sigma_px = 1.0;  // standard deviation of each coordinate
};

// A segment stands for the infinite line through it: where it ends says nothing about the scene.
// The two ends are the places at which the distance to the projected line is measured.
struct LineObservation {
  int view = -1;
  int line = -1;
  Eigen::Vector2d start = Eigen::Vector2d::Zero();
  Eigen::Vector2d end = Eigen::Vector2d::Zero();
  double sigma_px = 1.0;  // standard deviation of each end across the line
};

// At most one observation of a point or line per view. `sizes` has one entry per view.
struct MultiviewTracks {
  std::vector<ImageSize> sizes;
  int points = 0;
  int lines = 0;
  std::vector<PointObservation> point_observations;
  std::vector<LineObservation> line_observations;
};

// Cameras, points and lines up to a collineation; what could not be determined is empty.
struct ProjectiveScene {
  std::vector<std::optional<CameraMatrix>> cameras;    // pixels, |P| = 1
  std::vector<std::optional<Eigen::Vector4d>> points;  // |X| = 1
  std::vector<std::optional<PluckerLine>> lines;       // |L| = 1
  // Per observation: used, and consistent with the scene.
  std::vector<bool> point_inlier;
  std::vector<bool> line_inlier;
};

// Errors: INVALID_ARGUMENT naming what is out of range, not finite or given twice. More than
// kMaxViews views or kMaxFeatures features are refused too: time must stay bounded.
inline constexpr int kMaxViews = 32;
inline constexpr int kMaxFeatures = 20000;
absl::Status Validate(const MultiviewTracks& tracks);

// A scene of the tracks' sizes in which nothing is known and every observation counts.
ProjectiveScene EmptyScene(const MultiviewTracks& tracks);

// Coordinates in which the algorithms work: image centre 0, half diagonal about 1 (pixels divided
// by (w + h) / 2.8). x_normalized = T x_pixels.
Eigen::Matrix3d NormalizedFromPixels(const ImageSize& size);
MultiviewTracks NormalizeTracks(const MultiviewTracks& tracks);
// Cameras of normalised coordinates become cameras of pixels.
void CamerasToPixels(const std::vector<ImageSize>& sizes, ProjectiveScene* scene);

// Residuals in units of the observation's sigma; not finite where the projection is not.
Eigen::Vector2d PointResidual(const CameraMatrix& P,
                              const Eigen::Vector4d& X,
                              const PointObservation& o);
// Signed distances of both ends from the projected line.
Eigen::Vector2d LineResidual(const CameraMatrix& P, const PluckerLine& L, const LineObservation& o);

// What the observations of a scene leave.
struct ResidualSummary {
  int point_observations = 0;  // inliers whose camera and feature are known
  int line_observations = 0;
  double rms_sigma = 0.0;  // per coordinate, in sigmas, both kinds
  double rms_px = 0.0;     // per coordinate, in the tracks' own units
};
ResidualSummary Summarize(const MultiviewTracks& tracks, const ProjectiveScene& scene);

}  // namespace horopter
