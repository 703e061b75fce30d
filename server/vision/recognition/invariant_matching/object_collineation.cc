#include "server/vision/recognition/invariant_matching/object_collineation.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"
#include "server/base/constants.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/collineation.h"
#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

// Of the Cauchy loss on a vertex's or edge end's distance, in sigmas
constexpr double kLossSigma = 3.0;

using Vector16 = Eigen::Matrix<double, 16, 1>;
using Matrix16 = Eigen::Matrix<double, 16, 16>;

constexpr double kCoplanar = 1e-9;    // determinant or relative eigenvalue of points in a plane
constexpr int kMinForSimilarity = 3;  // points that determine one

// Second over largest singular value of the vertices about their middle: below it they are called
// collinear. Rounding leaves 1e-16.
constexpr double kFlat = 1e-6;

absl::Status CheckMatches(const SceneStructure& structure,
                          const ObjectShape& shape,
                          std::span<const VertexMatch> vertices,
                          std::span<const EdgeMatch> edges) {
  const auto in = [](int i, std::size_t n) { return i >= 0 && i < static_cast<int>(n); };
  for (std::size_t k = 0; k < vertices.size(); ++k) {
    const VertexMatch& m = vertices[k];
    if (!in(m.vertex, shape.vertices.size()) || !in(m.point, structure.points.size())) {
      return absl::InvalidArgumentError(absl::StrCat("vertices: match ", k, " out of range"));
    }
    if (!shape.vertices[m.vertex].allFinite() || !structure.points[m.point].allFinite()) {
      return absl::InvalidArgumentError(absl::StrCat("vertices: match ", k, " is not finite"));
    }
    for (std::size_t l = 0; l < k; ++l) {
      if (vertices[l].vertex == m.vertex || vertices[l].point == m.point) {
        return absl::InvalidArgumentError(absl::StrCat("vertices: match ", k, " repeats another"));
      }
    }
  }
  for (std::size_t k = 0; k < edges.size(); ++k) {
    const EdgeMatch& m = edges[k];
    if (!in(m.edge, shape.edges.size()) || !in(m.line, structure.lines.size())) {
      return absl::InvalidArgumentError(absl::StrCat("edges: match ", k, " out of range"));
    }
  }
  return absl::OkStatus();
}

