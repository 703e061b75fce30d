#include "server/vision/euclidean/scene_covariance.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>

#include "server/vision/euclidean/edge_groups.h"
#include "server/vision/euclidean/representative.h"
#include "server/vision/euclidean/robust_scatter.h"
#include "server/vision/geometry/pose_perturbation.h"
#include "server/vision/geometry/symmetric_eigen.h"

namespace horopter {
namespace {

constexpr double kUnknownDiameters = 10.0;  // deviation of a place that nothing determines
constexpr double kUnknownFarness = 1.0;     // of a camera, in distances from the scene's origin
constexpr double kLeastCurvature = 0.25;    // of the robust loss, of its value without outliers
constexpr double kMostDofFactor = 6.0;      // that few observations may widen what they say
// Of the equilibrated normal matrix: below it a factorisation is not trusted, and directions are
// as good as open.
constexpr double kSmallestPivot = 1e-9;
constexpr double kSmallestEigenvalue = 1e-12;

double Mad(std::vector<double> values) {
  if (values.empty()) return 0.0;
  for (double& v : values) v = std::abs(v);
  std::nth_element(
      values.begin(), values.begin() + static_cast<long>(values.size() / 2), values.end());
  return kNormalFromMad * values[values.size() / 2];
}

// d2/dr2 of the loss, of its value at zero.
double Curvature(double sigmas, double squared) {
  const double w = RobustWeight(sigmas, squared);
  return w * (2.0 * w - 1.0);  // (1 - x) / (1 + x)^2 with w = 1 / (1 + x)
}

struct PlaneTerm {
  const PlaneCell* cell = nullptr;
  PlaneRow row;
  double weight = 0.0;
};

// Adds a block given by `J` columns of a row to a matrix in layout order.
template <typename Block>
void Scatter(const Block& block,
             const int* starts,
             const int* columns,
             const int* sizes,
             int parts,
             Eigen::MatrixXd* out) {
  for (int p = 0; p < parts; ++p) {
    for (int q = 0; q < parts; ++q) {
      out->block(starts[p], starts[q], sizes[p], sizes[q]) +=
          block.block(columns[p], columns[q], sizes[p], sizes[q]);
    }
  }
}

struct Sandwich {
  Eigen::MatrixXd H;       // all
  Eigen::MatrixXd H_data;  // edges only
  Eigen::MatrixXd V_edges, V_plane, V_texture, V_prior, V_cad;
};

void AddEdges(const SceneBundleLayout& layout,
              const std::vector<EdgeGroup>& groups,
              double curvature,
              const EdgeScatter& scatter,
              Sandwich* s) {
  using Row = Eigen::Matrix<double, kEdgeRow, 1>;
  using Block = Eigen::Matrix<double, kEdgeRow, kEdgeRow>;
  // What a displacement of a CAD edge does to the right side, over all views.
  std::map<std::pair<int, int>, Eigen::Matrix<double, Eigen::Dynamic, 3>> displaced;
  const double sc = scatter.common_px, st = scatter.tilt_px, sp = scatter.point_px;
  for (const EdgeGroup& g : groups) {
    Block H = Block::Zero(), V = Block::Zero();
    Row common = Row::Zero(), tilt = Row::Zero();
    Eigen::Matrix<double, kEdgeRow, 3> cad = Eigen::Matrix<double, kEdgeRow, 3>::Zero();
    for (const EdgeGroup::Point& p : g.points) {
      const Row J = p.weight * p.row.J;
      H.noalias() += curvature * J * p.row.J.transpose();
      V.noalias() += (sp * sp * p.unit * p.unit * p.shared) * J * J.transpose();
      // A shift of the whole edge moves the right side by the slope of its terms, not by their
      // weight.
      const Row slope = curvature * J;
      common += p.unit * slope;
      tilt += p.unit * p.at * slope;
      cad.noalias() += slope * p.row.by_point.transpose();
    }
    V.noalias() += sc * sc * common * common.transpose() + st * st * tilt * tilt.transpose();
    const int starts[2] = {layout.view[g.view], layout.object[g.object]};
    const int columns[2] = {0, kViewParameters};
    const int sizes[2] = {kViewParameters, kObjectParameters};
    Scatter(H, starts, columns, sizes, 2, &s->H_data);
    Scatter(V, starts, columns, sizes, 2, &s->V_edges);
    auto& d = displaced[{g.object, g.edge}];
    if (d.rows() == 0) d = Eigen::Matrix<double, Eigen::Dynamic, 3>::Zero(layout.size, 3);
    d.middleRows(starts[0], kViewParameters) += cad.topRows<kViewParameters>();
    d.middleRows(starts[1], kObjectParameters) += cad.bottomRows<kObjectParameters>();
  }
  for (const auto& [key, d] : displaced) s->V_cad.noalias() += d * d.transpose();
}

void AddPlane(const SceneBundleLayout& layout,
              const std::vector<PlaneTerm>& terms,
              double curvature,
              double sigma_ratio,
              Sandwich* s) {
  const int columns[3] = {0, kViewParameters, 2 * kViewParameters};
  const int sizes[3] = {kViewParameters, kViewParameters, kPlaneParameters};
  for (const PlaneTerm& t : terms) {
    const int starts[3] = {layout.view[t.cell->view_a], layout.view[t.cell->view_b], layout.plane};
    const Eigen::Matrix<double, 23, 23> JtJ = t.row.J.transpose() * t.row.J;
    Scatter(Eigen::Matrix<double, 23, 23>(curvature * t.weight * JtJ),
            starts,
            columns,
            sizes,
            3,
            &s->H);
    Scatter(Eigen::Matrix<double, 23, 23>(sigma_ratio * sigma_ratio * t.weight * t.weight * JtJ),
            starts,
            columns,
            sizes,
            3,
            &s->V_plane);
  }
}

// ratio: of the residuals' scatter to their sigmas.
void AddTextureVariance(const SceneBundle& bundle,
                        const SceneBundleLayout& layout,
                        double ratio,
                        Sandwich* s,
                        Eigen::VectorXd* gradient) {
  TextureRows rows;
  constexpr int k = kViewParameters;
  for (const TexturePoint& point : bundle.texture.points) {
    if (!LinearizeTexturePoint(bundle.views, bundle.texture, point, 1.0, &rows)) continue;
    const Eigen::MatrixXd H = rows.J.transpose() * rows.J;
    const Eigen::MatrixXd V =
        ratio * ratio * rows.J.transpose() * rows.weight.asDiagonal() * rows.J;
    const Eigen::VectorXd g = rows.J.transpose() * rows.residual;
    for (std::size_t i = 0; i < rows.views.size(); ++i) {
      const int row = layout.view[rows.views[i]];
      gradient->segment<k>(row) += g.segment<k>(k * i);
      for (std::size_t j = 0; j < rows.views.size(); ++j) {
        const int column = layout.view[rows.views[j]];
        s->H.block<k, k>(row, column) += H.block<k, k>(k * i, k * j);
        s->V_texture.block<k, k>(row, column) += V.block<k, k>(k * i, k * j);
      }
    }
  }
}

// Directions of the objects that nothing determines.
void BoundObjects(const SceneBundle& bundle, const SceneBundleLayout& layout, Eigen::MatrixXd* H) {
  for (std::size_t k = 0; k < bundle.objects.size(); ++k) {
    const double far = kUnknownDiameters * bundle.objects[k].model->model.diameter_m;
    for (int i = 0; i < 6; ++i) {
      const double sigma = i < 3 ? kUnknownTurnRad : far;
      (*H)(layout.object[k] + i, layout.object[k] + i) += 1.0 / (sigma * sigma);
    }
  }
}

void AddPriors(const SceneBundle& bundle, const SceneBundleLayout& layout, Sandwich* s) {
  for (Eigen::MatrixXd* matrix : {&s->H, &s->V_prior})
    AddSimilarity(bundle.views, bundle.alike, IntrinsicsColumns(layout), matrix, nullptr);
  for (Eigen::MatrixXd* matrix : {&s->H, &s->V_prior})
    AddGroupPrior(bundle.group, bundle.views, layout.view, matrix, nullptr);
  for (std::size_t v = 0; v < bundle.views.size(); ++v) {
    if (!bundle.views[v].known) continue;
    const Eigen::Vector4d w = PriorWeights(bundle, static_cast<int>(v)).cwiseAbs2();
    const int at = layout.view[v];
    s->H.diagonal().segment<4>(at + 6) += w;
    s->V_prior.diagonal().segment<4>(at + 6) += w;
    // What nothing else determines is at least bounded.
    const double far = kUnknownFarness * std::max(1e-3, bundle.views[v].camera_from_scene.t.norm());
    for (int i = 0; i < 6; ++i) {
      const double sigma = i < 3 ? kUnknownTurnRad : far;
      s->H(at + i, at + i) += 1.0 / (sigma * sigma);
      s->V_prior(at + i, at + i) += 1.0 / (sigma * sigma);
    }
  }
  for (Eigen::MatrixXd* matrix : {&s->H, &s->V_prior}) BoundObjects(bundle, layout, matrix);
}

// Inverse over the parameters that are not fixed; equilibrated, so that radians, metres and pixels
// are treated alike.
Eigen::MatrixXd InverseOfFree(const Eigen::MatrixXd& H, const std::vector<bool>& fixed) {
  std::vector<int> free;
  for (int i = 0; i < static_cast<int>(fixed.size()); ++i) {
    if (!fixed[i]) free.push_back(i);
  }
  const int n = static_cast<int>(free.size());
  Eigen::MatrixXd A(n, n);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) A(i, j) = H(free[i], free[j]);
  }
  const Eigen::VectorXd scale = A.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  A = scale.asDiagonal() * A * scale.asDiagonal();
  const Eigen::LDLT<Eigen::MatrixXd> ldlt(A);
  Eigen::MatrixXd inverse;
  if (ldlt.vectorD().minCoeff() > kSmallestPivot) {
    inverse = ldlt.solve(Eigen::MatrixXd::Identity(n, n));
  } else {
    const SymmetricEigen<Eigen::Dynamic> eigen(A);
    inverse = eigen.eigenvectors() *
              eigen.eigenvalues().cwiseMax(kSmallestEigenvalue).cwiseInverse().asDiagonal() *
              eigen.eigenvectors().transpose();
  }
  inverse = scale.asDiagonal() * inverse * scale.asDiagonal();
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(H.rows(), H.cols());
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) out(free[i], free[j]) = 0.5 * (inverse(i, j) + inverse(j, i));
  }
  return out;
}

