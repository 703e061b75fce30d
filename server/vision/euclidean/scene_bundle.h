// Joint adjustment of cameras and objects on CAD edges, the matched points of the supporting plane
// and points of texture, with analytic derivatives.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/vision/euclidean/camera_group.h"
#include "server/vision/euclidean/camera_similarity.h"
#include "server/vision/euclidean/edge_observations.h"
#include "server/vision/euclidean/plane_cells.h"
#include "server/vision/euclidean/texture_points.h"
#include "server/vision/euclidean/view_jacobian.h"

namespace horopter {

// Of an object: rotation vector and translation, and the log of its scale about its centre where
// that is asked for. Of the plane: ObservedPlane::plane. Points of texture follow the cameras and
// are no parameters.
inline constexpr int kObjectParameters = 7;
inline constexpr int kEdgeRow = kViewParameters + kObjectParameters;
inline constexpr int kPlaneParameters = 3;

// What is known of a camera beforehand; image pixels.
struct CameraPrior {
  double log_focal = 0.0;
  double cx = 0.0;
  double cy = 0.0;
  double k1 = 0.0;
  double log_focal_sigma = 1.0;
  double center_sigma_px = 1.0;
  double k1_sigma = 1.0;
};

struct SceneBundle {
  std::vector<AdjustedView> views;
  std::vector<CameraPrior> priors;      // per view
  std::vector<CameraSimilarity> alike;  // no view in two of them
  CameraGroupPrior group;               // of known views; empty: nothing is known of them together
  std::vector<double> working_from_image;  // per view
  std::vector<AdjustedObject> objects;
  std::vector<double> log_scale;  // per object, 0: as enrolled
  std::vector<EdgeObservation> edges;
  ObservedPlane plane;
  ObservedTexture texture;
  double edge_sigma_px = 0.35;  // of an edge point, working pixels
  // Residuals beyond this many sigmas count ever less (Cauchy). Edges of a rounded or shaded part
  // err in common: hard on outliers. Higher: more efficient on clean points.
  double cauchy_sigmas = 0.5;
  // The same for cells of the plane: means of many matches, few of them on another surface.
  double plane_cauchy_sigmas = 3.0;
  // Cells and texture are taken for this many times less sure than they are: large while the
  // cameras are still far off.
  double plane_slack = 1.0;
};

// Where the parameters of each block begin; -1: not adjusted.
struct SceneBundleLayout {
  std::vector<int> view;
  std::vector<int> object;
  int plane = -1;
  int size = 0;
};

enum class Gauge {
  kFirstObject,  // holds the pose of objects[0]
  kFirstView,    // holds the pose of the first known view
  kFree,         // holds nothing: the caller sees to the six freedoms
};

SceneBundleLayout LayoutOf(const SceneBundle& bundle);

// Parameters fixed: those of the gauge, and all scales unless they are adjusted.
struct FixedParameters {
  Gauge gauge = Gauge::kFirstObject;
  bool scales = true;
};
std::vector<bool> FixedMask(const SceneBundle& bundle,
                            const SceneBundleLayout& layout,
                            const FixedParameters& fixed);

// One edge residual in sigmas, and its derivatives by the parameters of its view (10), its object
// (7) and by the sample's position in the object (3). Invalid (false) behind the camera.
struct EdgeRow {
  double residual = 0.0;
  Eigen::Matrix<double, kEdgeRow, 1> J;
  Eigen::Vector3d by_point;
};
bool LinearizeEdge(const SceneBundle& bundle, const EdgeObservation& edge, EdgeRow* row);

// One cell of the plane, in sigmas: by the parameters of view a (10), view b (10) and of the
// plane (3).
struct PlaneRow {
  Eigen::Vector2d residual;
  Eigen::Matrix<double, 2, 2 * kViewParameters + kPlaneParameters> J;
};
bool LinearizePlaneCell(const SceneBundle& bundle, const PlaneCell& cell, PlaneRow* row);
// How far the plane's cells are off, in their deviations: about 1 where cameras and plane explain
// them, whose median it is told by; 0 without cells.
double PlaneDeviation(const SceneBundle& bundle);

// A view's distances from its prior in sigmas: of log f, cx, cy, k1.
Eigen::Vector4d PriorResiduals(const SceneBundle& bundle, int view);
Eigen::Vector4d PriorWeights(const SceneBundle& bundle, int view);  // 1 / sigma
// First of these four parameters of every view; -1: not adjusted.
std::vector<int> IntrinsicsColumns(const SceneBundleLayout& layout);

// Moves everything along `step` (layout order); points of texture follow.
void MoveBundle(const SceneBundleLayout& layout, const Eigen::VectorXd& step, SceneBundle* bundle);

double BundleCost(const SceneBundle& bundle, int threads);

struct SceneBundleOptions {
  int max_iterations = 15;
  double min_decrease = 1e-4;  // of the cost, relative; less ends the adjustment
  FixedParameters fixed;
  int threads = 1;
};

// Neighbouring samples of one edge share the edge's error: how many samples, `spacing_px` apart,
// count as one.
double SharedSamples(double spacing_px);

// Levenberg-Marquardt on iteratively reweighted normal equations. False when the system cannot be
// solved; the bundle is then where it got to, never worse than at the start.
bool AdjustBundle(const SceneBundleOptions& options, SceneBundle* bundle);

}  // namespace horopter