// Absolute orientation (Umeyama 1991), scale free or given.
absl::StatusOr<Eigen::Matrix4d> FitSimilarity(const SceneStructure& structure,
                                              const ObjectShape& shape,
                                              std::span<const VertexMatch> vertices,
                                              const double* scale) {
  const auto n = static_cast<Eigen::Index>(vertices.size());
  if (n < kMinForSimilarity) {
    return absl::FailedPreconditionError(
        absl::StrCat(n, " vertices, a similarity needs ", kMinForSimilarity));
  }
  Eigen::Matrix3Xd from(3, n), to(3, n);
  for (Eigen::Index k = 0; k < n; ++k) {
    from.col(k) = shape.vertices[vertices[k].vertex];
    to.col(k) = structure.points[vertices[k].point];
  }
  const Eigen::Vector3d from_mean = from.rowwise().mean(), to_mean = to.rowwise().mean();
  from.colwise() -= from_mean;
  to.colwise() -= to_mean;
  const Eigen::Matrix3d moment = from * from.transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> spread(moment, Eigen::EigenvaluesOnly);
  if (!(spread.eigenvalues()(1) > kFlat * kFlat * spread.eigenvalues()(2))) {
    return absl::FailedPreconditionError("the vertices lie on a line");
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(to * from.transpose(),
                                              Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d sign(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant());
  const double s = scale != nullptr ? *scale : svd.singularValues().dot(sign) / from.squaredNorm();
  if (!(s > 0.0)) return absl::FailedPreconditionError("the points are not of the vertices' shape");
  const Eigen::Matrix3d A = s * svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
  Eigen::Matrix4d H = Eigen::Matrix4d::Identity();
  H.topLeftCorner<3, 3>() = A;
  H.topRightCorner<3, 1>() = to_mean - A * from_mean;
  return H;
}

// The one of H and -H that gives most vertices a positive w; not normalised further.
Eigen::Matrix4d WithPositiveW(const Eigen::Matrix4d& H,
                              const ObjectShape& shape,
                              std::span<const VertexMatch> vertices) {
  int positive = 0;
  for (const VertexMatch& m : vertices) {
    positive += H.row(3).dot(shape.vertices[m.vertex].homogeneous()) > 0.0 ? 1 : -1;
  }
  return positive < 0 ? Eigen::Matrix4d(-H) : H;
}

// Gradient by H, stacked column by column, of something whose gradient by H x is `g`.
Vector16 ByTransform(const Eigen::Vector4d& g, const Eigen::Vector4d& x) {
  Vector16 out;
  for (int c = 0; c < 4; ++c) out.segment<4>(4 * c) = g * x(c);
  return out;
}

struct Normal {
  Matrix16 N = Matrix16::Zero();
  Vector16 g = Vector16::Zero();
  double cost = 0.0;

  // `rows` residuals of variance one that share one robust weight.
  template <int R>
  void Add(const Eigen::Matrix<double, R, 1>& r,
           const Eigen::Matrix<double, R, 16>& J,
           double loss_sigma) {
    const double c2 = loss_sigma * loss_sigma, u = r.squaredNorm() / c2;
    cost += 0.5 * c2 * std::log1p(u);
    const double weight = 1.0 / (1.0 + u);
    N += weight * J.transpose() * J;
    g += weight * J.transpose() * r;
  }
};

// l with |l.xy| = 1 of the image of the line through H a and H b, and the two image points.
struct ProjectedEdge {
  Eigen::Vector3d qa, qb;
  double norm = 0.0;
};
ProjectedEdge ProjectEdge(const CameraMatrix& P,
                          const Eigen::Matrix4d& H,
                          const Eigen::Vector3d& a,
                          const Eigen::Vector3d& b) {
  ProjectedEdge out{P * (H * a.homogeneous()), P * (H * b.homogeneous()), 0.0};
  out.norm = out.qa.cross(out.qb).head<2>().norm();
  return out;
}

Normal Linearize(const SceneStructure& structure,
                 std::span<const Eigen::Matrix3d> roots,
                 const ObjectShape& shape,
                 std::span<const VertexMatch> vertices,
                 std::span<const EdgeMatch> edges,
                 const std::vector<std::vector<int>>& observations_of_line,
                 double loss_sigma,
                 const Eigen::Matrix4d& H) {
  Normal normal;
  for (std::size_t k = 0; k < vertices.size(); ++k) {
    const Eigen::Vector4d x = shape.vertices[vertices[k].vertex].homogeneous(), y = H * x;
    const Eigen::Vector3d e = y.hnormalized() - structure.points[vertices[k].point];
    Eigen::Matrix<double, 3, 4> to_finite;
    to_finite << Eigen::Matrix3d::Identity() / y.w(), -y.head<3>() / (y.w() * y.w());
    const Eigen::Matrix<double, 3, 4> D = roots[k] * to_finite;
    Eigen::Matrix<double, 3, 16> J;
    for (int r = 0; r < 3; ++r) J.row(r) = ByTransform(D.row(r).transpose(), x);
    normal.Add<3>(roots[k] * e, J, loss_sigma);
  }
  for (const EdgeMatch& m : edges) {
    const auto& [a, b] = shape.edges[m.edge];
    const Eigen::Vector4d xa = shape.vertices[a].homogeneous(),
                          xb = shape.vertices[b].homogeneous();
    for (const int k : observations_of_line[m.line]) {
      const LineObservation& o = structure.line_observations[k];
      const CameraMatrix& P = *structure.cameras[o.view];
      const ProjectedEdge l = ProjectEdge(P, H, shape.vertices[a], shape.vertices[b]);
      const double scale = 1.0 / (l.norm * o.sigma_px * structure.sigma_factor);
      Eigen::Vector2d r;
      Eigen::Matrix<double, 2, 16> J;
      for (int end = 0; end < 2; ++end) {
        const Eigen::Vector3d e = (end == 0 ? o.start : o.end).homogeneous();
        r(end) = scale * e.dot(l.qa.cross(l.qb));
        const Eigen::Vector4d by_a = scale * P.transpose() * l.qb.cross(e);
        const Eigen::Vector4d by_b = scale * P.transpose() * e.cross(l.qa);
        J.row(end) = ByTransform(by_a, xa) + ByTransform(by_b, xb);
      }
      if (r.allFinite() && J.allFinite()) normal.Add<2>(r, J, loss_sigma);
    }
  }
  return normal;
}

// Directions in which H may move, as columns of 16.
Eigen::Matrix<double, 16, Eigen::Dynamic> Tangent(TransformGroup group, const Eigen::Matrix4d& H) {
  if (group == TransformGroup::kCollineation) return Matrix16::Identity();
  const int size = group == TransformGroup::kSimilarity ? 7 : 6;
  Eigen::Matrix<double, 16, Eigen::Dynamic> T(16, size);
  for (int k = 0; k < size; ++k) {
    Eigen::Matrix4d G = Eigen::Matrix4d::Zero();
    if (k < 3) {
      G.topLeftCorner<3, 3>() = CrossMatrix(Eigen::Vector3d::Unit(k));
    } else if (k < 6) {
      G(k - 3, 3) = 1.0;
    } else {
      G.topLeftCorner<3, 3>().setIdentity();
    }
    const Eigen::Matrix4d moved = G * H;
    T.col(k) = Eigen::Map<const Vector16>(moved.data());
  }
  return T;
}

Eigen::Matrix4d Moved(TransformGroup group, const Eigen::Matrix4d& H, const Eigen::VectorXd& step) {
  if (group == TransformGroup::kCollineation) {
    return H + Eigen::Map<const Eigen::Matrix4d>(step.data());
  }
  Eigen::Matrix4d G = Eigen::Matrix4d::Identity();
  const Eigen::Vector3d w = step.head<3>();
  const double scale = step.size() > 6 ? std::exp(step(6)) : 1.0;
  G.topLeftCorner<3, 3>() =
      scale * (w.norm() > 0.0 ? Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix()
                              : Eigen::Matrix3d::Identity());
  G.topRightCorner<3, 1>() = step.segment<3>(3);
  return G * H;
}

}  // namespace

ObjectShape ShapeOf(const ObjectModel& model) {
  ObjectShape shape;
  const int n = static_cast<int>(model.vertices.size());
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const auto& v : model.vertices) centre += v / std::max(1, n);
  double radius = 0.0;
  for (const auto& v : model.vertices) radius = std::max(radius, (v - centre).norm());
  const double scale = radius > 0.0 ? 1.0 / radius : 1.0;
  shape.unit_from_object.topLeftCorner<3, 3>() *= scale;
  shape.unit_from_object.topRightCorner<3, 1>() = -scale * centre;
  for (const auto& v : model.vertices) shape.vertices.push_back(scale * (v - centre));
  shape.joined.assign(n, std::vector<bool>(n, false));
  for (const ModelEdge& e : model.edges) {
    const int a = e.start_vertex, b = e.end_vertex;
    if (e.kind != CurveKind::kLine || a < 0 || b < 0 || a >= n || b >= n || a == b) continue;
    shape.edges.push_back({a, b});
    shape.joined[a][b] = shape.joined[b][a] = true;
  }
  return shape;
}

