#include "server/vision/matching/robust_fundamental.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <random>

#include "server/vision/geometry/fundamental_matrix.h"
#include "server/vision/matching/homography.h"

namespace horopter {
namespace {

constexpr int kLocalRounds = 4;          // refits of a good draw (locally optimised RANSAC)
constexpr int kHomographySamples = 300;  // draws that look for one plane behind all; for time

// Sign by which both rays leave the epipoles; the same for all points before both cameras.
bool SideOf(const Eigen::Matrix3d& F, const Eigen::Vector3d& epipole_b, const WeightedMatch& m) {
  return epipole_b.cross(m.b.homogeneous()).dot(F * m.a.homogeneous()) > 0.0;
}

struct Scored {
  double score = 0.0;
  bool side = true;
};

Scored Score(const Eigen::Matrix3d& F, std::span<const WeightedMatch> matches, double limit_px) {
  const Eigen::Vector3d e = EpipoleB(F);
  double total[2] = {0.0, 0.0};
  for (const WeightedMatch& m : matches) {
    const double r = SignedSampson(F, m.a, m.b) / limit_px;
    if (r * r < 1.0) total[SideOf(F, e, m)] += m.weight * (1.0 - r * r);
  }
  return {std::max(total[0], total[1]), total[1] >= total[0]};
}

std::vector<int> InliersOf(const Eigen::Matrix3d& F,
                           bool side,
                           std::span<const WeightedMatch> matches,
                           double limit_px) {
  const Eigen::Vector3d e = EpipoleB(F);
  std::vector<int> inliers;
  for (size_t i = 0; i < matches.size(); ++i) {
    const WeightedMatch& m = matches[i];
    if (std::abs(SignedSampson(F, m.a, m.b)) < limit_px && SideOf(F, e, m) == side)
      inliers.push_back(static_cast<int>(i));
  }
  return inliers;
}

std::vector<WeightedMatch> Select(std::span<const WeightedMatch> matches,
                                  const std::vector<int>& indices) {
  std::vector<WeightedMatch> selected;
  for (int i : indices) selected.push_back(matches[i]);
  return selected;
}

// Off the homography that explains most of the inliers.
int OffHomography(const std::vector<WeightedMatch>& inliers, double limit_px, unsigned seed) {
  const int n = static_cast<int>(inliers.size());
  std::mt19937 rng(seed);
  int most = 0;
  for (int h = 0; h < kHomographySamples; ++h) {
    std::array<PointPair, 4> sample;
    std::array<int, 4> index{};
    for (int k = 0; k < 4; ++k) {
      index[k] = static_cast<int>(rng() % n);
      sample[k] = {inliers[index[k]].a, inliers[index[k]].b};
    }
    std::sort(index.begin(), index.end());
    if (std::adjacent_find(index.begin(), index.end()) != index.end()) continue;
    auto H = FitHomography(sample);
    for (int round = 0; H && round < 2; ++round) {
      const Eigen::Matrix3d inverse = H->inverse();
      std::vector<PointPair> near;
      for (const WeightedMatch& m : inliers) {
        const PointPair pair{m.a, m.b};
        if (SymmetricTransferError(*H, inverse, pair) < limit_px) near.push_back(pair);
      }
      if (static_cast<int>(near.size()) <= most) break;
      if (round == 1) most = static_cast<int>(near.size());
      if (round == 0) H = near.size() > 4 ? FitHomography(near) : H;
    }
  }
  return n - most;
}

class Search {
 public:
  Search(std::span<const WeightedMatch> matches, const RobustFundamentalOptions& options)
      : matches_(matches), options_(options), order_(matches.size()), rng_(options.seed) {
    std::iota(order_.begin(), order_.end(), 0);
    std::stable_sort(order_.begin(), order_.end(), [&](int i, int j) {
      return matches[i].weight > matches[j].weight;
    });
  }

  bool Run() {
    for (int h = 0; h < options_.hypotheses; ++h) {
      std::array<Eigen::Vector2d, 7> a, b;
      if (!Draw(&a, &b)) continue;
      for (const Eigen::Matrix3d& F : SevenPoint(a, b)) {
        const Scored scored = Score(F, matches_, options_.inlier_px);
        if (scored.score <= best_.score) continue;
        best_ = scored;
        best_F_ = F;
        Optimize();
      }
    }
    return best_.score > 0.0;
  }

  const Eigen::Matrix3d& F() const { return best_F_; }
  bool side() const { return best_.side; }

