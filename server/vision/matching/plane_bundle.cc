#include "server/vision/matching/plane_bundle.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "server/base/stop_scope.h"
#include "server/vision/geometry/plucker_line.h"
#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

constexpr double kPlanePointSigmaPx = 0.4;  // a junction is not known better than this
constexpr double kCauchyPx = 1.0;     // errors beyond count ever less: junctions err by half of it
constexpr double kGaugeWeight = 1e6;  // 1 / squared working units: holds a coordinate
constexpr int kIterations = 10;       // Gauss-Newton steps at most
constexpr double kNowherePx = 1e9;    // the error of what cannot be projected

using Matrix23 = Eigen::Matrix<double, 2, 3>;

double Cost(const PlaneBundle& bundle) {
  double sum = 0.0;
  for (const PlaneBundlePoint& point : bundle.points) {
    if (!point.valid) continue;
    for (const PlaneSight& s : point.seen) {
      if (!bundle.cameras[s.view].known) continue;
      const double e = ErrorPx(bundle.cameras[s.view], point.X, s.p) / kCauchyPx;
      sum += std::log1p(e * e);
    }
  }
  return sum;
}

// The views the scale hung on were dropped: two others carry it. False when fewer are known.
bool RepairGauge(PlaneBundle* bundle) {
  std::vector<int> known;
  for (size_t v = 0; v < bundle->cameras.size(); ++v) {
    if (bundle->cameras[v].known) known.push_back(static_cast<int>(v));
  }
  if (known.size() < 2) return false;
  bundle->reference = known[0];
  // e_i -> e_i - H_i v and x -> x + rho v leave all images alone.
  const ParallaxCamera& reference = bundle->cameras[bundle->reference];
  const Eigen::Vector3d v = reference.H.inverse() * reference.e;
  for (ParallaxCamera& c : bundle->cameras) c.e -= c.H * v;
  for (PlaneBundlePoint& point : bundle->points) {
    if (!point.valid) continue;
    point.X.head<3>() += point.X(3) * v;
    if (std::abs(point.X(2)) > 1e-9) point.X /= point.X(2);
  }
  bundle->scaled = known[1];
  return true;
}

// A point's share of the normal equations, and what is needed to move it along with the centres.
struct EliminatedPoint {
  Eigen::Matrix3d V_inverse;
  Eigen::Vector3d g;
  std::vector<std::pair<int, Eigen::Matrix3d>> W;
};

// Normal equations of the centres with the points eliminated (Schur complement).
struct ReducedSystem {
  Eigen::MatrixXd S;
  Eigen::VectorXd g;
  std::vector<EliminatedPoint> points;
};

void AddPoint(const PlaneBundle& bundle,
              const PlaneBundlePoint& point,
              double lambda,
              EliminatedPoint* out,
              ReducedSystem* system) {
  Eigen::Matrix3d V = Eigen::Matrix3d::Zero();
  out->g.setZero();
  for (const PlaneSight& s : point.seen) {
    const ParallaxCamera& camera = bundle.cameras[s.view];
    if (!camera.known) continue;
    const Eigen::Vector3d y = camera.Apply(point.X);
    const Eigen::Vector2d r = kPlaneUnitPx * (y.head<2>() / y.z() - s.p.head<2>());
    Matrix23 D;
    D << 1 / y.z(), 0, -y.x() / (y.z() * y.z()), 0, 1 / y.z(), -y.y() / (y.z() * y.z());
    D *= kPlaneUnitPx;
    const Matrix23 J_e = point.X(3) * D;
    Eigen::Matrix3d of_point;  // of (x, y, rho)
    of_point << camera.H.col(0), camera.H.col(1), camera.e;
    const Matrix23 J_p = D * of_point;
    const double w = 1.0 / (1.0 + r.squaredNorm() / (kCauchyPx * kCauchyPx));
    V += w * J_p.transpose() * J_p;
    out->g -= w * J_p.transpose() * r;
    system->S.block<3, 3>(3 * s.view, 3 * s.view) += w * J_e.transpose() * J_e;
    system->g.segment<3>(3 * s.view) -= w * J_e.transpose() * r;
    out->W.emplace_back(s.view, w * J_e.transpose() * J_p);
  }
  V.diagonal() *= 1.0 + lambda;
  V.diagonal().array() += 1e-12 * V.trace() + 1e-12;
  out->V_inverse = V.inverse();
  for (const auto& [i, W_i] : out->W) {
    system->g.segment<3>(3 * i) -= W_i * out->V_inverse * out->g;
    for (const auto& [j, W_j] : out->W)
      system->S.block<3, 3>(3 * i, 3 * j) -= W_i * out->V_inverse * W_j.transpose();
  }
}

