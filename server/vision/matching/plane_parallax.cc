#include "server/vision/matching/plane_parallax.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <random>
#include <set>

#include "server/base/stop_scope.h"
#include "server/vision/geometry/plucker_line.h"
#include "server/vision/matching/homography.h"

namespace horopter {
namespace {

constexpr double kSphereUnitPx =
    300.0;  // pixels per unit of the epipole's sphere: a well spread parametrisation
constexpr size_t kMaxScored = 800;           // candidates scored per hypothesis, likeliest first
constexpr double kMinJunctionSigmaPx = 0.4;  // a junction is not known better than this

struct Frame {
  Eigen::Matrix3d H;  // determinant 1: w > 0 on the seen side
  Eigen::Matrix3d H_inverse;
};

// A candidate with its transferred point; only off-plane ones vote for an epipole.
struct Vote {
  const MatchCandidate* candidate = nullptr;
  Eigen::Vector3d Ha = Eigen::Vector3d::Zero();  // unit coordinates of view b, third entry 1
  Eigen::Vector3d b = Eigen::Vector3d::Zero();   // unit coordinates, third entry 1
  double weight = 0.0;
};

Eigen::Vector3d Unit(const Eigen::Vector2d& x) {
  return {x.x() / kSphereUnitPx, x.y() / kSphereUnitPx, 1.0};
}

// Signed distance (px) of b from the line through Ha and the epipole.
double LineDistance(const Vote& v, const Eigen::Vector3d& e) {
  const Eigen::Vector3d l = e.cross(v.Ha);
  const double n = l.head<2>().norm();
  return n > 1e-12 ? kSphereUnitPx * l.dot(v.b) / n : 1e9;
}

// Side of the plane: lambda b = Ha + rho e has rho of this sign (0: cannot say).
int SideOfEpipole(const Vote& v, const Eigen::Vector3d& e) {
  const double s = -v.b.cross(v.Ha).dot(v.b.cross(e));
  return s > 0.0 ? 1 : (s < 0.0 ? -1 : 0);
}

struct Support {
  double score = 0.0;
  int side = 1;
};

// Sum over the junctions of view a of their best consistent candidate; candidates are grouped by
// junction a.
Support ScoreEpipole(const std::vector<Vote>& votes, const Eigen::Vector3d& e, double max_px) {
  double total[2] = {0.0, 0.0};
  double best[2] = {0.0, 0.0};
  int current = -1;
  const auto flush = [&] {
    for (int s = 0; s < 2; ++s) {
      total[s] += best[s];
      best[s] = 0.0;
    }
  };
  for (const Vote& v : votes) {
    if (v.candidate->index_a != current) {
      flush();
      current = v.candidate->index_a;
    }
    const double r = LineDistance(v, e) / max_px;
    if (!(r * r < 1.0)) continue;
    const int side = SideOfEpipole(v, e);
    if (side == 0) continue;
    double& slot = best[side > 0 ? 1 : 0];
    slot = std::max(slot, v.weight * (1.0 - r * r));
  }
  flush();
  return total[1] >= total[0] ? Support{total[1], 1} : Support{total[0], -1};
}

struct Inlier {
  Vote vote;
  double residual_px = 0.0;
};

// One-to-one consistent candidates, likeliest first.
std::vector<Inlier> CollectInliers(const std::vector<Vote>& votes,
                                   const Eigen::Vector3d& e,
                                   int side,
                                   double max_px) {
  std::vector<Inlier> consistent;
  for (const Vote& v : votes) {
    const double r = LineDistance(v, e);
    if (std::abs(r) < max_px && SideOfEpipole(v, e) == side) consistent.push_back({v, r});
  }
  std::stable_sort(consistent.begin(), consistent.end(), [](const Inlier& x, const Inlier& y) {
    return x.vote.weight > y.vote.weight;
  });
  std::set<int> used_a, used_b;
  std::vector<Inlier> inliers;
  for (const Inlier& i : consistent) {
    const MatchCandidate& c = *i.vote.candidate;
    if (used_a.count(c.index_a) || used_b.count(c.index_b)) continue;
    used_a.insert(c.index_a);
    used_b.insert(c.index_b);
    inliers.push_back(i);
  }
  return inliers;
}

Eigen::Matrix<double, 3, 2> TangentBasis(const Eigen::Vector3d& e) {
  const Eigen::Vector3d axis =
      std::abs(e.z()) < 0.9 ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitX();
  Eigen::Matrix<double, 3, 2> T;
  T.col(0) = e.cross(axis).normalized();
  T.col(1) = e.cross(T.col(0)).normalized();
  return T;
}

struct Refinement {
  Eigen::Vector3d epipole = Eigen::Vector3d::Zero();
  double sigma_px = 1e9;  // largest predicted deviation of an epipolar line at an inlier
};

// Gauss-Newton on the sphere with Cauchy weights.
Refinement RefineEpipole(const std::vector<Inlier>& inliers, Eigen::Vector3d e) {
  Eigen::Matrix2d A = Eigen::Matrix2d::Zero();
  double weighted = 0.0, weights = 0.0;
  for (int iteration = 0; iteration < 8; ++iteration) {
    const Eigen::Matrix<double, 3, 2> T = TangentBasis(e);
    A.setZero();
    Eigen::Vector2d g = Eigen::Vector2d::Zero();
    weighted = weights = 0.0;
    for (const Inlier& i : inliers) {
      constexpr double kStep = 1e-6;  // of a numerical derivative; the epipole has unit norm
      const double r = LineDistance(i.vote, e);
      Eigen::RowVector2d J;
      for (int k = 0; k < 2; ++k) J(k) = (LineDistance(i.vote, e + kStep * T.col(k)) - r) / kStep;
      const double w = 1.0 / (1.0 + r * r);
      A += w * J.transpose() * J;
      g -= w * J.transpose() * r;
      weighted += w * r * r;
      weights += w;
    }
    A.diagonal().array() += 1e-12 * A.trace() + 1e-12;
    const Eigen::Vector2d step = A.ldlt().solve(g);
    if (!step.allFinite()) break;
    const double length = step.norm();
    e = (e + T * (length > 0.3 ? step * (0.3 / length) : step)).normalized();
    if (length < 1e-9) break;
  }
  Refinement result;
  result.epipole = e;
  if (inliers.size() < 3) return result;
  const double freedom = std::max(1.0, weights * (1.0 - 2.0 / static_cast<double>(inliers.size())));
  const double variance = std::max(kMinJunctionSigmaPx * kMinJunctionSigmaPx, weighted / freedom);
  const Eigen::Matrix2d C = variance * A.inverse();
  const Eigen::Matrix<double, 3, 2> T = TangentBasis(e);
  double worst = 0.0;
  for (const Inlier& i : inliers) {
    Eigen::RowVector2d J;
    const double r = LineDistance(i.vote, e);
    for (int k = 0; k < 2; ++k) J(k) = (LineDistance(i.vote, e + 1e-6 * T.col(k)) - r) / 1e-6;
    worst = std::max(worst, (J * C * J.transpose())(0));
  }
  result.sigma_px = std::isfinite(worst) ? std::sqrt(worst) : 1e9;
  return result;
}

std::vector<Vote> MakeVotes(const Frame& frame,
                            std::span<const MatchCandidate> candidates,
                            const ParallaxOptions& options) {
  // A junction whose likeliest candidate does not move with respect to the plane lies on the plane.
  std::map<int, const MatchCandidate*> best;
  for (const MatchCandidate& c : candidates) {
    const auto [it, added] = best.emplace(c.index_a, &c);
    if (!added && c.similarity > it->second->similarity) it->second = &c;
  }
  std::vector<Vote> votes;
  for (const MatchCandidate& c : candidates) {
    if (c.parallax_px <= options.on_plane_px) continue;
    if (best.at(c.index_a)->parallax_px <= options.on_plane_px) continue;
    const Eigen::Vector3d y = frame.H * Eigen::Vector3d(c.a.x(), c.a.y(), 1.0);
    if (!(y.z() > 0.0)) continue;
    votes.push_back({&c, Unit(y.head<2>() / y.z()), Unit(c.b), std::max(0.05, c.similarity)});
  }
  return votes;
}

// Expected number of junctions that support a random epipole: each candidate falls into the band
// with the probability band / range of directions, half of them on the right side.
double ExpectedByChance(const std::vector<Vote>& votes, double max_px) {
  std::map<int, double> miss;
  for (const Vote& v : votes) {
    const double parallax = std::max(max_px, v.candidate->parallax_px);
    // The direction of the displacement must agree within +-asin(band / parallax), of a full turn.
    const double p = std::asin(std::min(1.0, max_px / parallax)) / M_PI;
    const auto [it, added] = miss.emplace(v.candidate->index_a, 1.0);
    it->second *= 1.0 - p;
  }
  double expected = 0.0;
  for (const auto& [unused, m] : miss) expected += 1.0 - m;
  return expected;
}

Support SearchEpipole(const std::vector<Vote>& votes,
                      const ParallaxOptions& options,
                      Eigen::Vector3d* best) {
  std::vector<Vote> scored = votes;
  std::stable_sort(scored.begin(), scored.end(), [](const Vote& x, const Vote& y) {
    return x.weight > y.weight;
  });
  if (scored.size() > kMaxScored) scored.resize(kMaxScored);
  const std::vector<Vote> by_weight = scored;
  std::stable_sort(scored.begin(), scored.end(), [](const Vote& x, const Vote& y) {
    return x.candidate->index_a < y.candidate->index_a;
  });
  std::mt19937 rng(options.seed);
  Support support;
  const auto draw = [&] {
    // Squared uniform: likely candidates are drawn more often.
    const double u = static_cast<double>(rng()) / 4294967296.0;
    return static_cast<size_t>(u * u * static_cast<double>(by_weight.size()));
  };
  for (int h = 0; h < options.hypotheses; ++h) {
    LeaveIfStopped();
    const Vote& v = by_weight[draw()];
    const Vote& w = by_weight[draw()];
    if (v.candidate->index_a == w.candidate->index_a ||
        v.candidate->index_b == w.candidate->index_b)
      continue;
    Eigen::Vector3d e = v.Ha.cross(v.b).cross(w.Ha.cross(w.b));
    const double norm = e.norm();
    if (norm < 1e-12) continue;
    e /= norm;
    const Support s = ScoreEpipole(scored, e, options.epipolar_px);
    if (s.score > support.score) {
      support = s;
      *best = e;
    }
  }
  return support;
}

void AppendOnPlane(std::span<const MatchCandidate> candidates,
                   const ParallaxOptions& options,
                   std::vector<MatchCandidate>* matches) {
  std::set<int> used_a, used_b;
  for (const MatchCandidate& m : *matches) {
    used_a.insert(m.index_a);
    used_b.insert(m.index_b);
  }
  std::vector<const MatchCandidate*> on_plane;
  for (const MatchCandidate& c : candidates) {
    if (c.parallax_px <= options.on_plane_px) on_plane.push_back(&c);
  }
  std::stable_sort(
      on_plane.begin(), on_plane.end(), [](const MatchCandidate* x, const MatchCandidate* y) {
        return x->similarity > y->similarity;
      });
  for (const MatchCandidate* c : on_plane) {
    if (used_a.count(c->index_a) || used_b.count(c->index_b)) continue;
    used_a.insert(c->index_a);
    used_b.insert(c->index_b);
    matches->push_back(*c);
  }
}

}  // namespace

ParallaxResult EstimatePlaneParallax(const Eigen::Matrix3d& b_from_a,
                                     std::span<const MatchCandidate> candidates,
                                     const ParallaxOptions& options) {
  ParallaxResult result;
  const std::optional<Eigen::Matrix3d> H = NormalizeDeterminant(b_from_a);
  if (!H) {
    result.refusal = "singular plane homography";
    return result;
  }
  const Frame frame{*H, H->inverse()};
  const std::vector<Vote> votes = MakeVotes(frame, candidates, options);
  std::set<int> voters;
  for (const Vote& v : votes) voters.insert(v.candidate->index_a);
  AppendOnPlane(candidates, options, &result.matches);
  if (static_cast<int>(voters.size()) < options.min_off_plane) {
    result.refusal = "no parallax: " + std::to_string(voters.size()) +
                     " junctions off the plane, need " + std::to_string(options.min_off_plane);
    return result;
  }
  Eigen::Vector3d e = Eigen::Vector3d::Zero();
  const Support support = SearchEpipole(votes, options, &e);
  if (e.isZero()) {
    result.refusal = "no parallax: no two displacements define an epipole";
    return result;
  }
  std::vector<Inlier> inliers;
  Refinement refined;
  refined.epipole = e;
  for (int round = 0; round < 4; ++round) {
    inliers = CollectInliers(votes, refined.epipole, support.side, options.epipolar_px);
    if (inliers.size() < 2) break;
    refined = RefineEpipole(inliers, refined.epipole);
  }
  result.off_plane = static_cast<int>(inliers.size());
  const double expected = ExpectedByChance(votes, options.epipolar_px);
  const double needed = std::max({static_cast<double>(options.min_off_plane),
                                  options.min_surprise * expected,
                                  options.min_share * static_cast<double>(voters.size())});
  char text[160];
  if (result.off_plane < needed) {
    std::snprintf(
        text,
        sizeof(text),
        "%d of %zu off-plane junctions agree on one epipole, %.1f expected by chance, need %.0f",
        result.off_plane,
        voters.size(),
        expected,
        std::ceil(needed));
    result.refusal = text;
    return result;
  }
  if (refined.sigma_px > options.max_sigma_px) {
    std::snprintf(text,
                  sizeof(text),
                  "epipolar lines uncertain by %.1f px from %d off-plane matches, need %.2f px",
                  std::min(refined.sigma_px, 999.0),
                  result.off_plane,
                  options.max_sigma_px);
    result.refusal = text;
    return result;
  }
  result.epipole_b = {refined.epipole.x() * kSphereUnitPx,
                      refined.epipole.y() * kSphereUnitPx,
                      refined.epipole.z()};
  result.epipole_b.normalize();
  const Eigen::Matrix3d F = CrossMatrix(result.epipole_b) * frame.H;
  result.F = F / F.norm();
  result.matches.clear();
  for (const Inlier& i : inliers) result.matches.push_back(*i.vote.candidate);
  AppendOnPlane(candidates, options, &result.matches);
  return result;
}

}  // namespace horopter
