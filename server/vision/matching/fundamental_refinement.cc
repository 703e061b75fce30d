#include "server/vision/matching/fundamental_refinement.h"

#include <Eigen/Dense>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>

#include "server/vision/geometry/fundamental_matrix.h"
#include "server/vision/geometry/plucker_line.h"

namespace horopter {
namespace {

constexpr double kStop = 1e-10;  // relative change of the cost

using Vector7 = Eigen::Matrix<double, 7, 1>;

Eigen::Matrix3d Rotation(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  if (angle < 1e-15) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, w / angle).toRotationMatrix();
}

// F = U diag(cos t, sin t, 0) V^T; the seven freedoms are two rotations and t.
struct Factors {
  Eigen::Matrix3d U, V;
  double t = 0.0;

  explicit Factors(const Eigen::Matrix3d& F) {
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(F, Eigen::ComputeFullU | Eigen::ComputeFullV);
    U = svd.matrixU();
    V = svd.matrixV();
    t = std::atan2(svd.singularValues()(1), svd.singularValues()(0));
  }
  Eigen::Matrix3d F() const {
    return std::cos(t) * U.col(0) * V.col(0).transpose() +
           std::sin(t) * U.col(1) * V.col(1).transpose();
  }
  Factors Moved(const Vector7& step) const {
    Factors moved = *this;
    moved.U = U * Rotation(step.head<3>());
    moved.V = V * Rotation(step.segment<3>(3));
    moved.t += step(6);
    return moved;
  }
  static constexpr int kPriors = 0;  // what speaks beside the matches: nothing
  Eigen::Matrix<double, 3, 1> Priors() const { return Eigen::Vector3d::Zero(); }
};

// F = K_b^-T [t]x R K_a^-1: a motion and two focal lengths.
struct Motion {
  Eigen::Matrix3d R;
  Eigen::Vector3d t;                            // unit
  double log_focal_a = 0.0, log_focal_b = 0.0;  // of focal lengths in image widths
  FocalPrior prior;

  static Eigen::Matrix3d K(double log_focal, double width, double height) {
    const double f = std::exp(log_focal) * width;
    Eigen::Matrix3d k;
    k << f, 0, 0.5 * (width - 1), 0, f, 0.5 * (height - 1), 0, 0, 1;
    return k;
  }
  Eigen::Matrix3d KA() const { return K(log_focal_a, prior.width_a, prior.height_a); }
  Eigen::Matrix3d KB() const { return K(log_focal_b, prior.width_b, prior.height_b); }
  Eigen::Matrix3d F() const {
    return KB().inverse().transpose() * CrossMatrix(t) * R * KA().inverse();
  }
  Motion Moved(const Vector7& step) const {
    Motion moved = *this;
    moved.R = R * Rotation(step.head<3>());
    const Eigen::Vector3d other =
        std::abs(t.z()) < 0.9 ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitX();
    const Eigen::Vector3d u = t.cross(other).normalized();
    moved.t = (t + step(3) * u + step(4) * t.cross(u)).normalized();
    moved.log_focal_a += step(5);
    moved.log_focal_b += step(6);
    return moved;
  }
  static constexpr int kPriors = 3;  // both focal lengths and their ratio
  Eigen::Vector3d Priors() const {
    const double middle = std::log(prior.focal_widths);
    return {(log_focal_a - middle) / prior.log_sigma,
            (log_focal_b - middle) / prior.log_sigma,
            (log_focal_a - log_focal_b) / prior.log_ratio_sigma};
  }
};

// Levenberg-Marquardt over seven freedoms; residuals in units of scale_px with Cauchy weights,
// priors in sigmas.
template <typename Model>
class Refiner {
 public:
  Refiner(Model model, std::span<const WeightedMatch> matches, double scale_px)
      : at_(std::move(model)), matches_(matches), scale_(scale_px), jacobian_(matches.size()) {}

  void Run() {
    double lambda = 1e-3, current = Cost(at_, true);
    for (int iteration = 0; iteration < 15; ++iteration) {
      Vector7 g;
      Normals(&g);
      Normal damped = A_;
      damped.diagonal() += lambda * (A_.diagonal().array() + 1e-9 * A_.trace()).matrix();
      const Vector7 step = damped.ldlt().solve(g);
      if (!step.allFinite()) return;
      const Model next = at_.Moved(step);
      const double there = Cost(next, true);
      if (there < current) {
        const bool done = current - there < kStop * current;
        at_ = next;
        current = there;
        lambda = std::max(1e-9, lambda * 0.1);
        if (done) return;
      } else {
        lambda *= 10.0;
        if (lambda > 1e6) return;
      }
    }
  }