 private:
  bool Draw(std::array<Eigen::Vector2d, 7>* a, std::array<Eigen::Vector2d, 7>* b) {
    std::array<int, 7> index{};
    for (int k = 0; k < 7; ++k) {
      // Squared uniform: likely matches are drawn more often.
      const double u = static_cast<double>(rng_()) / 4294967296.0;
      index[k] = order_[static_cast<size_t>(u * std::sqrt(u) * static_cast<double>(order_.size()))];
      (*a)[k] = matches_[index[k]].a;
      (*b)[k] = matches_[index[k]].b;
    }
    std::sort(index.begin(), index.end());
    return std::adjacent_find(index.begin(), index.end()) == index.end();
  }

  // Least squares over the inliers as long as that helps.
  void Optimize() {
    for (int round = 0; round < kLocalRounds; ++round) {
      const std::vector<WeightedMatch> inliers =
          Select(matches_, InliersOf(best_F_, best_.side, matches_, options_.inlier_px));
      if (inliers.size() < 8) return;
      const Eigen::Matrix3d F = RefineFundamental(best_F_, inliers, 1.0).F;
      const Scored scored = Score(F, matches_, options_.inlier_px);
      if (scored.score <= best_.score) return;
      best_ = scored;
      best_F_ = F;
    }
  }

  std::span<const WeightedMatch> matches_;
  const RobustFundamentalOptions& options_;
  std::vector<int> order_;
  std::mt19937 rng_;
  Scored best_;
  Eigen::Matrix3d best_F_ = Eigen::Matrix3d::Zero();
};

}  // namespace

RobustFundamental EstimateFundamental(std::span<const WeightedMatch> matches,
                                      const RobustFundamentalOptions& options) {
  RobustFundamental result;
  const auto refuse = [&](std::string why) {
    result.refusal = std::move(why);
    return result;
  };
  const int needed = std::max(8, options.min_inliers);
  const int n = static_cast<int>(matches.size());
  if (n < needed) return refuse(std::to_string(n) + " matches, need " + std::to_string(needed));
  for (const WeightedMatch& m : matches) {
    if (!m.a.allFinite() || !m.b.allFinite() || !(m.weight > 0.0))
      return refuse("a match is not finite");
  }
  // Before a plane or without motion seven points determine nothing, and any F or none may come
  // out.
  const auto refuse_without_F = [&](std::string why) {
    const std::vector<WeightedMatch> all(matches.begin(), matches.end());
    const int planar = n - OffHomography(all, options.homography_px, options.seed);
    if (planar >= needed && planar > (1.0 - options.min_off_homography_share) * n)
      why = "no parallax: one homography explains " + std::to_string(planar) + " of " +
            std::to_string(n) + " matches";
    return refuse(std::move(why));
  };
  Search search(matches, options);
  if (!search.Run()) return refuse_without_F("no fundamental matrix agrees with any match");
  Eigen::Matrix3d F = search.F();
  RefinedFundamental refined;
  for (int round = 0; round < 2; ++round) {
    result.inliers = InliersOf(F, search.side(), matches, options.inlier_px);
    if (static_cast<int>(result.inliers.size()) < needed) break;
    refined = RefineFundamental(F, Select(matches, result.inliers), 1.0);
    F = refined.F;
  }
  const int inliers = static_cast<int>(result.inliers.size());
  const int agreeing = std::max(needed, static_cast<int>(std::ceil(options.min_share * n)));
  if (inliers < agreeing)
    return refuse_without_F(std::to_string(inliers) + " of " + std::to_string(n) +
                            " matches agree, need " + std::to_string(agreeing));
  const std::vector<WeightedMatch> selected = Select(matches, result.inliers);
  result.off_homography = OffHomography(selected, options.homography_px, options.seed);
  const int off_needed =
      std::max(options.min_off_homography,
               static_cast<int>(std::ceil(options.min_off_homography_share * inliers)));
  if (result.off_homography < off_needed)
    return refuse("no parallax: one homography explains all but " +
                  std::to_string(result.off_homography) + " of " + std::to_string(inliers) +
                  " matches, need " + std::to_string(off_needed));
  result.sigma_px = *std::max_element(refined.line_sigma_px.begin(), refined.line_sigma_px.end());
  if (!(result.sigma_px <= options.max_sigma_px)) {
    char text[96];
    std::snprintf(text,
                  sizeof(text),
                  "epipolar lines uncertain by %.1f px, need %.2f px",
                  std::min(result.sigma_px, 999.0),
                  options.max_sigma_px);
    return refuse(text);
  }
  result.F = F;
  return result;
}

}  // namespace horopter
