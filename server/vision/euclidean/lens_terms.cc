#include "server/vision/euclidean/lens_terms.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <map>
#include <utility>

namespace horopter {
namespace {

constexpr int kTerms = 3;
constexpr int kCenterColumn = 7;  // of a view's parameters: cx, cy
using Design = Eigen::Matrix<double, 2, kTerms>;

// Shift of an image point by each term.
Design DesignAt(const PinholeCamera& camera, const Eigen::Vector2d& pixel) {
  const Eigen::Vector2d n = NormalizedPoint(camera, pixel);
  const double x = n.x(), y = n.y(), squared = n.squaredNorm();
  Design out;
  out << squared * squared * x, 2 * x * y, squared + 2 * x * x,  //
      squared * squared * y, squared + 2 * y * y, 2 * x * y;
  return camera.focal_px * out;
}

// Sums over all rows: what they say of the bundle's parameters and of the terms, and what each
// cluster says of both.
struct Sums {
  Eigen::MatrixXd A;               // all parameters, the terms last
  std::vector<Eigen::VectorXd> b;  // of each cluster
  Eigen::VectorXd prior;           // what priors say: no evidence, but pulls the others
};

class Accumulator {
 public:
  Accumulator(const SceneBundle& bundle, const std::vector<int>& views)
      : bundle_(bundle), layout_(LayoutOf(bundle)), has_terms_(bundle.views.size(), false) {
    for (const int v : views) has_terms_[v] = true;
    const int size = layout_.size + kTerms;
    sums_.A = Eigen::MatrixXd::Zero(size, size);
    AddEdges();
    AddPlane();
    AddTexture();
    AddPriors();
  }

  const SceneBundleLayout& layout() const { return layout_; }
  const Sums& sums() const { return sums_; }
  // Where the terms shift most.
  double LargestShift(const LensTerms& terms) const {
    const Eigen::Vector3d t(terms.k2, terms.p1, terms.p2);
    double largest = 0.0;
    for (const Design& d : designs_) largest = std::max(largest, (d * t).norm());
    return largest;
  }

 private:
  // Rows by the parameters they depend on alone, each at its column.
  struct Rows {
    Eigen::MatrixXd J;
    std::vector<int> columns;
  };

  // Without the terms', which are the last.
  Rows MakeRows(int count, const std::vector<std::pair<int, int>>& blocks) const {
    Rows rows;
    for (const auto& [first, size] : blocks) {
      for (int i = 0; i < size; ++i) rows.columns.push_back(first + i);
    }
    for (int i = 0; i < kTerms; ++i) rows.columns.push_back(layout_.size + i);
    rows.J = Eigen::MatrixXd::Zero(count, static_cast<Eigen::Index>(rows.columns.size()));
    return rows;
  }

  // Moving the principal point moves an observed point back: its columns, those that begin at
  // `center`, are those of shifts.
  void AddTerms(int center, int view, const Eigen::Vector2d& pixel, Rows* rows) {
    if (!has_terms_[view]) return;
    designs_.push_back(DesignAt(bundle_.views[view].camera, pixel));
    rows->J.rightCols<kTerms>() += rows->J.middleCols<2>(center) * designs_.back();
  }

  void Add(const Rows& rows, const Eigen::VectorXd& residual, double weight, int cluster) {
    if (cluster == static_cast<int>(sums_.b.size()))
      sums_.b.emplace_back(Eigen::VectorXd::Zero(sums_.A.rows()));
    const Eigen::MatrixXd A = weight * rows.J.transpose() * rows.J;
    const Eigen::VectorXd b = weight * rows.J.transpose() * residual;
    for (Eigen::Index i = 0; i < b.size(); ++i) {
      sums_.b[cluster](rows.columns[i]) += b(i);
      for (Eigen::Index k = 0; k < b.size(); ++k)
        sums_.A(rows.columns[k], rows.columns[i]) += A(k, i);
    }
  }

  void AddEdges() {
    std::map<std::pair<int, int>, int> clusters;
    EdgeRow of_edge;
    for (const EdgeObservation& o : bundle_.edges) {
      if (!LinearizeEdge(bundle_, o, &of_edge)) continue;
      Rows rows = MakeRows(
          1,
          {{layout_.view[o.view], kViewParameters}, {layout_.object[o.object], kObjectParameters}});
      rows.J.leftCols(of_edge.J.size()) = of_edge.J.transpose();
      AddTerms(kCenterColumn, o.view, o.edge_point, &rows);
      const auto [at, is_new] =
          clusters.try_emplace({o.object, o.edge}, static_cast<int>(sums_.b.size()));
      Add(rows,
          Eigen::VectorXd::Constant(1, of_edge.residual),
          RobustWeight(bundle_.cauchy_sigmas, of_edge.residual * of_edge.residual),
          at->second);
    }
  }

  void AddPlane() {
    PlaneRow of_cell;
    for (const PlaneCell& cell : bundle_.plane.cells) {
      if (!LinearizePlaneCell(bundle_, cell, &of_cell)) continue;
      Rows rows = MakeRows(2,
                           {{layout_.view[cell.view_a], kViewParameters},
                            {layout_.view[cell.view_b], kViewParameters},
                            {layout_.plane, kPlaneParameters}});
      rows.J.leftCols(of_cell.J.cols()) = of_cell.J;
      AddTerms(kCenterColumn, cell.view_a, cell.pixel_a, &rows);
      AddTerms(kViewParameters + kCenterColumn, cell.view_b, cell.pixel_b, &rows);
      Add(rows,
          of_cell.residual,
          RobustWeight(bundle_.plane_cauchy_sigmas, of_cell.residual.squaredNorm()),
          static_cast<int>(sums_.b.size()));
    }
  }

