#include "server/pipeline/view_templates.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <string>
#include <utility>

#include "server/base/status_macros.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {
namespace {

// Number i of `count` in an order that strides through them: templates lie on a spiral over the
// sphere, and a stride of a golden section leaves no side of it out.
int NumberInOrder(int i, int count) {
  int stride = std::max(1, static_cast<int>(std::lround(count * (std::numbers::phi - 1.0))));
  while (std::gcd(stride, count) != 1) ++stride;
  return static_cast<int>(int64_t{i} * stride % count);
}

TemplateEdge KindOf(VisibleEdgeKind kind) {
  switch (kind) {
    case VisibleEdgeKind::kSilhouette:
      return TemplateEdge::kSilhouette;
    case VisibleEdgeKind::kOcclusion:
      return TemplateEdge::kOcclusion;
    case VisibleEdgeKind::kCrease:
      return TemplateEdge::kCrease;
  }
  return TemplateEdge::kSilhouette;
}

TemplatePoint Drawn(const AspectPoint& edge, const PinholeCamera& camera, const Rigid3& pose) {
  const Eigen::Vector3d at = pose.R * edge.point.cast<double>() + pose.t;
  const Eigen::Vector3d along = pose.R * edge.direction.cast<double>();
  const Eigen::Vector2d image = Project(camera, at);
  // The derivative of the projection along the edge.
  const Eigen::Vector2d tangent = along.head<2>() * at.z() - at.head<2>() * along.z();
  double angle = std::atan2(tangent.y(), tangent.x());
  if (angle < 0.0) angle += std::numbers::pi;
  return {image.cast<float>(), static_cast<float>(angle), KindOf(edge.kind)};
}

}  // namespace

absl::StatusOr<TemplateViews> ReadTemplates(
    ObjectModel model, std::string_view data, std::string_view keys, int first, int limit) {
  HOROPTER_ASSIGN_OR_RETURN(
      const auto object,
      CatalogPreparer().restore(std::move(model), {std::string(data), std::string(keys)}));
  if (object->aspects == nullptr) return absl::FailedPreconditionError("has no view templates");
  const AspectSet& set = object->aspects->object.aspects;
  TemplateViews views;
  views.camera = AspectCamera(set);
  views.count = static_cast<int>(set.aspects.size());
  for (int i = first; i < std::min(views.count, first + limit); ++i) {
    const int number = NumberInOrder(i, views.count);
    TemplateView& view = views.views.emplace_back();
    view.camera_from_object = AspectPose(set, number);
    for (const AspectPoint& edge : AspectPoints(set, number)) {
      view.points.push_back(Drawn(edge, views.camera, view.camera_from_object));
    }
  }
  return views;
}

}  // namespace horopter
