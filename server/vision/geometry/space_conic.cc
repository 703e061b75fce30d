#include "server/vision/geometry/space_conic.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <unsupported/Eigen/NonLinearOptimization>
#include <utility>

#include "server/vision/geometry/nearest_point.h"

namespace horopter {
namespace {

constexpr std::size_t kLeastPoints = 6;
constexpr std::size_t kLeastSightsOfEllipse = 3;
constexpr double kLeastParallax = 1e-3;  // radians between the rays of two centres
// Of the starts the ones that come so near are refined: working in pixels would ask for the scale.
constexpr double kStartShare = 0.4;      // of the image's semi-minor axis
constexpr double kUndetermined = 1e-12;  // of the largest eigenvalue of the balanced normal matrix
constexpr double kLeastRatio = 0.02;     // of an ellipse's axes: thinner is a line
constexpr int kEvaluations = 200;

// A sight without its lens, and the cone of its rays: q^T cone q < 0 inside of the conic.
struct Cone {
  Rigid3 camera_from_scene;
  double focal_px = 0.0;
  std::vector<Eigen::Vector3d> rays;  // z = 1
  Eigen::Matrix3d cone = Eigen::Matrix3d::Zero();
};

// Of points that lie on an ellipse; nothing where they lie on none.
std::optional<Eigen::Matrix3d> ConeOf(const std::vector<Eigen::Vector3d>& rays) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const auto& q : rays) mean += q.head<2>() / static_cast<double>(rays.size());
  double spread = 0.0;
  for (const auto& q : rays)
    spread += (q.head<2>() - mean).norm() / static_cast<double>(rays.size());
  if (!(spread > 0.0)) return std::nullopt;
  Eigen::MatrixXd A(rays.size(), 6);
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const Eigen::Vector2d p = (rays[i].head<2>() - mean) / spread;
    A.row(static_cast<Eigen::Index>(i)) << p.x() * p.x(), 2.0 * p.x() * p.y(), p.y() * p.y(),
        2.0 * p.x(), 2.0 * p.y(), 1.0;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(A.transpose() * A);
  const Eigen::VectorXd c = eigen.eigenvectors().col(0);
  Eigen::Matrix3d C, T;
  C << c(0), c(1), c(3), c(1), c(2), c(4), c(3), c(4), c(5);
  T << 1.0 / spread, 0.0, -mean.x() / spread, 0.0, 1.0 / spread, -mean.y() / spread, 0.0, 0.0, 1.0;
  if (!(C.topLeftCorner<2, 2>().determinant() > 0.0)) return std::nullopt;
  if (C.trace() - C(2, 2) < 0.0) C = -C;
  if (!(C.determinant() < 0.0)) return std::nullopt;
  const Eigen::Matrix3d cone = T.transpose() * C * T;
  return Eigen::Matrix3d(cone / cone.norm());
}

std::optional<Cone> MakeCone(const ConicSight& sight) {
  if (sight.points.size() < kLeastPoints) return std::nullopt;
  Cone out;
  out.camera_from_scene = sight.view.camera_from_scene;
  out.focal_px = sight.view.camera.focal_px;
  for (const Eigen::Vector2d& x : sight.points) {
    out.rays.push_back(NormalizedPoint(sight.view.camera, x).homogeneous());
    if (!out.rays.back().allFinite()) return std::nullopt;
  }
  const auto cone = ConeOf(out.rays);
  if (!cone) return std::nullopt;
  out.cone = *cone;
  return out;
}

