#include "server/vision/euclidean/scene_bundle.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/base/parallel_for.h"
#include "server/vision/euclidean/robust_scatter.h"
#include "server/vision/geometry/plucker_line.h"
#include "server/vision/geometry/pose_perturbation.h"
#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

// Neighbouring samples of one edge share the edge's error; samples closer than this (working
// pixels) count as one.
constexpr double kCorrelationPx = 12.0;
// Parameters that an edge point depends on.
using EdgeMatrix = Eigen::Matrix<double, kEdgeRow, kEdgeRow>;
using EdgeVector = Eigen::Matrix<double, kEdgeRow, 1>;
using Matrix23 = Eigen::Matrix<double, 2, 3>;

double EdgeWeight(const SceneBundle& bundle, const EdgeObservation& o) {
  return bundle.working_from_image[o.view] /
         (bundle.edge_sigma_px * std::sqrt(SharedSamples(o.spacing_px)));
}

// Where view b sees the plane's point that view a sees in the cell, against where it was found:
// squared, in sigmas.
double PlaneCellSquared(const SceneBundle& bundle, const PlaneCell& cell) {
  const AdjustedView &a = bundle.views[cell.view_a], &b = bundle.views[cell.view_b];
  const Eigen::Vector3d ray =
      a.camera_from_scene.R.transpose() * NormalizedPoint(a.camera, cell.pixel_a).homogeneous();
  const Eigen::Vector3d center = a.camera_from_scene.Inverse().t;
  const double along = bundle.plane.plane.dot(ray);
  const double s = (-1.0 - bundle.plane.plane.dot(center - bundle.plane.anchor)) / along;
  const Eigen::Vector3d p = b.camera_from_scene * Eigen::Vector3d(center + s * ray);
  if (!(s > kMinDepthM) || !(p.z() > kMinDepthM)) return kBehindSigmas * kBehindSigmas;
  const Eigen::Vector2d e = cell.whitening * (Project(b.camera, p) - cell.pixel_b);
  return e.squaredNorm() / (bundle.plane_slack * bundle.plane_slack);
}

struct NormalEquations {
  Eigen::MatrixXd A;
  Eigen::VectorXd b;
  double cost = 0.0;
};

// The edges of one view and one object lie together: [first, last).
struct EdgeRun {
  int first = 0;
  int last = 0;
};

std::vector<EdgeRun> RunsOf(const std::vector<EdgeObservation>& edges) {
  std::vector<EdgeRun> runs;
  for (int i = 0; i < static_cast<int>(edges.size()); ++i) {
    if (runs.empty() || edges[i].view != edges[runs.back().first].view ||
        edges[i].object != edges[runs.back().first].object) {
      runs.push_back({i, i});
    }
    runs.back().last = i + 1;
  }
  return runs;
}

struct RunSums {
  EdgeMatrix A = EdgeMatrix::Zero();
  EdgeVector b = EdgeVector::Zero();
  double cost = 0.0;
};

// J^T W J, J^T W r of all residuals. Runs of edges are summed in parallel, added up in order.
void AddEdgeRuns(const SceneBundle& bundle,
                 const SceneBundleLayout& layout,
                 const std::vector<EdgeRun>& runs,
                 const std::vector<RunSums>& sums,
                 NormalEquations* out) {
  for (std::size_t i = 0; i < runs.size(); ++i) {
    const EdgeObservation& o = bundle.edges[runs[i].first];
    const int v = layout.view[o.view], k = layout.object[o.object];
    const EdgeMatrix& A = sums[i].A;
    out->A.block<kViewParameters, kViewParameters>(v, v) +=
        A.topLeftCorner<kViewParameters, kViewParameters>();
    out->A.block<kObjectParameters, kObjectParameters>(k, k) +=
        A.bottomRightCorner<kObjectParameters, kObjectParameters>();
    out->A.block<kViewParameters, kObjectParameters>(v, k) +=
        A.topRightCorner<kViewParameters, kObjectParameters>();
    out->A.block<kObjectParameters, kViewParameters>(k, v) +=
        A.bottomLeftCorner<kObjectParameters, kViewParameters>();
    out->b.segment<kViewParameters>(v) += sums[i].b.head<kViewParameters>();
    out->b.segment<kObjectParameters>(k) += sums[i].b.tail<kObjectParameters>();
    out->cost += sums[i].cost;
  }
}

