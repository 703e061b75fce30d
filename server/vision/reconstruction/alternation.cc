#include "server/vision/reconstruction/alternation.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/geometry/collineation.h"
#include "server/vision/geometry/symmetric_eigen.h"
#include "server/vision/reconstruction/intersection_resection.h"

namespace horopter {
namespace {

// Of a projective scene of several views: of fewer nothing is over to judge it.
constexpr int kMinPoints = 7;
constexpr int kGaugePoints = 8;  // of fewer points the frame follows the lines, too

// Weights of the residuals against the present scene; 1 where nothing is known yet.
double PointWeight(
    const MultiviewTracks& tracks, const ProjectiveScene& scene, int k, RobustLoss loss, double c) {
  const PointObservation& o = tracks.point_observations[k];
  if (!scene.points[o.point]) return 1.0;
  return RobustWeight(
      loss, PointResidual(*scene.cameras[o.view], *scene.points[o.point], o).norm(), c);
}

double LineWeight(
    const MultiviewTracks& tracks, const ProjectiveScene& scene, int k, RobustLoss loss, double c) {
  const LineObservation& o = tracks.line_observations[k];
  if (!scene.lines[o.line]) return 1.0;
  return RobustWeight(
      loss, LineResidual(*scene.cameras[o.view], *scene.lines[o.line], o).norm(), c);
}

// Weighted squared image distances, by which a geometric sweep accepts a new feature: reweighted
// linear steps usually lower them but need not.
double PointCost(const std::vector<WeightedPoint>& observations, const Eigen::Vector4d& X) {
  double cost = 0.0;
  for (const WeightedPoint& o : observations) {
    cost += o.weight * PointResidual(o.P, X, *o.observation).squaredNorm();
  }
  return cost;
}

double LineCost(const std::vector<WeightedLine>& observations, const PluckerLine& L) {
  double cost = 0.0;
  for (const WeightedLine& o : observations) {
    cost += o.weight * LineResidual(o.P, L, *o.observation).squaredNorm();
  }
  return cost;
}

double CameraCost(const std::vector<WeightedPoint>& points,
                  const std::vector<WeightedLine>& lines,
                  const CameraMatrix& P) {
  double cost = 0.0;
  for (const WeightedPoint& o : points) {
    cost += o.weight * PointResidual(P, o.X, *o.observation).squaredNorm();
  }
  for (const WeightedLine& o : lines) {
    cost += o.weight * LineResidual(P, o.L, *o.observation).squaredNorm();
  }
  return cost;
}

struct Sweep {
  const MultiviewTracks& tracks;
  const TrackIndex& index;
  bool geometric;
  RobustLoss loss;
  double c;
};

void Intersect(const Sweep& sweep, ProjectiveScene* scene) {
  std::vector<WeightedPoint> points;
  for (int j = 0; j < sweep.tracks.points; ++j) {
    points.clear();
    for (const int k : sweep.index.of_point[j]) {
      const PointObservation& o = sweep.tracks.point_observations[k];
      if (!scene->point_inlier[k] || !scene->cameras[o.view]) continue;
      const double w = PointWeight(sweep.tracks, *scene, k, sweep.loss, sweep.c);
      if (w > 0.0) points.push_back({&o, *scene->cameras[o.view], Eigen::Vector4d::Zero(), w});
    }
    if (points.size() < 2) {
      scene->points[j].reset();
      continue;
    }
    const auto previous = sweep.geometric ? scene->points[j] : std::optional<Eigen::Vector4d>();
    const auto next = IntersectPoint(points, previous);
    if (!previous || (next && PointCost(points, *next) <= PointCost(points, *previous))) {
      scene->points[j] = next;
    }
  }
  std::vector<WeightedLine> lines;
  for (int j = 0; j < sweep.tracks.lines; ++j) {
    lines.clear();
    for (const int k : sweep.index.of_line[j]) {
      const LineObservation& o = sweep.tracks.line_observations[k];
      if (!scene->line_inlier[k] || !scene->cameras[o.view]) continue;
      const double w = LineWeight(sweep.tracks, *scene, k, sweep.loss, sweep.c);
      if (w > 0.0) lines.push_back({&o, *scene->cameras[o.view], PluckerLine::Zero(), w});
    }
    if (lines.size() < 2) {
      scene->lines[j].reset();
      continue;
    }
    const auto previous = sweep.geometric ? scene->lines[j] : std::optional<PluckerLine>();
    const auto next = IntersectLine(lines, previous);
    if (!previous || (next && LineCost(lines, *next) <= LineCost(lines, *previous))) {
      scene->lines[j] = next;
    }
  }
}

void Resect(const Sweep& sweep, ProjectiveScene* scene) {
  std::vector<WeightedPoint> points;
  std::vector<WeightedLine> lines;
  for (size_t v = 0; v < scene->cameras.size(); ++v) {
    if (!scene->cameras[v]) continue;
    points.clear();
    lines.clear();
    for (const int k : sweep.index.points_in_view[v]) {
      const PointObservation& o = sweep.tracks.point_observations[k];
      if (!scene->point_inlier[k] || !scene->points[o.point]) continue;
      const double w = PointWeight(sweep.tracks, *scene, k, sweep.loss, sweep.c);
      if (w > 0.0) points.push_back({&o, CameraMatrix::Zero(), *scene->points[o.point], w});
    }
    for (const int k : sweep.index.lines_in_view[v]) {
      const LineObservation& o = sweep.tracks.line_observations[k];
      if (!scene->line_inlier[k] || !scene->lines[o.line]) continue;
      const double w = LineWeight(sweep.tracks, *scene, k, sweep.loss, sweep.c);
      if (w > 0.0) lines.push_back({&o, CameraMatrix::Zero(), *scene->lines[o.line], w});
    }
    const auto previous = sweep.geometric ? scene->cameras[v] : std::optional<CameraMatrix>();
    // A camera that its features no longer determine stays where it was.
    const auto P = ResectCamera(points, lines, previous);
    if (!P) continue;
    if (!previous || CameraCost(points, lines, *P) <= CameraCost(points, lines, *previous)) {
      scene->cameras[v] = P;
    }
  }
}

// Cameras (rows of three) and points (columns) whose product is the pixels times their depths,
// which are found in turn with these; where a point is not seen, what the last round says. q:
// homogeneous pixels, three rows a view; seen: 1 where there is one. False: no such factors.
bool FactorDepths(const Eigen::MatrixXd& q,
                  const Eigen::MatrixXi& seen,
                  int rounds,
                  Eigen::MatrixXd* P,
                  Eigen::MatrixXd* X) {
  const int m = static_cast<int>(seen.rows()), n = static_cast<int>(seen.cols());
  Eigen::MatrixXd depths = Eigen::MatrixXd::Ones(m, n);
  Eigen::MatrixXd product = Eigen::MatrixXd::Zero(3 * m, n);  // P X of the last round
  for (int i = 0; i < m; ++i) {
    for (int j = 0; j < n; ++j) product(3 * i + 2, j) = 1.0;  // before it: the image's centre
  }
  for (int round = 0; round < rounds; ++round) {
    Eigen::MatrixXd W = product;
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < m; ++i) {
        if (seen(i, j)) W.block<3, 1>(3 * i, j) = depths(i, j) * q.block<3, 1>(3 * i, j);
      }
    }
    // Balance: rows of a view, then columns, to unit mean square; scales go into P and X.
    Eigen::VectorXd row_scale(m), column_scale(n);
    for (int j = 0; j < n; ++j) {
      column_scale(j) = std::sqrt(static_cast<double>(m)) / W.col(j).norm();
      W.col(j) *= column_scale(j);
    }
    for (int i = 0; i < m; ++i) {
      row_scale(i) = std::sqrt(static_cast<double>(n)) / W.middleRows(3 * i, 3).norm();
      W.middleRows(3 * i, 3) *= row_scale(i);
    }
    if (!W.allFinite()) return false;
    const Eigen::MatrixXd moment = W * W.transpose();
    const SymmetricEigen<Eigen::Dynamic> solver(moment);
    if (solver.info() != Eigen::Success) return false;
    *P = solver.eigenvectors().rightCols(4);
    *X = P->transpose() * W;
    for (int i = 0; i < m; ++i) P->middleRows(3 * i, 3) /= row_scale(i);
    for (int j = 0; j < n; ++j) X->col(j) /= column_scale(j);
    product = *P * *X;
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < m; ++i) {
        if (!seen(i, j)) continue;
        const Eigen::Vector3d x = q.block<3, 1>(3 * i, j), y = product.block<3, 1>(3 * i, j);
        depths(i, j) = x.dot(y) / x.squaredNorm();
      }
    }
  }
  return true;
}

}  // namespace

