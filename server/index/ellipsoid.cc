#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "server/index/box_kernels.h"
#include "server/index/walk.h"

namespace horopter {

using index_internal::ForEachMeeting;
using index_internal::Node;
using index_internal::Scratch;
using index_internal::Walk;

namespace {

constexpr int kMaxTriangle = kMaxDimensions * (kMaxDimensions + 1) / 2;

// Row by row, the lower triangle of L^-1 with covariance = L L': y = L^-1 (x - c) makes the
// ellipsoid a ball. By hand, as a library's dynamic matrices cost more than a small query. False
// when the covariance is not positive definite.
bool InvertedCholesky(const Eigen::MatrixXd& covariance, double* inverse) {
  const int n = static_cast<int>(covariance.rows());
  double factor[kMaxTriangle];
  const auto at = [](int r, int c) { return r * (r + 1) / 2 + c; };
  for (int r = 0; r < n; ++r) {
    for (int c = 0; c <= r; ++c) {
      double sum = covariance(r, c);
      for (int k = 0; k < c; ++k) sum -= factor[at(r, k)] * factor[at(c, k)];
      if (r != c) {
        factor[at(r, c)] = sum / factor[at(c, c)];
        continue;
      }
      if (!(sum > 0.0) || !std::isfinite(sum)) return false;
      factor[at(r, r)] = std::sqrt(sum);
    }
  }
  for (int r = 0; r < n; ++r) {
    for (int c = 0; c < r; ++c) {
      double sum = 0.0;
      for (int k = c; k < r; ++k) sum -= factor[at(r, k)] * inverse[at(k, c)];
      inverse[at(r, c)] = sum / factor[at(r, r)];
    }
    inverse[at(r, r)] = 1.0 / factor[at(r, r)];
  }
  return true;
}

// The ellipsoid as a ball of whitened coordinates, and its bounding box.
struct WhitenedBall {
  WhitenedBall(const Ellipsoid& ellipsoid, const double* whitening)
      : n(static_cast<int>(ellipsoid.center.size())),
        gate(ellipsoid.gate),
        center(ellipsoid.center.data()),
        whiten(whitening) {
    // A hair wider than exact: rounding must not lose what the exact test would accept.
    for (int d = 0; d < n; ++d) {
      const double half = std::sqrt(ellipsoid.covariance(d, d) * gate) * (1.0 + 1e-12);
      low[d] = center[d] - half;
      high[d] = center[d] + half;
    }
  }

  // By a lower bound of |y|^2 over child i's box, from interval arithmetic row by row.
  bool Misses(const Node& node, int i) const {
    double sum = 0.0;
    const double* w = whiten;
    for (int r = 0; r < n; ++r) {
      double least = 0.0, most = 0.0;
      for (int c = 0; c <= r; ++c, ++w) {
        const double a = *w * (node.Low(c)[i] - center[c]);
        const double b = *w * (node.High(c)[i] - center[c]);
        least += std::min(a, b);
        most += std::max(a, b);
      }
      const double t = least > 0.0 ? least : most < 0.0 ? most : 0.0;
      sum += t * t;
      if (sum > gate * (1.0 + 1e-9)) return true;
    }
    return false;
  }

  // Of the middle of child i's box; beyond the gate some number beyond it.
  double SquaredMahalanobis(const Node& node, int i) const {
    double sum = 0.0;
    const double* w = whiten;
    for (int r = 0; r < n && sum <= gate; ++r) {
      double y = 0.0;
      for (int c = 0; c <= r; ++c, ++w) {
        y += *w * (0.5 * (node.Low(c)[i] + node.High(c)[i]) - center[c]);
      }
      sum += y * y;
    }
    return sum;
  }

  int n;
  double gate;
  const double* center;
  const double* whiten;  // lower triangle, row by row
  double low[kMaxDimensions], high[kMaxDimensions];
};

}  // namespace

absl::StatusOr<std::vector<EllipsoidMatch>> XTreeSnapshot::Inside(const Ellipsoid& ellipsoid,
                                                                  QueryStats* stats) const {
  const int n = dimensions();
  if (ellipsoid.center.size() != n || ellipsoid.covariance.rows() != n ||
      ellipsoid.covariance.cols() != n) {
    return absl::InvalidArgumentError(absl::StrCat("ellipsoid: not of dimension ", n));
  }
  double whiten[kMaxTriangle];
  if (!ellipsoid.center.allFinite() || !InvertedCholesky(ellipsoid.covariance, whiten)) {
    return absl::InvalidArgumentError("ellipsoid.covariance: not positive definite");
  }
  std::vector<EllipsoidMatch> found;
  const double gate = ellipsoid.gate;
  if (root_ == nullptr || !(gate >= 0.0)) return found;

  const WhitenedBall ball(ellipsoid, whiten);
  QueryStats unused;
  Walk(
      *root_,
      options_.scan_share,
      stats != nullptr ? *stats : unused,
      [&](const Node& node, Scratch&, auto visit) {
        ForEachMeeting(node, ball.low, ball.high, [&](int i) {
          if (!ball.Misses(node, i)) visit(i);
        });
      },
      [&](const Node& node, Scratch&) {
        // The bounding box of the ellipsoid thins the entries of points; a box is judged by its
        // centre, which lies in it.
        ForEachMeeting(node, ball.low, ball.high, [&](int i) {
          const double squared = ball.SquaredMahalanobis(node, i);
          if (squared <= gate) found.push_back({node.ids[i], squared});
        });
      });
  return found;
}

}  // namespace horopter