  RefinedFundamental Result() {
    RefinedFundamental result;
    const Eigen::Matrix3d F = at_.F();
    result.F = F / F.norm();
    result.cost = Cost(at_, false);
    Vector7 g;
    const double variance = Normals(&g);
    Normal regular = A_;
    regular.diagonal().array() += 1e-12 * A_.trace();
    // A_ counts in units of scale_px, to which the priors were added.
    const Normal C = regular.inverse();
    const double excess = std::max(1.0, variance);
    for (const Row& row : jacobian_) {
      // The Sampson distance shares a deviation between both points: the line in b moves by about
      // twice as much.
      const double s =
          2.0 * excess * kPointSigmaPx * kPointSigmaPx * (row * C * row.transpose())(0);
      result.line_sigma_px.push_back(
          std::isfinite(s) && s >= 0.0 ? std::sqrt(s) : std::numeric_limits<double>::infinity());
    }
    return result;
  }

  const Model& model() const { return at_; }

 private:
  using Normal = Eigen::Matrix<double, 7, 7>;
  using Row = Eigen::Matrix<double, 1, 7>;
  static constexpr double kStep = 1e-6;  // of numerical derivatives; parameters are of order 1
  static constexpr double kPointSigmaPx = 0.4;  // a junction is not known better than this

  double Cost(const Model& model, bool with_priors) const {
    const Eigen::Matrix3d F = model.F();
    double sum = 0.0;
    for (const WeightedMatch& m : matches_) {
      const double r = SignedSampson(F, m.a, m.b) / scale_;
      sum += std::log1p(r * r);
    }
    if (with_priors && Model::kPriors > 0) sum += PriorWeight() * model.Priors().squaredNorm();
    return sum;
  }

  // The cost of matches is in units of scale_px, their deviation is kPointSigmaPx: priors in sigmas
  // are scaled alike.
  double PriorWeight() const { return kPointSigmaPx * kPointSigmaPx / (scale_ * scale_); }

  // Normal equations at the present model; returns the weighted variance in units of
  // kPointSigmaPx^2.
  double Normals(Vector7* g) {
    Eigen::Matrix3d moved[7];
    for (int k = 0; k < 7; ++k) moved[k] = at_.Moved(kStep * Vector7::Unit(k)).F();
    const Eigen::Matrix3d here = at_.F();
    A_.setZero();
    g->setZero();
    double weighted = 0.0, weights = 0.0;
    for (size_t i = 0; i < matches_.size(); ++i) {
      const double r = SignedSampson(here, matches_[i].a, matches_[i].b);
      for (int k = 0; k < 7; ++k)
        jacobian_[i](k) = (SignedSampson(moved[k], matches_[i].a, matches_[i].b) - r) / kStep;
      const double w = 1.0 / (1.0 + r * r / (scale_ * scale_));
      A_ += w / (scale_ * scale_) * jacobian_[i].transpose() * jacobian_[i];
      *g -= w * r / (scale_ * scale_) * jacobian_[i].transpose();
      weighted += w * r * r;
      weights += w;
    }
    if (Model::kPriors > 0) {
      const Eigen::Vector3d p = at_.Priors();
      for (int k = 0; k < 3; ++k) {
        Row row;
        for (int f = 0; f < 7; ++f)
          row(f) = (at_.Moved(kStep * Vector7::Unit(f)).Priors()(k) - p(k)) / kStep;
        A_ += PriorWeight() * row.transpose() * row;
        *g -= PriorWeight() * p(k) * row.transpose();
      }
    }
    return weighted / std::max(1.0, weights - 7.0) / (kPointSigmaPx * kPointSigmaPx);
  }

