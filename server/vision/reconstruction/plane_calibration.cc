#include "server/vision/reconstruction/plane_calibration.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

namespace horopter {
namespace {

constexpr int kFocalSteps = 12;          // of the grid, geometric: a factor of 1.23 apart
constexpr double kMinFocalWidths = 0.5;  // image widths: 90 degrees ...
constexpr double kMaxFocalWidths = 5.0;  // ... to 11 degrees of view
constexpr int kTiltSteps = 12;  // 3 .. 80 degrees between the plane's normal and the optical axis
constexpr int kAzimuthSteps = 36;  // 10 degrees apart
constexpr double kAnisotropySigma =
    0.02;                                // error of a homography's relative axis lengths and angle
constexpr double kDistinctAngle = 0.17;  // 10 degrees
constexpr double kDistinctStartLogFocal =
    0.2;  // log of the ratio; nearer starts lead to one solution

// Focal lengths to try, image widths: the given one or a geometric series.
std::vector<double> PlaneFocalGrid(const ImageSize& size, const ViewPrior& prior) {
  if (prior.focal_px) return {*prior.focal_px / size.width};
  std::vector<double> grid;
  for (int step = 0; step < kFocalSteps; ++step) {
    grid.push_back(kMinFocalWidths * std::pow(kMaxFocalWidths / kMinFocalWidths,
                                              step / static_cast<double>(kFocalSteps - 1)));
  }
  return grid;
}

// Pixels to coordinates about the principal point and divided by the image's width.
Eigen::Matrix3d CenteredFromPixels(const ImageSize& size, const ViewPrior& prior) {
  const Eigen::Vector2d center = prior.principal_point_px.value_or(
      Eigen::Vector2d(0.5 * (size.width - 1), 0.5 * (size.height - 1)));
  Eigen::Matrix3d T;
  const double s = 1.0 / size.width;
  T << s, 0, -s * center.x(), 0, s, -s * center.y(), 0, 0, 1;
  return T;
}

// How far the images a, b of two orthonormal plane axes are from K r1, K r2: relative, 0 for a
// perfect fit.
double Anisotropy(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double focal_widths) {
  const Eigen::Vector3d k(1.0 / focal_widths, 1.0 / focal_widths, 1.0);
  const Eigen::Vector3d x = k.cwiseProduct(a), y = k.cwiseProduct(b);
  const double xx = x.squaredNorm(), yy = y.squaredNorm();
  return std::hypot(2.0 * x.dot(y), xx - yy) / (xx + yy);
}

struct GridPoint {
  double focal_widths = 0.0;
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  std::vector<double> focals;
  double cost = 0.0;
};

// Columns: two orthonormal axes of the plane and its point on the optical axis, in the first
// camera's frame.
Eigen::Matrix3d PlaneBasis(const Eigen::Vector3d& normal) {
  const Eigen::Vector3d u = Eigen::Vector3d(normal.z(), 0.0, -normal.x()).normalized();
  Eigen::Matrix3d B;
  B.col(0) = u;
  B.col(1) = normal.cross(u);
  B.col(2) = Eigen::Vector3d::UnitZ();
  return B;
}

Eigen::Matrix3d FocalMatrix(double focal_widths) {
  return Eigen::Vector3d(focal_widths, focal_widths, 1.0).asDiagonal();
}

// Rotation and translation of [r1 r2 t] up to a positive scale; nullopt when degenerate.
std::optional<Rigid3> PoseFromColumns(const Eigen::Matrix3d& columns) {
  const double scale = 0.5 * (columns.col(0).norm() + columns.col(1).norm());
  if (!(scale > 1e-12) || !columns.allFinite()) return std::nullopt;
  Eigen::Matrix3d R;
  R.col(0) = columns.col(0) / scale;
  R.col(1) = columns.col(1) / scale;
  R.col(2) = R.col(0).cross(R.col(1));
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Rigid3 pose;
  pose.R = svd.matrixU() * svd.matrixV().transpose();
  if (pose.R.determinant() < 0.0) return std::nullopt;
  pose.t = columns.col(2) / scale;
  return pose;
}

std::optional<CalibrationStart> MakeStart(const GridPoint& point,
                                          const std::vector<Eigen::Matrix3d>& maps,
                                          std::span<const ImageSize> sizes) {
  CalibrationStart start;
  start.cost = point.cost;
  const Eigen::Matrix3d M0 = FocalMatrix(point.focal_widths) * PlaneBasis(point.normal);
  for (size_t i = 0; i < maps.size(); ++i) {
    const Eigen::Matrix3d columns = FocalMatrix(point.focals[i]).inverse() * maps[i] * M0;
    const std::optional<Rigid3> pose = PoseFromColumns(columns);
    if (!pose) return std::nullopt;
    start.focal_px.push_back(point.focals[i] * sizes[i].width);
    start.camera_from_world.push_back(*pose);
  }
  // Gauge: the first centre to (0, 0, 1).
  const Eigen::Vector3d first = start.camera_from_world[0].Inverse().t;
  if (!(first.z() > 1e-9)) return std::nullopt;
  for (Rigid3& pose : start.camera_from_world) {
    Eigen::Vector3d center = pose.Inverse().t;
    if (!(center.z() > 0.0)) return std::nullopt;
    center = (center - Eigen::Vector3d(first.x(), first.y(), 0.0)) / first.z();
    pose.t = -(pose.R * center);
  }
  return start;
}

// Every first focal length and normal, with the other views' best focal lengths. maps: centred view
// from centred first view.
std::vector<GridPoint> CostGrid(const std::vector<Eigen::Matrix3d>& maps,
                                const std::vector<std::vector<double>>& focals,
                                std::span<const ViewPrior> priors,
                                const ReconstructionOptions& options) {
  const auto prior = [&](size_t view, double focal_widths) {
    if (priors[view].focal_px) return 0.0;
    const double d =
        std::log(focal_widths / options.focal_prior_widths) / options.focal_prior_log_sigma;
    return d * d;
  };
  std::vector<GridPoint> grid;
  for (const double first_focal : focals[0]) {
    for (int tilt = 0; tilt < kTiltSteps; ++tilt) {
      for (int azimuth = 0; azimuth < kAzimuthSteps; ++azimuth) {
        const double t = (3.0 + 7.0 * tilt) * M_PI / 180.0,
                     z = 2.0 * M_PI * azimuth / kAzimuthSteps;
        GridPoint point;
        point.focal_widths = first_focal;
        point.normal = {std::sin(t) * std::cos(z), std::sin(t) * std::sin(z), -std::cos(t)};
        point.cost = prior(0, point.focal_widths);
        const Eigen::Matrix3d M0 = FocalMatrix(point.focal_widths) * PlaneBasis(point.normal);
        point.focals.push_back(point.focal_widths);
        for (size_t i = 1; i < maps.size(); ++i) {
          const Eigen::Vector3d a = maps[i] * M0.col(0), b = maps[i] * M0.col(1);
          double best = 1e300, best_focal = 1.0;
          for (const double focal : focals[i]) {
            const double r = Anisotropy(a, b, focal) / kAnisotropySigma;
            const double cost = r * r + prior(i, focal);
            if (cost < best) {
              best = cost;
              best_focal = focal;
            }
          }
          point.focals.push_back(best_focal);
          point.cost += best;
        }
        if (std::isfinite(point.cost)) grid.push_back(std::move(point));
      }
    }
  }
  return grid;
}

}  // namespace

std::vector<CalibrationStart> CalibrateFromPlane(std::span<const Eigen::Matrix3d> view_from_plane,
                                                 std::span<const ImageSize> sizes,
                                                 std::span<const ViewPrior> priors,
                                                 const ReconstructionOptions& options,
                                                 int keep) {
  std::vector<Eigen::Matrix3d> maps;  // centred view from centred first view
  for (size_t i = 0; i < view_from_plane.size(); ++i) {
    maps.push_back(CenteredFromPixels(sizes[i], priors[i]) * view_from_plane[i] *
                   CenteredFromPixels(sizes[0], priors[0]).inverse());
  }
  std::vector<std::vector<double>> focals;
  for (size_t i = 0; i < sizes.size(); ++i) focals.push_back(PlaneFocalGrid(sizes[i], priors[i]));
  std::vector<GridPoint> grid = CostGrid(maps, focals, priors, options);
  std::stable_sort(grid.begin(), grid.end(), [](const GridPoint& x, const GridPoint& y) {
    return x.cost < y.cost;
  });
  std::vector<CalibrationStart> starts;
  std::vector<const GridPoint*> kept;
  for (const GridPoint& point : grid) {
    if (static_cast<int>(starts.size()) >= keep) break;
    const bool known = std::any_of(kept.begin(), kept.end(), [&](const GridPoint* k) {
      return std::acos(std::clamp(k->normal.dot(point.normal), -1.0, 1.0)) < kDistinctAngle &&
             std::abs(std::log(k->focal_widths / point.focal_widths)) < kDistinctStartLogFocal;
    });
    if (known) continue;
    std::optional<CalibrationStart> start = MakeStart(point, maps, sizes);
    if (!start) continue;
    kept.push_back(&point);
    starts.push_back(*std::move(start));
  }
  return starts;
}

}  // namespace horopter
