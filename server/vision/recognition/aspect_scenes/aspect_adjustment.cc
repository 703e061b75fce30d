#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_search/pose_edges.h"

namespace horopter {
namespace {

constexpr int kViewParameters = 7;     // rotation, translation, ln f
constexpr int kObjectParameters = 6;   // rotation about the object's origin, translation
constexpr double kMinDepth = 1e-4;     // metres
constexpr double kStaleEdgesPx = 2.0;  // poses that shifted by less keep their edges; chosen
// Weakly seen directions stay near where they were: radians, metres over the depth.
constexpr double kRotationSigma = 0.5;
constexpr double kTranslationSigma = 0.5;
// Deviation of the views' log focal lengths from their mean; Cauchy's loss beyond a few of them, as
// a set may come from several cameras. Sets of cad-dev, parts-dev and parts-train deviate by 0.11
// at most. Much less than that, since rows along an edge err together. Commit 79ca89f.
constexpr double kAlikeSigma = 0.07;
constexpr double kAlikeReach = 2.0;

Eigen::Matrix3d Cross(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Eigen::Matrix3d Rotation(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  if (angle < 1e-12) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, w / angle).toRotationMatrix();
}

// Where each view's and object's parameters begin, and that of ln unit_m; -1: none.
struct Layout {
  std::vector<int> view, object;
  int unit = -1;
  int size = 0;
};

Layout LayOut(const AspectScene& scene, const CamerasPrior* prior) {
  Layout layout;
  for (const auto& view : scene.views) {
    layout.view.push_back(view ? layout.size : -1);
    if (view) layout.size += kViewParameters;
  }
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const bool free = i > 0 || prior != nullptr;
    layout.object.push_back(free ? layout.size : -1);
    if (free) layout.size += kObjectParameters;
  }
  if (prior != nullptr && !prior->scale_known) layout.unit = layout.size++;
  return layout;
}

// d(normal . projection) / dx; the lens is left out of the derivative, not of the residual.
Eigen::Matrix<double, 1, 3> ProjectionSlope(double focal_px,
                                            const Eigen::Vector2d& normal,
                                            const Eigen::Vector3d& x) {
  const double s = focal_px / x.z();
  return {s * normal.x(), s * normal.y(), -s / x.z() * (normal.x() * x.x() + normal.y() * x.y())};
}

struct Equations {
  Eigen::MatrixXd H;
  Eigen::VectorXd g;
  double cost = 0.0;  // with priors
  double rows_cost = 0.0;
  double weight = 0.0;
};

void AddRow(const SceneRow& row,
            const AspectScene& scene,
            const Layout& layout,
            double inverse_variance,
            Equations* out) {
  const AspectSceneView& view = *scene.views[row.view];
  const Rigid3& pose = scene.objects[row.object].scene_from_object;
  const Eigen::Vector3d turned = pose.R * row.point;
  const Eigen::Vector3d in_scene = turned + pose.t;
  const Eigen::Vector3d x = view.camera_from_scene * in_scene;
  if (x.z() < kMinDepth) return;
  const double r = row.normal.dot(row.target - Project(view.camera, x));
  const double w = row.weight * inverse_variance;
  out->rows_cost += row.weight * r * r;
  out->weight += row.weight;
  out->cost += w * r * r;
  const double f = view.camera.focal_px;
  const Eigen::Matrix<double, 1, 3> dx = ProjectionSlope(f, row.normal, x);
  Eigen::Matrix<double, 1, kViewParameters> jv;
  jv.head<3>() = -dx * Cross(x - view.camera_from_scene.t);
  jv.segment<3>(3) = dx;
  jv(6) = f / x.z() * (row.normal.x() * x.x() + row.normal.y() * x.y());
  const int a = layout.view[row.view], b = layout.object[row.object];
  out->H.block<kViewParameters, kViewParameters>(a, a) += w * jv.transpose() * jv;
  out->g.segment<kViewParameters>(a) += w * r * jv.transpose();
  if (b < 0) return;
  const Eigen::Matrix<double, 1, 3> ds = dx * view.camera_from_scene.R;
  Eigen::Matrix<double, 1, kObjectParameters> jo;
  jo.head<3>() = -ds * Cross(turned);
  jo.tail<3>() = ds;
  out->H.block<kObjectParameters, kObjectParameters>(b, b) += w * jo.transpose() * jo;
  const Eigen::Matrix<double, kViewParameters, kObjectParameters> cross = w * jv.transpose() * jo;
  out->H.block<kViewParameters, kObjectParameters>(a, b) += cross;
  out->H.block<kObjectParameters, kViewParameters>(b, a) += cross.transpose();
  out->g.segment<kObjectParameters>(b) += w * r * jo.transpose();
}

// The vector whose rotation it is.
Eigen::Vector3d RotationVector(const Eigen::Matrix3d& R) {
  const Eigen::AngleAxisd turn(R);
  return turn.angle() * turn.axis();
}

// A view's camera is where the prior has it: its turn, and its centre in its own frame.
void AddPrior(const CamerasPrior& prior,
              const AspectScene& scene,
              const Layout& layout,
              std::size_t v,
              Equations* out) {
  if (!prior.camera_from_world[v]) return;
  const Rigid3& here = scene.views[v]->camera_from_scene;
  const Rigid3& there = *prior.camera_from_world[v];
  const int a = layout.view[v];
  const double w = 1.0 / (prior.rotation_sigma_rad * prior.rotation_sigma_rad);
  const Eigen::Vector3d turn = RotationVector(here.R * there.R.transpose());
  out->H.block<3, 3>(a, a).diagonal().array() += w;
  out->g.segment<3>(a) -= w * turn;
  out->cost += w * turn.squaredNorm();
  // e = t + unit R C, of the centre C = -R' t of the prior.
  const Eigen::Vector3d center = here.R * (prior.unit_m * there.Inverse().t);
  const Eigen::Vector3d e = here.t + center;
  const double distance = (here * scene.objects.front().scene_from_object.t).norm();
  const double sigma = prior.position_sigma * std::max(distance, kMinDepth);
  Eigen::Matrix<double, 3, kViewParameters> j = Eigen::Matrix<double, 3, kViewParameters>::Zero();
  j.leftCols<3>() = -Cross(center);
  j.middleCols<3>(3).setIdentity();
  const double q = 1.0 / (sigma * sigma);
  out->H.block<kViewParameters, kViewParameters>(a, a) += q * j.transpose() * j;
  out->g.segment<kViewParameters>(a) -= q * j.transpose() * e;
  out->cost += q * e.squaredNorm();
  if (layout.unit < 0) return;
  const int u = layout.unit;
  out->H(u, u) += q * center.squaredNorm();
  out->g(u) -= q * center.dot(e);
  const Eigen::Matrix<double, kViewParameters, 1> cross = q * j.transpose() * center;
  out->H.block<kViewParameters, 1>(a, u) += cross;
  out->H.block<1, kViewParameters>(u, a) += cross.transpose();
}

Equations Linearise(std::span<const SceneRow> rows,
                    double sigma_px,
                    const AspectScene& scene,
                    const CamerasPrior* prior,
                    const Layout& layout) {
  Equations out;
  out.H.setZero(layout.size, layout.size);
  out.g.setZero(layout.size);
  const double inverse_variance = 1.0 / (sigma_px * sigma_px);
  for (const SceneRow& row : rows) AddRow(row, scene, layout, inverse_variance, &out);
  double mean = 0.0, count = 0.0;
  for (const auto& view : scene.views) {
    if (view) mean += std::log(RelativeFocal(view->camera)), count += 1.0;
  }
  mean /= std::max(1.0, count);
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    const AspectSceneView& view = *scene.views[v];
    const int at = layout.view[v] + 6;
    const double w = 1.0 / (view.log_focal_sigma * view.log_focal_sigma);
    const double off = view.prior_log_focal - std::log(view.camera.focal_px);
    out.H(at, at) += w;
    out.g(at) += w * off;
    out.cost += w * off * off;
    // The mean is fixed for the step: it moves with the views, and is recomputed before the next.
    const double unlike = (mean - std::log(RelativeFocal(view.camera))) / kAlikeSigma;
    const double reach = kAlikeReach * kAlikeReach;
    const double alike = 1.0 / (1.0 + unlike * unlike / reach);
    out.H(at, at) += alike / (kAlikeSigma * kAlikeSigma);
    out.g(at) += alike * unlike / kAlikeSigma;
    out.cost += reach * std::log1p(unlike * unlike / reach);
    if (prior != nullptr) AddPrior(*prior, scene, layout, v, &out);
  }
  return out;
}