// The cone's section with the plane {x : normal . x = offset} in the camera's frame.
std::optional<SpaceConic> Section(const Cone& cone, const Eigen::Vector3d& normal, double offset) {
  Eigen::Matrix3d B;
  B.col(0) = normal.unitOrthogonal();
  B.col(1) = normal.cross(B.col(0));
  B.col(2) = offset * normal;
  const Eigen::Matrix3d C = B.transpose() * cone.cone * B;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> axes(C.topLeftCorner<2, 2>());
  if (!(axes.eigenvalues()(0) > 0.0)) return std::nullopt;
  const Eigen::Vector2d middle = -C.topLeftCorner<2, 2>().inverse() * C.topRightCorner<2, 1>();
  const double level = -(C(2, 2) + C.topRightCorner<2, 1>().dot(middle));
  if (!(level > 0.0)) return std::nullopt;
  SpaceConic out;
  Eigen::Matrix3d R;
  R.col(0) = (B.leftCols<2>() * axes.eigenvectors().col(0)).normalized();
  R.col(2) = normal;
  R.col(1) = R.col(2).cross(R.col(0));
  out.semi_major = std::sqrt(level / axes.eigenvalues()(0));
  out.semi_minor = std::sqrt(level / axes.eigenvalues()(1));
  const Rigid3 camera_from_conic = {R, B * middle.homogeneous()};
  if (!(camera_from_conic.t.z() > 0.0)) return std::nullopt;
  out.scene_from_conic = cone.camera_from_scene.Inverse() * camera_from_conic;
  return out;
}

// Maps (cos s, sin s, 1) to the image, z = 1.
Eigen::Matrix3d ImageFromCircle(const SpaceConic& conic, const Rigid3& camera_from_scene) {
  const Rigid3 camera_from_conic = camera_from_scene * conic.scene_from_conic;
  Eigen::Matrix3d H;
  H << conic.semi_major * camera_from_conic.R.col(0), conic.semi_minor * camera_from_conic.R.col(1),
      camera_from_conic.t;
  return H;
}

// Sampson's distance: of g = m0^2 + m1^2 - m2^2 with m = H^-1 q.
double DistanceTo(const Eigen::Matrix3d& adjugate, const Eigen::Vector3d& ray, double focal_px) {
  const Eigen::Vector3d m = adjugate * ray;
  const Eigen::Vector3d half = adjugate.transpose() * Eigen::Vector3d(m.x(), m.y(), -m.z());
  return focal_px * 0.5 * (m.squaredNorm() - 2.0 * m.z() * m.z()) / half.head<2>().norm();
}

Eigen::Matrix3d Adjugate(const Eigen::Matrix3d& H) {
  Eigen::Matrix3d out;
  out << H.col(1).cross(H.col(2)).transpose(), H.col(2).cross(H.col(0)).transpose(),
      H.col(0).cross(H.col(1)).transpose();
  return out;
}

// Distances of all points from a conic that is changed by the parameters: of a circle two of turn,
// three of place in radii, the radius; of an ellipse all eight of SpaceConic::covariance.
struct Residuals {
  using Scalar = double;
  using InputType = Eigen::VectorXd;
  using ValueType = Eigen::VectorXd;
  using JacobianType = Eigen::MatrixXd;
  enum { InputsAtCompileTime = Eigen::Dynamic, ValuesAtCompileTime = Eigen::Dynamic };

  std::span<const Cone> cones;
  SpaceConic start;
  int points = 0;

  int inputs() const { return start.circle ? 6 : 8; }
  int values() const { return points; }

  SpaceConic Changed(const Eigen::VectorXd& x) const {
    SpaceConic out = start;
    const bool circle = start.circle;
    const Eigen::Vector3d turn(x(0), x(1), circle ? 0.0 : x(2));
    const double angle = turn.norm();
    if (angle > 0.0)
      out.scene_from_conic.R =
          start.scene_from_conic.R * Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix();
    out.scene_from_conic.t += start.semi_major * x.segment<3>(circle ? 2 : 3);
    out.semi_major *= std::exp(x(circle ? 5 : 6));
    out.semi_minor *= std::exp(x(circle ? 5 : 7));
    return out;
  }

  int operator()(const Eigen::VectorXd& x, Eigen::VectorXd& out) const {
    const SpaceConic conic = Changed(x);
    Eigen::Index k = 0;
    for (const Cone& cone : cones) {
      const Eigen::Matrix3d adjugate = Adjugate(ImageFromCircle(conic, cone.camera_from_scene));
      for (const Eigen::Vector3d& ray : cone.rays) {
        const double distance = DistanceTo(adjugate, ray, cone.focal_px);
        out(k++) = std::isfinite(distance) ? distance : 1e6;
      }
    }
    return 0;
  }
};

double Rms(const Residuals& residuals, const Eigen::VectorXd& x) {
  Eigen::VectorXd values(residuals.values());
  residuals(x, values);
  return values.norm() / std::sqrt(static_cast<double>(values.size()));
}

