#include "server/vision/invariants/line_sets.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "server/vision/invariants/cross_ratio.h"

namespace horopter {
namespace {

// Lambda = A B' - B A' in the order (d; m) = (L41 L42 L43 L23 L31 L12).
Eigen::Matrix4d MatrixOf(const Vector6d& l) {
  Eigen::Matrix4d m = Eigen::Matrix4d::Zero();
  m(3, 0) = l(0);
  m(3, 1) = l(1);
  m(3, 2) = l(2);
  m(1, 2) = l(3);
  m(2, 0) = l(4);
  m(0, 1) = l(5);
  m(0, 3) = -l(0);
  m(1, 3) = -l(1);
  m(2, 3) = -l(2);
  m(2, 1) = -l(3);
  m(0, 2) = -l(4);
  m(1, 0) = -l(5);
  return m;
}

Vector6d VectorOf(const Eigen::Matrix4d& m) {
  Vector6d l;
  l << m(3, 0), m(3, 1), m(3, 2), m(1, 2), m(2, 0), m(0, 1);
  return l;
}

double Incidence(const Vector6d& a, const Vector6d& b) {
  return a.head<3>().dot(b.tail<3>()) + a.tail<3>().dot(b.head<3>());
}

Vector6d Dual(const Vector6d& l) {
  Vector6d dual;
  dual << l.tail<3>(), l.head<3>();
  return dual;
}

// Products of unit features below this are rounding, whatever their ratios.
constexpr double kVanishing = 1e-10;

bool WellSpread(std::initializer_list<double> products, double min_ratio) {
  double least = INFINITY, most = 0.0;
  for (const double p : products) {
    least = std::min(least, std::abs(p));
    most = std::max(most, std::abs(p));
  }
  return std::isfinite(most) && most > kVanishing && least >= min_ratio * most;
}

// Sorted entries move together with their derivatives: the order is found once, at the given set,
// and then kept while its values are differentiated.
std::vector<int> Ascending(const Eigen::VectorXd& values) {
  std::vector<int> order(values.size());
  for (size_t i = 0; i < order.size(); ++i) order[i] = static_cast<int>(i);
  std::sort(order.begin(), order.end(), [&](int a, int b) { return values(a) < values(b); });
  return order;
}

template <typename Function>
InvariantKey SortedKey(const Function& f, const Eigen::VectorXd& x, const Eigen::MatrixXd& c) {
  const Eigen::VectorXd raw = f(x);
  const std::vector<int> order = Ascending(raw);
  const auto sorted = [&](const Eigen::VectorXd& at) {
    const Eigen::VectorXd values = f(at);
    Eigen::VectorXd result(values.size());
    for (Eigen::Index i = 0; i < result.size(); ++i) result(i) = values(order[i]);
    return result;
  };
  InvariantKey key{sorted(x), {}};
  if (c.size() > 0) key.covariance = PropagateCovariance(sorted, x, c);
  return key;
}

// Features stacked and scaled to unit norm, with their covariance.
struct Stacked {
  Eigen::VectorXd x;
  Eigen::MatrixXd covariance;
};

Stacked Stack(std::span<const Eigen::Vector4d> points,
              std::span<const Vector6d> lines,
              const Eigen::MatrixXd& covariance) {
  Stacked s;
  s.x.resize(static_cast<Eigen::Index>(4 * points.size() + 6 * lines.size()));
  Eigen::VectorXd scale(s.x.size());
  Eigen::Index at = 0;
  for (const Eigen::Vector4d& p : points) {
    s.x.segment<4>(at) = p.normalized();
    scale.segment<4>(at).setConstant(1.0 / p.norm());
    at += 4;
  }
  for (const Vector6d& l : lines) {
    s.x.segment<6>(at) = l.normalized();
    scale.segment<6>(at).setConstant(1.0 / l.norm());
    at += 6;
  }
  if (covariance.size() == 0) return s;
  // A line has five coordinates to vary, not six: deviations off the Klein quadric are taken out,
  // as the nearest-line correction does to first order.
  Eigen::MatrixXd project = scale.asDiagonal();
  at = static_cast<Eigen::Index>(4 * points.size());
  for (size_t i = 0; i < lines.size(); ++i, at += 6) {
    const Vector6d normal = Dual(s.x.segment<6>(at));
    project.block<6, 6>(at, at) =
        (Eigen::Matrix<double, 6, 6>::Identity() - normal * normal.transpose()) * scale(at);
  }
  s.covariance = project * covariance * project.transpose();
  return s;
}

std::array<double, 3> LineProducts(const Vector6d* l) {
  return {Incidence(l[0], l[1]) * Incidence(l[2], l[3]),
          Incidence(l[0], l[2]) * Incidence(l[1], l[3]),
          Incidence(l[0], l[3]) * Incidence(l[1], l[2])};
}

// l12 l34, l13 l42, l14 l23 of a line in the basis of four points; they sum to 0. Scaled so that
// the largest coordinate is of order 1: products that are all tiny mean a line through a point.
std::array<double, 3> BasisProducts(const Eigen::Matrix4d& basis, const Vector6d& line) {
  const Eigen::Matrix4d inverse = basis.inverse();
  const Eigen::Matrix4d l = (inverse * MatrixOf(line) * inverse.transpose()).normalized();
  return {l(0, 1) * l(2, 3), l(0, 2) * l(3, 1), l(0, 3) * l(1, 2)};
}

// (a : b : c) with a + b + c = 0 is the cross ratio -a / b; S3 on the three acts as S4 on it.
double FoldedProducts(const std::array<double, 3>& p) {
  return FoldedAngle({-p[0], p[1]});
}

Eigen::Matrix4d Columns(const Eigen::VectorXd& x, std::initializer_list<int> points) {
  Eigen::Matrix4d m;
  int c = 0;
  for (const int i : points) m.col(c++) = x.segment<4>(4 * i);
  return m;
}

// The plane of three points: the generalised cross product of the columns.
Eigen::Vector4d PlaneThrough(const Eigen::Matrix<double, 4, 3>& points) {
  Eigen::Vector4d plane;
  for (int k = 0; k < 4; ++k) {
    Eigen::Matrix3d minor;
    for (int r = 0, to = 0; r < 4; ++r) {
      if (r != k) minor.row(to++) = points.row(r);
    }
    plane(k) = (k % 2 == 0 ? 1.0 : -1.0) * minor.determinant();
  }
  return plane;
}

// Points in general position: the volume they span relative to their norms.
bool SpansSpace(const Eigen::Matrix4d& m) {
  return std::abs(m.colwise().normalized().determinant()) > 1e-9;
}

// Four of the five points of a stacked set.
Eigen::Matrix4d BasisWithout(const Eigen::VectorXd& x, int left_out) {
  return Columns(
      x,
      {left_out == 0 ? 1 : 0, left_out <= 1 ? 2 : 1, left_out <= 2 ? 3 : 2, left_out <= 3 ? 4 : 3});
}

// Where the planes of three of five points meet the line that is stacked behind them, on the line;
// by the two points left out.
std::array<std::array<Eigen::Vector2d, 5>, 5> PlanesOnLine(const Eigen::VectorXd& x) {
  const Eigen::Matrix4d matrix = MatrixOf(x.segment<6>(20));
  const Eigen::JacobiSVD<Eigen::Matrix4d> svd(matrix, Eigen::ComputeFullU);
  const Eigen::Matrix<double, 4, 2> basis = svd.matrixU().leftCols<2>();
  std::array<std::array<Eigen::Vector2d, 5>, 5> at;
  for (int i = 0; i < 5; ++i) {
    for (int j = i + 1; j < 5; ++j) {
      Eigen::Matrix<double, 4, 3> plane_points;
      for (int k = 0, to = 0; k < 5; ++k) {
        if (k != i && k != j) plane_points.col(to++) = x.segment<4>(4 * k);
      }
      at[i][j] = at[j][i] =
          (basis.transpose() * (matrix * PlaneThrough(plane_points))).normalized();
    }
  }
  return at;
}

// The three pairings of the four points other than i cut the line in three pairs of points; two
// pairs have a cross ratio (jk, lm; jl, km), of which the mean over all is symmetric.
Eigen::VectorXd PairingRatios(const Eigen::VectorXd& x) {
  const auto at = PlanesOnLine(x);
  Eigen::VectorXd values(5);
  for (int i = 0; i < 5; ++i) {
    int o[4];
    for (int k = 0, to = 0; k < 5; ++k) {
      if (k != i) o[to++] = k;
    }
    const Eigen::Vector2d* pairs[3][2] = {{&at[o[0]][o[1]], &at[o[2]][o[3]]},
                                          {&at[o[0]][o[2]], &at[o[1]][o[3]]},
                                          {&at[o[0]][o[3]], &at[o[1]][o[2]]}};
    values(i) = 0.0;
    for (int a = 0; a < 3; ++a) {
      const int b = (a + 1) % 3;
      values(i) +=
          FoldedAngle(CrossRatioOf(*pairs[a][0], *pairs[a][1], *pairs[b][0], *pairs[b][1])) / 3.0;
    }
  }
  return values;
}

}  // namespace

Vector6d LineThrough(const Eigen::Vector4d& a, const Eigen::Vector4d& b) {
  return VectorOf(a * b.transpose() - b * a.transpose());
}

Vector6d TransformLine(const Eigen::Matrix4d& collineation, const Vector6d& line) {
  return VectorOf(collineation * MatrixOf(line) * collineation.transpose());
}

std::optional<InvariantKey> FourLines(std::span<const Vector6d, 4> lines,
                                      const Eigen::MatrixXd& covariance,
                                      const LineSetOptions& options) {
  const Stacked s = Stack({}, lines, covariance);
  const auto products = [](const Eigen::VectorXd& x) {
    const Vector6d l[4] = {x.segment<6>(0), x.segment<6>(6), x.segment<6>(12), x.segment<6>(18)};
    return LineProducts(l);
  };
  const std::array<double, 3> p = products(s.x);
  if (!WellSpread({p[0], p[1], p[2]}, options.min_ratio)) return std::nullopt;
  const int largest = static_cast<int>(
      std::max_element(
          p.begin(), p.end(), [](double a, double b) { return std::abs(a) < std::abs(b); }) -
      p.begin());
  return SortedKey(
      [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
        const std::array<double, 3> q = products(x);
        return Eigen::Vector2d(q[(largest + 1) % 3], q[(largest + 2) % 3]) / q[largest];
      },
      s.x,
      s.covariance);
}

std::optional<InvariantKey> FourPointsOneLine(std::span<const Eigen::Vector4d, 4> points,
                                              const Vector6d& line,
                                              const Eigen::MatrixXd& covariance,
                                              const LineSetOptions& options) {
  const Stacked s = Stack(points, std::span(&line, 1), covariance);
  if (!SpansSpace(Columns(s.x, {0, 1, 2, 3}))) return std::nullopt;
  const auto products = [](const Eigen::VectorXd& x) {
    return BasisProducts(Columns(x, {0, 1, 2, 3}), x.segment<6>(16));
  };
  const std::array<double, 3> p = products(s.x);
  if (!WellSpread({p[0], p[1], p[2]}, options.min_ratio)) return std::nullopt;
  return SortedKey(
      [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
        return Eigen::VectorXd::Constant(1, FoldedProducts(products(x)));
      },
      s.x,
      s.covariance);
}

std::optional<InvariantKey> ThreePointsTwoLines(std::span<const Eigen::Vector4d, 3> points,
                                                std::span<const Vector6d, 2> lines,
                                                const Eigen::MatrixXd& covariance,
                                                const LineSetOptions& options) {
  const Stacked s = Stack(points, lines, covariance);
  // Coordinates of the lines' meets with the plane, in the basis of its three points: the plane's
  // normal completes the basis, entries (i, 4) of the line's matrix are what is left.
  const auto ratios = [](const Eigen::VectorXd& x) -> Eigen::VectorXd {
    Eigen::Matrix<double, 3, 4> rows;
    for (int i = 0; i < 3; ++i) rows.row(i) = x.segment<4>(4 * i).transpose();
    Eigen::Matrix4d basis;
    basis.leftCols<3>() = rows.transpose();
    basis.col(3) = PlaneThrough(rows.transpose());
    const Eigen::Matrix4d inverse = basis.inverse();
    const Eigen::Vector3d u =
        (inverse * MatrixOf(x.segment<6>(12)) * inverse.transpose()).col(3).head<3>();
    const Eigen::Vector3d v =
        (inverse * MatrixOf(x.segment<6>(18)) * inverse.transpose()).col(3).head<3>();
    Eigen::VectorXd both(6);
    both << u, v;
    return both;
  };
  const Eigen::VectorXd uv = ratios(s.x);
  if (!uv.allFinite() || !WellSpread({uv(0), uv(1), uv(2)}, options.min_ratio) ||
      !WellSpread({uv(3), uv(4), uv(5)}, options.min_ratio)) {
    return std::nullopt;
  }
  const auto log_ratios = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
    const Eigen::VectorXd at = ratios(x);
    Eigen::Vector3d logs;
    for (int i = 0; i < 3; ++i) logs(i) = std::log(std::abs(at(i) / at(i + 3)));
    return logs.array() - logs.mean();
  };
  // Exchanging the lines turns all signs: the middle value is made positive.
  const std::vector<int> order = Ascending(log_ratios(s.x));
  const double sign = log_ratios(s.x)(order[1]) < 0.0 ? -1.0 : 1.0;
  const auto values = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
    const Eigen::VectorXd logs = log_ratios(x);
    return Eigen::Vector2d(sign * logs(order[1]), 0.5 * (logs(order[2]) - logs(order[0])));
  };
  InvariantKey key{values(s.x), {}};
  if (key.values(1) <= 0.5 * options.min_ratio) return std::nullopt;  // the lines meet in the plane
  if (covariance.size() > 0) key.covariance = PropagateCovariance(values, s.x, s.covariance);
  return key;
}