  Model at_;
  std::span<const WeightedMatch> matches_;
  double scale_;
  std::vector<Row> jacobian_;
  Normal A_ = Normal::Zero();
};

// 1 - s2 / s1 of the essential matrix.
double Strain(const Eigen::Matrix3d& F, const Eigen::Matrix3d& K_a, const Eigen::Matrix3d& K_b) {
  const Eigen::Matrix3d E = K_b.transpose() * F * K_a;
  const Eigen::Vector3d s = Eigen::JacobiSVD<Eigen::Matrix3d>(E).singularValues();
  return s(0) > 0.0 ? 1.0 - s(1) / s(0) : 1.0;
}

struct CalibratedStart {
  Motion motion;  // focal lengths only
  double strain = 1.0;
};

CalibratedStart StartFrom(const Eigen::Matrix3d& F, const FocalPrior& prior) {
  CalibratedStart start;
  start.motion.prior = prior;
  double best = std::numeric_limits<double>::infinity();
  constexpr int kFocals = 11;  // of each view, 0.8 to 2.5 image widths, 1.12 apart
  for (int i = 0; i < kFocals; ++i) {
    for (int j = 0; j < kFocals; ++j) {
      Motion m = start.motion;
      m.log_focal_a = std::log(0.8) + i * std::log(2.5 / 0.8) / (kFocals - 1);
      m.log_focal_b = std::log(0.8) + j * std::log(2.5 / 0.8) / (kFocals - 1);
      const double strain = Strain(F, m.KA(), m.KB());
      start.strain = std::min(start.strain, strain);
      // Among nearly equal ones the likelier focal lengths.
      const double rank = strain + 0.005 * m.Priors().squaredNorm();
      if (rank >= best) continue;
      best = rank;
      start.motion.log_focal_a = m.log_focal_a;
      start.motion.log_focal_b = m.log_focal_b;
    }
  }
  return start;
}

}  // namespace

double SignedSampson(const Eigen::Matrix3d& F, const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  const Eigen::Vector3d Fa = F.leftCols<2>() * a + F.col(2);
  const Eigen::Vector3d Fb = F.topRows<2>().transpose() * b + F.row(2).transpose();
  const double e = b.dot(Fa.head<2>()) + Fa.z();
  const double n = std::sqrt(Fa.head<2>().squaredNorm() + Fb.head<2>().squaredNorm());
  return n > 1e-300 ? e / n : 1e9;
}

RefinedFundamental RefineFundamental(const Eigen::Matrix3d& F,
                                     std::span<const WeightedMatch> matches,
                                     double scale_px) {
  RefinedFundamental result;
  result.F = F;
  result.line_sigma_px.assign(matches.size(), std::numeric_limits<double>::infinity());
  if (matches.size() < 8 || !F.allFinite() || F.norm() <= 0.0) return result;
  // Normalised coordinates make all freedoms alike; the residuals stay pixels of image b.
  std::vector<Eigen::Vector2d> points_a, points_b;
  for (const WeightedMatch& m : matches) {
    points_a.push_back(m.a);
    points_b.push_back(m.b);
  }
  const Eigen::Matrix3d T_a = NormalizingSimilarity(points_a);
  const Eigen::Matrix3d T_b = NormalizingSimilarity(points_b);
  struct Normalized : Factors {
    Eigen::Matrix3d T_a, T_b;
    Normalized(const Eigen::Matrix3d& G, const Eigen::Matrix3d& a, const Eigen::Matrix3d& b)
        : Factors(G), T_a(a), T_b(b) {}
    Eigen::Matrix3d F() const { return T_b.transpose() * Factors::F() * T_a; }
    Normalized Moved(const Vector7& step) const {
      Normalized moved = *this;
      static_cast<Factors&>(moved) = Factors::Moved(step);
      return moved;
    }
  };
  const Eigen::Matrix3d G = T_b.inverse().transpose() * F * T_a.inverse();
  Refiner<Normalized> refiner(Normalized(G / G.norm(), T_a, T_b), matches, scale_px);
  refiner.Run();
  return refiner.Result();
}

double CalibrationStrain(const Eigen::Matrix3d& F, const FocalPrior& prior) {
  return StartFrom(F, prior).strain;
}

CalibratedFundamental RefineCalibrated(const Eigen::Matrix3d& F,
                                       std::span<const WeightedMatch> matches,
                                       double scale_px,
                                       const FocalPrior& prior) {
  CalibratedFundamental result;
  auto [start, strain] = StartFrom(F, prior);
  result.strain = strain;
  // Any of the four motions of an essential matrix gives its F.
  const Eigen::Matrix3d E = start.KB().transpose() * F * start.KA();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(E, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d W;
  W << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  start.R = svd.matrixU() * W * svd.matrixV().transpose();
  if (start.R.determinant() < 0.0) start.R = -start.R;
  start.t = svd.matrixU().col(2);
  Refiner<Motion> refiner(start, matches, scale_px);
  refiner.Run();
  result.refined = refiner.Result();
  result.focal_a_px = std::exp(refiner.model().log_focal_a) * prior.width_a;
  result.focal_b_px = std::exp(refiner.model().log_focal_b) * prior.width_b;
  return result;
}

}  // namespace horopter
