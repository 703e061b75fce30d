#include "server/vision/recognition/invariant_matching/association.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/invariants/six_points.h"

namespace horopter {
namespace {

int MinimalPairs(TransformGroup group) {
  return group == TransformGroup::kCollineation ? 5 : 4;
}

// As few pairs as determine it.
absl::StatusOr<Eigen::Matrix4d> FitSample(TransformGroup group,
                                          const SceneStructure& structure,
                                          const ObjectShape& shape,
                                          std::span<const VertexMatch> sample) {
  if (group != TransformGroup::kCollineation) {
    return FitTransform(group, structure, shape, sample, {});
  }
  std::vector<Eigen::Vector4d> from, to;
  for (const VertexMatch& m : sample) {
    from.emplace_back(shape.vertices[m.vertex].homogeneous());
    to.emplace_back(structure.points[m.point].homogeneous());
  }
  HOROPTER_ASSIGN_OR_RETURN(const Eigen::Matrix4d H, CollineationFromBasis(from, to));
  return H.row(3).dot(from[0]) < 0.0 ? Eigen::Matrix4d(-H) : H;
}

}  // namespace

absl::StatusOr<std::array<int, 6>> AssociateByAxes(std::span<const Eigen::Vector4d, 6> points,
                                                   std::span<const Eigen::Vector4d, 6> vertices,
                                                   double tolerance) {
  for (int i = 0; i < 6; ++i) {
    if (!points[i].allFinite() || !vertices[i].allFinite()) {
      return absl::InvalidArgumentError(absl::StrCat("points or vertices: ", i, " is not finite"));
    }
  }
  return MatchByAxes(AxisInvariants(points), AxisInvariants(vertices), tolerance);
}

void AssociationTable::Add(std::span<const VertexMatch> pairs, double weight) {
  for (const VertexMatch& m : pairs) votes_(m.point, m.vertex) += weight;
}

std::vector<VertexMatch> AssociationTable::Assign(double min_votes) const {
  // Only rows and columns with votes take part.
  std::vector<int> rows, columns;
  for (int r = 0; r < votes_.rows(); ++r) {
    if (votes_.row(r).maxCoeff() >= min_votes) rows.push_back(r);
  }
  for (int c = 0; c < votes_.cols(); ++c) {
    if (votes_.col(c).maxCoeff() >= min_votes) columns.push_back(c);
  }
  if (rows.empty() || columns.empty()) return {};
  Eigen::MatrixXd value(rows.size(), columns.size());
  for (std::size_t r = 0; r < rows.size(); ++r) {
    for (std::size_t c = 0; c < columns.size(); ++c) {
      const double v = votes_(rows[r], columns[c]);
      value(static_cast<Eigen::Index>(r), static_cast<Eigen::Index>(c)) = v >= min_votes ? v : 0.0;
    }
  }
  const std::vector<int> column_of = MaximumAssignment(value);
  std::vector<VertexMatch> out;
  for (std::size_t r = 0; r < rows.size(); ++r) {
    if (column_of[r] >= 0) out.push_back({columns[column_of[r]], rows[r]});
  }
  std::stable_sort(out.begin(), out.end(), [&](const VertexMatch& a, const VertexMatch& b) {
    return votes_(a.point, a.vertex) > votes_(b.point, b.vertex);
  });
  return out;
}

std::vector<int> MaximumAssignment(const Eigen::MatrixXd& value) {
  // Shortest augmenting paths (Jonker, Volgenant 1987) on the negated values, made square.
  const int n = static_cast<int>(std::max(value.rows(), value.cols()));
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const auto cost = [&](int r, int c) {
    return r < value.rows() && c < value.cols() ? -value(r, c) : 0.0;
  };
  std::vector<double> u(n + 1, 0.0), v(n + 1, 0.0);
  std::vector<int> row_of(n + 1, 0);
  for (int row = 1; row <= n; ++row) {
    row_of[0] = row;
    int column = 0;
    std::vector<double> slack(n + 1, kInfinity);
    std::vector<int> way(n + 1, 0);
    std::vector<bool> used(n + 1, false);
    do {
      used[column] = true;
      const int r = row_of[column];
      double delta = kInfinity;
      int next = 0;
      for (int c = 1; c <= n; ++c) {
        if (used[c]) continue;
        const double reduced = cost(r - 1, c - 1) - u[r] - v[c];
        if (reduced < slack[c]) slack[c] = reduced, way[c] = column;
        if (slack[c] < delta) delta = slack[c], next = c;
      }
      for (int c = 0; c <= n; ++c) {
        if (used[c]) {
          u[row_of[c]] += delta;
          v[c] -= delta;
        } else {
          slack[c] -= delta;
        }
      }
      column = next;
    } while (row_of[column] != 0);
    while (column != 0) {
      row_of[column] = row_of[way[column]];
      column = way[column];
    }
  }
  std::vector<int> out(value.rows(), -1);
  for (int c = 1; c <= n; ++c) {
    const int r = row_of[c] - 1;
    if (r < value.rows() && c - 1 < value.cols() && value(r, c - 1) > 0.0) out[r] = c - 1;
  }
  return out;
}

absl::StatusOr<ConsistentMatches> FindConsistentMatches(TransformGroup group,
                                                        const SceneStructure& structure,
                                                        const ObjectShape& shape,
                                                        std::span<const VertexMatch> pairs,
                                                        const ConsistencyOptions& options) {
  const int n = static_cast<int>(pairs.size()), minimal = MinimalPairs(group);
  const auto explained = [&](const Eigen::Matrix4d& H) {
    std::vector<VertexMatch> out;
    for (const VertexMatch& m : pairs) {
      const Eigen::Vector4d y = H * shape.vertices[m.vertex].homogeneous();
      if (!(y.w() > 0.0)) continue;
      if ((y.hnormalized() - structure.points[m.point]).norm() < options.reach) out.push_back(m);
    }
    return out;
  };
  ConsistentMatches best;
  const auto all = FitTransform(group, structure, shape, pairs, {});
  if (!all.ok() && (n < minimal || all.status().code() == absl::StatusCode::kInvalidArgument)) {
    return all.status();
  }
  if (all.ok()) best = {*all, explained(*all)};
  std::mt19937 rng(options.seed);
  std::vector<int> order(n);
  for (int draw = 0; draw < options.draws && static_cast<int>(best.matches.size()) < n; ++draw) {
    std::iota(order.begin(), order.end(), 0);
    std::vector<VertexMatch> sample;
    for (int k = 0; k < minimal; ++k) {
      std::swap(order[k], order[k + static_cast<int>(rng() % static_cast<unsigned>(n - k))]);
      sample.push_back(pairs[order[k]]);
    }
    const auto H = FitSample(group, structure, shape, sample);
    if (!H.ok()) continue;
    std::vector<VertexMatch> matches = explained(*H);
    if (matches.size() <= best.matches.size()) continue;
    // All that agree determine it better than the sample.
    const auto refit = FitTransform(group, structure, shape, matches, {});
    if (!refit.ok()) continue;
    std::vector<VertexMatch> again = explained(*refit);
    if (again.size() >= matches.size()) {
      best = {*refit, std::move(again)};
    } else {
      best = {*H, std::move(matches)};
    }
  }
  if (static_cast<int>(best.matches.size()) <= minimal) {
    return absl::FailedPreconditionError(
        absl::StrCat("no transformation explains more than ", minimal, " of ", n, " pairs"));
  }
  return best;
}

}  // namespace horopter