AspectScene Moved(const AspectScene& scene, const Layout& layout, const Eigen::VectorXd& step) {
  AspectScene out = scene;
  for (std::size_t v = 0; v < out.views.size(); ++v) {
    if (!out.views[v]) continue;
    const auto d = step.segment<kViewParameters>(layout.view[v]);
    Rigid3& pose = out.views[v]->camera_from_scene;
    pose.R = Rotation(d.head<3>()) * pose.R;
    pose.t += d.segment<3>(3);
    out.views[v]->camera.focal_px *= std::exp(std::clamp(d(6), -0.3, 0.3));
  }
  for (std::size_t i = 0; i < out.objects.size(); ++i) {
    if (layout.object[i] < 0) continue;
    const auto d = step.segment<kObjectParameters>(layout.object[i]);
    Rigid3& pose = out.objects[i].scene_from_object;
    pose.R = Rotation(d.head<3>()) * pose.R;
    pose.t += d.tail<3>();
  }
  return out;
}

}  // namespace

double RelativeFocal(const PinholeCamera& camera) {
  return camera.focal_px / std::max(1, std::max(camera.width, camera.height));
}

AspectScene WithOneFocal(AspectScene scene,
                         const Eigen::Vector3d& middle,
                         double relative_focal,
                         double log_focal_sigma) {
  for (auto& view : scene.views) {
    if (!view) continue;
    const double ratio = relative_focal / RelativeFocal(view->camera);
    // Farther away by as much as it is drawn larger.
    view->camera_from_scene.t.z() += (view->camera_from_scene * middle).z() * (ratio - 1.0);
    view->camera.focal_px *= ratio;
    view->prior_log_focal = std::log(view->camera.focal_px);
    view->log_focal_sigma = log_focal_sigma;
  }
  return scene;
}

