#include "server/vision/recognition/initialization/scene_decomposition.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <cmath>
#include <set>
#include <vector>

#include "server/vision/recognition/initialization/decomposition.h"

namespace horopter {
namespace {

// Of an object under the upgrade, above which it is something else
constexpr double kMaxStretch = 1.5;
constexpr std::size_t kMostObjects = 12;  // of a scene; their points share the structure's 400
constexpr double kFlat = 1e-3;            // least over largest extent of points in a plane

bool InAPlane(const std::vector<Eigen::Vector3d>& points) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : points) middle += p / static_cast<double>(points.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& p : points) scatter += (p - middle) * (p - middle).transpose();
  const Eigen::Vector3d extent = scatter.jacobiSvd().singularValues().cwiseSqrt();
  return extent(2) < kFlat * extent(0);
}

// The hypotheses that take part, as the decomposition wants them.
struct Chosen {
  std::vector<const StructureHypothesis*> hypotheses;
  std::vector<CollineatedObject> objects;
};

Chosen Choose(std::span<const std::shared_ptr<const PreparedObject>> objects,
              const SceneStructure& structure,
              std::span<const StructureHypothesis> hypotheses) {
  Chosen out;
  std::set<int> taken;
  for (const StructureHypothesis& h : hypotheses) {
    if (out.objects.size() == kMostObjects) break;
    CollineatedObject object{h.structure_from_object, {}, {}};
    bool free = h.vertices.size() >= 4;
    for (const VertexMatch& m : h.vertices) {
      free = free && taken.count(m.point) == 0;
      object.points_in_object.push_back(objects[h.object]->model.vertices[m.vertex]);
      object.points_in_scene.push_back(structure.points[m.point].homogeneous());
    }
    if (!free || InAPlane(object.points_in_object)) continue;
    for (const VertexMatch& m : h.vertices) taken.insert(m.point);
    out.hypotheses.push_back(&h);
    out.objects.push_back(std::move(object));
  }
  return out;
}

std::vector<ObjectPointObservation> ObservationsOf(
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    const SceneStructure& structure,
    const Chosen& chosen) {
  std::vector<ObjectPointObservation> out;
  for (std::size_t k = 0; k < chosen.hypotheses.size(); ++k) {
    const StructureHypothesis& h = *chosen.hypotheses[k];
    for (const VertexMatch& m : h.vertices) {
      for (const PointObservation& o : structure.point_observations) {
        if (o.point != m.point) continue;
        out.push_back(
            {o.view, static_cast<int>(k), objects[h.object]->model.vertices[m.vertex], o.pixel});
      }
    }
  }
  return out;
}

absl::StatusOr<Decomposition> Decompose(
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    const SceneStructure& structure,
    const Chosen& chosen,
    const BottomUpOptions& options) {
  const DecompositionMethod method = options.decomposition;
  if (method == DecompositionMethod::kPerObject) return DecomposePerObject(chosen.objects);
  absl::StatusOr<Decomposition> start = DecomposeCommon(chosen.objects, options.upgrade);
  if (!start.ok() || method == DecompositionMethod::kCommon) return start;
  if (method == DecompositionMethod::kMetric) return RefineDecomposition(chosen.objects, *start);
  return RefineInImages(
      chosen.objects, structure.cameras, ObservationsOf(objects, structure, chosen), *start);
}

}  // namespace

std::optional<AspectScene> SceneByDecomposition(
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    std::span<const PinholeCamera> start_cameras,
    const SceneStructure& structure,
    std::span<const StructureHypothesis> hypotheses,
    const BottomUpOptions& options) {
  if (options.decomposition == DecompositionMethod::kNone) return std::nullopt;
  const Chosen chosen = Choose(objects, structure, hypotheses);
  if (chosen.objects.size() < 2) return std::nullopt;
  const auto found = Decompose(objects, structure, chosen, options);
  if (!found.ok()) return std::nullopt;
  AspectScene scene;
  scene.views.resize(start_cameras.size());
  int registered = 0;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!structure.cameras[v]) continue;
    const PinholeCamera& start = start_cameras[v];
    const auto view =
        UpgradeCamera(*structure.cameras[v], found->metric_from_scene, start.width, start.height);
    if (!view) continue;
    ++registered;
    scene.views[v] = AspectSceneView{view->camera,
                                     view->camera_from_metric,
                                     std::log(view->camera.focal_px),
                                     kNominalFocalLogSigma};
  }
  for (std::size_t k = 0; k < chosen.hypotheses.size(); ++k) {
    if (found->stretch[k] > kMaxStretch) continue;
    scene.objects.push_back({chosen.hypotheses[k]->object, found->metric_from_object[k]});
  }
  if (registered < 2 || scene.objects.size() < 2) return std::nullopt;
  return scene;
}

}  // namespace horopter
