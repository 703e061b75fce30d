#include "server/vision/matching/plane_chain.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <tuple>
#include <utility>

#include "server/vision/matching/homography.h"

namespace horopter {
namespace {

constexpr double kUnitPx =
    300.0;  // pixels per unit of the refinement's coordinates: entries of order 1
constexpr double kHalfWeightPx = 1.0;  // residual at which a match has lost half its weight
constexpr int kMaxPairsPerLink = 400;  // matches of one link used by the refinement
constexpr int kMaxIterations = 15;     // Gauss-Newton steps at most

double MedianTransferError(const PlaneHomography& plane, const Eigen::Matrix3d& b_from_a) {
  if (plane.inliers_a.empty()) return 1e30;
  std::vector<double> errors;
  for (size_t i = 0; i < plane.inliers_a.size(); ++i) {
    const double e = (plane.inliers_b[i] - Transfer(b_from_a, plane.inliers_a[i])).norm();
    errors.push_back(std::isfinite(e) ? e : 1e30);
  }
  std::nth_element(errors.begin(), errors.begin() + errors.size() / 2, errors.end());
  return errors[errors.size() / 2];
}

// Joins links into components, surest first: confirmed by a triangle, then by number of inliers.
void JoinLinks(std::span<const PlaneHomography> planes, double max_px, PlaneChain* chain) {
  const int views = static_cast<int>(chain->component.size());
  std::vector<int> closed(planes.size(), 0);
  for (const auto& triangle : ClosedTriangles(planes, max_px)) ++closed[triangle[0]];
  std::vector<int> order(planes.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    const auto key = [&](int k) {
      return std::make_tuple(std::min(closed[k], 2), planes[k].inliers_a.size());
    };
    return key(a) > key(b);
  });
  // Union of components; the maps of a component are relative to an arbitrary member until the end.
  std::vector<int> root(views);
  std::iota(root.begin(), root.end(), 0);
  std::vector<bool> touched(views, false);
  chain->consistent.assign(planes.size(), true);
  for (int k : order) {
    const PlaneHomography& p = planes[k];
    std::vector<Eigen::Matrix3d>& maps = chain->view_from_plane;
    if (root[p.view_a] == root[p.view_b]) {
      const Eigen::Matrix3d chained = maps[p.view_b] * maps[p.view_a].inverse();
      if (MedianTransferError(p, chained) < max_px) continue;
      chain->consistent[k] = false;
      ++chain->contradicted;
      continue;
    }
    touched[p.view_a] = touched[p.view_b] = true;
    const Eigen::Matrix3d plane_from_plane_b =
        maps[p.view_a].inverse() * p.b_from_a.inverse() * maps[p.view_b];
    const int old_root = root[p.view_b];
    for (int v = 0; v < views; ++v) {
      if (root[v] != old_root) continue;
      maps[v] = maps[v] * plane_from_plane_b.inverse();
      root[v] = root[p.view_a];
    }
  }
  std::map<int, int> ids;
  for (int v = 0; v < views; ++v) {
    if (touched[v])
      chain->component[v] = ids.emplace(root[v], static_cast<int>(ids.size())).first->second;
  }
}

// Makes the first view of every component the plane's coordinate system and all determinants 1.
void FixGauge(PlaneChain* chain) {
  std::map<int, Eigen::Matrix3d> plane_from_first;
  for (size_t v = 0; v < chain->component.size(); ++v) {
    Eigen::Matrix3d& map = chain->view_from_plane[v];
    if (chain->component[v] < 0) {
      map.setIdentity();
      continue;
    }
    const auto [it, first] = plane_from_first.emplace(chain->component[v], map.inverse());
    map = first ? Eigen::Matrix3d::Identity().eval()
                : NormalizeDeterminant(map * it->second).value_or(Eigen::Matrix3d::Identity());
  }
}

// Gauss-Newton over H_v <- (I + D_v) H_v (D with 8 free entries) of all views but each component's
// first. With y = M a, M = H_b H_a^-1: dy = D_b y - M D_a a.
class ChainRefinement {
 public:
  ChainRefinement(std::span<const PlaneHomography> planes, PlaneChain* chain) : chain_(chain) {
    scale_ = Eigen::Vector3d(1.0 / kUnitPx, 1.0 / kUnitPx, 1.0).asDiagonal();
    for (size_t v = 0; v < chain->component.size(); ++v) {
      maps_.push_back(scale_ * chain->view_from_plane[v]);
      const auto first =
          std::find(chain->component.begin(), chain->component.end(), chain->component[v]);
      const bool fixed =
          chain->component[v] < 0 || first - chain->component.begin() == static_cast<long>(v);
      block_.push_back(fixed ? -1 : unknowns_);
      if (!fixed) unknowns_ += 8;
    }
    for (size_t k = 0; k < planes.size(); ++k) {
      if (!chain->consistent[k]) continue;
      const PlaneHomography& p = planes[k];
      const size_t step = 1 + p.inliers_a.size() / kMaxPairsPerLink;
      for (size_t i = 0; i < p.inliers_a.size(); i += step) {
        matches_.push_back(
            {p.view_a, p.view_b, p.inliers_a[i] / kUnitPx, p.inliers_b[i] / kUnitPx});
      }
    }
  }

