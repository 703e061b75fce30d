#include "server/vision/recognition/object/prepared_object.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "server/base/status_macros.h"

namespace horopter {
namespace {

void SampleEdges(const PrepareOptions& options, PreparedObject* object) {
  const std::vector<ModelEdge>& edges = object->model.edges;
  double total = 0.0;
  for (const ModelEdge& e : edges) {
    for (std::size_t i = 1; i < e.polyline.size(); ++i)
      total += (e.polyline[i] - e.polyline[i - 1]).norm();
  }
  object->sample_spacing_m =
      std::max(total / options.max_samples, object->model.diameter_m / 120.0);
  const double spacing = object->sample_spacing_m;
  for (int index = 0; index < static_cast<int>(edges.size()); ++index) {
    const auto& line = edges[index].polyline;
    double length = 0.0;
    for (std::size_t i = 1; i < line.size(); ++i) length += (line[i] - line[i - 1]).norm();
    const int count = std::max(1, static_cast<int>(std::lround(length / spacing)));
    double next = 0.5 * length / count;  // samples sit in the middle of equal pieces
    double walked = 0.0;
    for (std::size_t i = 1; i < line.size(); ++i) {
      const Eigen::Vector3d step = line[i] - line[i - 1];
      const double piece = step.norm();
      while (piece > 0 && next <= walked + piece) {
        EdgeSample s;
        s.point = (line[i - 1] + step * ((next - walked) / piece)).cast<float>();
        s.tangent = (step / piece).cast<float>();
        s.edge = index;
        object->samples.push_back(s);
        next += length / count;
      }
      walked += piece;
    }
  }
}

}  // namespace

absl::StatusOr<std::shared_ptr<PreparedObject>> BeginPrepared(ObjectModel model,
                                                              const PrepareOptions& options) {
  auto object = std::make_shared<PreparedObject>();
  object->model = std::move(model);
  const ObjectModel& m = object->model;
  if (m.mesh.triangles.empty())
    return absl::InvalidArgumentError("object " + m.id + " has no mesh");
  Eigen::Vector3d low = m.mesh.vertices[0], high = low;
  for (const auto& v : m.mesh.vertices) low = low.cwiseMin(v), high = high.cwiseMax(v);
  object->center = 0.5 * (low + high);
  if (!((high - low).norm() > 0) || !(m.diameter_m > 0)) {
    return absl::InvalidArgumentError("object " + m.id + " has no extent");
  }
  object->radius_m = 0.5 * m.diameter_m;
  SampleEdges(options, object.get());
  return object;
}

absl::StatusOr<std::shared_ptr<const ModelAspects>> MakeModelAspects(const ObjectModel& model) {
  auto aspects = std::make_shared<ModelAspects>();
  HOROPTER_ASSIGN_OR_RETURN(aspects->object.mesh, MakeRenderMesh(model.mesh, model.diameter_m));
  AspectsWithFragments made = MakeAspectsWithFragments(aspects->object.mesh, model.symmetries);
  aspects->object.aspects = std::move(made.aspects);
  aspects->fragments = std::move(made.fragments);
  return std::shared_ptr<const ModelAspects>(std::move(aspects));
}

absl::StatusOr<std::shared_ptr<const PreparedObject>> PrepareObject(ObjectModel model,
                                                                    const PrepareOptions& options) {
  HOROPTER_ASSIGN_OR_RETURN(const std::shared_ptr<PreparedObject> object,
                            BeginPrepared(std::move(model), options));
  object->stable_poses = FindStablePoses(object->model.mesh);
  MeshSymmetries symmetries = FindMeshSymmetries(object->model.mesh, object->model.diameter_m);
  object->near_symmetries = std::move(symmetries.near);
  object->sphere = symmetries.sphere;
  object->keys = ComputeObjectKeys(object->model);
  if (options.aspects) {
    HOROPTER_ASSIGN_OR_RETURN(object->aspects, MakeModelAspects(object->model));
  }
  return std::shared_ptr<const PreparedObject>(object);
}

}  // namespace horopter