absl::StatusOr<Eigen::Matrix4d> FitTransform(TransformGroup group,
                                             const SceneStructure& structure,
                                             const ObjectShape& shape,
                                             std::span<const VertexMatch> vertices,
                                             std::span<const EdgeMatch> edges,
                                             double structure_units_per_shape) {
  HOROPTER_RETURN_IF_ERROR(CheckMatches(structure, shape, vertices, edges));
  if (group != TransformGroup::kCollineation) {
    const bool free = group == TransformGroup::kSimilarity;
    return FitSimilarity(structure, shape, vertices, free ? nullptr : &structure_units_per_shape);
  }
  std::vector<PointPair3> points;
  for (const VertexMatch& m : vertices) {
    points.push_back(
        {shape.vertices[m.vertex].homogeneous(), structure.points[m.point].homogeneous()});
  }
  std::vector<LinePair3> lines;
  for (const EdgeMatch& m : edges) {
    const auto& [a, b] = shape.edges[m.edge];
    lines.push_back({JoinPoints(Eigen::Vector4d(shape.vertices[a].homogeneous()),
                                Eigen::Vector4d(shape.vertices[b].homogeneous())),
                     structure.lines[m.line]});
  }
  // Three equations a point, four a line.
  if (3 * points.size() + 4 * lines.size() < 15) {
    return absl::FailedPreconditionError(absl::StrCat(
        points.size(), " vertices and ", lines.size(), " edges do not determine a collineation"));
  }
  const auto H = FitCollineation(points, lines);
  if (!H) return absl::FailedPreconditionError("vertices and edges in a degenerate position");
  return WithPositiveW(*H, shape, vertices);
}