void AddPlaneCells(const SceneBundle& bundle,
                   const SceneBundleLayout& layout,
                   NormalEquations* out) {
  PlaneRow row;
  for (const PlaneCell& m : bundle.plane.cells) {
    if (!LinearizePlaneCell(bundle, m, &row)) {
      out->cost += CauchyLoss(bundle.plane_cauchy_sigmas, kBehindSigmas * kBehindSigmas);
      continue;
    }
    const double w = RobustWeight(bundle.plane_cauchy_sigmas, row.residual.squaredNorm());
    out->cost += CauchyLoss(bundle.plane_cauchy_sigmas, row.residual.squaredNorm());
    const int starts[3] = {layout.view[m.view_a], layout.view[m.view_b], layout.plane};
    const int columns[3] = {0, kViewParameters, 2 * kViewParameters};
    const int sizes[3] = {kViewParameters, kViewParameters, kPlaneParameters};
    const Eigen::Matrix<double, 23, 23> JtJ = w * row.J.transpose() * row.J;
    const Eigen::Matrix<double, 23, 1> Jtr = w * row.J.transpose() * row.residual;
    for (int p = 0; p < 3; ++p) {
      out->b.segment(starts[p], sizes[p]) += Jtr.segment(columns[p], sizes[p]);
      for (int q = 0; q < 3; ++q) {
        out->A.block(starts[p], starts[q], sizes[p], sizes[q]) +=
            JtJ.block(columns[p], columns[q], sizes[p], sizes[q]);
      }
    }
  }
}

void AddTexture(const SceneBundle& bundle, const SceneBundleLayout& layout, NormalEquations* out) {
  TextureRows rows;
  constexpr int k = kViewParameters;
  for (const TexturePoint& point : bundle.texture.points) {
    if (!LinearizeTexturePoint(bundle.views, bundle.texture, point, bundle.plane_slack, &rows))
      continue;
    const Eigen::MatrixXd JtJ = rows.J.transpose() * rows.J;
    const Eigen::VectorXd Jtr = rows.J.transpose() * rows.residual;
    for (std::size_t i = 0; i < rows.views.size(); ++i) {
      const int row = layout.view[rows.views[i]];
      out->b.segment<k>(row) += Jtr.segment<k>(k * i);
      for (std::size_t j = 0; j < rows.views.size(); ++j)
        out->A.block<k, k>(row, layout.view[rows.views[j]]) += JtJ.block<k, k>(k * i, k * j);
    }
  }
  out->cost += TextureCost(bundle.views, bundle.texture, bundle.plane_slack);
}

void AddCameraPriors(const SceneBundle& bundle,
                     const SceneBundleLayout& layout,
                     NormalEquations* out) {
  for (std::size_t v = 0; v < bundle.views.size(); ++v) {
    if (!bundle.views[v].known) continue;
    const Eigen::Vector4d r = PriorResiduals(bundle, static_cast<int>(v));
    const Eigen::Vector4d w = PriorWeights(bundle, static_cast<int>(v));
    out->A.diagonal().segment<4>(layout.view[v] + 6) += w.cwiseAbs2();
    out->b.segment<4>(layout.view[v] + 6) += w.cwiseProduct(r);
    out->cost += r.squaredNorm();
  }
}

NormalEquations Linearize(const SceneBundle& bundle,
                          const SceneBundleLayout& layout,
                          const std::vector<EdgeRun>& runs,
                          int threads) {
  NormalEquations out{
      Eigen::MatrixXd::Zero(layout.size, layout.size), Eigen::VectorXd::Zero(layout.size), 0.0};
  std::vector<RunSums> sums(runs.size());
  ParallelFor(static_cast<int>(runs.size()), threads, [&](int i) {
    EdgeRow row;
    for (int e = runs[i].first; e < runs[i].last; ++e) {
      if (!LinearizeEdge(bundle, bundle.edges[e], &row)) {
        sums[i].cost += CauchyLoss(bundle.cauchy_sigmas, kBehindSigmas * kBehindSigmas);
        continue;
      }
      const double squared = row.residual * row.residual,
                   w = RobustWeight(bundle.cauchy_sigmas, squared);
      sums[i].cost += CauchyLoss(bundle.cauchy_sigmas, squared);
      sums[i].A.noalias() += (w * row.J) * row.J.transpose();
      sums[i].b += w * row.residual * row.J;
    }
  });
  AddEdgeRuns(bundle, layout, runs, sums, &out);
  AddPlaneCells(bundle, layout, &out);
  AddTexture(bundle, layout, &out);
  AddCameraPriors(bundle, layout, &out);
  AddSimilarity(bundle.views, bundle.alike, IntrinsicsColumns(layout), &out.A, &out.b);
  out.cost += SimilarityCost(bundle.views, bundle.alike);
  AddGroupPrior(bundle.group, bundle.views, layout.view, &out.A, &out.b);
  out.cost += GroupCost(bundle.group, bundle.views);
  return out;
}

}  // namespace

