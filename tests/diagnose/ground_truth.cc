#include "tests/diagnose/ground_truth.h"

#include <cmath>
#include <utility>

#include "client/cad_import.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/depth_buffer.h"

namespace horopter {
namespace {

constexpr double kMinVisiblePx = 20.0;
constexpr double kDepthToleranceM = 1e-3;
constexpr double kBufferMargin =
    0.15;  // of the image size: undistorted points may lie outside the frame

TrueEdge SampleEdge(const BopImage& image,
                    const PinholeCamera& wide,
                    const DepthBuffer& depth,
                    const Rigid3& camera_from_object,
                    const ModelEdge& edge) {
  TrueEdge out;
  out.kind = edge.kind;
  for (size_t k = 0; k + 1 < edge.polyline.size(); ++k) {
    const Eigen::Vector3d a = camera_from_object * edge.polyline[k];
    const Eigen::Vector3d b = camera_from_object * edge.polyline[k + 1];
    if (a.z() <= 1e-3 || b.z() <= 1e-3) {
      continue;
    }
    const Eigen::Vector2d pa = ProjectTrue(image, a);
    const Eigen::Vector2d pb = ProjectTrue(image, b);
    const double length = (pb - pa).norm();
    const int steps = std::max(1, static_cast<int>(std::lround(length)));
    for (int s = 0; s < steps; ++s) {
      const Eigen::Vector3d p = a + (b - a) * ((s + 0.5) / steps);
      const Eigen::Vector2d pixel = ProjectTrue(image, p);
      if (pixel.x() < 1 || pixel.y() < 1 || pixel.x() > image.camera.width - 2 ||
          pixel.y() > image.camera.height - 2 ||
          !IsVisible(depth, Project(wide, p), p.z(), kDepthToleranceM)) {
        continue;
      }
      out.points.push_back(pixel);
      out.tangents.push_back((pb - pa).normalized());
      out.length_px += length / steps;
    }
  }
  return out;
}

void CollectCorners(const BopImage& image, const TrueModels& models, TrueView* view) {
  std::map<std::pair<int, int>, int> meeting;
  for (const TrueEdge& edge : view->edges) {
    const BopInstance& instance = image.instances[edge.instance];
    const ObjectModel& model = models.at(instance.obj_id);
    for (int vertex : {model.edges[edge.edge].start_vertex, model.edges[edge.edge].end_vertex}) {
      if (vertex < 0) {
        continue;
      }
      const Eigen::Vector2d pixel =
          ProjectTrue(image, instance.camera_from_object * model.vertices[vertex]);
      // The edge must be visible up to the vertex.
      if ((edge.points.front() - pixel).norm() < 3.0 || (edge.points.back() - pixel).norm() < 3.0) {
        if (++meeting[{edge.instance, vertex}] == 2) {
          view->corners.push_back({edge.instance, vertex, pixel});
        }
      }
    }
  }
}

}  // namespace

absl::StatusOr<TrueModels> ReadTrueModels(const BopDataset& dataset) {
  TrueModels models;
  for (const BopObject& object : dataset.objects) {
    const std::string& path = object.cad_path.empty() ? object.mesh_path : object.cad_path;
    if (path.empty()) {
      return absl::NotFoundError("object " + std::to_string(object.obj_id) +
                                 " has neither CAD nor mesh");
    }
    HOROPTER_ASSIGN_OR_RETURN(CadImport imported, ImportCad(path));
    ObjectModel model = std::move(imported.model);
    model.id = BopObjectName(object.obj_id);
    model.display_name = object.name;
    if (object.in_models_info) {
      model.symmetries = object.symmetries;
    }
    if (!object.grasps_path.empty()) {
      HOROPTER_ASSIGN_OR_RETURN(model.grasps, ReadGrasps(object.grasps_path));
    }
    models[object.obj_id] = std::move(model);
  }
  return models;
}

Eigen::Vector2d ProjectTrue(const BopImage& image, const Eigen::Vector3d& point_in_camera) {
  return Project(image.camera, point_in_camera);
}

TrueView MakeTrueView(const BopImage& image, const TrueModels& models) {
  PinholeCamera wide = image.camera;
  wide.k1 = 0.0;
  const int margin_x = static_cast<int>(kBufferMargin * wide.width);
  const int margin_y = static_cast<int>(kBufferMargin * wide.height);
  wide.width += 2 * margin_x;
  wide.height += 2 * margin_y;
  wide.cx += margin_x;
  wide.cy += margin_y;
  DepthBuffer depth = MakeDepthBuffer(wide.width, wide.height);
  for (const BopInstance& instance : image.instances) {
    if (const auto it = models.find(instance.obj_id); it != models.end()) {
      RenderDepth(it->second.mesh, wide, instance.camera_from_object, &depth);
    }
  }
  TrueView view;
  for (size_t i = 0; i < image.instances.size(); ++i) {
    const auto it = models.find(image.instances[i].obj_id);
    // What nothing is seen of hides behind something that may be no part.
    if (it == models.end() || image.instances[i].visib_fract <= 0.0) {
      continue;
    }
    for (size_t e = 0; e < it->second.edges.size(); ++e) {
      TrueEdge edge = SampleEdge(
          image, wide, depth, image.instances[i].camera_from_object, it->second.edges[e]);
      if (edge.length_px >= kMinVisiblePx) {
        edge.instance = static_cast<int>(i);
        edge.edge = static_cast<int>(e);
        view.edges.push_back(std::move(edge));
      }
    }
  }
  CollectCorners(image, models, &view);
  return view;
}

}  // namespace horopter