double AdjustToRows(std::span<const SceneRow> rows,
                    int steps,
                    double sigma_px,
                    AspectScene* scene,
                    CamerasPrior* prior) {
  if (rows.empty() || scene->objects.empty()) return 0.0;
  const Layout layout = LayOut(*scene, prior);
  Equations now = Linearise(rows, sigma_px, *scene, prior, layout);
  double damping = 1e-4;
  for (int i = 0; i < steps; ++i) {
    bool better = false;
    for (int attempt = 0; attempt < 5 && !better; ++attempt) {
      Eigen::MatrixXd H = now.H;
      for (int k = 0; k < layout.size; ++k) H(k, k) += damping * now.H(k, k) + 1e-9;
      // Directions no row sees: an object or view without rows stays.
      for (std::size_t v = 0; v < scene->views.size(); ++v) {
        if (layout.view[v] < 0) continue;
        const double depth = std::max(scene->views[v]->camera_from_scene.t.norm(), 0.01);
        for (int k = 0; k < 3; ++k) {
          H(layout.view[v] + k, layout.view[v] + k) += 1.0 / (kRotationSigma * kRotationSigma);
          H(layout.view[v] + 3 + k, layout.view[v] + 3 + k) +=
              1.0 / (kTranslationSigma * kTranslationSigma * depth * depth);
        }
      }
      for (std::size_t o = 0; o < scene->objects.size(); ++o) {
        if (layout.object[o] < 0) continue;
        for (int k = 0; k < 6; ++k) H(layout.object[o] + k, layout.object[o] + k) += 1.0;
      }
      const Eigen::VectorXd step = H.ldlt().solve(now.g);
      if (!step.allFinite()) break;
      AspectScene moved = Moved(*scene, layout, step);
      std::optional<CamerasPrior> rescaled;
      if (layout.unit >= 0) {
        rescaled = *prior;
        rescaled->unit_m *= std::exp(std::clamp(step(layout.unit), -0.3, 0.3));
      }
      Equations then = Linearise(rows, sigma_px, moved, rescaled ? &*rescaled : prior, layout);
      if (then.cost < now.cost && then.weight >= 0.9 * now.weight) {
        *scene = std::move(moved);
        if (rescaled) *prior = *std::move(rescaled);
        now = std::move(then);
        better = true;
        damping = std::max(1e-7, 0.2 * damping);
      } else {
        damping *= 20.0;
      }
    }
    if (!better) break;
  }
  return now.weight > 0 ? std::sqrt(now.rows_cost / now.weight) : 0.0;
}