std::optional<InvariantKey> TwoPointsThreeLines(std::span<const Eigen::Vector4d, 2> points,
                                                std::span<const Vector6d, 3> lines,
                                                const Eigen::MatrixXd& covariance,
                                                const LineSetOptions& options) {
  const Stacked s = Stack(points, lines, covariance);
  // Cross ratio on line i: its four planes from the pencils P^Lj, P^Lk, Q^Lj, Q^Lk. The line's two
  // points with the largest matrix entries parametrise it: X = (X.a, X.b) up to scale.
  const auto cross = [](const Eigen::VectorXd& x, int i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    const Eigen::Matrix4d line = MatrixOf(x.segment<6>(8 + 6 * i));
    Eigen::Vector4d meets[4];
    int n = 0;
    for (int p = 0; p < 2; ++p) {
      for (const int other : {j, k}) {
        const Eigen::Vector4d plane =
            MatrixOf(Dual(x.segment<6>(8 + 6 * other))) * x.segment<4>(4 * p);
        meets[n++] = line * plane;
      }
    }
    // All four lie on the line: their components along two directions of it are coordinates.
    const Eigen::JacobiSVD<Eigen::Matrix4d> svd(line, Eigen::ComputeFullU);
    const Eigen::Matrix<double, 4, 2> basis = svd.matrixU().leftCols<2>();
    return CrossRatioOf(basis.transpose() * meets[0],
                        basis.transpose() * meets[1],
                        basis.transpose() * meets[2],
                        basis.transpose() * meets[3]);
  };
  for (int i = 0; i < 3; ++i) {
    const CrossRatio c = cross(s.x, i);
    if (!WellSpread({c.numerator, c.denominator, c.numerator - c.denominator}, options.min_ratio)) {
      return std::nullopt;
    }
  }
  return SortedKey(
      [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
        return Eigen::Vector3d(
            FoldedAngle(cross(x, 0)), FoldedAngle(cross(x, 1)), FoldedAngle(cross(x, 2)));
      },
      s.x,
      s.covariance);
}

