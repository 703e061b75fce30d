#include "tests/diagnose/conic_report.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <set>
#include <utility>

#include "server/vision/features/ellipse_frame.h"
#include "server/vision/geometry/model_circles.h"

namespace horopter {
namespace {

constexpr int kSteps = 96, kPointsOfArc = 24;
constexpr double kNearPx = 2.0;
constexpr double kSameShare = 1e-3;  // of the radius: an edge of a file is often half a circle

// An instance's circle, by their numbers.
using CircleLabel = std::pair<int, int>;

std::vector<ModelCircle> DistinctCircles(const ObjectModel& model) {
  std::vector<ModelCircle> out;
  for (const ModelCircle& c : CirclesOf(model)) {
    const double same = kSameShare * c.radius_m;
    if (std::none_of(out.begin(), out.end(), [&](const ModelCircle& o) {
          return (o.center - c.center).norm() < same && std::abs(o.radius_m - c.radius_m) < same &&
                 std::abs(o.axis.dot(c.axis)) > 1.0 - kSameShare;
        }))
      out.push_back(c);
  }
  return out;
}

// Points of its image; empty where a point is behind the camera.
std::vector<Eigen::Vector2d> ImageOf(const ModelCircle& circle,
                                     const Rigid3& camera_from_object,
                                     const BopImage& image) {
  const Eigen::Vector3d u = circle.axis.unitOrthogonal(), w = circle.axis.cross(u);
  std::vector<Eigen::Vector2d> points;
  for (int k = 0; k < kSteps; ++k) {
    const double t = 2.0 * std::numbers::pi * k / kSteps;
    const Eigen::Vector3d x =
        camera_from_object *
        Eigen::Vector3d(circle.center + circle.radius_m * (std::cos(t) * u + std::sin(t) * w));
    if (!(x.z() > 0.0)) return {};
    points.push_back(ProjectTrue(image, x));
  }
  return points;
}

// Whether all of an arc is near the closed polygon.
bool IsOf(const EllipseArc& arc, const std::vector<Eigen::Vector2d>& polygon, double near_px) {
  const EllipseFrame frame(arc);
  for (int k = 0; k < kPointsOfArc; ++k) {
    const Eigen::Vector2d x =
        frame.PointAt(UnitAt(arc.start_rad + arc.sweep_rad * (k + 0.5) / kPointsOfArc));
    double nearest = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Eigen::Vector2d& a = polygon[i];
      const Eigen::Vector2d d = polygon[(i + 1) % polygon.size()] - a;
      const double s = std::clamp(d.dot(x - a) / std::max(d.squaredNorm(), 1e-12), 0.0, 1.0);
      nearest = std::min(nearest, (a + s * d - x).norm());
    }
    if (nearest > near_px) return false;
  }
  return true;
}

// Per arc the circles that it may be of.
std::vector<std::set<CircleLabel>> LabelArcs(const ImageFeatures& features,
                                             const BopImage& image,
                                             const TrueModels& models,
                                             double near_px) {
  std::vector<std::set<CircleLabel>> labels(features.arcs.size());
  for (int i = 0; i < std::ssize(image.instances); ++i) {
    const BopInstance& instance = image.instances[i];
    const auto model = models.find(instance.obj_id);
    if (model == models.end() || instance.visib_fract <= 0.0) continue;
    const std::vector<ModelCircle> circles = DistinctCircles(model->second);
    for (int c = 0; c < std::ssize(circles); ++c) {
      const auto polygon = ImageOf(circles[c], instance.camera_from_object, image);
      if (polygon.empty()) continue;
      for (std::size_t k = 0; k < labels.size(); ++k) {
        if (IsOf(features.arcs[k], polygon, near_px)) labels[k].insert({i, c});
      }
    }
  }
  return labels;
}

// Whether the true cameras show both arcs as one circle; nothing where they are not known.
std::optional<bool> FitsTruth(const EllipseArc& a,
                              const BopImage& in_a,
                              const EllipseArc& b,
                              const BopImage& in_b,
                              double near_px) {
  if (!in_a.has_pose || !in_b.has_pose) return std::nullopt;
  const auto circle =
      FitSpaceCircle(std::vector<ConicSight>{SightOfArc(a, {in_a.camera, in_a.camera_from_world}),
                                             SightOfArc(b, {in_b.camera, in_b.camera_from_world})});
  return circle && circle->rms_px <= near_px;
}

std::set<CircleLabel> Common(const std::set<CircleLabel>& a, const std::set<CircleLabel>& b) {
  std::set<CircleLabel> out;
  std::set_intersection(a.begin(), a.end(), b.begin(), b.end(), std::inserter(out, out.begin()));
  return out;
}

}  // namespace

ConicFinding CompareConics(const ConicMatching& matching,
                           const std::vector<ImageFeatures>& features,
                           const BopScene& scene,
                           const TrueModels& models,
                           double off_px) {
  ConicFinding finding;
  std::vector<std::vector<std::set<CircleLabel>>> labels;
  std::vector<std::set<CircleLabel>> seen(features.size());  // per view
  for (std::size_t v = 0; v < features.size(); ++v) {
    labels.push_back(LabelArcs(features[v], scene.images[v], models, kNearPx + off_px));
    for (const auto& of_arc : labels[v]) seen[v].insert(of_arc.begin(), of_arc.end());
  }
  for (const ConicPair& pair : matching.pairs) {
    std::set<CircleLabel> matched;
    for (const ConicMatch& m : pair.matches) {
      const auto& a = labels[pair.view_a][m.arc_a];
      const auto& b = labels[pair.view_b][m.arc_b];
      const std::set<CircleLabel> common = Common(a, b);
      matched.insert(common.begin(), common.end());
      std::optional<bool> right = !common.empty();
      if (a.empty() && b.empty()) {
        right = FitsTruth(features[pair.view_a].arcs[m.arc_a],
                          scene.images[pair.view_a],
                          features[pair.view_b].arcs[m.arc_b],
                          scene.images[pair.view_b],
                          kNearPx + off_px);
      }
      finding.matches += right.has_value();
      finding.matches_right += right.value_or(false);
    }
    if (pair.view_b != pair.view_a + 1) continue;
    const std::set<CircleLabel> shared = Common(seen[pair.view_a], seen[pair.view_b]);
    finding.shared += static_cast<int>(shared.size());
    finding.shared_matched += static_cast<int>(Common(shared, matched).size());
  }
  std::set<CircleLabel> tracked;
  for (const TrackedConic& conic : matching.conics) {
    const auto& track = conic.track.features;
    if (track.size() < 3) continue;
    std::set<CircleLabel> common = labels[track[0].view][track[0].feature];
    for (const FeatureTrack::Feature& f : track) common = Common(common, labels[f.view][f.feature]);
    tracked.insert(common.begin(), common.end());
  }
  finding.tracked = static_cast<int>(tracked.size());
  finding.in_space = static_cast<int>(matching.conics.size());
  return finding;
}

}  // namespace horopter
