#include "tests/support/joint_adjustment.h"

#include <algorithm>
#include <cmath>

#include "server/vision/euclidean/scene_bundle.h"

namespace horopter {
namespace {

// Prior of the joint adjustment: photographs are rarely cut out.
constexpr double kCenterSigma = 0.016;  // of the width
// Of ln f about 1.2 widths; wide, as nothing is known of the lens.
constexpr double kFocalLogSigma = 0.7;
constexpr double kAlonePx = 1e3;  // spacing of observations that each count by themselves

SceneBundle BundleOf(std::span<const std::optional<CameraMatrix>> cameras,
                     std::span<const Eigen::Vector2i> sizes,
                     const Decomposition& start,
                     std::span<const PreparedObject> models) {
  SceneBundle bundle;
  for (std::size_t v = 0; v < cameras.size(); ++v) {
    const int w = sizes[v].x(), h = sizes[v].y();
    const auto camera =
        cameras[v] ? UpgradeCamera(*cameras[v], start.metric_from_scene, w, h) : std::nullopt;
    bundle.views.push_back({});
    bundle.priors.push_back({});
    bundle.working_from_image.push_back(1.0);
    if (!camera) continue;
    bundle.views.back() = {true, camera->camera, camera->camera_from_metric};
    bundle.priors.back() = {std::log(1.2 * w),
                            0.5 * (w - 1),
                            0.5 * (h - 1),
                            0.0,
                            kFocalLogSigma,
                            kCenterSigma * w,
                            1e-4};
  }
  for (std::size_t i = 0; i < models.size(); ++i) {
    bundle.objects.push_back({start.metric_from_object[i], &models[i]});
  }
  bundle.log_scale.assign(models.size(), 0.0);
  return bundle;
}

// A point is two edges through it that are orthogonal.
void AddPoints(std::span<const ObjectPointObservation> points, SceneBundle* bundle) {
  for (const ObjectPointObservation& o : points) {
    if (!bundle->views[o.view].known) continue;
    for (int axis = 0; axis < 2; ++axis) {
      EdgeObservation e;
      e.view = o.view;
      e.object = o.object;
      e.point_in_object = o.point_in_object;
      e.edge_point = o.pixel;
      e.normal = Eigen::Vector2d::Unit(axis);
      e.spacing_px = kAlonePx;
      bundle->edges.push_back(e);
    }
  }
}

// Both ends of the piece against the points of the projected edge that are nearest to them.
void AddEdge(const ObjectEdgeObservation& o, SceneBundle* bundle) {
  const AdjustedView& view = bundle->views[o.view];
  if (!view.known) return;
  const Rigid3 pose = view.camera_from_scene * bundle->objects[o.object].scene_from_object;
  const Eigen::Vector3d a = pose * o.start_in_object, b = pose * o.end_in_object;
  if (!(a.z() > 0.0 && b.z() > 0.0)) return;
  const Eigen::Vector2d from = Project(view.camera, a);
  const Eigen::Vector2d along = Project(view.camera, b) - from;
  const double squared = along.squaredNorm();
  if (!(squared > 1.0)) return;  // seen end-on
  for (const Eigen::Vector2d& pixel : {o.start, o.end}) {
    // s in the image is s z_a / (z_b + s (z_a - z_b)) of the way on the edge.
    const double s = along.dot(pixel - from) / squared;
    const double share = s * a.z() / (b.z() + s * (a.z() - b.z()));
    EdgeObservation e;
    e.view = o.view;
    e.object = o.object;
    e.point_in_object = o.start_in_object + share * (o.end_in_object - o.start_in_object);
    e.edge_point = pixel;
    e.normal = Eigen::Vector2d(-along.y(), along.x()) / std::sqrt(squared);
    e.spacing_px = kAlonePx;
    bundle->edges.push_back(e);
  }
}

}  // namespace

absl::StatusOr<JointAdjustment> AdjustJointly(std::span<const std::optional<CameraMatrix>> cameras,
                                              std::span<const Eigen::Vector2i> sizes,
                                              std::span<const ObjectPointObservation> points,
                                              std::span<const ObjectEdgeObservation> edges,
                                              const Decomposition& start,
                                              double sigma_px) {
  std::vector<PreparedObject> models(start.metric_from_object.size());
  SceneBundle bundle = BundleOf(cameras, sizes, start, models);
  bundle.edge_sigma_px = sigma_px;
  bundle.cauchy_sigmas = 6.0;
  SceneBundleOptions options;
  options.max_iterations = 60;
  options.min_decrease = 1e-7;
  // Where on an edge a piece ends, and the edge's direction, follow the poses.
  const int rounds = edges.empty() ? 1 : 3;
  for (int round = 0; round < rounds; ++round) {
    bundle.edges.clear();
    AddPoints(points, &bundle);
    for (const ObjectEdgeObservation& e : edges) AddEdge(e, &bundle);
    std::stable_sort(bundle.edges.begin(), bundle.edges.end(), [](const auto& a, const auto& b) {
      return std::pair(a.view, a.object) < std::pair(b.view, b.object);
    });
    if (!AdjustBundle(options, &bundle)) {
      return absl::FailedPreconditionError("the joint adjustment failed");
    }
  }
  JointAdjustment out;
  for (const AdjustedView& view : bundle.views) {
    out.cameras.push_back(
        view.known ? std::optional<MetricCamera>(MetricCamera{view.camera, view.camera_from_scene})
                   : std::nullopt);
  }
  for (const AdjustedObject& o : bundle.objects) {
    out.metric_from_object.push_back(o.scene_from_object);
  }
  return out;
}

}  // namespace horopter
