#include "server/vision/recognition/interpretation/feature_evidence.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "server/vision/geometry/hidden_tolerance.h"
#include "server/vision/recognition/aspects/edge_difference.h"

namespace horopter {
namespace {

// Of creases that are of no feature: fewer working px say nothing of the light.
constexpr double kTellingCreasePx = 80.0;
constexpr double kLeastFound = 0.2, kMostFound = 0.8;

// What lies around a rendered part, as far as it is seen beside and not through it.
class Surroundings {
 public:
  Surroundings(const RenderedView& view, const PinholeCamera& camera)
      : view_(view), rendered_(view, camera), outside_(view.inverse_depth.size(), 0) {
    std::vector<int> open;
    const auto enter = [&](int x, int y) {
      if (x < 0 || y < 0 || x >= view_.width || y >= view_.height) return;
      const int cell = y * view_.width + x;
      if (outside_[cell] || view_.Covered(x, y)) return;
      outside_[cell] = 1;
      open.push_back(cell);
    };
    for (int x = 0; x < view_.width; ++x) enter(x, 0), enter(x, view_.height - 1);
    for (int y = 0; y < view_.height; ++y) enter(0, y), enter(view_.width - 1, y);
    while (!open.empty()) {
      const int x = open.back() % view_.width, y = open.back() / view_.width;
      open.pop_back();
      enter(x - 1, y), enter(x + 1, y), enter(x, y - 1), enter(x, y + 1);
    }
  }

  // Whether they begin at a pixel of the image.
  bool BeginAt(const Eigen::Vector2d& pixel) const {
    constexpr int kReach = 2;  // rendered px
    const Eigen::Vector2d at = rendered_(pixel);
    const int cx = static_cast<int>(std::lround(at.x()));
    const int cy = static_cast<int>(std::lround(at.y()));
    for (int y = cy - kReach; y <= cy + kReach; ++y) {
      for (int x = cx - kReach; x <= cx + kReach; ++x) {
        if (x < 0 || y < 0 || x >= view_.width || y >= view_.height) return true;
        if (outside_[y * view_.width + x]) return true;
      }
    }
    return false;
  }

 private:
  const RenderedView& view_;
  const RenderedFromImage rendered_;
  std::vector<char> outside_;
};

// A point of the part that is in sight of a view.
struct SightedPoint {
  std::size_t view = 0;
  const VisibleEdgePoint* point = nullptr;
  int feature = -1;
  double length_px = 0.0;
};

std::vector<SightedPoint> PointsInSight(std::span<const AspectImage> images,
                                        const std::vector<std::optional<CalibratedCamera>>& views,
                                        const SeenPart& part,
                                        const FeatureMap& features,
                                        std::span<const DepthBuffer> hidden) {
  const double tolerance_m = kHiddenShareOfFaces * part.mesh.diameter_m;
  std::vector<SightedPoint> out;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v] || images[v].width == 0) continue;
    PinholeCamera straight = WorkingCamera(images[v], views[v]->camera);
    straight.k1 = 0.0;
    const Rigid3 pose = views[v]->camera_from_scene * part.scene_from_object;
    const VisibleEdges& edges = part.edges[v];
    const Surroundings around(edges.view, WorkingCamera(images[v], views[v]->camera));
    for (std::size_t i = 0; i < edges.points.size(); ++i) {
      const VisibleEdgePoint& p = edges.points[i];
      if (v < hidden.size() && IsHidden(hidden[v], straight, pose, p, tolerance_m)) continue;
      // Where the part ends it ends somewhere, with the feature or without.
      if (around.BeginAt(p.image.cast<double>())) continue;
      out.push_back({v, &p, features.At(p.point.cast<double>()), LengthAt(edges, i)});
    }
  }
  return out;
}

// How often creases of no feature are found, beyond chance; the default where there are few.
double FoundCrease(std::span<const AspectImage> images,
                   const std::vector<SightedPoint>& points,
                   double otherwise) {
  double length = 0.0, found = 0.0;
  for (const SightedPoint& p : points) {
    if (p.feature >= 0 || p.point->kind != VisibleEdgeKind::kCrease) continue;
    const auto at = SupportAt(images[p.view], *p.point);
    if (!at) continue;
    length += p.length_px;
    found += p.length_px * (at->support - at->chance) / (1.0 - at->chance);
  }
  if (length < kTellingCreasePx) return otherwise;
  return std::clamp(found / length, kLeastFound, kMostFound);
}

}  // namespace

std::vector<FeatureEvidence> RateFeatures(std::span<const AspectImage> images,
                                          const std::vector<std::optional<CalibratedCamera>>& views,
                                          const SeenPart& part,
                                          const std::vector<ModelFeature>& features,
                                          std::span<const DepthBuffer> hidden,
                                          PoseChoiceAcceptance acceptance) {
  std::vector<FeatureEvidence> out(features.size());
  if (features.empty()) return out;
  const FeatureMap map(features, part.mesh.diameter_m);
  const std::vector<SightedPoint> points = PointsInSight(images, views, part, map, hidden);
  acceptance.found_crease = FoundCrease(images, points, acceptance.found_crease);
  std::vector<std::vector<double>> says(features.size(), std::vector<double>(views.size(), 0.0));
  for (const SightedPoint& p : points) {
    if (p.feature < 0) continue;
    says[p.feature][p.view] += PointLogOdds(images[p.view], *p.point, acceptance) * p.length_px /
                               acceptance.independent_px;
    out[p.feature].visible_px += p.length_px;
  }
  for (std::size_t f = 0; f < out.size(); ++f) {
    for (const double of_view : says[f]) out[f].log_odds += BoundedLogOdds(of_view, acceptance);
  }
  return out;
}

}  // namespace horopter