SceneBundleLayout LayoutOf(const SceneBundle& bundle) {
  SceneBundleLayout layout;
  for (const AdjustedView& view : bundle.views) {
    layout.view.push_back(view.known ? layout.size : -1);
    if (view.known) layout.size += kViewParameters;
  }
  for (std::size_t k = 0; k < bundle.objects.size(); ++k) {
    layout.object.push_back(layout.size);
    layout.size += kObjectParameters;
  }
  if (!bundle.plane.cells.empty()) {
    layout.plane = layout.size;
    layout.size += kPlaneParameters;
  }
  return layout;
}

std::vector<bool> FixedMask(const SceneBundle& bundle,
                            const SceneBundleLayout& layout,
                            const FixedParameters& fixed) {
  std::vector<bool> out(layout.size, false);
  const auto hold = [&](int from, int count) { std::fill_n(out.begin() + from, count, true); };
  if (fixed.gauge == Gauge::kFirstObject && !bundle.objects.empty()) hold(layout.object[0], 6);
  if (fixed.gauge == Gauge::kFirstView) {
    const auto first =
        std::find_if(layout.view.begin(), layout.view.end(), [](int at) { return at >= 0; });
    if (first != layout.view.end()) hold(*first, 6);
  }
  for (std::size_t k = 0; k < bundle.objects.size(); ++k) {
    if (fixed.scales || k == 0) hold(layout.object[k] + 6, 1);
  }
  return out;
}

double SharedSamples(double spacing_px) {
  return std::max(1.0, kCorrelationPx / std::max(spacing_px, 0.2));
}

bool LinearizeEdge(const SceneBundle& bundle, const EdgeObservation& edge, EdgeRow* row) {
  const AdjustedView& view = bundle.views[edge.view];
  const AdjustedObject& object = bundle.objects[edge.object];
  const Eigen::Vector3d& center = object.model->center;
  const double scale = std::exp(bundle.log_scale[edge.object]);
  const Eigen::Vector3d from_center = scale * (edge.point_in_object - center);
  const Eigen::Vector3d object_arm = object.scene_from_object.R * (center + from_center);
  const Eigen::Vector3d view_arm =
      view.camera_from_scene.R * (object_arm + object.scene_from_object.t);
  const Eigen::Vector3d p = view_arm + view.camera_from_scene.t;
  if (!(p.z() > kMinDepthM)) return false;
  Matrix23 by_point;
  ViewJacobian by_view;
  const Eigen::Vector2d u = ProjectWithJacobian(view.camera, p, view_arm, &by_point, &by_view);
  const double w = EdgeWeight(bundle, edge);
  const Eigen::RowVector2d n = w * edge.normal.transpose();
  row->residual = n * (u - edge.edge_point);
  const Eigen::Vector3d g = view.camera_from_scene.R.transpose() * (n * by_point).transpose();
  row->J.head<kViewParameters>() = (n * by_view).transpose();
  row->J.segment<3>(kViewParameters) = object_arm.cross(g);
  row->J.segment<3>(kViewParameters + 3) = g;
  row->by_point = scale * object.scene_from_object.R.transpose() * g;
  row->J(kViewParameters + 6) = row->by_point.dot(from_center) / scale;
  return true;
}