// fixed_entry: of the scaled view's e.
ReducedSystem Reduce(const PlaneBundle& bundle, int fixed_entry, double lambda) {
  const int n = static_cast<int>(bundle.cameras.size());
  ReducedSystem system;
  system.S = Eigen::MatrixXd::Zero(3 * n, 3 * n);
  system.g = Eigen::VectorXd::Zero(3 * n);
  system.points.resize(bundle.points.size());
  for (size_t k = 0; k < bundle.points.size(); ++k) {
    if (bundle.points[k].valid)
      AddPoint(bundle, bundle.points[k], lambda, &system.points[k], &system);
  }
  for (int v = 0; v < n; ++v) {
    if (!bundle.cameras[v].known || v == bundle.reference)
      system.S.block<3, 3>(3 * v, 3 * v) += kGaugeWeight * Eigen::Matrix3d::Identity();
  }
  const int fixed = 3 * bundle.scaled + fixed_entry;
  system.S(fixed, fixed) += kGaugeWeight;
  return system;
}

void Move(const ReducedSystem& system, const Eigen::VectorXd& step, PlaneBundle* bundle) {
  for (int v = 0; v < static_cast<int>(bundle->cameras.size()); ++v) {
    if (bundle->cameras[v].known && v != bundle->reference)
      bundle->cameras[v].e += step.segment<3>(3 * v);
  }
  for (size_t k = 0; k < bundle->points.size(); ++k) {
    if (!bundle->points[k].valid) continue;
    Eigen::Vector3d rhs = system.points[k].g;
    for (const auto& [i, W_i] : system.points[k].W) rhs -= W_i.transpose() * step.segment<3>(3 * i);
    const Eigen::Vector3d d = system.points[k].V_inverse * rhs;
    bundle->points[k].X += Eigen::Vector4d(d.x(), d.y(), 0.0, d.z());
  }
}

}  // namespace

const PlaneSight* PlaneBundlePoint::In(int view) const {
  for (const PlaneSight& s : seen) {
    if (s.view == view) return &s;
  }
  return nullptr;
}

double ErrorPx(const ParallaxCamera& camera, const Eigen::Vector4d& X, const Eigen::Vector3d& p) {
  const Eigen::Vector3d y = camera.Apply(X);
  if (!(std::abs(y.z()) > 1e-9)) return kNowherePx;
  return kPlaneUnitPx * (y.head<2>() / y.z() - p.head<2>()).norm();
}

double RmsPx(const PlaneBundle& bundle) {
  double sum = 0.0;
  int count = 0;
  for (const PlaneBundlePoint& point : bundle.points) {
    if (!point.valid) continue;
    for (const PlaneSight& s : point.seen) {
      if (!bundle.cameras[s.view].known) continue;
      const double e = ErrorPx(bundle.cameras[s.view], point.X, s.p);
      sum += 0.5 * e * e;
      ++count;
    }
  }
  return count > 0 ? std::sqrt(sum / count) : 0.0;
}

PlaneBundlePoint Triangulated(const PlaneBundle& bundle,
                              const PlaneBundlePoint& point,
                              double inlier_px,
                              int without) {
  const auto counts = [&](const PlaneSight& s) {
    return bundle.cameras[s.view].known && s.view != without;
  };
  PlaneBundlePoint out = point;
  out.valid = false;
  Eigen::Matrix4d A = Eigen::Matrix4d::Zero();
  int known = 0;
  for (const PlaneSight& s : point.seen) {
    if (!counts(s)) continue;
    Eigen::Matrix<double, 3, 4> P;
    P << bundle.cameras[s.view].H, bundle.cameras[s.view].e;
    const Eigen::Matrix<double, 3, 4> rows = CrossMatrix(s.p) * P;
    A += rows.transpose() * rows;
    ++known;
  }
  if (known < 2) return out;
  Eigen::Vector4d X = SymmetricEigen<4>(A).eigenvectors().col(0);
  if (std::abs(X(2)) < 1e-9) return out;
  X /= X(2);
  int consistent = 0;
  for (const PlaneSight& s : point.seen)
    if (counts(s)) consistent += ErrorPx(bundle.cameras[s.view], X, s.p) < inlier_px;
  if (consistent < 2 || consistent < known || !(X(3) > 0.0)) return out;
  out.X = X;
  out.valid = true;
  return out;
}

