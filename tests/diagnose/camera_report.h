// Estimated cameras against the true ones, up to the freedom they have.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {

// An estimated camera in the estimate's own world.
struct EstimatedView {
  PinholeCamera camera;
  Rigid3 camera_from_world;
};

// A part's vertex in the true world (metres), with where each view sees it (pixels, with
// distortion; empty: outside).
struct WorldCorner {
  int instance = -1;
  int vertex = -1;
  Eigen::Vector3d point_in_world = Eigen::Vector3d::Zero();
  std::vector<std::optional<Eigen::Vector2d>> seen;
};

// All vertices of the instances that are visible to >= 0.1 in some view whose pose is known
// (CompleteTruth).
std::vector<WorldCorner> TrueWorldCorners(const BopScene& scene, const TrueModels& models);

enum class Freedom { kSimilarity, kCollineation };

struct CameraFinding {
  bool measured = false;  // the truth has corners in two images whose poses it knows
  int registered = 0;
  bool recovered = false;      // all views in, and every view's corners reprojected to <= 2 px rms
  double worst_view_px = 0.0;  // rms
  // estimate ~ H truth for homogeneous points (a similarity when that was asked)
  Eigen::Matrix4d estimate_from_truth = Eigen::Matrix4d::Identity();
  bool aligned = false;
};

// Finds the transform of the true corners that reprojects best through the estimated cameras.
CameraFinding CompareCameras(const std::vector<std::optional<EstimatedView>>& views,
                             const BopScene& scene,
                             const std::vector<WorldCorner>& corners,
                             Freedom freedom);

// Median relative error of the focal lengths; empty without a view.
std::optional<double> FocalError(const std::vector<std::optional<EstimatedView>>& views,
                                 const BopScene& scene);

// Distance in millimetres of an estimated point from a true one, after alignment.
double DistanceMm(const CameraFinding& alignment,
                  const Eigen::Vector3d& estimate,
                  const Eigen::Vector3d& truth);

double Median(std::vector<double> values);  // 0 when empty

}  // namespace horopter