absl::StatusOr<Eigen::Matrix4d> CollineationFromBasis(std::span<const Eigen::Vector4d> from,
                                                      std::span<const Eigen::Vector4d> to) {
  if (from.size() != to.size() || from.size() < 5) {
    return absl::InvalidArgumentError("points: five or more, as many on both sides");
  }
  Eigen::Matrix4d A, B;
  for (int k = 0; k < 4; ++k) {
    A.col(k) = from[k].normalized();
    B.col(k) = to[k].normalized();
  }
  if (!(std::abs(A.determinant()) > kCoplanar && std::abs(B.determinant()) > kCoplanar)) {
    return absl::FailedPreconditionError("the first four points lie in a plane");
  }
  const Eigen::Matrix4d A_inverse = A.inverse(), B_inverse = B.inverse();
  // H = B diag(s) A^-1: every further point says that diag(a) s is parallel to b.
  Eigen::Matrix4d moment = Eigen::Matrix4d::Zero();
  for (std::size_t k = 4; k < from.size(); ++k) {
    const Eigen::Vector4d a = (A_inverse * from[k]).normalized();
    const Eigen::Vector4d b = (B_inverse * to[k]).normalized();
    for (int i = 0; i < 4; ++i) {
      for (int j = i + 1; j < 4; ++j) {
        const double u = a(i) * b(j), v = -a(j) * b(i);
        moment(i, i) += u * u;
        moment(j, j) += v * v;
        moment(i, j) += u * v;
        moment(j, i) += u * v;
      }
    }
  }
  const SymmetricEigen<4> solver(moment);
  if (!moment.allFinite() || !(solver.eigenvalues()(1) > kCoplanar * solver.eigenvalues()(3))) {
    return absl::FailedPreconditionError("the points are in a degenerate position");
  }
  const Eigen::Matrix4d H = B * solver.eigenvectors().col(0).asDiagonal() * A_inverse;
  if (!H.allFinite() || !(H.norm() > 0.0)) {
    return absl::FailedPreconditionError("the points are in a degenerate position");
  }
  return Eigen::Matrix4d(H / H.norm());
}

std::vector<Eigen::Matrix3d> PointInformation(const SceneStructure& structure) {
  std::vector<Eigen::Matrix3d> out(structure.points.size(), Eigen::Matrix3d::Zero());
  for (const PointObservation& o : structure.point_observations) {
    const CameraMatrix& P = *structure.cameras[o.view];
    const Eigen::Vector3d q = P * structure.points[o.point].homogeneous();
    Eigen::Matrix<double, 2, 3> to_pixel;
    to_pixel << 1.0 / q.z(), 0.0, -q.x() / (q.z() * q.z()),  //
        0.0, 1.0 / q.z(), -q.y() / (q.z() * q.z());
    const Eigen::Matrix<double, 2, 3> J =
        to_pixel * P.leftCols<3>() / (o.sigma_px * structure.sigma_factor);
    out[o.point] += J.transpose() * J;
  }
  return out;
}