TrackIndex IndexTracks(const MultiviewTracks& tracks) {
  TrackIndex index;
  index.of_point.resize(tracks.points);
  index.of_line.resize(tracks.lines);
  index.points_in_view.resize(tracks.sizes.size());
  index.lines_in_view.resize(tracks.sizes.size());
  for (size_t k = 0; k < tracks.point_observations.size(); ++k) {
    const PointObservation& o = tracks.point_observations[k];
    index.of_point[o.point].push_back(static_cast<int>(k));
    index.points_in_view[o.view].push_back(static_cast<int>(k));
  }
  for (size_t k = 0; k < tracks.line_observations.size(); ++k) {
    const LineObservation& o = tracks.line_observations[k];
    index.of_line[o.line].push_back(static_cast<int>(k));
    index.lines_in_view[o.view].push_back(static_cast<int>(k));
  }
  return index;
}

std::optional<ProjectiveScene> DecomposeDepths(const MultiviewTracks& tracks,
                                               const DepthDecompositionOptions& options) {
  const TrackIndex index = IndexTracks(tracks);
  std::vector<int> views;
  std::vector<int> row_of(tracks.sizes.size(), -1);
  for (size_t v = 0; v < tracks.sizes.size(); ++v) {
    if (static_cast<double>(index.points_in_view[v].size()) <
        options.min_view_share * tracks.points) {
      continue;
    }
    row_of[v] = static_cast<int>(views.size());
    views.push_back(static_cast<int>(v));
  }
  const int n = tracks.points, m = static_cast<int>(views.size());
  if (m < 2 || n < kMinPoints) return std::nullopt;
  Eigen::MatrixXd q = Eigen::MatrixXd::Zero(3 * m, n);
  Eigen::MatrixXi seen = Eigen::MatrixXi::Zero(m, n);
  for (const PointObservation& o : tracks.point_observations) {
    if (row_of[o.view] < 0) continue;
    q.block<3, 1>(3 * row_of[o.view], o.point) = o.pixel.homogeneous();
    seen(row_of[o.view], o.point) = 1;
  }
  Eigen::MatrixXd P, X;
  if (!FactorDepths(q, seen, options.rounds, &P, &X)) return std::nullopt;
  ProjectiveScene scene = EmptyScene(tracks);
  for (int i = 0; i < m; ++i) {
    const CameraMatrix camera = P.middleRows(3 * i, 3);
    if (!camera.allFinite() || !(camera.norm() > 0.0)) return std::nullopt;
    scene.cameras[views[i]] = camera / camera.norm();
  }
  for (int j = 0; j < n; ++j) {
    if (seen.col(j).sum() >= 2 && X.col(j).norm() > 0.0) {
      scene.points[j] = Eigen::Vector4d(X.col(j).normalized());
    }
  }
  return scene;
}

