#include "server/vision/euclidean/edge_observations.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "server/base/parallel_for.h"
#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/geometry/hidden_tolerance.h"
#include "server/vision/recognition/aspects/visible_edges.h"

namespace horopter {
namespace {

constexpr double kMaxTurnRad = 0.35;  // between a sample's and its edge point's direction
constexpr double kEndOn = 0.05;       // sine of the angle between edge and ray
constexpr double kNearestM = 1e-3;    // nearer to the camera nothing is projected

PinholeCamera WorkingCamera(const PinholeCamera& camera, const EdgeGrid& grid) {
  const double s = grid.working_from_image();
  return {
      grid.width(), grid.height(), camera.focal_px * s, camera.cx * s, camera.cy * s, camera.k1};
}

// Direction of the projected edge (through p along q, camera frame) times the depth squared; empty
// when seen nearly end-on. A lens bends straight edges: without that, edges would seem to say where
// they lie along themselves.
std::optional<Eigen::Vector2d> ImageTangent(const Eigen::Vector3d& p,
                                            const Eigen::Vector3d& q,
                                            double k1) {
  const Eigen::Vector2d along(q.x() * p.z() - p.x() * q.z(), q.y() * p.z() - p.y() * q.z());
  if (along.norm() < kEndOn * p.z()) return std::nullopt;
  const Eigen::Vector2d n = p.head<2>() / p.z();
  return (1.0 + k1 * n.squaredNorm()) * along + 2.0 * k1 * n.dot(along) * n;
}

// Every sample, or as many as wanted, evenly spread.
void Thin(int wanted, VisibleSamples* seen) {
  const std::size_t n = seen->samples.size();
  if (wanted <= 0 || n <= static_cast<std::size_t>(wanted)) return;
  for (int i = 0; i < wanted; ++i) seen->samples[i] = seen->samples[i * n / wanted];
  seen->samples.resize(wanted);
  seen->spacing_m *= static_cast<double>(n) / wanted;
}

constexpr int kChainsPerView = 4096;  // a chain of one view is no edge of another

std::vector<EdgeSample> SamplesOfAspect(const PreparedObject& model,
                                        const PinholeCamera& camera,
                                        const Rigid3& camera_from_object,
                                        int view,
                                        double* spacing_m) {
  std::vector<EdgeSample> out;
  const VisibleEdges edges =
      FindVisibleEdges(model.aspects->object.mesh, camera, camera_from_object);
  double length = 0.0;
  for (const VisibleEdgePoint& p : edges.points) {
    if (!out.empty() && out.back().edge == p.chain + view * kChainsPerView)
      length += (p.point - out.back().point).norm();
    out.push_back({p.point, p.direction, p.chain % kChainsPerView + view * kChainsPerView});
  }
  *spacing_m = out.empty() ? 0.0 : length / static_cast<double>(out.size());
  return out;
}

}  // namespace

EdgeGrid::EdgeGrid(const ImageFeatures& features) {
  if (features.width > kAdjustmentWidth) {
    scale_ = static_cast<double>(kAdjustmentWidth) / features.width;
  }
  width_ = std::max(1, static_cast<int>(std::lround(features.width * scale_)));
  height_ = std::max(1, static_cast<int>(std::lround(features.height * scale_)));
  columns_ = static_cast<int>(width_ / kCellPx) + 1;
  rows_ = static_cast<int>(height_ / kCellPx) + 1;
  const std::vector<EdgePoint> points = CollectEdgePoints(features);
  const auto cell_of = [&](const EdgePoint& p) {
    const double x = p.point.x() * scale_ / kCellPx, y = p.point.y() * scale_ / kCellPx;
    if (!(x >= 0 && y >= 0 && x < columns_ && y < rows_)) return -1;
    return static_cast<int>(y) * columns_ + static_cast<int>(x);
  };
  std::vector<int> cells;
  cells.reserve(points.size());
  first_.assign(static_cast<std::size_t>(columns_) * rows_ + 1, 0);
  for (const EdgePoint& p : points) {
    cells.push_back(cell_of(p));
    if (cells.back() >= 0) ++first_[cells.back() + 1];
  }
  for (std::size_t c = 1; c < first_.size(); ++c) first_[c] += first_[c - 1];
  points_.resize(first_.back());
  std::vector<int> next(first_.begin(), first_.end() - 1);
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (cells[i] >= 0) points_[next[cells[i]]++] = points[i];
  }
}

