#include "server/vision/invariants/six_points.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "server/vision/geometry/symmetric_eigen.h"
#include "server/vision/invariants/cross_ratio.h"

namespace horopter {
namespace {

using Points = Eigen::Matrix<double, 4, 6>;

// The transform (map, one scale per point) that spreads the points evenly over the sphere: unit
// norms and second moment near I (Tyler's iteration). Brackets of the result depend little on the
// collineation the set has been through. False when all points lie in a plane.
struct Normalised {
  Points points;
  Eigen::Matrix4d map = Eigen::Matrix4d::Identity();
  Eigen::Matrix<double, 6, 1> scale;
};

std::optional<Normalised> Normalise(const Points& points) {
  constexpr int kIterations = 4;  // of scaling rows and columns in turn
  Normalised result;
  result.points = points;
  for (int k = 0; k < kIterations; ++k) {
    for (int i = 0; i < 6; ++i) result.points.col(i).normalize();
    const Eigen::Matrix4d moment = result.points * result.points.transpose();
    const SymmetricEigen<4> eigen(moment);
    if (!(eigen.eigenvalues()(0) > 1e-12 * eigen.eigenvalues()(3))) return std::nullopt;
    const Eigen::Matrix4d whiten = eigen.eigenvectors() *
                                   eigen.eigenvalues().cwiseInverse().cwiseSqrt().asDiagonal() *
                                   eigen.eigenvectors().adjoint();
    result.points = whiten * result.points;
    result.map = whiten * result.map;
  }
  for (int i = 0; i < 6; ++i) {
    result.points.col(i).normalize();
    result.scale(i) = result.points.col(i).norm() / (result.map * points.col(i)).norm();
  }
  return result;
}

// The four indices that are neither i nor j, ascending, and the sign of (i, j, rest) as a
// permutation.
std::array<int, 4> Complement(int i, int j) {
  std::array<int, 4> rest{};
  int n = 0;
  for (int k = 0; k < 6; ++k) {
    if (k != i && k != j) rest[n++] = k;
  }
  return rest;
}

double PermutationSign(int i, int j) {
  // Moving i to the front passes i elements, then j passes the rest before it.
  const int moves = i + (j > i ? j - 1 : j);
  return moves % 2 == 0 ? 1.0 : -1.0;
}

// Brackets (t_i, t_j) of the associated points and their derivatives by the points' coordinates.
struct Association {
  Eigen::Matrix<double, 6, 6> bracket = Eigen::Matrix<double, 6, 6>::Zero();