  void Run() {
    double cost = Cost(maps_);
    for (int iteration = 0; iteration < kMaxIterations && unknowns_ > 0; ++iteration) {
      const Eigen::VectorXd step = Step();
      if (!step.allFinite()) break;
      std::vector<Eigen::Matrix3d> next = maps_;
      for (size_t v = 0; v < maps_.size(); ++v) {
        if (block_[v] < 0) continue;
        Eigen::Matrix3d D = Eigen::Matrix3d::Zero();
        for (int e = 0; e < 8; ++e) D(e / 3, e % 3) = step(block_[v] + e);
        next[v] = (Eigen::Matrix3d::Identity() + D) * maps_[v];
      }
      const double next_cost = Cost(next);
      if (!(next_cost < cost)) break;
      const bool converged = cost - next_cost < 1e-8 * cost;
      maps_ = next;
      cost = next_cost;
      if (converged) break;
    }
    for (size_t v = 0; v < maps_.size(); ++v) {
      chain_->view_from_plane[v] = scale_.inverse() * maps_[v];
    }
    chain_->rms_px = Rms();
  }

 private:
  struct Match {
    int view_a, view_b;
    Eigen::Vector2d a, b;
  };

  static double Loss(double squared) {
    const double c2 = kHalfWeightPx * kHalfWeightPx / (kUnitPx * kUnitPx);
    return c2 * std::log1p(squared / c2);
  }
  static double Weight(double squared) {
    return 1.0 / (1.0 + squared * kUnitPx * kUnitPx / (kHalfWeightPx * kHalfWeightPx));
  }

  double Cost(const std::vector<Eigen::Matrix3d>& maps) const {
    std::vector<Eigen::Matrix3d> inverse;
    for (const Eigen::Matrix3d& m : maps) inverse.push_back(m.inverse());
    double sum = 0.0;
    for (const Match& m : matches_) {
      sum += Loss((m.b - Transfer(maps[m.view_b] * inverse[m.view_a], m.a)).squaredNorm());
    }
    return std::isfinite(sum) ? sum : 1e300;
  }

  double Rms() const {
    double sum = 0.0;
    for (const Match& m : matches_) {
      sum += (m.b - Transfer(maps_[m.view_b] * maps_[m.view_a].inverse(), m.a)).squaredNorm();
    }
    return matches_.empty() ? 0.0 : kUnitPx * std::sqrt(sum / static_cast<double>(matches_.size()));
  }