Rigid3 AdjustObjectToRows(std::span<const SceneRow> rows,
                          const std::vector<std::optional<AspectSceneView>>& views,
                          const Rigid3& scene_from_object) {
  using Matrix6 = Eigen::Matrix<double, kObjectParameters, kObjectParameters>;
  using Vector6 = Eigen::Matrix<double, kObjectParameters, 1>;
  Matrix6 H = Matrix6::Identity() * 1e-6;
  Vector6 g = Vector6::Zero();
  for (const SceneRow& row : rows) {
    const AspectSceneView& view = *views[row.view];
    const Eigen::Vector3d turned = scene_from_object.R * row.point;
    const Eigen::Vector3d x =
        view.camera_from_scene * Eigen::Vector3d(turned + scene_from_object.t);
    if (x.z() < kMinDepth) continue;
    const double r = row.normal.dot(row.target - Project(view.camera, x));
    const Eigen::Matrix<double, 1, 3> ds =
        ProjectionSlope(view.camera.focal_px, row.normal, x) * view.camera_from_scene.R;
    Eigen::Matrix<double, 1, kObjectParameters> j;
    j.head<3>() = -ds * Cross(turned);
    j.tail<3>() = ds;
    H += row.weight * j.transpose() * j;
    g += row.weight * r * j.transpose();
  }
  const Vector6 step = H.ldlt().solve(g);
  if (!step.allFinite()) return scene_from_object;
  return {Rotation(step.head<3>()) * scene_from_object.R, scene_from_object.t + step.tail<3>()};
}

double AdjustToEdges(std::span<const AspectImage> images,
                     std::span<const RenderMesh* const> meshes,
                     const AspectAdjustmentOptions& options,
                     int threads,
                     AspectScene* scene,
                     CamerasPrior* prior) {
  const int views = static_cast<int>(scene->views.size());
  const int objects = static_cast<int>(scene->objects.size());
  double rms_px = 0.0;
  VisibleEdgeOptions visible;
  visible.render_px = options.render_px;
  std::vector<std::optional<PoseRendering>> rendered(views * objects);
  for (const double search : options.search_px) {
    std::vector<std::vector<ModelEdgePoint>> points(views * objects);
    PoseEdgeOptions edges;
    edges.search_px = search;
    ParallelFor(views * objects, threads, [&](int i) {
      const int v = i / objects, o = i % objects;
      if (!scene->views[v]) return;
      const AspectSceneView& view = *scene->views[v];
      if (!rendered[i])
        rendered[i].emplace(*meshes[scene->objects[o].object], visible, kStaleEdgesPx);
      points[i] = ThinnedEdgePoints(
          rendered[i]->At(view.camera,
                          view.camera_from_scene * scene->objects[o].scene_from_object),
          options.max_points);
    });
    for (int step = 0; step < options.steps; ++step) {
      std::vector<SceneRow> rows;
      for (int i = 0; i < views * objects; ++i) {
        const int v = i / objects, o = i % objects;
        if (points[i].empty()) continue;
        const AspectSceneView& view = *scene->views[v];
        for (const PoseEdgeMatch& m :
             MatchPoseEdges(images[v],
                            points[i],
                            view.camera,
                            view.camera_from_scene * scene->objects[o].scene_from_object,
                            edges)) {
          rows.push_back({v, o, m.point, m.matched, m.normal, m.weight});
        }
      }
      rms_px = AdjustToRows(rows, 1, options.sigma_px, scene, prior);
    }
  }
  return rms_px;
}

}  // namespace horopter
