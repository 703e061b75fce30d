// Metric bundle adjustment of cameras, plane points (z = 0) and free points.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/geometry/rigid3.h"
#include "server/vision/reconstruction/reconstruction.h"
#include "server/vision/reconstruction/reconstruction_options.h"
#include "server/vision/reconstruction/tracks.h"
#include "server/vision/reconstruction/view_prior.h"

namespace horopter {

struct BundleView {
  ImageSize size;
  double focal_px = 0.0;
  double k1 = 0.0;
  Rigid3 camera_from_world;
  // Out; 0 until computed. Posterior deviation of log f scaled by the residuals, and what the
  // principal point's own deviation adds to it.
  double focal_log_sigma = 0.0;
  double focal_log_sigma_of_center = 0.0;
  ViewPrior prior;  // what is known of focal length, principal point and k1; its pose is not used

  // Given, or the image's centre.
  Eigen::Vector2d PrincipalPoint() const {
    return prior.principal_point_px.value_or(
        Eigen::Vector2d(0.5 * (size.width - 1), 0.5 * (size.height - 1)));
  }
  // Of each of its coordinates.
  double PrincipalPointSigmaPx(const BundleOptions& options) const {
    return prior.principal_point_px ? prior.principal_point_sigma_px
                                    : options.principal_point_sigma_widths * size.width;
  }
};

struct BundlePoint {
  Track track;  // observation.view indexes Bundle::views
  Eigen::Vector3d point_in_world = Eigen::Vector3d::Zero();
  bool on_plane = false;                                // z is kept 0
  int Coordinates() const { return on_plane ? 2 : 3; }  // that an adjustment moves
};

struct Bundle {
  std::vector<BundleView> views;
  std::vector<BundlePoint> points;
};

struct BundleSummary {
  bool usable = false;
  double cost = 0.0;  // robust, pixels^2 / 2
};

// Minimises the robust reprojection error in place. Gauge: the first view's centre stays where it
// is, and its rotation about the world's z stays. The bundle is left unchanged when the solver
// fails.
BundleSummary AdjustBundle(const BundleOptions& options, Bundle* bundle);

// Projection of a world point, pixels; nullopt behind the camera.
std::optional<Eigen::Vector2d> ProjectInto(const BundleView& view,
                                           const Eigen::Vector3d& point_in_world);

// Largest reprojection error (px) over the track's observations; 1e9 when behind a camera.
double WorstReprojection(const Bundle& bundle, const BundlePoint& point);

// Least-squares point of a track (linear, then Gauss-Newton); nullopt when the rays are parallel
// within min_angle_rad or the point is behind a camera.
std::optional<Eigen::Vector3d> Triangulate(const Bundle& bundle,
                                           const Track& track,
                                           double min_angle_rad);

// Intersection of an observation's ray with the plane z = 0; nullopt when it points away.
std::optional<Eigen::Vector3d> PointOnPlane(const BundleView& view, const Eigen::Vector2d& pixel);

}  // namespace horopter