  void AddTexture() {
    TextureRows of_point;
    for (const TexturePoint& point : bundle_.texture.points) {
      if (!LinearizeTexturePoint(bundle_.views, bundle_.texture, point, 1.0, &of_point)) continue;
      std::vector<std::pair<int, int>> blocks;
      for (const int v : of_point.views) blocks.emplace_back(layout_.view[v], kViewParameters);
      Rows rows = MakeRows(static_cast<int>(of_point.residual.size()), blocks);
      rows.J.leftCols(of_point.J.cols()) = of_point.J;
      for (std::size_t i = 0; i < point.seen.size(); ++i) {
        AddTerms(kViewParameters * static_cast<int>(i) + kCenterColumn,
                 point.seen[i].view,
                 point.seen[i].pixel,
                 &rows);
      }
      Add(rows, of_point.residual, 1.0, static_cast<int>(sums_.b.size()));
    }
  }

  void AddPriors() {
    const std::vector<int> columns = IntrinsicsColumns(layout_);
    Eigen::MatrixXd A = sums_.A.topLeftCorner(layout_.size, layout_.size);
    Eigen::VectorXd b = Eigen::VectorXd::Zero(layout_.size);
    for (std::size_t v = 0; v < bundle_.views.size(); ++v) {
      if (!bundle_.views[v].known) continue;
      // A prior of k1 would have the others explain what it does not let k1 do.
      Eigen::Vector4d w = PriorWeights(bundle_, static_cast<int>(v));
      if (has_terms_[v]) w(3) = 0.0;
      A.diagonal().segment<4>(columns[v]) += w.cwiseAbs2();
      b.segment<4>(columns[v]) += w.cwiseProduct(PriorResiduals(bundle_, static_cast<int>(v)));
    }
    AddSimilarity(bundle_.views, bundle_.alike, columns, &A, &b);
    sums_.A.topLeftCorner(layout_.size, layout_.size) = A;
    sums_.prior = b;
  }

  const SceneBundle& bundle_;
  SceneBundleLayout layout_;
  std::vector<bool> has_terms_;
  Sums sums_;
  std::vector<Design> designs_;
};

}  // namespace

Eigen::Vector2d ShiftByTerms(const PinholeCamera& camera,
                             const LensTerms& terms,
                             const Eigen::Vector2d& pixel) {
  if (terms.none()) return Eigen::Vector2d::Zero();
  return DesignAt(camera, pixel) * Eigen::Vector3d(terms.k2, terms.p1, terms.p2);
}

Eigen::Vector2d WithoutTerms(const PinholeCamera& camera,
                             const LensTerms& terms,
                             const Eigen::Vector2d& pixel) {
  Eigen::Vector2d out = pixel;
  for (int i = 0; i < 5; ++i) out = pixel - ShiftByTerms(camera, terms, out);
  return out;
}

std::optional<LensFit> FitLensTerms(const SceneBundle& bundle,
                                    const std::vector<int>& views,
                                    const LensTermOptions& options) {
  const Accumulator rows(bundle, views);
  const int size = rows.layout().size;
  const std::vector<bool> held = FixedMask(bundle, rows.layout(), {});
  Eigen::MatrixXd A = rows.sums().A.topLeftCorner(size, size);
  Eigen::MatrixXd cross = rows.sums().A.topRightCorner(size, kTerms);
  for (int i = 0; i < size; ++i) {
    if (!held[i]) continue;
    A.row(i).setZero();
    A.col(i).setZero();
    A(i, i) = 1.0;
    cross.row(i).setZero();
  }
  A.diagonal().array() += 1e-12 * A.diagonal().maxCoeff();
  const Eigen::LDLT<Eigen::MatrixXd> solver(A);
  if (solver.info() != Eigen::Success) return std::nullopt;
  const Eigen::MatrixXd followed = solver.solve(cross);  // how the others follow the terms
  if (!followed.allFinite()) return std::nullopt;
  Eigen::Matrix3d information =
      rows.sums().A.bottomRightCorner<kTerms, kTerms>() - cross.transpose() * followed;
  // What the clusters say of the terms, the others' part taken out; their own scatter is its
  // variance.
  Eigen::Vector3d score = -followed.transpose() * rows.sums().prior;
  Eigen::Matrix3d variance = Eigen::Matrix3d::Zero();
  for (const Eigen::VectorXd& b : rows.sums().b) {
    const Eigen::Vector3d own = b.tail<kTerms>() - followed.transpose() * b.head(size);
    score += own;
    variance += own * own.transpose();
  }
  const auto inverse = variance.ldlt();
  if (!(variance.diagonal().minCoeff() > 0) || inverse.info() != Eigen::Success)
    return std::nullopt;
  LensFit out;
  out.proof = score.dot(inverse.solve(score));
  information.diagonal() +=
      Eigen::Vector3d(options.k2_sigma, options.tangential_sigma, options.tangential_sigma)
          .cwiseInverse()
          .cwiseAbs2();
  const Eigen::Vector3d terms = -information.ldlt().solve(score);
  if (!terms.allFinite() || !std::isfinite(out.proof)) return std::nullopt;
  out.terms = {terms(0), terms(1), terms(2)};
  out.shift_px = rows.LargestShift(out.terms);
  return out;
}

}  // namespace horopter
