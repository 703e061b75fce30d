#include "server/vision/recognition/aspect_scenes/view_links.h"

#include <algorithm>
#include <cmath>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_scenes/surface_links.h"

namespace horopter {
namespace {

constexpr double kCarriedShare = 0.2;    // of carried edges against a hypothesis's weight
constexpr int kVirtualSteps = 12;        // Gauss-Newton; chosen
constexpr double kVirtualSigmaPx = 6.0;  // working px; chosen, commit cffbdd4
// Of correlation over the surface: by so much more it denies a turn that edges do not; chosen.
constexpr double kSurfaceTells = 0.2;
// Poses of a part alone in a view of which it chooses, and their support against the best one's;
// chosen, for time.
constexpr std::size_t kSurfacePoses = 4;
constexpr double kNearlySupported = 0.5;

}  // namespace

ViewLinks::ViewLinks(const AspectLinkInput& input,
                     const AspectLinkOptions& options,
                     const StopRequested& stop)
    : in_(input), options_(options), stop_(stop), turns_(input.models), support_(input, options) {}

std::vector<AspectSceneObject> ViewLinks::Carried(
    const std::vector<std::optional<AspectSceneView>>& views) const {
  std::vector<std::pair<double, AspectSceneObject>> carried;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    const Rigid3 scene_from_camera = views[v]->camera_from_scene.Inverse();
    for (const AspectHypothesis& h : Hypotheses(static_cast<int>(v))) {
      const Rigid3 pose =
          WithFocal(h.camera_from_object, h.camera.focal_px, views[v]->camera.focal_px);
      carried.emplace_back(h.score, AspectSceneObject{h.object, scene_from_camera * pose});
    }
  }
  std::stable_sort(carried.begin(), carried.end(), [](const auto& a, const auto& b) {
    return a.first > b.first;
  });
  std::vector<AspectSceneObject> out;
  for (auto& [score, object] : carried) out.push_back(object);
  return out;
}

std::vector<GrownScene> ViewLinks::InitialScenes() const {
  return LinkPairs(in_, options_, support_, turns_, stop_);
}

