#include "server/vision/recognition/aspect_scenes/transfer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/vision/recognition/aspect_search/aspect_score.h"
#include "server/vision/recognition/aspect_search/near_plane.h"

namespace horopter {
namespace {

constexpr std::size_t kMostPoints = 64;  // of an aspect: the first ones are spread evenly
constexpr float kSameSideCos = 0.9986f;  // 3 degrees, a third of what aspects are apart
// Working px between places along a ray, in the view that moves most
constexpr double kRayStepPx = 5.0;
constexpr int kMostRayPlaces = 400;   // ... and at most so many
constexpr int kAdjustRounds = 7;      // of the adjustment; the reach narrows
constexpr double kLastReachPx = 3.0;  // working px
constexpr double kTransferSigmaPx =
    3.0;  // of a row of the adjustment: neighbouring rows err together
constexpr double kChanceSupport = 0.35;  // of edges in a wrong place
constexpr double kPeakRatio = 1.06;      // units nearer than this to a better one are the same
constexpr double kShiftStepPx = 3.0;     // of ShiftViews, working px
constexpr double kShiftReachPx = 5.0;
constexpr int kAdjustSteps = 2;  // of a round

double AboveChance(double support) {
  return std::max(0.0, support - kChanceSupport) / (1.0 - kChanceSupport);
}

// A unit, and what the views show under it.
struct UnitSample {
  double unit_m, support;
};

// Those that are supported best and differ, at most so many.
std::vector<UnitSample> BestApart(std::vector<UnitSample> samples, int most) {
  std::stable_sort(samples.begin(), samples.end(), [](const UnitSample& a, const UnitSample& b) {
    return a.support > b.support;
  });
  std::vector<UnitSample> out;
  for (const UnitSample& s : samples) {
    if (static_cast<int>(out.size()) >= most || s.support <= 0.0) break;
    if (std::none_of(out.begin(), out.end(), [&](const UnitSample& other) {
          return std::max(other.unit_m / s.unit_m, s.unit_m / other.unit_m) < kPeakRatio;
        }))
      out.push_back(s);
  }
  return out;
}

// The view turned about its centre so that its image moves, working px.
AspectSceneView Shifted(const AspectSceneView& view, double focal_px, double dx, double dy) {
  const Eigen::Vector3d turn(-dy / focal_px, dx / focal_px, 0.0);
  AspectSceneView out = view;
  if (turn.norm() < 1e-12) return out;
  const Eigen::Matrix3d R = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
  out.camera_from_scene = {R * view.camera_from_scene.R, R * view.camera_from_scene.t};
  return out;
}

}  // namespace

ContourPoints::ContourPoints(std::span<const AspectModel> models)
    : models_(models), stored_(models.size()) {}

const ContourPoints::Stored& ContourPoints::StoredOf(int object) const {
  Stored& stored = stored_[object];
  std::call_once(stored.unpacked, [&] {
    const AspectSet& set = models_[object].object->aspects;
    for (int a = 0; a < static_cast<int>(set.aspects.size()); ++a) {
      stored.toward.emplace_back(-set.aspects[a].camera_from_object.row(2).transpose());
      std::vector<ModelEdgePoint>& points = stored.points.emplace_back();
      for (const AspectPoint& p : AspectPoints(set, a, kMostPoints))
        points.push_back({p.point, p.direction, 1.0f});
    }
  });
  return stored;
}

void ContourPoints::See(int object, const Rigid3& camera_from_object, Seen* seen) const {
  const Eigen::Vector3d center = models_[object].object->mesh.center.cast<double>();
  const Eigen::Vector3f toward =
      (-(camera_from_object.R.transpose() * (camera_from_object * center)).normalized())
          .cast<float>();
  if (!seen->points.empty() && seen->toward.dot(toward) > kSameSideCos) return;
  const Stored& stored = StoredOf(object);
  float best = -2.0f;
  std::size_t aspect = 0;
  const Rigid3* turn = nullptr;
  const auto look = [&](const Eigen::Vector3f& direction, const Rigid3* symmetry) {
    for (std::size_t a = 0; a < stored.toward.size(); ++a) {
      const float cosine = stored.toward[a].dot(direction);
      if (cosine > best) best = cosine, aspect = a, turn = symmetry;
    }
  };
  look(toward, nullptr);
  // Of views that symmetries make equal one is stored.
  for (const Rigid3& symmetry : models_[object].symmetries)
    look(symmetry.R.transpose().cast<float>() * toward, &symmetry);
  seen->toward = toward;
  if (stored.points.empty()) return;
  seen->points = stored.points[aspect];
  if (turn == nullptr) return;
  const Eigen::Matrix3f R = turn->R.cast<float>();
  const Eigen::Vector3f t = turn->t.cast<float>();
  for (ModelEdgePoint& p : seen->points) {
    p.point = R * p.point + t;
    p.direction = R * p.direction;
  }
}

void SortBySupport(std::vector<TransferredObject>* list) {
  std::stable_sort(list->begin(), list->end(), [](const auto& a, const auto& b) {
    return a.support > b.support;
  });
}

Transfer::Transfer(const AspectLinkInput& input,
                   const std::vector<std::optional<AspectSceneView>>& cameras,
                   const CamerasPrior& prior,
                   const ContourPoints& contours,
                   const TransferOptions& options)
    : in_(input), cameras_(cameras), prior_(prior), contours_(contours), options_(options) {}

TransferredObject Transfer::At(int view,
                               const Rigid3& camera_from_object,
                               double unit_m,
                               int object) const {
  TransferredObject out;
  out.unit_m = unit_m;
  out.scene.views = cameras_;
  for (auto& v : out.scene.views) {
    if (v) v->camera_from_scene.t *= unit_m / prior_.unit_m;
  }
  out.scene.objects = {
      {object, out.scene.views[view]->camera_from_scene.Inverse() * camera_from_object}};
  return out;
}

double Transfer::Support(const AspectScene& scene, double reach_px, int left_out) const {
  const AspectSceneObject& o = scene.objects.front();
  double sum = 0.0;
  ContourPoints::Seen seen;
  for (int v = 0; v < static_cast<int>(scene.views.size()); ++v) {
    if (!scene.views[v] || v == left_out) continue;
    const Rigid3 pose = scene.views[v]->camera_from_scene * o.scene_from_object;
    seen.points.clear();
    contours_.See(o.object, pose, &seen);
    sum += AboveChance(PointSupport(
        in_.images[v], seen.points, scene.views[v]->camera, pose, kFreeChance, reach_px));
  }
  return sum;
}

std::vector<TransferredObject> Transfer::Place(
    int view, const AspectHypothesis& h, const UnitRange& range, int least_views, int most) const {
  const AspectSceneView& from = *cameras_[view];
  const Rigid3 pose = WithFocal(h.camera_from_object, h.camera.focal_px, from.camera.focal_px);
  const Eigen::Vector3d center = in_.models[h.object].object->mesh.center.cast<double>();
  const int views = static_cast<int>(cameras_.size());
  // A view's pose of the object at a unit.
  std::vector<Rigid3> turned(views), baseline(views);
  for (int w = 0; w < views; ++w) {
    if (!cameras_[w] || w == view) continue;
    baseline[w] = cameras_[w]->camera_from_scene * from.camera_from_scene.Inverse();
    turned[w] = {baseline[w].R * pose.R, baseline[w].R * pose.t};
    baseline[w].t /= prior_.unit_m;
  }
  std::vector<UnitSample> samples;
  std::vector<ContourPoints::Seen> seen(views);
  double unit = range.least_m;
  for (int i = 0; i < kMostRayPlaces && unit <= range.most_m; ++i) {
    double support = 0.0, fastest = 1e-3;  // px per relative change of the unit
    int shown = 0;
    for (int w = 0; w < views; ++w) {
      if (!cameras_[w] || w == view) continue;
      Rigid3 there = turned[w];
      there.t += unit * baseline[w].t;
      const Eigen::Vector3d x = there * center;
      if (x.z() < kNearM) continue;
      const PinholeCamera& camera = cameras_[w]->camera;
      const Eigen::Vector2d at = Project(camera, x);
      if (!(at.x() >= 0 && at.y() >= 0 && at.x() < camera.width && at.y() < camera.height))
        continue;
      ++shown;
      const Eigen::Vector3d step = unit * baseline[w].t;
      const Eigen::Vector2d moved = (step.head<2>() - x.head<2>() / x.z() * step.z()) / x.z();
      fastest =
          std::max(fastest, camera.focal_px * in_.images[w].working_from_image * moved.norm());
      contours_.See(h.object, there, &seen[w]);
      support += AboveChance(PointSupport(
          in_.images[w], seen[w].points, camera, there, kFreeChance, options_.reach_px));
    }
    if (shown >= least_views) samples.push_back({unit, support});
    unit *= 1.0 + std::clamp(kRayStepPx / fastest, 2e-3, 0.05);
  }
  std::vector<TransferredObject> out;
  for (const UnitSample& s : BestApart(std::move(samples), most)) {
    Rigid3 placed = pose;
    if (range.known) placed.t += (prior_.unit_m / s.unit_m - 1.0) * (pose * center);
    out.push_back(At(view, placed, range.known ? prior_.unit_m : s.unit_m, h.object));
    out.back().support = s.support;
  }
  return out;
}

void Transfer::ShiftViews(AspectScene* scene) const {
  const AspectSceneObject& o = scene->objects.front();
  ContourPoints::Seen seen;
  for (std::size_t v = 0; v < scene->views.size(); ++v) {
    if (!scene->views[v]) continue;
    const AspectSceneView view = *scene->views[v];
    seen.points.clear();
    contours_.See(o.object, view.camera_from_scene * o.scene_from_object, &seen);
    const double focal = view.camera.focal_px * in_.images[v].working_from_image;
    double best = -1.0;
    const int reach = static_cast<int>(options_.reach_px / kShiftStepPx);
    for (int y = -reach; y <= reach; ++y) {
      for (int x = -reach; x <= reach; ++x) {
        const AspectSceneView shifted = Shifted(view, focal, x * kShiftStepPx, y * kShiftStepPx);
        // Far shifts are less likely: as much as three deviations cost a tenth.
        const double off = std::hypot(x, y) * kShiftStepPx / std::max(options_.reach_px, 1.0);
        const double support = PointSupport(in_.images[v],
                                            seen.points,
                                            shifted.camera,
                                            shifted.camera_from_scene * o.scene_from_object,
                                            kFreeChance,
                                            kShiftReachPx) -
                               0.1 * off * off;
        if (support > best) best = support, scene->views[v] = shifted;
      }
    }
  }
}

void Transfer::Adjust(TransferredObject* placed) const {
  AspectScene& scene = placed->scene;
  ShiftViews(&scene);
  const int object = scene.objects.front().object;
  std::vector<ContourPoints::Seen> seen(scene.views.size());
  CamerasPrior prior = prior_;
  prior.unit_m = placed->unit_m;
  PoseEdgeOptions edges;
  for (int round = 0; round < kAdjustRounds; ++round) {
    const double share = round / std::max(1.0, kAdjustRounds - 1.0);
    edges.search_px = options_.reach_px * std::pow(kLastReachPx / options_.reach_px, share);
    for (int step = 0; step < kAdjustSteps; ++step) {
      std::vector<SceneRow> rows;
      for (std::size_t v = 0; v < scene.views.size(); ++v) {
        if (!scene.views[v]) continue;
        const Rigid3 pose =
            scene.views[v]->camera_from_scene * scene.objects.front().scene_from_object;
        contours_.See(object, pose, &seen[v]);
        for (const PoseEdgeMatch& m :
             MatchPoseEdges(in_.images[v], seen[v].points, scene.views[v]->camera, pose, edges))
          rows.push_back({static_cast<int>(v), 0, m.point, m.matched, m.normal, m.weight});
      }
      AdjustToRows(rows, 1, kTransferSigmaPx, &scene, &prior);
    }
  }
  placed->unit_m = prior.unit_m;
  placed->support = Support(scene, kLastReachPx);
}

}  // namespace horopter