// With C the centre of a and r = R_a^T q the ray of its pixel, the plane's point is P = C + s r,
// s = (-1 - m.(C - anchor)) / (m.r). A move dC of the centre and dr of the ray shift it by
// (I - r m^T / (m.r)) (dC + s dr).
bool LinearizePlaneCell(const SceneBundle& bundle, const PlaneCell& cell, PlaneRow* row) {
  const AdjustedView &a = bundle.views[cell.view_a], &b = bundle.views[cell.view_b];
  const Eigen::Vector3d& m = bundle.plane.plane;
  const Eigen::Matrix3d Rt = a.camera_from_scene.R.transpose();
  const Eigen::Vector3d q = NormalizedPoint(a.camera, cell.pixel_a).homogeneous();
  const Eigen::Vector3d r = Rt * q, C = -(Rt * a.camera_from_scene.t);
  const double mr = m.dot(r);
  if (mr == 0.0) return false;
  const double s = (-1.0 - m.dot(C - bundle.plane.anchor)) / mr;
  const Eigen::Vector3d P = C + s * r;
  const Eigen::Vector3d view_arm = b.camera_from_scene.R * P;
  const Eigen::Vector3d p = view_arm + b.camera_from_scene.t;
  if (!(s > kMinDepthM) || !(p.z() > kMinDepthM)) return false;
  Matrix23 by_point;
  ViewJacobian by_b;
  const Eigen::Vector2d u = ProjectWithJacobian(b.camera, p, view_arm, &by_point, &by_b);
  const Eigen::Matrix2d W = cell.whitening / bundle.plane_slack;
  row->residual = W * (u - cell.pixel_b);
  const Matrix23 by_P = by_point * b.camera_from_scene.R;
  const Matrix23 by_move =
      by_P * (Eigen::Matrix3d::Identity() - r * m.transpose() / mr) * Rt;  // moves given in a
  // q (1 + k1 q^2) = (pixel - c) / f: M dq = d((pixel - c) / f) - q^2 q dk1.
  const Eigen::Vector2d n = q.head<2>();
  const double squared = n.squaredNorm(), d = 1.0 + a.camera.k1 * squared;
  const Eigen::Matrix2d M_inverse =
      (d * Eigen::Matrix2d::Identity() + 2.0 * a.camera.k1 * n * n.transpose()).inverse();
  const Eigen::Matrix2d by_q = s * by_move.leftCols<2>() * M_inverse;
  row->J.leftCols<3>() = by_move * CrossMatrix(s * q - a.camera_from_scene.t);
  row->J.middleCols<3>(3) = -by_move;
  row->J.col(6) = -d * by_q * n;
  row->J.middleCols<2>(7) = -by_q / a.camera.focal_px;
  row->J.col(9) = -squared * by_q * n;
  row->J.middleCols<kViewParameters>(kViewParameters) = by_b;
  row->J.rightCols<kPlaneParameters>() = -by_P * r * (P - bundle.plane.anchor).transpose() / mr;
  row->J = W * row->J;
  return row->J.allFinite();
}

Eigen::Vector4d PriorWeights(const SceneBundle& bundle, int view) {
  const CameraPrior& p = bundle.priors[view];
  return Eigen::Vector4d(p.log_focal_sigma, p.center_sigma_px, p.center_sigma_px, p.k1_sigma)
      .cwiseInverse();
}

std::vector<int> IntrinsicsColumns(const SceneBundleLayout& layout) {
  std::vector<int> columns = layout.view;
  for (int& at : columns) at = at < 0 ? -1 : at + 6;
  return columns;
}

Eigen::Vector4d PriorResiduals(const SceneBundle& bundle, int view) {
  const CameraPrior& p = bundle.priors[view];
  const PinholeCamera& c = bundle.views[view].camera;
  const Eigen::Vector4d off(
      std::log(c.focal_px) - p.log_focal, c.cx - p.cx, c.cy - p.cy, c.k1 - p.k1);
  return off.cwiseProduct(PriorWeights(bundle, view));
}

void MoveBundle(const SceneBundleLayout& layout, const Eigen::VectorXd& step, SceneBundle* bundle) {
  for (std::size_t v = 0; v < bundle->views.size(); ++v) {
    AdjustedView& view = bundle->views[v];
    if (!view.known) continue;
    const auto d = step.segment<kViewParameters>(layout.view[v]);
    view.camera_from_scene = Perturbed(view.camera_from_scene, d.head<6>());
    view.camera.focal_px *= std::exp(d(6));
    view.camera.cx += d(7);
    view.camera.cy += d(8);
    view.camera.k1 += d(9);
  }
  for (std::size_t k = 0; k < bundle->objects.size(); ++k) {
    const auto d = step.segment<kObjectParameters>(layout.object[k]);
    Rigid3& pose = bundle->objects[k].scene_from_object;
    pose = Perturbed(pose, d.head<6>());
    bundle->log_scale[k] += d(6);
  }
  if (layout.plane >= 0) bundle->plane.plane += step.segment<kPlaneParameters>(layout.plane);
  FollowCameras(bundle->views, bundle->plane_slack, &bundle->texture);
}