int ViewLinks::Grow(const std::vector<bool>& wanted, GrownScene* scene) const {
  const std::vector<std::vector<ModelEdgePoint>> points = PointsOf(*scene);
  const int count = static_cast<int>(scene->views.size());
  std::vector<std::pair<double, AspectSceneView>> best(count);
  ParallelFor(count, options_.threads, [&](int v) {
    if (!scene->views[v] && wanted[v]) best[v] = BestView(*scene, points, v);
  });
  const auto most = std::max_element(
      best.begin(), best.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  if (most->first <= 0.0) return -1;
  const int v = static_cast<int>(most - best.begin());
  scene->views[v] = most->second;
  scene->support += most->first;
  for (GrownObject& o : scene->objects) {
    const Rigid3 expected = most->second.camera_from_scene * o.placed.scene_from_object;
    o.hypothesis[v] = support_.BestAgreeing(v, most->second, o.placed.object, expected).first;
  }
  return v;
}

std::pair<double, AspectSceneView> ViewLinks::BestView(
    const GrownScene& scene, const std::vector<std::vector<ModelEdgePoint>>& points, int v) const {
  std::vector<LinkedView> linked;  // by each hypothesis, under its best turn
  for (const GrownObject& o : scene.objects) {
    for (const AspectHypothesis& h : support_.Hypotheses(v)) {
      if (h.object != o.placed.object) continue;
      const auto view_of = [&](const Rigid3& turn) {
        return support_.ViewOf(
            v, h.camera, h.camera_from_object * turn * o.placed.scene_from_object.Inverse());
      };
      const auto support = [&](const Rigid3& turn) {
        return SupportOfView(scene, points, v, view_of(turn), &o) +
               SupportInOthers(scene, v, view_of(turn), h);
      };
      LinkedView best;
      for (const Rigid3& turn : turns_.Supported(h.object, support)) {
        const AspectSceneView view = view_of(turn);
        const double sum =
            SupportOfView(scene, points, v, view, nullptr) + SupportInOthers(scene, v, view, h);
        if (sum > best.support) best = {sum, view, &o};
      }
      if (best.by != nullptr) linked.push_back(best);
    }
  }
  std::stable_sort(linked.begin(), linked.end(), [](const LinkedView& a, const LinkedView& b) {
    return a.support > b.support;
  });
  if (linked.empty()) return {0.0, {}};
  return {linked.front().support, ChosenBySurface(scene, v, linked)};
}

AspectSceneView ViewLinks::ChosenBySurface(const GrownScene& scene,
                                           int v,
                                           std::span<const LinkedView> linked) const {
  const LinkedView& first = linked.front();
  if (!options_.printed_surfaces) return first.view;
  std::vector<AspectSceneView> views;
  std::vector<PoseInView> poses;
  for (const LinkedView& l : linked) {
    // Others tell the poses of one apart.
    const bool asked = poses.empty() || (scene.objects.size() == 1 && poses.size() < kSurfacePoses);
    if (!asked || l.by != first.by || l.support < kNearlySupported * first.support) break;
    views.push_back(l.view);
    poses.push_back({l.view.camera, l.view.camera_from_scene * l.by->placed.scene_from_object});
  }
  const auto choice = ChooseBySurface(in_, scene.views, first.by->placed, v, poses, turns_);
  if (!choice || choice->correlation <= choice->stated + kSurfaceTells) return first.view;
  AspectSceneView out = views[choice->pose];
  out.camera_from_scene = poses[choice->pose].camera_from_object * choice->turn *
                          first.by->placed.scene_from_object.Inverse();
  return out;
}

double ViewLinks::SupportOfView(const GrownScene& scene,
                                const std::vector<std::vector<ModelEdgePoint>>& points,
                                int v,
                                const AspectSceneView& view,
                                const GrownObject* linking) const {
  double sum = 0.0;
  for (std::size_t o = 0; o < scene.objects.size(); ++o) {
    if (&scene.objects[o] == linking) continue;
    const AspectSceneObject& placed = scene.objects[o].placed;
    const Rigid3 expected = view.camera_from_scene * placed.scene_from_object;
    sum += std::max(
        support_.BestAgreeing(v, view, placed.object, expected).second,
        kCarriedShare * support_.Found(v, placed.object, points[o], view.camera, expected));
  }
  return sum;
}

double ViewLinks::SupportInOthers(const GrownScene& scene,
                                  int v,
                                  const AspectSceneView& view,
                                  const AspectHypothesis& linking) const {
  int nearest = -1;
  for (int w = 0; w < static_cast<int>(scene.views.size()); ++w) {
    if (scene.views[w] && (nearest < 0 || std::abs(w - v) < std::abs(nearest - v))) nearest = w;
  }
  std::vector<int> known;
  for (std::size_t k = 0; k < support_.Hypotheses(v).size(); ++k) {
    const AspectHypothesis& h = support_.Hypotheses(v)[k];
    const bool placed =
        std::any_of(scene.objects.begin(), scene.objects.end(), [&](const GrownObject& o) {
          return o.placed.object == h.object;
        });
    if (&h == &linking || placed) known.push_back(static_cast<int>(k));
  }
  return support_.CarriedSupport(view, *scene.views[nearest], v, nearest, known);
}

std::vector<std::vector<ModelEdgePoint>> ViewLinks::PointsOf(const GrownScene& scene) const {
  const auto view = std::find_if(
      scene.views.begin(), scene.views.end(), [](const auto& v) { return v.has_value(); });
  std::vector<std::vector<ModelEdgePoint>> out;
  for (const GrownObject& o : scene.objects) {
    const Rigid3 pose = (*view)->camera_from_scene * o.placed.scene_from_object;
    out.push_back(support_.EdgePoints(o.placed.object, (*view)->camera, pose));
  }
  return out;
}

void ViewLinks::AdjustToHypotheses(const GrownScene& grown, AspectScene* scene) const {
  std::vector<SceneRow> rows;
  for (std::size_t o = 0; o < grown.objects.size(); ++o) {
    const int object = grown.objects[o].placed.object;
    const auto corners = BoxCorners(support_.MeshOf(object));
    for (std::size_t v = 0; v < grown.views.size(); ++v) {
      const int i = grown.objects[o].hypothesis[v];
      if (i < 0 || !grown.views[v]) continue;
      const AspectHypothesis& h = support_.Hypotheses(v)[i];
      const Rigid3 expected =
          grown.views[v]->camera_from_scene * grown.objects[o].placed.scene_from_object;
      Rigid3 nearest = h.camera_from_object;
      double least = 1e18;
      for (const Rigid3& turn : turns_.Of(object)) {
        const Rigid3 pose = h.camera_from_object * turn;
        double off = 0.0;
        for (const Eigen::Vector3d& c : corners)
          off +=
              (Project(h.camera, pose * c) - Project(grown.views[v]->camera, expected * c)).norm();
        if (off < least) least = off, nearest = pose;
      }
      for (const Eigen::Vector3d& c : corners) {
        const Eigen::Vector2d target = Project(h.camera, nearest * c);
        for (const Eigen::Vector2d& axis : {Eigen::Vector2d(1, 0), Eigen::Vector2d(0, 1)})
          rows.push_back({static_cast<int>(v), static_cast<int>(o), c, target, axis, h.score});
      }
    }
  }
  AdjustToRows(rows, kVirtualSteps, kVirtualSigmaPx, scene);
}

}  // namespace horopter
