#include "server/vision/recognition/object/prepared_object.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/vision/geometry/depth_buffer.h"
#include "server/vision/geometry/hidden_tolerance.h"
#include "server/vision/geometry/pinhole_camera.h"

namespace horopter {
namespace {

constexpr int kAspectPixels = 160;  // side of the rendering that tells which edges an aspect shows

struct CubeCell {
  int face;
  double s;  // -1..1
  double t;
};

CubeCell ToCube(const Eigen::Vector3f& d) {
  const Eigen::Vector3f a = d.cwiseAbs();
  int axis = 0;
  if (a.y() > a.x()) axis = 1;
  if (a.z() > a[axis]) axis = 2;
  const double m = a[axis] > 0 ? a[axis] : 1.0;
  return {2 * axis + (d[axis] < 0 ? 1 : 0), d[(axis + 1) % 3] / m, d[(axis + 2) % 3] / m};
}

int GridCell(double x) {
  return std::clamp(static_cast<int>((x + 1.0) * 0.5 * kAspectGrid), 0, kAspectGrid - 1);
}

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

void ComputeAspects(const PrepareOptions& options, PreparedObject* object) {
  const int n = static_cast<int>(object->samples.size());
  if (n == 0) return;
  object->visible.assign(static_cast<std::size_t>(kAspectCount) * object->words, 0);

  const double diameter = object->model.diameter_m;
  const double distance = options.aspect_distance_diameters * diameter;
  const double focal = 0.9 * kAspectPixels * options.aspect_distance_diameters;
  const PinholeCamera camera = CenteredCamera(kAspectPixels, kAspectPixels, focal);
  DepthBuffer buffer = MakeDepthBuffer(kAspectPixels, kAspectPixels);

  for (int aspect = 0; aspect < kAspectCount; ++aspect) {
    LeaveIfStopped();
    const Eigen::Vector3d direction = AspectDirection(aspect);
    Rigid3 camera_from_object;
    const Eigen::Vector3d x = direction.unitOrthogonal();
    camera_from_object.R.row(0) = x;
    camera_from_object.R.row(1) = (-direction).cross(x);
    camera_from_object.R.row(2) = -direction;
    camera_from_object.t = -(camera_from_object.R * (object->center + direction * distance));
    ClearDepth(&buffer);
    RenderDepth(object->model.mesh, camera, camera_from_object, &buffer);
    for (int i = 0; i < n; ++i) {
      const Eigen::Vector3d p = camera_from_object * object->samples[i].point.cast<double>();
      if (!IsVisible(buffer, Project(camera, p), p.z(), kHiddenShareAdjusted * diameter)) continue;
      object->visible[static_cast<std::size_t>(aspect) * object->words + i / 64] |= 1ull
                                                                                    << (i % 64);
    }
  }
}

}  // namespace

int AspectIndex(const Eigen::Vector3f& direction) {
  const CubeCell c = ToCube(direction);
  return (c.face * kAspectGrid + GridCell(c.s)) * kAspectGrid + GridCell(c.t);
}

Eigen::Vector3d AspectDirection(int index) {
  const int face = index / (kAspectGrid * kAspectGrid);
  const int axis = face / 2;
  const double s = ((index / kAspectGrid) % kAspectGrid + 0.5) * 2.0 / kAspectGrid - 1.0;
  const double t = (index % kAspectGrid + 0.5) * 2.0 / kAspectGrid - 1.0;
  Eigen::Vector3d d;
  d[axis] = face % 2 ? -1.0 : 1.0;
  d[(axis + 1) % 3] = s;
  d[(axis + 2) % 3] = t;
  return d.normalized();
}

void FillEdgeVisibility(PreparedObject* object) {
  const std::size_t edges = object->model.edges.size();
  object->edge_visible.assign(kAspectCount * edges, 0);
  std::vector<int> per_edge(edges, 0), seen(edges, 0);
  for (const EdgeSample& s : object->samples) ++per_edge[s.edge];
  for (int aspect = 0; aspect < kAspectCount; ++aspect) {
    LeaveIfStopped();
    const std::uint64_t* bits = object->VisibleBits(aspect);
    std::fill(seen.begin(), seen.end(), 0);
    for (std::size_t i = 0; i < object->samples.size(); ++i) {
      seen[object->samples[i].edge] += (bits[i / 64] >> (i % 64)) & 1;
    }
    for (std::size_t e = 0; e < edges; ++e) {
      object->edge_visible[aspect * edges + e] =
          per_edge[e] ? static_cast<std::uint8_t>(255 * seen[e] / per_edge[e]) : 0;
    }
  }
}

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
  object->words = static_cast<int>((object->samples.size() + 63) / 64);
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
  ComputeAspects(options, object.get());
  FillEdgeVisibility(object.get());
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