double VertexChi2(const Eigen::Matrix4d& transform,
                  const Eigen::Vector3d& vertex,
                  const Eigen::Vector3d& point,
                  const Eigen::Matrix3d& information) {
  const Eigen::Vector4d y = transform * vertex.homogeneous();
  if (!(y.w() > 0.0)) return kInfinity;
  const Eigen::Vector3d e = y.hnormalized() - point;
  return e.dot(information * e);
}

Eigen::Matrix4d RefineTransform(TransformGroup group,
                                const SceneStructure& structure,
                                std::span<const Eigen::Matrix3d> information,
                                const ObjectShape& shape,
                                std::span<const VertexMatch> vertices,
                                std::span<const EdgeMatch> edges,
                                const RefineTransformOptions& options,
                                const Eigen::Matrix4d& transform) {
  std::vector<Eigen::Matrix3d> roots;
  for (const VertexMatch& m : vertices) {
    const Eigen::LLT<Eigen::Matrix3d> llt(information[m.point]);
    roots.push_back(llt.info() == Eigen::Success ? Eigen::Matrix3d(llt.matrixU())
                                                 : Eigen::Matrix3d::Zero());
  }
  const std::vector<std::vector<int>> of_line =
      edges.empty() ? std::vector<std::vector<int>>{} : ObservationsOfLines(structure);
  const auto linearize = [&](const Eigen::Matrix4d& H) {
    return Linearize(structure, roots, shape, vertices, edges, of_line, kLossSigma, H);
  };
  const bool projective = group == TransformGroup::kCollineation;
  Eigen::Matrix4d best = projective ? Eigen::Matrix4d(transform / transform.norm()) : transform;
  Normal normal = linearize(best);
  double lambda = 1e-4;
  for (int i = 0; i < options.iterations && std::isfinite(normal.cost) && lambda < 1e6; ++i) {
    const auto T = Tangent(group, best);
    Eigen::MatrixXd N = T.transpose() * normal.N * T;
    N.diagonal() *= 1.0 + lambda;
    N.diagonal().array() += 1e-12 * N.diagonal().maxCoeff();  // the scale of a collineation is free
    const Eigen::VectorXd step = N.ldlt().solve(-T.transpose() * normal.g);
    if (!step.allFinite()) break;
    Eigen::Matrix4d next = Moved(group, best, step);
    if (projective) next /= next.norm();
    const Normal moved = linearize(next);
    if (moved.cost < normal.cost) {
      const bool done = normal.cost - moved.cost < 1e-6 * normal.cost;
      best = next;
      normal = moved;
      lambda = std::max(1e-9, 0.1 * lambda);
      if (done) break;
    } else {
      lambda *= 10.0;
    }
  }
  return best;
}

std::vector<std::vector<int>> ObservationsOfLines(const SceneStructure& structure) {
  std::vector<std::vector<int>> out(structure.lines.size());
  for (std::size_t k = 0; k < structure.line_observations.size(); ++k) {
    out[structure.line_observations[k].line].push_back(static_cast<int>(k));
  }
  return out;
}

double EdgeChi2(const SceneStructure& structure,
                const std::vector<std::vector<int>>& observations_of_line,
                const Eigen::Matrix4d& transform,
                const Eigen::Vector3d& a,
                const Eigen::Vector3d& b,
                int line) {
  double sum = 0.0;
  for (const int k : observations_of_line[line]) {
    const LineObservation& o = structure.line_observations[k];
    const ProjectedEdge l = ProjectEdge(*structure.cameras[o.view], transform, a, b);
    const Eigen::Vector3d line_in_image = l.qa.cross(l.qb) / l.norm;
    const double s = line_in_image.dot(o.start.homogeneous()),
                 e = line_in_image.dot(o.end.homogeneous());
    const double sigma = o.sigma_px * structure.sigma_factor;
    sum += 0.5 * (s * s + e * e) / (sigma * sigma);
  }
  const double mean = sum / static_cast<double>(observations_of_line[line].size());
  return std::isfinite(mean) ? mean : kInfinity;
}

}  // namespace horopter