  Eigen::VectorXd Step() const {
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(unknowns_, unknowns_);
    Eigen::VectorXd g = Eigen::VectorXd::Zero(unknowns_);
    for (const Match& m : matches_) {
      const Eigen::Matrix3d M = maps_[m.view_b] * maps_[m.view_a].inverse();
      const Eigen::Vector3d a = m.a.homogeneous();
      const Eigen::Vector3d y = M * a;
      const Eigen::Vector2d p = y.head<2>() / y.z();
      const Eigen::Vector2d e = m.b - p;
      Eigen::Matrix<double, 2, 3> dp_dy;
      dp_dy << 1.0 / y.z(), 0, -p.x() / y.z(), 0, 1.0 / y.z(), -p.y() / y.z();
      Eigen::Matrix<double, 2, 8> Ja, Jb;
      const Eigen::Matrix<double, 2, 3> dp_dM = -dp_dy * M;
      for (int k = 0; k < 8; ++k) {
        Jb.col(k) = dp_dy.col(k / 3) * y(k % 3);
        Ja.col(k) = dp_dM.col(k / 3) * a(k % 3);
      }
      const double w = Weight(e.squaredNorm());
      const int ia = block_[m.view_a], ib = block_[m.view_b];
      if (ia >= 0) {
        A.block<8, 8>(ia, ia) += w * Ja.transpose() * Ja;
        g.segment<8>(ia) += w * Ja.transpose() * e;
      }
      if (ib >= 0) {
        A.block<8, 8>(ib, ib) += w * Jb.transpose() * Jb;
        g.segment<8>(ib) += w * Jb.transpose() * e;
      }
      if (ia >= 0 && ib >= 0) {
        A.block<8, 8>(ia, ib) += w * Ja.transpose() * Jb;
        A.block<8, 8>(ib, ia) += w * Jb.transpose() * Ja;
      }
    }
    A.diagonal() *= 1.0 + 1e-9;
    return A.ldlt().solve(g);
  }

  PlaneChain* chain_;
  Eigen::Matrix3d scale_;
  std::vector<Eigen::Matrix3d> maps_;  // unit coordinates from plane
  std::vector<int> block_;             // first unknown of a view, -1: fixed
  int unknowns_ = 0;
  std::vector<Match> matches_;
};

}  // namespace

std::vector<std::array<size_t, 3>> ClosedTriangles(std::span<const PlaneHomography> planes,
                                                   double max_px) {
  std::map<std::pair<int, int>, size_t> link;
  for (size_t k = 0; k < planes.size(); ++k) link[{planes[k].view_a, planes[k].view_b}] = k;
  const auto index_of = [&](int x, int y) { return link.find(std::minmax(x, y)); };
  const auto map_between = [&](size_t k, int from) {
    return planes[k].view_a == from ? planes[k].b_from_a : planes[k].b_from_a.inverse().eval();
  };
  int views = 0;
  for (const PlaneHomography& p : planes) views = std::max({views, p.view_a + 1, p.view_b + 1});
  std::vector<std::array<size_t, 3>> closed;
  for (size_t k = 0; k < planes.size(); ++k) {
    const PlaneHomography& p = planes[k];
    for (int c = 0; c < views; ++c) {
      if (c == p.view_a || c == p.view_b) continue;
      const auto i = index_of(p.view_a, c), j = index_of(c, p.view_b);
      if (i == link.end() || j == link.end()) continue;
      const Eigen::Matrix3d around = map_between(j->second, c) * map_between(i->second, p.view_a);
      if (MedianTransferError(p, around) < max_px) closed.push_back({k, i->second, j->second});
    }
  }
  return closed;
}

PlaneChain ChainPlanes(std::span<const PlaneHomography> planes, int views, double max_px) {
  PlaneChain chain;
  chain.component.assign(views, -1);
  chain.view_from_plane.assign(views, Eigen::Matrix3d::Identity());
  JoinLinks(planes, max_px, &chain);
  FixGauge(&chain);
  ChainRefinement(planes, &chain).Run();
  FixGauge(&chain);
  return chain;
}

}  // namespace horopter