void BalanceGauge(ProjectiveScene* scene) {
  Eigen::Matrix4d moment = Eigen::Matrix4d::Zero();
  int points = 0;
  for (const auto& X : scene->points) {
    if (!X) continue;
    moment += *X * X->transpose() / X->squaredNorm();
    ++points;
  }
  if (points < kGaugePoints) {
    for (const auto& L : scene->lines) {
      if (!L) continue;
      for (const Eigen::Vector4d& A : PointsOnLine(ToOrthonormal(*L))) moment += A * A.transpose();
    }
  }
  const Eigen::LLT<Eigen::Matrix4d> llt(moment);
  const Eigen::Vector4d diagonal = llt.matrixLLT().diagonal();
  if (llt.info() != Eigen::Success || !(diagonal.minCoeff() > 1e-7 * diagonal.maxCoeff())) return;
  const Eigen::Matrix4d L = llt.matrixL();
  const Eigen::Matrix4d H = L.inverse();
  for (auto& X : scene->points) {
    if (X) X = Eigen::Vector4d((H * *X).normalized());
  }
  if (std::any_of(scene->lines.begin(), scene->lines.end(), [](const auto& l) { return !!l; })) {
    const Matrix6d of_lines = LineCollineation(H);
    for (auto& l : scene->lines) {
      if (l) l = PluckerLine((of_lines * *l).normalized());
    }
  }
  for (auto& P : scene->cameras) {
    if (!P) continue;
    const CameraMatrix moved = *P * L;
    P = moved / moved.norm();
  }
}