bool InFront(const SpaceConic& conic, std::span<const Cone> cones) {
  return std::all_of(cones.begin(), cones.end(), [&](const Cone& cone) {
    const Rigid3 pose = cone.camera_from_scene * conic.scene_from_conic;
    return pose.t.z() >
           std::hypot(conic.semi_major * pose.R(2, 0), conic.semi_minor * pose.R(2, 1));
  });
}

// The covariance in SpaceConic's parameters; nothing where one of them is not determined.
std::optional<Eigen::Matrix<double, 8, 8>> CovarianceOf(const Residuals& residuals,
                                                        double sigma_px) {
  const int n = residuals.inputs();
  Eigen::MatrixXd J(residuals.values(), n);
  Eigen::NumericalDiff<Residuals, Eigen::Central>(residuals).df(Eigen::VectorXd::Zero(n), J);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(J.transpose() * J);
  if (!eigen.eigenvalues().allFinite() ||
      !(eigen.eigenvalues()(0) > kUndetermined * eigen.eigenvalues()(n - 1)))
    return std::nullopt;
  const Eigen::MatrixXd inverse = eigen.eigenvectors() *
                                  eigen.eigenvalues().cwiseInverse().asDiagonal() *
                                  eigen.eigenvectors().transpose();
  Eigen::MatrixXd full = Eigen::MatrixXd::Zero(8, n);  // by the parameters of the fit
  const int place = residuals.start.circle ? 2 : 3;
  full.block(0, 0, place, place).setIdentity();
  full.block(3, place, 3, 3) = residuals.start.semi_major * Eigen::Matrix3d::Identity();
  full(6, place + 3) = 1.0;
  full(7, n - 1) = 1.0;
  return Eigen::Matrix<double, 8, 8>(sigma_px * sigma_px * full * inverse * full.transpose());
}

std::optional<SpaceConic> Refine(std::span<const Cone> cones,
                                 const SpaceConic& start,
                                 const SpaceConicOptions& options) {
  Residuals residuals = {cones, start, 0};
  for (const Cone& cone : cones) residuals.points += static_cast<int>(cone.rays.size());
  Eigen::VectorXd x = Eigen::VectorXd::Zero(residuals.inputs());
  Eigen::NumericalDiff<Residuals> numeric(residuals);
  Eigen::LevenbergMarquardt<Eigen::NumericalDiff<Residuals>> solver(numeric);
  solver.parameters.maxfev = kEvaluations;
  solver.parameters.xtol = solver.parameters.ftol = 1e-9;
  solver.minimize(x);
  if (!x.allFinite()) return std::nullopt;
  residuals.start = residuals.Changed(x);
  SpaceConic out = residuals.start;
  if (!InFront(out, cones) || !std::isfinite(out.semi_major)) return std::nullopt;
  const int n = residuals.inputs();
  out.rms_px = Rms(residuals, Eigen::VectorXd::Zero(n));
  const double fitted = out.rms_px * std::sqrt(static_cast<double>(residuals.points) /
                                               std::max(1, residuals.points - n));
  const auto covariance = CovarianceOf(residuals, std::max(options.sigma_px, fitted));
  if (!covariance) return std::nullopt;
  out.covariance = *covariance;
  return out;
}

