#include "server/vision/matching/pair_geometry.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <opencv2/calib3d.hpp>

#include "server/vision/matching/homography.h"
#include "server/vision/matching/junction_patches.h"

namespace horopter {
namespace {

constexpr int kMinInliersWithoutPlane =
    24;  // 8-17 shared corners of one part are too few for a free F
constexpr double kMaxHomographyShare = 0.6;  // of the inliers of a free F

Eigen::Matrix3d FromCv(const cv::Mat& m) {
  Eigen::Matrix3d e;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) e(r, c) = m.at<double>(r, c);
  }
  return e;
}

cv::UsacParams Magsac(double threshold_px, unsigned seed) {
  cv::UsacParams usac;
  usac.confidence = 0.999;
  usac.isParallel = false;
  usac.maxIterations = 5000;
  usac.randomGeneratorState = static_cast<int>(seed);
  usac.sampler = cv::SAMPLING_UNIFORM;
  usac.score = cv::SCORE_METHOD_MAGSAC;
  usac.loMethod = cv::LOCAL_OPTIM_SIGMA;
  usac.loIterations = 10;
  usac.threshold = threshold_px;
  return usac;
}

// Mutually best candidates only.
std::vector<MatchCandidate> MutualBest(const std::vector<MatchCandidate>& candidates,
                                       int na,
                                       int nb) {
  std::vector<int> best_a(na, -1), best_b(nb, -1);
  const auto offer = [&](int* slot, int k) {
    if (*slot < 0 || candidates[k].likeness > candidates[*slot].likeness) *slot = k;
  };
  for (size_t k = 0; k < candidates.size(); ++k) {
    offer(&best_a[candidates[k].index_a], static_cast<int>(k));
    offer(&best_b[candidates[k].index_b], static_cast<int>(k));
  }
  std::vector<MatchCandidate> mutual;
  for (size_t k = 0; k < candidates.size(); ++k) {
    if (best_a[candidates[k].index_a] == static_cast<int>(k) &&
        best_b[candidates[k].index_b] == static_cast<int>(k)) {
      mutual.push_back(candidates[k]);
    }
  }
  return mutual;
}

// F without a plane.
void EstimateFree(const std::vector<MatchCandidate>& matches,
                  const MatchingOptions& options,
                  PairGeometry* pair) {
  const auto refuse = [&](std::string why) { pair->refusal = "no plane, and " + std::move(why); };
  if (static_cast<int>(matches.size()) < kMinInliersWithoutPlane) {
    return refuse(std::to_string(matches.size()) + " junction matches, need " +
                  std::to_string(kMinInliersWithoutPlane));
  }
  std::vector<cv::Point2d> from, to;
  for (const MatchCandidate& m : matches) {
    from.emplace_back(m.a.x(), m.a.y());
    to.emplace_back(m.b.x(), m.b.y());
  }
  cv::Mat mask, h_mask, F, H;
  std::vector<cv::Point2d> from_in, to_in;
  std::vector<JunctionMatch> inliers;
  try {
    F = cv::findFundamentalMat(from, to, mask, Magsac(options.epipolar_px, options.seed));
    if (F.rows != 3 || F.cols != 3) return refuse("no fundamental matrix");
    for (size_t i = 0; i < matches.size(); ++i) {
      if (!mask.at<unsigned char>(static_cast<int>(i))) continue;
      from_in.push_back(from[i]);
      to_in.push_back(to[i]);
      inliers.push_back({matches[i].index_a, matches[i].index_b});
    }
    if (static_cast<int>(inliers.size()) < kMinInliersWithoutPlane) {
      return refuse(std::to_string(inliers.size()) + " inliers of a fundamental matrix, need " +
                    std::to_string(kMinInliersWithoutPlane));
    }
    H = cv::findHomography(from_in, to_in, h_mask, Magsac(2.0 * options.epipolar_px, options.seed));
  } catch (const cv::Exception&) {
    return refuse("a degenerate configuration");
  }
  const int explained = h_mask.empty() ? 0 : cv::countNonZero(h_mask);
  if (explained > kMaxHomographyShare * static_cast<double>(inliers.size())) {
    return refuse("one homography explains " + std::to_string(explained) + " of " +
                  std::to_string(inliers.size()) + " matches");
  }
  // Chance: a match with an arbitrary partner falls within the band with about this probability.
  const double share = static_cast<double>(inliers.size()) / static_cast<double>(matches.size());
  if (share < 0.6)
    return refuse("only " + std::to_string(static_cast<int>(100 * share)) +
                  " % of the matches agree");
  const Eigen::Matrix3d f = FromCv(F);
  if (!f.allFinite() || f.norm() <= 0.0) return refuse("no finite fundamental matrix");
  pair->F = f / f.norm();
  pair->matches = std::move(inliers);
}

