#include "server/vision/reconstruction/bundle_covariance.h"

#include <ceres/crs_matrix.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>

namespace horopter {
namespace {

// A feature whose own normal matrix is worse conditioned is not determined.
constexpr double kSingularFeature = 1e-15;

}  // namespace

double BundleCovariance::WeakestDeviation() const {
  if (gauge_freedom >= camera_spectrum.size()) return std::numeric_limits<double>::infinity();
  const double value = camera_spectrum(gauge_freedom);
  return value > 0.0 ? 1.0 / std::sqrt(value) : std::numeric_limits<double>::infinity();
}

Eigen::MatrixXd BundleCovariance::Features(std::span<const int> features) const {
  int total = 0;
  for (const int f : features) total += feature_size[f];
  // Columns W_f V_f^-1 side by side.
  Eigen::MatrixXd reach(cameras.rows(), total);
  int at = 0;
  for (const int f : features) {
    reach.middleCols(at, feature_size[f]) = W[f] * V_inverse[f];
    at += feature_size[f];
  }
  Eigen::MatrixXd joint = reach.transpose() * cameras * reach;
  at = 0;
  for (const int f : features) {
    joint.block(at, at, feature_size[f], feature_size[f]) += V_inverse[f];
    at += feature_size[f];
  }
  return joint;
}

std::optional<BundleCovariance> InvertBundle(const ceres::CRSMatrix& J,
                                             int camera_parameters,
                                             std::span<const int> feature_size,
                                             int gauge_freedom) {
  BundleCovariance out;
  out.gauge_freedom = gauge_freedom;
  out.feature_size.assign(feature_size.begin(), feature_size.end());
  std::vector<int> feature_of, offset_of;
  for (size_t f = 0; f < feature_size.size(); ++f) {
    for (int k = 0; k < feature_size[f]; ++k) {
      feature_of.push_back(static_cast<int>(f));
      offset_of.push_back(k);
    }
    out.W.emplace_back(Eigen::MatrixXd::Zero(camera_parameters, feature_size[f]));
    out.V_inverse.emplace_back(Eigen::MatrixXd::Zero(feature_size[f], feature_size[f]));
  }
  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(camera_parameters, camera_parameters);
  for (int r = 0; r < J.num_rows; ++r) {
    for (int a = J.rows[r]; a < J.rows[r + 1]; ++a) {
      for (int b = J.rows[r]; b < J.rows[r + 1]; ++b) {
        const double product = J.values[a] * J.values[b];
        if (!std::isfinite(product)) return std::nullopt;
        const int ca = J.cols[a] - camera_parameters, cb = J.cols[b] - camera_parameters;
        if (ca < 0 && cb < 0) {
          S(J.cols[a], J.cols[b]) += product;
        } else if (ca < 0) {
          out.W[feature_of[cb]](J.cols[a], offset_of[cb]) += product;
        } else if (cb >= 0) {
          out.V_inverse[feature_of[ca]](offset_of[ca], offset_of[cb]) += product;
        }
      }
    }
  }
  for (size_t f = 0; f < feature_size.size(); ++f) {
    if (feature_size[f] == 0) continue;
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(out.V_inverse[f]);
    const Eigen::VectorXd& values = solver.eigenvalues();
    if (!(values(0) > kSingularFeature * values(values.size() - 1))) return std::nullopt;
    out.V_inverse[f] = solver.eigenvectors() * values.cwiseInverse().asDiagonal() *
                       solver.eigenvectors().transpose();
    S -= out.W[f] * out.V_inverse[f] * out.W[f].transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(0.5 * (S + S.transpose()));
  if (solver.info() != Eigen::Success) return std::nullopt;
  out.camera_spectrum = solver.eigenvalues();
  Eigen::VectorXd inverse = Eigen::VectorXd::Zero(camera_parameters);
  const double floor = 1e-14 * std::max(0.0, out.camera_spectrum.maxCoeff());
  for (int k = gauge_freedom; k < camera_parameters; ++k) {
    inverse(k) = 1.0 / std::max(out.camera_spectrum(k), floor);
  }
  out.cameras = solver.eigenvectors() * inverse.asDiagonal() * solver.eigenvectors().transpose();
  if (!out.cameras.allFinite()) return std::nullopt;
  return out;
}

}  // namespace horopter