double BundleCost(const SceneBundle& bundle, int threads) {
  // A chunk costs more than starting a thread.
  constexpr int kChunk = 1024;
  const int edges = static_cast<int>(bundle.edges.size());
  std::vector<double> parts((edges + kChunk - 1) / kChunk, 0.0);
  ParallelFor(static_cast<int>(parts.size()), threads, [&](int c) {
    for (int i = c * kChunk; i < std::min(edges, (c + 1) * kChunk); ++i) {
      const EdgeObservation& o = bundle.edges[i];
      const AdjustedView& view = bundle.views[o.view];
      const AdjustedObject& object = bundle.objects[o.object];
      const Eigen::Vector3d& center = object.model->center;
      const Eigen::Vector3d x =
          center + std::exp(bundle.log_scale[o.object]) * (o.point_in_object - center);
      const Eigen::Vector3d p = view.camera_from_scene * (object.scene_from_object * x);
      double r = kBehindSigmas;
      if (p.z() > kMinDepthM) {
        r = EdgeWeight(bundle, o) * o.normal.dot(Project(view.camera, p) - o.edge_point);
      }
      parts[c] += CauchyLoss(bundle.cauchy_sigmas, r * r);
    }
  });
  double cost = 0.0;
  for (const double part : parts) cost += part;
  for (const PlaneCell& cell : bundle.plane.cells) {
    const double squared = PlaneCellSquared(bundle, cell);
    cost += CauchyLoss(bundle.plane_cauchy_sigmas, squared);
  }
  for (std::size_t v = 0; v < bundle.views.size(); ++v) {
    if (bundle.views[v].known) cost += PriorResiduals(bundle, static_cast<int>(v)).squaredNorm();
  }
  cost += TextureCost(bundle.views, bundle.texture, bundle.plane_slack);
  return cost + SimilarityCost(bundle.views, bundle.alike) + GroupCost(bundle.group, bundle.views);
}

bool AdjustBundle(const SceneBundleOptions& options, SceneBundle* bundle) {
  const SceneBundleLayout layout = LayoutOf(*bundle);
  const std::vector<bool> fixed = FixedMask(*bundle, layout, options.fixed);
  const std::vector<EdgeRun> runs = RunsOf(bundle->edges);
  double lambda = 1e-4;
  NormalEquations normal = Linearize(*bundle, layout, runs, options.threads);
  for (int iteration = 0; iteration < options.max_iterations; ++iteration) {
    for (int i = 0; i < layout.size; ++i) {
      if (!fixed[i]) continue;
      normal.A.row(i).setZero();
      normal.A.col(i).setZero();
      normal.A(i, i) = 1.0;
      normal.b(i) = 0.0;
    }
    bool moved = false, settled = false;
    while (!moved && lambda < 1e8) {
      Eigen::MatrixXd A = normal.A;
      A.diagonal() *= 1.0 + lambda;
      A.diagonal().array() += 1e-12;
      const Eigen::VectorXd step = -A.ldlt().solve(normal.b);
      if (!step.allFinite()) return false;
      SceneBundle trial = *bundle;
      MoveBundle(layout, step, &trial);
      const double cost = BundleCost(trial, options.threads);
      if (cost < normal.cost) {
        moved = true;
        settled = normal.cost - cost < options.min_decrease * normal.cost;
        *bundle = std::move(trial);
        lambda = std::max(1e-9, 0.2 * lambda);
      } else {
        lambda *= 10.0;
      }
    }
    if (!moved || settled) break;
    normal = Linearize(*bundle, layout, runs, options.threads);
  }
  return true;
}

double PlaneDeviation(const SceneBundle& bundle) {
  std::vector<double> squared;
  PlaneRow row;
  for (const PlaneCell& cell : bundle.plane.cells) {
    if (LinearizePlaneCell(bundle, cell, &row)) squared.push_back(row.residual.squaredNorm());
  }
  return std::sqrt(Median(&squared) / kMedianOfChiSquare2);
}

}  // namespace horopter