// The two circles of radius one that the cone is of, moved to where the other cone's axis is
// nearest.
std::vector<SpaceConic> CircleStarts(const Cone& cone, const Cone& other) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(cone.cone);
  const Eigen::Vector3d& l = eigen.eigenvalues();  // one negative, first
  const double across = std::sqrt(std::max(0.0, l(2) - l(1))), along = std::sqrt(l(1) - l(0));
  const auto axis_of = [](const Cone& c) {
    const Eigen::Vector2d middle =
        -c.cone.topLeftCorner<2, 2>().inverse() * c.cone.topRightCorner<2, 1>();
    const Rigid3 scene_from_camera = c.camera_from_scene.Inverse();
    return SpaceLine{scene_from_camera.t,
                     (scene_from_camera.R * middle.homogeneous()).normalized()};
  };
  std::vector<SpaceConic> starts;
  for (const double side : {1.0, -1.0}) {
    Eigen::Vector3d normal =
        (side * across * eigen.eigenvectors().col(2) + along * eigen.eigenvectors().col(0))
            .normalized();
    if (normal.dot(cone.camera_from_scene.R * axis_of(cone).direction) < 0.0) normal = -normal;
    auto circle = Section(cone, normal, 1.0);
    if (!circle) continue;
    const Eigen::Vector3d from = cone.camera_from_scene.Inverse().t;
    const SpaceLine ray = {from, (circle->scene_from_conic.t - from).normalized()};
    const auto meet = NearestToLines(std::vector<SpaceLine>{ray, axis_of(other)}, kLeastParallax);
    if (!meet) continue;
    const double scale =
        (*meet - from).dot(ray.direction) / (circle->scene_from_conic.t - from).norm();
    if (!(scale > 0.0)) continue;
    circle->scene_from_conic.t = from + scale * (circle->scene_from_conic.t - from);
    circle->semi_major = scale * std::sqrt(circle->semi_major * circle->semi_minor);
    circle->semi_minor = circle->semi_major;
    circle->circle = true;
    starts.push_back(*circle);
  }
  return starts;
}

// Planes of the member of rank two of the pencil of two cones, as sections of the first: A + l B is
// singular for every l; det(A + l B) = l (I2 + I3 l + I4 l^2), and of cones of one conic the root
// is double.
std::vector<SpaceConic> EllipseStarts(const Cone& first, const Cone& second) {
  const Rigid3 second_from_first = second.camera_from_scene * first.camera_from_scene.Inverse();
  const double baseline = second_from_first.t.norm();
  if (!(baseline > 0.0)) return {};
  Eigen::Matrix<double, 3, 4> P;
  P << second_from_first.R, second_from_first.t / baseline;
  Eigen::Matrix4d A = Eigen::Matrix4d::Zero(), B = P.transpose() * second.cone * P;
  A.topLeftCorner<3, 3>() = first.cone / first.cone.norm();
  B /= B.norm();
  const auto at = [&](double l) { return Eigen::Matrix4d(A + l * B).determinant() / l; };
  const double I3 = 0.5 * (at(1.0) - at(-1.0));
  const double I4 = (at(2.0) + at(-2.0) - at(1.0) - at(-1.0)) / 6.0;
  const double l = -I3 / (2.0 * I4);
  if (!std::isfinite(l)) return {};
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(A + l * B);
  if (!(eigen.eigenvalues()(0) < 0.0) || !(eigen.eigenvalues()(3) > 0.0)) return {};
  const Eigen::Vector4d up = std::sqrt(eigen.eigenvalues()(3)) * eigen.eigenvectors().col(3);
  const Eigen::Vector4d down = std::sqrt(-eigen.eigenvalues()(0)) * eigen.eigenvectors().col(0);
  std::vector<SpaceConic> starts;
  for (Eigen::Vector4d plane : {Eigen::Vector4d(up + down), Eigen::Vector4d(up - down)}) {
    const double norm = plane.head<3>().norm();
    if (!(norm > 0.0)) continue;
    const double offset = -plane.w() / norm * baseline;
    if (const auto section = Section(first, plane.head<3>() / norm, offset))
      starts.push_back(*section);
  }
  return starts;
}

// Root mean square of the semi-minor axes of the images, pixels: what a start's error compares to.
double ImageSize(std::span<const Cone> cones) {
  double sum = 0.0;
  for (const Cone& cone : cones) {
    const Eigen::Matrix2d C = cone.cone.topLeftCorner<2, 2>();
    const Eigen::Vector2d c = cone.cone.topRightCorner<2, 1>();
    const double level = c.dot(C.inverse() * c) - cone.cone(2, 2);
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(C);
    sum += cone.focal_px * cone.focal_px * level / eigen.eigenvalues()(1);
  }
  return std::sqrt(sum / static_cast<double>(cones.size()));
}

