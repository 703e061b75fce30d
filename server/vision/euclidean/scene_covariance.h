// How well an adjusted scene is known: the joint covariance of cameras and objects.
#pragma once

#include <Eigen/Core>

#include "server/vision/euclidean/learnt_constants.h"
#include "server/vision/euclidean/scene_bundle.h"

namespace horopter {

// What edges err by that their scatter along one edge does not show.
struct NoiseOptions {
  // Displacement of a CAD edge in the part, the same in all views: rounded edges shine beside
  // themselves. Standard deviation per coordinate, metres. Higher: wider covariances of small
  // parts.
  double cad_edge_sigma_m = kCadEdgeSigmaM;
  // Smallest deviations believed of an edge as a whole in one view, and of one point; working px.
  double min_common_px = kMinCommonPx;
  double min_point_px = kMinPointPx;
  // Factor on the deviations for all that is not modelled.
  double inflation = kDeviationInflation;
};

// Estimated scatter of the residuals; working pixels.
struct EdgeScatter {
  double common_px = 0.0;    // of an edge as a whole, per view
  double tilt_px = 0.0;      // of its ends against its middle
  double point_px = 0.0;     // of a point about its edge
  double plane_ratio = 0.0;  // of the plane's cells, to what is stated of them
  int edges = 0;             // edges seen, counted per view
};

// Covariance of the perturbations of all parameters, in the order of `layout`. The pose of the
// first known view is the origin: its columns are zero, as are those of scales that are fixed.
// Directions that nothing determines have the width of a weak prior (kUnknownTurnRad, ten
// diameters).
struct SceneCovariance {
  SceneBundleLayout layout;
  Eigen::MatrixXd matrix;  // empty: could not be computed
  EdgeScatter scatter;
};

inline constexpr double kUnknownTurnRad = 3.14;  // half a turn: nothing is known

// Of the robust estimate that AdjustBundle makes: H^-1 V H^-1 (Huber's sandwich), H the weighted
// normal matrix, V the covariance of its right side. Points of one edge in one view err in common
// (offset and tilt) and each on its own; the scatters are estimated from the residuals, and what
// cannot be seen in them is added. scales_fixed = false: the objects' scales (but the first's) are
// unknown too.
SceneCovariance ComputeSceneCovariance(const SceneBundle& bundle,
                                       const NoiseOptions& options,
                                       bool scales_fixed = true);

// What edges and plane say of the known cameras, with the objects unknown and without any prior of
// the cameras, as the same robust estimate; linearised where the bundle is, which need not be the
// data's optimum. Empty when it cannot be computed.
CameraEvidence ComputeCameraEvidence(const SceneBundle& bundle, const NoiseOptions& options);

}  // namespace horopter
