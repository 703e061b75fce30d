// Cameras and points over a plane whose homographies are known, and their adjustment (plane +
// parallax over many views; Rother and Carlsson 2001, Triggs 2000).
#pragma once

#include <Eigen/Core>
#include <vector>

namespace horopter {

// Working coordinates: pixels about the mean of what a view sees, in this many pixels.
inline constexpr double kPlaneUnitPx = 300.0;

// P = [H | e]; a point (x, y, 1, rho) with rho = 0 on the plane. Working coordinates, det H = 1.
struct ParallaxCamera {
  Eigen::Matrix3d H = Eigen::Matrix3d::Identity();
  Eigen::Vector3d e = Eigen::Vector3d::Zero();
  bool known = false;

  Eigen::Vector3d Apply(const Eigen::Vector4d& X) const { return H * X.head<3>() + X(3) * e; }
};

// Where a view sees a point; third entry 1.
struct PlaneSight {
  int view = -1;
  Eigen::Vector3d p = Eigen::Vector3d::UnitZ();
};

struct PlaneBundlePoint {
  std::vector<PlaneSight> seen;
  Eigen::Vector4d X = Eigen::Vector4d::Zero();
  bool valid = false;  // consistent in >= 2 known views

  // Null: the view does not see it.
  const PlaneSight* In(int view) const;
};

// Gauge: the reference's e stays, and the largest entry of one other view's, which carries the
// scale.
struct PlaneBundle {
  std::vector<ParallaxCamera> cameras;
  std::vector<PlaneBundlePoint> points;
  int reference = 0;
  int scaled = 0;
  Eigen::MatrixXd covariance;  // of all e, three rows a view; empty until adjusted
};

// Distance in pixels of where a camera shows a point from `p`; huge where it shows it nowhere.
double ErrorPx(const ParallaxCamera& camera, const Eigen::Vector4d& X, const Eigen::Vector3d& p);

// Of the valid points in the known views, per coordinate.
double RmsPx(const PlaneBundle& bundle);

// The least squares point of the known views but `without`; valid when it is consistent (within
// inlier_px) with at least two of them and with all that see it, and lies on the cameras' side of
// the plane.
PlaneBundlePoint Triangulated(const PlaneBundle& bundle,
                              const PlaneBundlePoint& point,
                              double inlier_px,
                              int without = -1);
void TriangulateAll(double inlier_px, PlaneBundle* bundle);

// Levenberg-Marquardt over centres and points with Cauchy weights, points eliminated. Leaves the
// covariance of the centres. Where the views that the gauge hung on are not known any more, two
// others carry it.
void AdjustPlaneBundle(PlaneBundle* bundle);

// x_b^T F x_a = 0 in working coordinates, unit norm.
Eigen::Matrix3d FundamentalOf(const ParallaxCamera& a, const ParallaxCamera& b);

// Largest predicted deviation (pixels) of the epipolar lines in b of the valid points, from both
// centres' covariance; huge when there is none.
double EpipolarSigmaPx(const PlaneBundle& bundle, int a, int b);

}  // namespace horopter