std::vector<std::vector<int>> TopPerRow(const std::vector<MatchCandidate>& all,
                                        int rows,
                                        bool by_a,
                                        int keep) {
  std::vector<std::vector<int>> top(rows);
  for (size_t k = 0; k < all.size(); ++k)
    top[by_a ? all[k].index_a : all[k].index_b].push_back(static_cast<int>(k));
  for (std::vector<int>& row : top) {
    std::stable_sort(
        row.begin(), row.end(), [&](int x, int y) { return all[x].likeness > all[y].likeness; });
    if (static_cast<int>(row.size()) > keep) row.resize(keep);
  }
  return top;
}

}  // namespace

std::vector<MatchCandidate> FindCandidates(const JunctionView& a,
                                           const JunctionView& b,
                                           const std::optional<Eigen::Matrix3d>& b_from_a,
                                           const CandidateOptions& options) {
  const std::vector<Junction>& ja = a.features->junctions;
  const std::vector<Junction>& jb = b.features->junctions;
  const Eigen::Matrix3d H = b_from_a.value_or(Eigen::Matrix3d::Identity());
  const Eigen::Matrix3d H_inverse = H.inverse();
  const std::vector<JunctionPatch> pa = SampleJunctionPatches(*a.image, ja);
  PatchShape shape;
  if (b_from_a) {
    shape = [&](const Eigen::Vector2d& p) { return TransferJacobian(H, Transfer(H_inverse, p)); };
  }
  const std::vector<JunctionPatch> pb = SampleJunctionPatches(*b.image, jb, shape);
  std::vector<Eigen::Vector2d> b_in_a;
  for (const Junction& j : jb) b_in_a.push_back(Transfer(H_inverse, j.point));
  const double max_parallax = options.max_parallax_widths * a.features->width;
  std::vector<MatchCandidate> all;
  for (size_t i = 0; i < ja.size(); ++i) {
    if (pa[i].empty) continue;
    for (size_t k = 0; k < jb.size(); ++k) {
      if (pb[k].empty) continue;
      const double parallax = (b_in_a[k] - ja[i].point).norm();
      if (!(parallax < max_parallax)) continue;
      const double likeness = PatchLikeness(pa[i], pb[k]);
      if (likeness < options.min_likeness) continue;
      all.push_back(
          {static_cast<int>(i), static_cast<int>(k), ja[i].point, jb[k].point, likeness, parallax});
    }
  }
  const auto top_a = TopPerRow(all, static_cast<int>(ja.size()), true, options.per_junction);
  const auto top_b = TopPerRow(all, static_cast<int>(jb.size()), false, options.per_junction);
  std::vector<bool> in_b(all.size(), false);
  for (const auto& row : top_b) {
    for (int k : row) in_b[k] = true;
  }
  std::vector<MatchCandidate> candidates;
  for (const auto& row : top_a) {
    for (int k : row) {
      if (in_b[k]) candidates.push_back(all[k]);
    }
  }
  return candidates;
}

PairGeometry EstimatePairGeometry(int view_a,
                                  int view_b,
                                  const JunctionView& a,
                                  const JunctionView& b,
                                  const std::optional<Eigen::Matrix3d>& b_from_a,
                                  const MatchingOptions& options) {
  PairGeometry pair;
  pair.view_a = view_a;
  pair.view_b = view_b;
  const std::vector<MatchCandidate> candidates = FindCandidates(a, b, b_from_a, {});
  if (!b_from_a) {
    EstimateFree(MutualBest(candidates,
                            static_cast<int>(a.features->junctions.size()),
                            static_cast<int>(b.features->junctions.size())),
                 options,
                 &pair);
    return pair;
  }
  ParallaxOptions parallax;
  parallax.epipolar_px = options.epipolar_px;
  parallax.seed = options.seed;
  ParallaxResult result = EstimatePlaneParallax(*b_from_a, candidates, parallax);
  pair.F = result.F;
  pair.refusal = std::move(result.refusal);
  for (const MatchCandidate& m : result.matches) pair.matches.push_back({m.index_a, m.index_b});
  return pair;
}

}  // namespace horopter