std::optional<SpaceConic> Best(std::span<const Cone> cones,
                               const std::vector<SpaceConic>& starts,
                               const SpaceConicOptions& options) {
  std::optional<SpaceConic> best;
  const double largest = kStartShare * ImageSize(cones);
  for (const SpaceConic& start : starts) {
    Residuals residuals = {cones, start, 0};
    for (const Cone& cone : cones) residuals.points += static_cast<int>(cone.rays.size());
    if (!InFront(start, cones) ||
        !(Rms(residuals, Eigen::VectorXd::Zero(residuals.inputs())) < largest))
      continue;
    auto fitted = Refine(cones, start, options);
    if (fitted && (!best || fitted->rms_px < best->rms_px)) best = std::move(fitted);
  }
  return best;
}

// The longer axis first.
void OrderAxes(SpaceConic* conic) {
  if (conic->semi_major >= conic->semi_minor) return;
  std::swap(conic->semi_major, conic->semi_minor);
  Eigen::Matrix<double, 8, 8> turned = Eigen::Matrix<double, 8, 8>::Zero();
  turned(0, 1) = turned(2, 2) = turned(3, 3) = turned(4, 4) = turned(5, 5) = 1.0;
  turned(1, 0) = -1.0;
  turned(6, 7) = turned(7, 6) = 1.0;
  conic->covariance = turned * conic->covariance * turned.transpose();
  const Eigen::Matrix3d R = conic->scene_from_conic.R;
  conic->scene_from_conic.R << R.col(1), -R.col(0), R.col(2);
}

std::vector<Cone> MakeCones(std::span<const ConicSight> sights) {
  std::vector<Cone> cones;
  for (const ConicSight& sight : sights) {
    auto cone = MakeCone(sight);
    if (!cone) return {};
    cones.push_back(*std::move(cone));
  }
  return cones;
}

}  // namespace

std::optional<SpaceConic> FitSpaceCircle(std::span<const ConicSight> sights,
                                         const SpaceConicOptions& options) {
  const std::vector<Cone> cones = MakeCones(sights);
  if (cones.size() < 2) return std::nullopt;
  std::vector<SpaceConic> starts = CircleStarts(cones[0], cones[1]);
  for (SpaceConic& start : CircleStarts(cones[1], cones[0])) starts.push_back(start);
  return Best(cones, starts, options);
}

std::optional<SpaceConic> FitSpaceEllipse(std::span<const ConicSight> sights,
                                          const SpaceConicOptions& options) {
  const std::vector<Cone> cones = MakeCones(sights);
  if (cones.size() < kLeastSightsOfEllipse) return std::nullopt;
  std::vector<SpaceConic> starts;
  for (const auto& [a, b] : {std::pair(0, 1), std::pair(0, 2), std::pair(1, 2)}) {
    for (SpaceConic& start : EllipseStarts(cones[a], cones[b])) starts.push_back(start);
  }
  for (SpaceConic& start : CircleStarts(cones[0], cones[1])) {  // in noise
    start.circle = false;
    starts.push_back(start);
  }
  auto found = Best(cones, starts, options);
  if (!found) return found;
  OrderAxes(&*found);
  if (found->semi_minor < kLeastRatio * found->semi_major) return std::nullopt;
  return found;
}

std::optional<SpaceConic> FitSpaceConic(std::span<const ConicSight> sights,
                                        const SpaceConicOptions& options) {
  auto found = FitSpaceCircle(sights, options);
  if (found && found->rms_px <= options.max_rms_px) return found;
  found = FitSpaceEllipse(sights, options);
  if (found && found->rms_px <= options.max_rms_px) return found;
  return std::nullopt;
}

std::vector<double> DistancesToImage(const SpaceConic& conic, const ConicSight& sight) {
  const Eigen::Matrix3d adjugate = Adjugate(ImageFromCircle(conic, sight.view.camera_from_scene));
  std::vector<double> out;
  for (const Eigen::Vector2d& x : sight.points) {
    out.push_back(DistanceTo(
        adjugate, NormalizedPoint(sight.view.camera, x).homogeneous(), sight.view.camera.focal_px));
  }
  return out;
}

Eigen::Vector3d PointOfConic(const SpaceConic& conic, double angle_rad) {
  return conic.scene_from_conic * Eigen::Vector3d(conic.semi_major * std::cos(angle_rad),
                                                  conic.semi_minor * std::sin(angle_rad),
                                                  0.0);
}

}  // namespace horopter
