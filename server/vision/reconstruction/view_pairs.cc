#include "server/vision/reconstruction/view_pairs.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>
#include <random>

#include "server/vision/geometry/fundamental_matrix.h"
#include "server/vision/matching/homography.h"

namespace horopter {
namespace {

constexpr int kScored = 400;  // matches that judge a hypothesis; more of them only cost time
constexpr int kHomographyTrials = 30;   // draws that look for one plane behind a pair; for time
constexpr int kHomographyRefits = 3;    // of a draw to what fits it
constexpr double kOffPlaneChi2 = 13.8;  // 2 degrees of freedom, 99.9 %
// Where no F can be estimated: share of the matches that a homography must explain to blame it.
constexpr double kOnPlaneShare = 0.9;
constexpr double kParallaxCap = 50.0;  // sigmas
constexpr int kStopEvery = 64;         // iterations between questions to the caller

struct Matches {
  std::vector<Eigen::Vector2d> a, b;
  std::vector<double> variance;  // mean of both observations
};

// Truncated quadratic cost of a hypothesis over the scored matches; infinite when it exceeds best.
double Score(const Matches& m,
             const std::vector<int>& scored,
             const Eigen::Matrix3d& F,
             double gate2,
             double best) {
  double cost = 0.0;
  for (const int k : scored) {
    const double e = SampsonSquared(F, m.a[k], m.b[k]) / m.variance[k];
    cost += e < gate2 ? e : gate2;  // not a number counts as an outlier
    if (cost >= best) return cost;
  }
  return cost;
}

std::vector<bool> Inliers(const Matches& m, const Eigen::Matrix3d& F, double gate2) {
  std::vector<bool> inlier;
  for (size_t k = 0; k < m.a.size(); ++k) {
    inlier.push_back(SampsonSquared(F, m.a[k], m.b[k]) < gate2 * m.variance[k]);
  }
  return inlier;
}

std::optional<Eigen::Matrix3d> Refit(const Matches& m, const std::vector<bool>& inlier) {
  std::vector<Eigen::Vector2d> a, b;
  for (size_t k = 0; k < m.a.size(); ++k) {
    if (!inlier[k]) continue;
    a.push_back(m.a[k]);
    b.push_back(m.b[k]);
  }
  return EightPoint(a, b);
}

int Below(std::mt19937* rng, int n) {
  return static_cast<int>((*rng)() % static_cast<unsigned>(n));
}

// `count` different numbers below n.
template <size_t count>
std::array<int, count> Sample(std::mt19937* rng, int n) {
  std::array<int, count> out{};
  for (size_t i = 0; i < count; ++i) {
    do {
      out[i] = Below(rng, n);
    } while (std::find(out.begin(), out.begin() + i, out[i]) != out.begin() + i);
  }
  return out;
}

std::optional<Eigen::Matrix3d> Ransac(const Matches& m,
                                      const ViewPairOptions& options,
                                      const StopRequested& stop,
                                      std::mt19937* rng) {
  const int n = static_cast<int>(m.a.size());
  const double gate2 = options.gate_sigma * options.gate_sigma;
  std::vector<int> scored;
  for (int k = 0; k < std::min(n, kScored); ++k) {
    scored.push_back(n <= kScored ? k : Below(rng, n));
  }
  std::optional<Eigen::Matrix3d> best;
  double best_cost = gate2 * static_cast<double>(scored.size());
  double needed = options.max_iterations;
  for (int i = 0; i < std::min<double>(needed, options.max_iterations); ++i) {
    if (i % kStopEvery == 0 && IsStopRequested(stop)) return std::nullopt;
    const auto sample = Sample<7>(rng, n);
    std::array<Eigen::Vector2d, 7> a, b;
    for (int k = 0; k < 7; ++k) {
      a[k] = m.a[sample[k]];
      b[k] = m.b[sample[k]];
    }
    bool improved = false;
    for (const Eigen::Matrix3d& F : SevenPoint(a, b)) {
      const double cost = Score(m, scored, F, gate2, best_cost);
      if (cost >= best_cost) continue;
      best = F;
      best_cost = cost;
      improved = true;
    }
    if (!improved) continue;
    for (int refit = 0; refit < 2; ++refit) {
      const auto F = Refit(m, Inliers(m, *best, gate2));
      if (!F) break;
      const double cost = Score(m, scored, *F, gate2, best_cost);
      if (cost >= best_cost) break;
      best = F;
      best_cost = cost;
    }
    const std::vector<bool> inlier = Inliers(m, *best, gate2);
    const double share = static_cast<double>(std::count(inlier.begin(), inlier.end(), true)) / n;
    const double miss = std::log1p(-std::pow(share, 7.0));
    if (miss < 0.0) needed = std::log(1.0 - options.confidence) / miss;
  }
  return best;
}

// Distance of a match from a homography in sigmas, capped; not a number is far.
double HomographyDistance(const Matches& m, int k, const Eigen::Matrix3d& H) {
  // Noise of a as H carries it over, and noise of b.
  const Eigen::Matrix2d J = TransferJacobian(H, m.a[k]);
  const Eigen::Matrix2d S = m.variance[k] * (J * J.transpose() + Eigen::Matrix2d::Identity());
  const Eigen::Vector2d d = Transfer(H, m.a[k]) - m.b[k];
  const double e = d.dot(S.inverse() * d);
  return e < kParallaxCap * kParallaxCap ? std::sqrt(e) : kParallaxCap;
}

// The collineation that takes the unit points and (1, 1, 1) to four points; nothing when three of
// them are on one line.
std::optional<Eigen::Matrix3d> FromUnitPoints(const std::array<Eigen::Vector2d, 4>& x) {
  Eigen::Matrix3d corners;
  for (int i = 0; i < 3; ++i) corners.col(i) = x[i].homogeneous();
  const Eigen::Vector3d scale = corners.inverse() * x[3].homogeneous();
  const Eigen::Matrix3d H = corners * scale.asDiagonal();
  if (!H.allFinite() || !(scale.cwiseAbs().minCoeff() > 1e-9)) return std::nullopt;
  return H;
}

// How many inliers of F the best of some homographies leaves unexplained, and by how much.
void MeasureParallax(const Matches& m, std::mt19937* rng, ViewPair* pair) {
  std::vector<int> inliers;
  for (size_t k = 0; k < m.a.size(); ++k) {
    if (pair->inlier[k]) inliers.push_back(static_cast<int>(k));
  }
  const int n = static_cast<int>(inliers.size());
  const double gate = std::sqrt(kOffPlaneChi2);
  std::vector<double> best, distance;
  int best_off = n + 1;
  const auto consider = [&](const std::optional<Eigen::Matrix3d>& H) {
    if (!H) return false;
    distance.clear();
    int off = 0;
    for (const int k : inliers) {
      distance.push_back(HomographyDistance(m, k, *H));
      off += distance.back() >= gate;
      if (off >= best_off) return false;
    }
    best_off = off;
    best = distance;
    return true;
  };
  std::vector<PointPair> pairs;
  for (int trial = 0; trial < kHomographyTrials && best_off > 0; ++trial) {
    std::array<Eigen::Vector2d, 4> a, b;
    const auto sample = Sample<4>(rng, n);
    for (int i = 0; i < 4; ++i) {
      a[i] = m.a[inliers[sample[i]]];
      b[i] = m.b[inliers[sample[i]]];
    }
    const auto from_a = FromUnitPoints(a), from_b = FromUnitPoints(b);
    if (!from_a || !from_b) continue;
    bool better = consider(Eigen::Matrix3d(*from_b * from_a->inverse()));
    for (int refit = 0; refit < kHomographyRefits && better; ++refit) {
      pairs.clear();
      for (int k = 0; k < n; ++k) {
        if (best[k] < 2.0 * gate) pairs.push_back({m.a[inliers[k]], m.b[inliers[k]]});
      }
      better = consider(FitHomography(pairs));
    }
  }
  pair->off_homography = std::min(best_off, n);
  for (const double d : best) pair->parallax += d;
}

double MedianMotion(const Matches& m) {
  std::vector<double> motion;
  for (size_t k = 0; k < m.a.size(); ++k) {
    motion.push_back((m.a[k] - m.b[k]).norm() / std::sqrt(m.variance[k]));
  }
  std::nth_element(motion.begin(), motion.begin() + motion.size() / 2, motion.end());
  return motion[motion.size() / 2];
}

}  // namespace

std::vector<ViewPair> EstimateViewPairs(const MultiviewTracks& tracks,
                                        const TrackIndex& index,
                                        const ViewPairOptions& options,
                                        const StopRequested& stop) {
  const int views = static_cast<int>(tracks.sizes.size());
  std::vector<std::vector<int>> observation_of(views, std::vector<int>(tracks.points, -1));
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    observation_of[o.view][o.point] = static_cast<int>(k);
  }
  std::vector<ViewPair> pairs;
  for (int a = 0; a < views; ++a) {
    for (int b = a + 1; b < views; ++b) {
      if (IsStopRequested(stop)) return pairs;
      std::mt19937 rng(options.seed + 977u * static_cast<unsigned>(a * views + b));
      ViewPair pair;
      pair.view_a = a;
      pair.view_b = b;
      Matches m;
      for (const int ka : index.points_in_view[a]) {
        const PointObservation& oa = tracks.point_observations[ka];
        const int kb = observation_of[b][oa.point];
        if (kb < 0) continue;
        const PointObservation& ob = tracks.point_observations[kb];
        pair.matches.push_back({ka, kb});
        m.a.push_back(oa.pixel);
        m.b.push_back(ob.pixel);
        m.variance.push_back(0.5 * (oa.sigma_px * oa.sigma_px + ob.sigma_px * ob.sigma_px));
      }
      if (static_cast<int>(m.a.size()) < std::max(8, options.min_inliers)) continue;
      pair.motion = MedianMotion(m);
      const auto F = Ransac(m, options, stop, &rng);
      if (F) {
        pair.F = *F;
        pair.inlier = Inliers(m, *F, options.gate_sigma * options.gate_sigma);
      } else {
        // Exact duplicates and exact planes: every F of a family fits, and none is found.
        pair.inlier.assign(m.a.size(), true);
      }
      pair.inliers = static_cast<int>(std::count(pair.inlier.begin(), pair.inlier.end(), true));
      if (pair.inliers < options.min_inliers) continue;
      MeasureParallax(m, &rng, &pair);
      if (!F && pair.off_homography > (1.0 - kOnPlaneShare) * pair.inliers) continue;
      if (!F) pair.off_homography = 0;
      pairs.push_back(std::move(pair));
    }
  }
  return pairs;
}

void ScreenObservations(const std::vector<ViewPair>& pairs, ProjectiveScene* scene) {
  std::vector<int> in(scene->point_inlier.size(), 0), out(scene->point_inlier.size(), 0);
  for (const ViewPair& pair : pairs) {
    if (!HasParallax(pair)) continue;
    for (size_t k = 0; k < pair.matches.size(); ++k) {
      for (const int o : pair.matches[k]) ++(pair.inlier[k] ? in : out)[o];
    }
  }
  for (size_t k = 0; k < in.size(); ++k) {
    // A right observation of a point whose other ones are wrong fails too; it is taken back later.
    if (out[k] > 0 && out[k] >= in[k]) scene->point_inlier[k] = false;
  }
}

}  // namespace horopter
