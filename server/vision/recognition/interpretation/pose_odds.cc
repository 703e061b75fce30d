#include "server/vision/recognition/interpretation/pose_odds.h"

#include <algorithm>
#include <cmath>

#include "server/vision/geometry/hidden_tolerance.h"
#include "server/vision/recognition/aspects/edge_difference.h"

namespace horopter {
namespace {

using Views = std::vector<std::optional<CalibratedCamera>>;

// That something is found where nothing is expected, bounded.
constexpr double kLeastEdgeChance = 0.03, kMostEdgeChance = 0.8;

// Log odds that an edge is there, of how far an image edge supports it (0..1).
double EdgeLogOdds(double support, double found, double chance) {
  const double there = found + (1.0 - found) * chance;
  return support * std::log(there / chance) +
         (1.0 - support) * std::log((1.0 - there) / (1.0 - chance));
}

}  // namespace

std::optional<PointEvidence> SupportAt(const AspectImage& image, const VisibleEdgePoint& p) {
  constexpr float kTolerancePx = 3.0f;  // working px to an edge that supports
  const float x = p.image.x(), y = p.image.y();
  if (!(x >= 0 && y >= 0 && x < static_cast<float>(image.width) &&
        y < static_cast<float>(image.height)) ||
      !IsSearched(image, x, y)) {
    return std::nullopt;
  }
  const int bin = AspectBin(p.tangent.x(), p.tangent.y());
  const float distance = image.DistanceAt(x, y, bin) / AspectImage::kDistanceScale;
  return PointEvidence{
      std::clamp(1.5f * (1.0f - distance / kTolerancePx), 0.0f, 1.0f),
      std::clamp(image.ChanceAt(x, y, bin, AspectImage::ChanceLevel(kTolerancePx)) / 255.0,
                 kLeastEdgeChance,
                 kMostEdgeChance)};
}

double PointLogOdds(const AspectImage& image,
                    const VisibleEdgePoint& p,
                    const PoseChoiceAcceptance& acceptance) {
  const std::optional<PointEvidence> at = SupportAt(image, p);
  if (!at) return 0.0;
  const double found =
      p.kind == VisibleEdgeKind::kCrease ? acceptance.found_crease : acceptance.found_contour;
  return EdgeLogOdds(at->support, found, at->chance);
}

double BoundedLogOdds(double of_view, const PoseChoiceAcceptance& acceptance) {
  return of_view * acceptance.most_log_odds / (acceptance.most_log_odds + std::abs(of_view));
}

bool IsHidden(const DepthBuffer& others,
              const PinholeCamera& camera,
              const Rigid3& camera_from_object,
              const VisibleEdgePoint& p,
              double tolerance_m) {
  const Eigen::Vector3d x = camera_from_object * p.point.cast<double>();
  return others.width > 0 && !IsVisible(others, Project(camera, x), x.z(), tolerance_m);
}

std::vector<DepthBuffer> DepthOfOthers(const JointContext& context,
                                       std::span<const AspectImage> images,
                                       const RecognitionResult& result,
                                       std::size_t object) {
  std::vector<DepthBuffer> out(images.size());
  for (std::size_t v = 0; v < images.size(); ++v) {
    if (!result.views[v]) continue;
    PinholeCamera camera = WorkingCamera(images[v], result.views[v]->camera);
    camera.k1 = 0.0;
    out[v] = MakeDepthBuffer(images[v].width, images[v].height);
    for (std::size_t k = 0; k < result.objects.size(); ++k) {
      if (k == object) continue;
      const SceneObject& o = result.objects[k];
      RenderDepth(context.objects[o.object]->model.mesh,
                  camera,
                  result.views[v]->camera_from_scene * o.scene_from_object,
                  &out[v]);
    }
  }
  return out;
}

std::vector<VisibleEdges> EdgesInViews(std::span<const AspectImage> images,
                                       const Views& views,
                                       const RenderMesh& mesh,
                                       const Rigid3& scene_from_object) {
  VisibleEdgeOptions rendering;
  rendering.render_px = EdgeDifferenceOptions{}.render_px;
  std::vector<VisibleEdges> out(views.size());
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v] || images[v].width == 0) continue;
    out[v] = FindVisibleEdges(mesh,
                              WorkingCamera(images[v], views[v]->camera),
                              views[v]->camera_from_scene * scene_from_object,
                              rendering);
  }
  return out;
}

double LogOddsBetween(std::span<const AspectImage> images,
                      const Views& views,
                      const SeenPart& a,
                      const SeenPart& b,
                      std::span<const DepthBuffer> hidden,
                      const PoseChoiceAcceptance& acceptance,
                      double* differing_share) {
  double sum = 0.0, only_px = 0.0, length_px = 0.0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v] || images[v].width == 0) continue;
    const PinholeCamera working = WorkingCamera(images[v], views[v]->camera);
    PinholeCamera straight = working;
    straight.k1 = 0.0;
    const EdgeDifference difference = CompareEdges(a.edges[v], b.edges[v], working);
    only_px += difference.only_a_px + difference.only_b_px;
    length_px += difference.length_a_px + difference.length_b_px;
    double of_view = 0.0;
    for (const DifferingPoint& d : difference.points) {
      if (v < hidden.size() &&
          IsHidden(hidden[v],
                   straight,
                   views[v]->camera_from_scene * (d.of_a ? a : b).scene_from_object,
                   d.point,
                   kHiddenShareOfFaces * a.mesh.diameter_m)) {
        continue;
      }
      const double says = PointLogOdds(images[v], d.point, acceptance) * d.length_px;
      of_view += (d.of_a ? says : -says) / acceptance.independent_px;
    }
    sum += BoundedLogOdds(of_view, acceptance);
  }
  if (differing_share != nullptr) *differing_share = only_px / std::max(1.0, length_px);
  return sum;
}

double LogOddsOfPose(std::span<const AspectImage> images,
                     const Views& views,
                     const RenderMesh& a,
                     const Rigid3& scene_from_a,
                     const RenderMesh& b,
                     const Rigid3& scene_from_b,
                     std::span<const DepthBuffer> hidden,
                     const PoseChoiceAcceptance& acceptance,
                     double* differing_share) {
  return LogOddsBetween(images,
                        views,
                        {a, scene_from_a, EdgesInViews(images, views, a, scene_from_a)},
                        {b, scene_from_b, EdgesInViews(images, views, b, scene_from_b)},
                        hidden,
                        acceptance,
                        differing_share);
}

}  // namespace horopter
