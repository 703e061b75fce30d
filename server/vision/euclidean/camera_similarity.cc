#include "server/vision/euclidean/camera_similarity.h"

#include <cmath>

namespace horopter {
namespace {

Eigen::Vector4d Intrinsics(const PinholeCamera& c) {
  return {std::log(c.focal_px), c.cx, c.cy, c.k1};
}

Eigen::Vector4d Mean(std::span<const AdjustedView> views, const CameraSimilarity& alike) {
  Eigen::Vector4d mean = Eigen::Vector4d::Zero();
  for (const int v : alike.views) mean += Intrinsics(views[v].camera);
  return mean / static_cast<double>(alike.views.size());
}

// 1 / sigma^2, 0 where nothing is alike.
Eigen::Vector4d Weights(const CameraSimilarity& alike) {
  const auto weight = [](double sigma) { return sigma > 0.0 ? 1.0 / (sigma * sigma) : 0.0; };
  return {weight(alike.log_focal_sigma),
          weight(alike.center_sigma_px),
          weight(alike.center_sigma_px),
          weight(alike.k1_sigma)};
}

}  // namespace

double SimilarityCost(std::span<const AdjustedView> views,
                      std::span<const CameraSimilarity> alike) {
  double cost = 0.0;
  for (const CameraSimilarity& a : alike) {
    const Eigen::Vector4d mean = Mean(views, a), w = Weights(a);
    for (const int v : a.views) cost += w.dot((Intrinsics(views[v].camera) - mean).cwiseAbs2());
  }
  return cost;
}

// sum_v (x_v - mean)^2 = x' (I - 11' / n) x; the mean itself drops out of the derivative.
void AddSimilarity(std::span<const AdjustedView> views,
                   std::span<const CameraSimilarity> alike,
                   std::span<const int> at,
                   Eigen::MatrixXd* A,
                   Eigen::VectorXd* b) {
  for (const CameraSimilarity& a : alike) {
    const Eigen::Vector4d mean = Mean(views, a), w = Weights(a);
    const double share = 1.0 / static_cast<double>(a.views.size());
    for (const int v : a.views) {
      A->diagonal().segment<4>(at[v]) += w;
      for (const int u : a.views) A->block<4, 4>(at[v], at[u]).diagonal() -= share * w;
      if (b != nullptr) b->segment<4>(at[v]) += w.cwiseProduct(Intrinsics(views[v].camera) - mean);
    }
  }
}

}  // namespace horopter