const EdgePoint* EdgeGrid::Nearest(const Eigen::Vector2d& u,
                                   double direction_rad,
                                   double reach_px,
                                   double max_turn_rad) const {
  const double x = u.x(), y = u.y();
  if (!(x > -reach_px && y > -reach_px && x < width_ + reach_px && y < height_ + reach_px)) {
    return nullptr;
  }
  const auto cell = [](double at, int n) {
    return std::clamp(static_cast<int>(std::floor(at / kCellPx)), 0, n - 1);
  };
  const int x0 = cell(x - reach_px, columns_), x1 = cell(x + reach_px, columns_);
  const int y0 = cell(y - reach_px, rows_), y1 = cell(y + reach_px, rows_);
  const EdgePoint* best = nullptr;
  double best_squared = reach_px * reach_px;
  for (int r = y0; r <= y1; ++r) {
    // The cells of a row lie one after the other.
    const int from = first_[r * columns_ + x0], to = first_[r * columns_ + x1 + 1];
    for (int i = from; i < to; ++i) {
      const EdgePoint& e = points_[i];
      const double dx = e.point.x() * scale_ - x, dy = e.point.y() * scale_ - y;
      const double squared = dx * dx + dy * dy;
      if (squared >= best_squared) continue;
      double turn = std::abs(e.direction - direction_rad);
      while (turn > M_PI) turn -= M_PI;
      if (std::min(turn, M_PI - turn) > max_turn_rad) continue;
      best_squared = squared;
      best = &e;
    }
  }
  return best;
}

std::vector<VisibleSamples> FindVisibleSamples(std::span<const AdjustedView> views,
                                               std::span<const AdjustedObject> objects,
                                               std::span<const EdgeGrid> grids,
                                               const ObservationOptions& options) {
  const int count = static_cast<int>(objects.size());
  std::vector<VisibleSamples> out(views.size() * objects.size());
  ParallelFor(static_cast<int>(views.size()), options.threads, [&](int v) {
    if (!views[v].known) return;
    const PinholeCamera camera = WorkingCamera(views[v].camera, grids[v]);
    DepthBuffer depth = MakeDepthBuffer(camera.width, camera.height);
    for (const AdjustedObject& o : objects) {
      RenderDepth(
          o.model->model.mesh, camera, views[v].camera_from_scene * o.scene_from_object, &depth);
    }
    for (int k = 0; k < count; ++k) {
      const PreparedObject& model = *objects[k].model;
      const Rigid3 pose = views[v].camera_from_scene * objects[k].scene_from_object;
      const double tolerance_m = kHiddenShareAdjusted * model.model.diameter_m;
      VisibleSamples& seen = out[static_cast<std::size_t>(v) * count + k];
      seen.spacing_m = model.sample_spacing_m;
      const bool by_aspect = options.aspects && model.aspects != nullptr;
      const std::vector<EdgeSample> of_aspect =
          by_aspect ? SamplesOfAspect(model, camera, pose, v, &seen.spacing_m)
                    : std::vector<EdgeSample>();
      for (const EdgeSample& sample : by_aspect ? of_aspect : model.samples) {
        const Eigen::Vector3d p = pose * sample.point.cast<double>();
        if (p.z() < kNearestM || !IsVisible(depth, Project(camera, p), p.z(), tolerance_m) ||
            !ImageTangent(p, pose.R * sample.tangent.cast<double>(), camera.k1)) {
          continue;
        }
        seen.samples.push_back(sample);
      }
      Thin(options.samples_per_view, &seen);
      seen.view = v;
      seen.object = k;
    }
  });
  std::erase_if(out, [](const VisibleSamples& s) { return s.samples.empty(); });
  return out;
}

std::vector<EdgeObservation> ObserveEdges(std::span<const AdjustedView> views,
                                          std::span<const AdjustedObject> objects,
                                          std::span<const EdgeGrid> grids,
                                          std::span<const VisibleSamples> visible,
                                          const ObservationOptions& options) {
  std::vector<std::vector<EdgeObservation>> parts(visible.size());
  ParallelFor(static_cast<int>(visible.size()), options.threads, [&](int part) {
    const VisibleSamples& seen = visible[part];
    const EdgeGrid& grid = grids[seen.view];
    const PinholeCamera camera = WorkingCamera(views[seen.view].camera, grid);
    const Rigid3 pose = views[seen.view].camera_from_scene * objects[seen.object].scene_from_object;
    for (const EdgeSample& sample : seen.samples) {
      const Eigen::Vector3d p = pose * sample.point.cast<double>();
      if (p.z() < kNearestM) continue;
      const auto along = ImageTangent(p, pose.R * sample.tangent.cast<double>(), camera.k1);
      if (!along) continue;
      const Eigen::Vector2d u = Project(camera, p);
      const EdgePoint* e =
          grid.Nearest(u, std::atan2(along->y(), along->x()), options.search_px, kMaxTurnRad);
      if (e == nullptr) continue;
      const double length = along->norm();
      const Eigen::Vector2d normal = Eigen::Vector2d(-along->y(), along->x()) / length;
      EdgeObservation o;
      o.view = seen.view;
      o.object = seen.object;
      o.edge = sample.edge;
      o.point_in_object = sample.point.cast<double>();
      o.edge_point = e->point.cast<double>();
      o.normal = normal;
      o.residual_px = normal.dot(u - o.edge_point * grid.working_from_image());
      o.spacing_px = length / (p.z() * p.z()) * camera.focal_px * seen.spacing_m;
      parts[part].push_back(o);
    }
  });
  std::vector<EdgeObservation> out;
  for (const auto& part : parts) out.insert(out.end(), part.begin(), part.end());
  return out;
}

}  // namespace horopter