double MeanCurvature(double sigmas, const std::vector<double>& squared) {
  double curvature = 0.0, weight = 1e-300;
  for (const double s : squared) {
    curvature += Curvature(sigmas, s);
    weight += RobustWeight(sigmas, s);
  }
  return squared.empty() ? 1.0 : std::clamp(curvature / weight, kLeastCurvature, 1.0);
}

// All that the covariance and the evidence are made of.
struct Assembled {
  SceneBundleLayout layout;
  Sandwich s;               // H: with all priors
  Eigen::MatrixXd H_seen;   // edges, plane and texture
  Eigen::VectorXd g_seen;   // gradient of their cost, halved
  Eigen::MatrixXd inverse;  // of H; zero where it is fixed
  EdgeScatter scatter;
  double dof = 1.0;  // factor on the edges' variance
};

// Covariance of the right side of the data.
Eigen::MatrixXd DataVariance(const Assembled& a, const NoiseOptions& options) {
  const double cad2 = options.cad_edge_sigma_m * options.cad_edge_sigma_m;
  const double inflation2 = options.inflation * options.inflation;
  return inflation2 * (a.dof * a.s.V_edges + a.s.V_plane + a.s.V_texture + cad2 * a.s.V_cad);
}

Eigen::VectorXd DataGradient(const SceneBundleLayout& layout,
                             const std::vector<EdgeGroup>& groups,
                             const std::vector<PlaneTerm>& plane) {
  Eigen::VectorXd g = Eigen::VectorXd::Zero(layout.size);
  for (const EdgeGroup& group : groups) {
    for (const EdgeGroup::Point& p : group.points) {
      const Eigen::Matrix<double, kEdgeRow, 1> by = p.weight * p.row.residual * p.row.J;
      g.segment<kViewParameters>(layout.view[group.view]) += by.head<kViewParameters>();
      g.segment<kObjectParameters>(layout.object[group.object]) += by.tail<kObjectParameters>();
    }
  }
  for (const PlaneTerm& t : plane) {
    const Eigen::Matrix<double, 23, 1> by = t.weight * t.row.J.transpose() * t.row.residual;
    g.segment<kViewParameters>(layout.view[t.cell->view_a]) += by.head<kViewParameters>();
    g.segment<kViewParameters>(layout.view[t.cell->view_b]) +=
        by.segment<kViewParameters>(kViewParameters);
    g.segment<kPlaneParameters>(layout.plane) += by.tail<kPlaneParameters>();
  }
  return g;
}

