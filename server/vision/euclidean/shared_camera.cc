#include "server/vision/euclidean/shared_camera.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

namespace horopter {
namespace {

// Differences of one parameter between the views of a group and its first, with their covariance
// as the adjustment gives it and as one of parameters drawn independently with deviation 1.
struct Differences {
  Eigen::VectorXd values;
  Eigen::MatrixXd covariance;
  Eigen::MatrixXd of_unit_spread;
};

Differences DifferencesOf(const std::vector<int>& views,
                          const Eigen::VectorXd& values,
                          const SceneCovariance& covariance,
                          int parameter) {
  const auto n = static_cast<Eigen::Index>(views.size());
  Eigen::MatrixXd L = Eigen::MatrixXd::Zero(n - 1, n), C(n, n);
  L.col(0).setConstant(-1.0);
  L.rightCols(n - 1).setIdentity();
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j) {
      C(i, j) = covariance.matrix(covariance.layout.view[views[i]] + parameter,
                                  covariance.layout.view[views[j]] + parameter);
    }
  }
  return {L * values, L * C * L.transpose(), L * L.transpose()};
}

// Log density of the differences, up to a constant, where parameters are drawn with this spread.
double LogLikelihood(const Differences& d, double spread) {
  const Eigen::LDLT<Eigen::MatrixXd> ldlt(d.covariance + spread * spread * d.of_unit_spread);
  return -0.5 * d.values.dot(ldlt.solve(d.values)) -
         0.5 * ldlt.vectorD().cwiseMax(1e-300).array().log().sum();
}

bool OneCamera(const SceneBundle& bundle,
               const SceneCovariance& covariance,
               const std::vector<int>& views,
               const SharedCameraOptions& options) {
  Eigen::VectorXd log_focals(static_cast<Eigen::Index>(views.size()));
  for (std::size_t i = 0; i < views.size(); ++i)
    log_focals(static_cast<Eigen::Index>(i)) = std::log(bundle.views[views[i]].camera.focal_px);
  constexpr int kLogFocal = 6;  // place in a view's block of parameters
  Differences focal = DifferencesOf(views, log_focals, covariance, kLogFocal);
  focal.covariance *= options.widening * options.widening;
  const double same = LogLikelihood(focal, options.same_log_focal),
               similar = LogLikelihood(focal, options.similar_log_focal),
               apart = LogLikelihood(focal, bundle.priors[views[0]].log_focal_sigma);
  return same > std::max(similar, apart) + options.least_log_odds;
}

}  // namespace

bool AreUnbelievable(const SceneBundle& bundle,
                     const std::vector<int>& views,
                     const SharedCameraOptions& options) {
  if (views.size() < 3) return false;
  const auto [least, most] = std::minmax_element(views.begin(), views.end(), [&](int a, int b) {
    return bundle.views[a].camera.focal_px < bundle.views[b].camera.focal_px;
  });
  return std::log(bundle.views[*most].camera.focal_px / bundle.views[*least].camera.focal_px) >
         options.unbelievable_log_focal;
}

std::vector<CameraSimilarity> JudgeCameras(const SceneBundle& bundle,
                                           const SceneCovariance& covariance,
                                           const std::vector<bool>& hinted,
                                           const SharedCameraOptions& options) {
  std::vector<CameraSimilarity> out;
  if (covariance.matrix.size() == 0) return out;
  std::map<std::pair<int, int>, std::vector<int>> groups;  // by image size
  for (int v = 0; v < static_cast<int>(bundle.views.size()); ++v) {
    const AdjustedView& view = bundle.views[v];
    if (view.known && !hinted[v]) groups[{view.camera.width, view.camera.height}].push_back(v);
  }
  for (const auto& [size, views] : groups) {
    if (views.size() < 2) continue;
    if (!AreUnbelievable(bundle, views, options) && !OneCamera(bundle, covariance, views, options))
      continue;
    out.push_back({views, options.same_log_focal, options.same_center_px, options.same_k1});
  }
  return out;
}

}  // namespace horopter