void Alternate(const MultiviewTracks& tracks,
               const TrackIndex& index,
               const AlternationOptions& options,
               ProjectiveScene* scene) {
  double scale = std::max(1.0, options.start_scale);
  double before = -1.0;
  for (int round = 0; round < options.max_sweeps; ++round) {
    const Sweep sweep{tracks,
                      index,
                      options.geometric,
                      options.loss,
                      scale * TuningConstant(options.loss) * std::sqrt(2.0)};
    Intersect(sweep, scene);
    BalanceGauge(scene);
    Resect(sweep, scene);
    const bool annealing = scale > 1.0;
    scale = std::max(1.0, scale * options.anneal);
    const double rms = Summarize(tracks, *scene).rms_sigma;
    if (!annealing && std::abs(rms - before) <= options.relative_change * rms) break;
    before = rms;
  }
}

std::optional<Eigen::Vector4d> TriangulatePoint(const MultiviewTracks& tracks,
                                                std::span<const int> observations,
                                                const ProjectiveScene& scene,
                                                int min_views) {
  std::vector<WeightedPoint> points;
  for (const int k : observations) {
    const PointObservation& o = tracks.point_observations[k];
    if (!scene.point_inlier[k] || !scene.cameras[o.view]) continue;
    points.push_back({&o, *scene.cameras[o.view], Eigen::Vector4d::Zero(), 1.0});
  }
  if (static_cast<int>(points.size()) < std::max(2, min_views)) return std::nullopt;
  std::optional<Eigen::Vector4d> X = IntersectPoint(points);
  for (int round = 0; round < 2 && X; ++round) X = IntersectPoint(points, X);
  return X;
}

std::optional<PluckerLine> TriangulateLine(const MultiviewTracks& tracks,
                                           std::span<const int> observations,
                                           const ProjectiveScene& scene,
                                           int min_views) {
  std::vector<WeightedLine> lines;
  for (const int k : observations) {
    const LineObservation& o = tracks.line_observations[k];
    if (!scene.line_inlier[k] || !scene.cameras[o.view]) continue;
    lines.push_back({&o, *scene.cameras[o.view], PluckerLine::Zero(), 1.0});
  }
  if (static_cast<int>(lines.size()) < std::max(2, min_views)) return std::nullopt;
  std::optional<PluckerLine> L = IntersectLine(lines);
  for (int round = 0; round < 2 && L; ++round) L = IntersectLine(lines, L);
  return L;
}

}  // namespace horopter