Assembled Assemble(const SceneBundle& bundle, const NoiseOptions& options, bool scales_fixed) {
  Assembled out;
  out.layout = LayoutOf(bundle);
  const int size = out.layout.size;
  const std::vector<EdgeGroup> groups = GroupEdges(bundle);
  std::vector<double> means, tilts, within, squared_edges;
  for (const EdgeGroup& g : groups) {
    for (const EdgeGroup::Point& p : g.points) {
      squared_edges.push_back(p.row.residual * p.row.residual);
      if (g.points.size() >= 4) within.push_back(p.residual - g.mean - g.tilt * p.at);
    }
    means.push_back(g.mean);
    if (g.points.size() >= 4) tilts.push_back(g.tilt);
  }
  std::vector<PlaneTerm> plane;
  std::vector<double> plane_residuals, squared_plane;
  for (const PlaneCell& m : bundle.plane.cells) {
    PlaneTerm term;
    term.cell = &m;
    if (!LinearizePlaneCell(bundle, m, &term.row)) continue;
    const double squared = term.row.residual.squaredNorm();
    term.weight = RobustWeight(bundle.plane_cauchy_sigmas, squared);
    squared_plane.push_back(squared);
    plane_residuals.push_back(term.row.residual.x());
    plane_residuals.push_back(term.row.residual.y());
    plane.push_back(term);
  }

  const Eigen::MatrixXd zero = Eigen::MatrixXd::Zero(size, size);
  out.s = {zero, zero, zero, zero, zero, zero, zero};
  Sandwich& s = out.s;
  EdgeScatter& scatter = out.scatter;
  scatter.edges = static_cast<int>(groups.size());
  scatter.common_px = std::max(options.min_common_px, Mad(means));
  scatter.tilt_px = Mad(tilts);
  scatter.point_px = std::max(options.min_point_px, Mad(within));
  // Residuals of the plane are in their own sigmas.
  const double ratio = std::max(1.0, Mad(plane_residuals));
  scatter.plane_ratio = ratio;
  AddEdges(out.layout, groups, MeanCurvature(bundle.cauchy_sigmas, squared_edges), scatter, &s);
  s.H += s.H_data;
  AddPlane(out.layout, plane, MeanCurvature(bundle.plane_cauchy_sigmas, squared_plane), ratio, &s);
  out.g_seen = DataGradient(out.layout, groups, plane);
  AddTextureVariance(bundle,
                     out.layout,
                     std::max(1.0, TextureDeviation(bundle.views, bundle.texture)),
                     &s,
                     &out.g_seen);
  out.H_seen = s.H;
  AddPriors(bundle, out.layout, &s);
  out.inverse =
      InverseOfFree(s.H, FixedMask(bundle, out.layout, {Gauge::kFirstView, scales_fixed}));
  if (!out.inverse.allFinite()) return out;
  // An adjustment explains a part of the scatter away: offset and tilt of an edge are two values.
  const double values = 2.0 * static_cast<double>(groups.size());
  const double explained = (s.H_data * out.inverse).trace();
  out.dof = std::min(kMostDofFactor, values / std::max(1.0, values - explained));
  scatter.common_px *= std::sqrt(out.dof);
  scatter.tilt_px *= std::sqrt(out.dof);
  return out;
}