std::optional<InvariantKey> FivePointsOneLine(std::span<const Eigen::Vector4d, 5> points,
                                              const Vector6d& line,
                                              const Eigen::MatrixXd& covariance,
                                              const LineSetOptions& options) {
  const Stacked s = Stack(points, std::span(&line, 1), covariance);
  for (int i = 0; i < 5; ++i) {
    if (!SpansSpace(BasisWithout(s.x, i))) return std::nullopt;
    const std::array<double, 3> p = BasisProducts(BasisWithout(s.x, i), s.x.segment<6>(20));
    if (!WellSpread({p[0], p[1], p[2]}, options.min_ratio)) return std::nullopt;
  }
  // Both halves are sorted by themselves; derivatives are taken of both together.
  const auto both = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
    Eigen::VectorXd values(10);
    for (int i = 0; i < 5; ++i) {
      values(i) = FoldedProducts(BasisProducts(BasisWithout(x, i), x.segment<6>(20)));
    }
    values.tail<5>() = PairingRatios(x);
    return values;
  };
  const Eigen::VectorXd raw = both(s.x);
  const std::vector<int> first = Ascending(raw.head<5>()), second = Ascending(raw.tail<5>());
  const auto sorted = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
    const Eigen::VectorXd values = both(x);
    Eigen::VectorXd result(10);
    for (int i = 0; i < 5; ++i) {
      result(i) = values(first[i]);
      result(5 + i) = values(5 + second[i]);
    }
    return result;
  };
  InvariantKey key{sorted(s.x), {}};
  if (covariance.size() > 0) key.covariance = PropagateCovariance(sorted, s.x, s.covariance);
  return key;
}

}  // namespace horopter