void TriangulateAll(double inlier_px, PlaneBundle* bundle) {
  for (PlaneBundlePoint& point : bundle->points) point = Triangulated(*bundle, point, inlier_px);
}

void AdjustPlaneBundle(PlaneBundle* bundle) {
  if ((!bundle->cameras[bundle->reference].known || !bundle->cameras[bundle->scaled].known) &&
      !RepairGauge(bundle)) {
    return;
  }
  int fixed_entry = 0;
  bundle->cameras[bundle->scaled].e.cwiseAbs().maxCoeff(&fixed_entry);
  double lambda = 1e-4, current = Cost(*bundle);
  ReducedSystem system;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    LeaveIfStopped();
    system = Reduce(*bundle, fixed_entry, lambda);
    Eigen::MatrixXd damped = system.S;
    damped.diagonal() *= 1.0 + lambda;
    const Eigen::VectorXd step = damped.ldlt().solve(system.g);
    if (!step.allFinite()) break;
    const std::vector<ParallaxCamera> cameras_before = bundle->cameras;
    const std::vector<PlaneBundlePoint> points_before = bundle->points;
    Move(system, step, bundle);
    const double there = Cost(*bundle);
    if (there < current) {
      const bool done = current - there < 1e-9 * current;
      current = there;
      lambda = std::max(1e-9, 0.1 * lambda);
      if (done) break;
    } else {
      bundle->cameras = cameras_before;
      bundle->points = points_before;
      lambda *= 10.0;
      if (lambda > 1e4) break;
    }
  }
  const double rms = RmsPx(*bundle);
  bundle->covariance =
      std::max(kPlanePointSigmaPx * kPlanePointSigmaPx, rms * rms) * system.S.inverse();
}

Eigen::Matrix3d FundamentalOf(const ParallaxCamera& a, const ParallaxCamera& b) {
  const Eigen::Matrix3d H = b.H * a.H.inverse();
  const Eigen::Matrix3d F = CrossMatrix(b.e - H * a.e) * H;
  return F / F.norm();
}

double EpipolarSigmaPx(const PlaneBundle& bundle, int a, int b) {
  if (bundle.covariance.size() == 0) return kNowherePx;
  constexpr double kStep = 1e-6;  // of numerical derivatives; epipoles have unit norm
  Eigen::Matrix<double, 6, 6> C;
  const int at[2] = {3 * a, 3 * b};
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j)
      C.block<3, 3>(3 * i, 3 * j) = bundle.covariance.block<3, 3>(at[i], at[j]);
  }
  Eigen::Matrix3d moved[6];
  for (int k = 0; k < 6; ++k) {
    ParallaxCamera x = bundle.cameras[a], y = bundle.cameras[b];
    (k < 3 ? x.e : y.e)(k % 3) += kStep;
    moved[k] = FundamentalOf(x, y);
  }
  const Eigen::Matrix3d F = FundamentalOf(bundle.cameras[a], bundle.cameras[b]);
  const auto offset =
      [](const Eigen::Matrix3d& f, const Eigen::Vector3d& p, const Eigen::Vector3d& q) {
        const Eigen::Vector3d l = f * p;
        return kPlaneUnitPx * l.dot(q) / std::max(1e-12, l.head<2>().norm());
      };
  double worst = 0.0;
  for (const PlaneBundlePoint& point : bundle.points) {
    if (!point.valid) continue;
    const PlaneSight *in_a = point.In(a), *in_b = point.In(b);
    if (!in_a || !in_b) continue;
    const double here = offset(F, in_a->p, in_b->p);
    Eigen::Matrix<double, 1, 6> J;
    for (int k = 0; k < 6; ++k) J(k) = (offset(moved[k], in_a->p, in_b->p) - here) / kStep;
    worst = std::max(worst, (J * C * J.transpose())(0));
  }
  return worst > 0.0 && std::isfinite(worst) ? std::sqrt(worst) : kNowherePx;
}

}  // namespace horopter