  explicit Association(const Points& points) {
    for (int i = 0; i < 6; ++i) {
      for (int j = i + 1; j < 6; ++j) {
        const std::array<int, 4> rest = Complement(i, j);
        Eigen::Matrix4d m;
        for (int k = 0; k < 4; ++k) m.col(k) = points.col(rest[k]);
        bracket(i, j) = PermutationSign(i, j) * m.determinant();
        bracket(j, i) = -bracket(i, j);
      }
    }
  }
};

// Adds `sign` times the derivative of log|(t_i, t_j)| to a row of 24: d log det M = tr M^-1 dM.
void AddLogDerivative(
    const Points& points, int i, int j, double sign, Eigen::Ref<Eigen::RowVectorXd> row) {
  const std::array<int, 4> rest = Complement(i, j);
  Eigen::Matrix4d m;
  for (int k = 0; k < 4; ++k) m.col(k) = points.col(rest[k]);
  const Eigen::Matrix4d inverse = m.inverse();
  for (int k = 0; k < 4; ++k) row.segment<4>(4 * rest[k]) += sign * inverse.row(k);
}

// Groups of points whose associated points coincide, in cyclic order.
std::vector<std::vector<int>> CyclicGroups(const Eigen::Matrix<double, 6, 6>& bracket,
                                           double coincidence) {
  std::array<int, 6> root;
  std::iota(root.begin(), root.end(), 0);
  for (int i = 0; i < 6; ++i) {
    for (int j = i + 1; j < 6; ++j) {
      if (std::abs(bracket(i, j)) > coincidence) continue;
      const int from = root[j], to = root[i];
      for (int& r : root) r = r == from ? to : r;
    }
  }
  // Coordinates in the basis of the two that are farthest apart: t_i = (i,b) t_a + (a,i) t_b.
  Eigen::Index a = 0, b = 0;
  bracket.cwiseAbs().maxCoeff(&a, &b);
  std::array<double, 6> angle{};
  for (int i = 0; i < 6; ++i) {
    double t = std::atan2(bracket(a, i), bracket(i, b));
    if (t < 0.0) t += M_PI;
    angle[i] = t >= M_PI ? t - M_PI : t;
  }
  std::vector<int> heads;
  for (int i = 0; i < 6; ++i) {
    if (root[i] == i) heads.push_back(i);
  }
  std::sort(heads.begin(), heads.end(), [&](int i, int j) { return angle[i] < angle[j]; });
  std::vector<std::vector<int>> groups;
  for (const int head : heads) {
    groups.emplace_back();
    for (int i = 0; i < 6; ++i) {
      if (root[i] == head) groups.back().push_back(i);
    }
  }
  return groups;
}

}  // namespace

std::optional<SixPointInvariants> InvariantsOfSixPoints(std::span<const Eigen::Vector4d, 6> points,
                                                        const Eigen::MatrixXd& covariance,
                                                        const SixPointOptions& options) {
  Points x;
  for (int i = 0; i < 6; ++i) x.col(i) = points[i];
  if (!x.allFinite()) return std::nullopt;
  const std::optional<Normalised> normalised = Normalise(x);
  if (!normalised) return std::nullopt;
  const Association association(normalised->points);
  const auto& bracket = association.bracket;
  const std::vector<std::vector<int>> groups = CyclicGroups(bracket, options.coincidence);
  const int m = static_cast<int>(groups.size());
  if (m < 4) return std::nullopt;

  // c = (12)(34) / ((13)(24)) of consecutive groups lies in (0, 1); logit c = log|(12)(34)| -
  // log|(14)(23)|.
  const auto head = [&](int g) { return groups[((g % m) + m) % m][0]; };
  for (int k = 0; k < m; ++k) {
    const int t1 = head(k), t2 = head(k + 1), t3 = head(k + 2), t4 = head(k + 3);
    const double c =
        std::abs(bracket(t1, t2) * bracket(t3, t4) / (bracket(t1, t3) * bracket(t2, t4)));
    if (!(c >= options.min_ratio && c <= 1.0 - options.min_ratio)) return std::nullopt;
  }

  // Values and derivatives of all m consecutive quadruples; labelings pick m - 3 of them.
  Eigen::VectorXd logits(m);
  Eigen::MatrixXd jacobian = Eigen::MatrixXd::Zero(m, 24);
  for (int k = 0; k < m; ++k) {
    const int t1 = head(k), t2 = head(k + 1), t3 = head(k + 2), t4 = head(k + 3);
    logits(k) = std::log(std::abs(bracket(t1, t2) * bracket(t3, t4))) -
                std::log(std::abs(bracket(t1, t4) * bracket(t2, t3)));
    if (covariance.size() == 0) continue;
    Eigen::RowVectorXd row = Eigen::RowVectorXd::Zero(24);
    AddLogDerivative(normalised->points, t1, t2, 1.0, row);
    AddLogDerivative(normalised->points, t3, t4, 1.0, row);
    AddLogDerivative(normalised->points, t1, t4, -1.0, row);
    AddLogDerivative(normalised->points, t2, t3, -1.0, row);
    // Back through the normalisation; its own change does not matter to an invariant.
    for (int i = 0; i < 6; ++i) {
      jacobian.row(k).segment<4>(4 * i) =
          row.segment<4>(4 * i) * normalised->scale(i) * normalised->map;
    }
  }

  SixPointInvariants result;
  result.invariants = m - 3;
  for (const int direction : {1, -1}) {
    for (int start = 0; start < m; ++start) {
      SixPointLabeling labeling;
      Eigen::MatrixXd rows(m - 3, 24);
      labeling.key.values.resize(m - 3);
      for (int k = 0; k < m - 3; ++k) {
        // The quadruple that begins at this position of the reading; read backwards it is the one
        // that ends there, with the same value.
        const int first = direction > 0 ? start + k : start - k - 3;
        const int at = ((first % m) + m) % m;
        labeling.key.values(k) = logits(at);
        rows.row(k) = jacobian.row(at);
      }
      if (covariance.size() > 0) labeling.key.covariance = rows * covariance * rows.transpose();
      for (int k = 0; k < m; ++k) {
        labeling.groups.push_back(groups[(((start + direction * k) % m) + m) % m]);
      }
      result.labelings.push_back(std::move(labeling));
    }
  }
  return result;
}

std::array<double, 15> AxisInvariants(std::span<const Eigen::Vector4d, 6> points) {
  const auto det = [&](int a, int b, int c, int d) {
    Eigen::Matrix4d m;
    m << points[a].normalized(), points[b].normalized(), points[c].normalized(),
        points[d].normalized();
    return m.determinant();
  };
  std::array<double, 15> values{};
  int axis = 0;
  for (int i = 0; i < 6; ++i) {
    for (int j = i + 1; j < 6; ++j) {
      const auto [k, l, m, n] = Complement(i, j);
      values[axis++] =
          FoldedAngle({det(i, j, k, m) * det(i, j, l, n), det(i, j, k, n) * det(i, j, l, m)});
    }
  }
  return values;
}

std::array<int, 6> MatchByAxes(const std::array<double, 15>& a,
                               const std::array<double, 15>& b,
                               double tolerance) {
  Eigen::Matrix<int, 6, 6> votes = Eigen::Matrix<int, 6, 6>::Zero();
  int axis_a = 0;
  for (int i = 0; i < 6; ++i) {
    for (int j = i + 1; j < 6; ++j, ++axis_a) {
      int axis_b = 0;
      for (int k = 0; k < 6; ++k) {
        for (int l = k + 1; l < 6; ++l, ++axis_b) {
          if (std::abs(a[axis_a] - b[axis_b]) > tolerance) continue;
          ++votes(i, k);
          ++votes(i, l);
          ++votes(j, k);
          ++votes(j, l);
        }
      }
    }
  }
  std::array<int, 6> permutation{0, 1, 2, 3, 4, 5}, best = permutation;
  int most = -1;
  do {
    int sum = 0;
    for (int i = 0; i < 6; ++i) sum += votes(i, permutation[i]);
    if (sum > most) {
      most = sum;
      best = permutation;
    }
  } while (std::next_permutation(permutation.begin(), permutation.end()));
  return best;
}

}  // namespace horopter