// Rows and columns of M.
Eigen::MatrixXd Picked(const Eigen::MatrixXd& M,
                       const std::vector<int>& rows,
                       const std::vector<int>& columns) {
  Eigen::MatrixXd out(rows.size(), columns.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    for (std::size_t j = 0; j < columns.size(); ++j) out(i, j) = M(rows[i], columns[j]);
  }
  return out;
}

}  // namespace

SceneCovariance ComputeSceneCovariance(const SceneBundle& bundle,
                                       const NoiseOptions& options,
                                       bool scales_fixed) {
  Assembled a = Assemble(bundle, options, scales_fixed);
  SceneCovariance out{std::move(a.layout), {}, a.scatter};
  if (!a.inverse.allFinite()) return out;
  out.matrix = a.inverse * (DataVariance(a, options) + a.s.V_prior) * a.inverse;
  return out;
}

// With the objects eliminated from normal matrix H, gradient g and its covariance V, the optimum is
// at -H^-1 g with covariance H^-1 V H^-1: its information is H V^-1 H and its information vector
// -H V^-1 g, which exist also where H is singular.
CameraEvidence ComputeCameraEvidence(const SceneBundle& bundle, const NoiseOptions& options) {
  Assembled a = Assemble(bundle, options, true);
  CameraEvidence out;
  if (!a.inverse.allFinite()) return out;
  std::vector<int> kept, eliminated, place;  // place: in the group's parameters
  for (std::size_t v = 0; v < bundle.views.size(); ++v) {
    if (!bundle.views[v].known) continue;
    const int first = kGroupParameters * static_cast<int>(out.group.views.size());
    for (int i = first == 0 ? 6 : 0; i < kViewParameters; ++i) {
      kept.push_back(a.layout.view[v] + i);
      place.push_back(first + i);
    }
    const Rigid3& anchor =
        bundle.views[out.group.views.empty() ? v : out.group.views[0]].camera_from_scene;
    out.group.views.push_back(static_cast<int>(v));
    out.group.cameras.push_back(bundle.views[v].camera);
    out.group.camera_from_anchor.push_back(bundle.views[v].camera_from_scene * anchor.Inverse());
  }
  for (const int at : a.layout.object) {
    for (int i = 0; i < 6; ++i) eliminated.push_back(at + i);
  }
  for (int i = 0; a.layout.plane >= 0 && i < kPlaneParameters; ++i)
    eliminated.push_back(a.layout.plane + i);
  BoundObjects(bundle, a.layout, &a.H_seen);
  const Eigen::MatrixXd V = DataVariance(a, options);
  const Eigen::LDLT<Eigen::MatrixXd> of_eliminated(Picked(a.H_seen, eliminated, eliminated));
  const Eigen::MatrixXd X = of_eliminated.solve(Picked(a.H_seen, eliminated, kept));
  Eigen::MatrixXd H = Picked(a.H_seen, kept, kept) - Picked(a.H_seen, kept, eliminated) * X;
  const Eigen::MatrixXd V_ek = Picked(V, eliminated, kept);
  Eigen::MatrixXd Vm = Picked(V, kept, kept) - X.transpose() * V_ek - V_ek.transpose() * X +
                       X.transpose() * Picked(V, eliminated, eliminated) * X;
  const int n = static_cast<int>(kept.size());
  Eigen::VectorXd g(n);
  for (int i = 0; i < n; ++i) g(i) = a.g_seen(kept[i]);
  for (std::size_t i = 0; i < eliminated.size(); ++i)
    g -= X.row(static_cast<int>(i)).transpose() * a.g_seen(eliminated[i]);
  // The relative poses are those of the scene but for the anchor's turn of the translation's arm.
  Eigen::MatrixXd from_group =
      Eigen::MatrixXd::Zero(n, kGroupParameters * static_cast<int>(out.group.views.size()));
  for (int i = 0; i < n; ++i) from_group(i, place[i]) = 1.0;
  for (std::size_t i = 1; i < out.group.views.size(); ++i) {
    const Matrix6d J = FirstInProduct(bundle.views[out.group.views[i]].camera_from_scene,
                                      bundle.views[out.group.views[0]].camera_from_scene.Inverse());
    const int row = static_cast<int>(
        std::find(kept.begin(), kept.end(), a.layout.view[out.group.views[i]]) - kept.begin());
    from_group.block<6, 6>(row, kGroupParameters * static_cast<int>(i)) = J.inverse();
  }
  // Equilibrated, so that radians, metres and pixels are treated alike.
  const Eigen::VectorXd scale = H.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  H = scale.asDiagonal() * H * scale.asDiagonal();
  Vm = scale.asDiagonal() * Vm * scale.asDiagonal();
  Vm.diagonal().array() += kSmallestPivot * (1.0 + Vm.diagonal().mean());
  const Eigen::LDLT<Eigen::MatrixXd> of_variance(Vm);
  const Eigen::MatrixXd from_scaled = scale.cwiseInverse().asDiagonal() * from_group;
  const Eigen::MatrixXd left = from_scaled.transpose() * H;
  Eigen::MatrixXd information = left * of_variance.solve(H * from_scaled);
  if (!information.allFinite()) return out;
  out.information = 0.5 * (information + information.transpose());
  out.vector = -left * of_variance.solve(Eigen::VectorXd(scale.cwiseProduct(g)));
  return out;
}

}  // namespace horopter
