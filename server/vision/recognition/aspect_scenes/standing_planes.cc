#include "server/vision/recognition/aspect_scenes/standing_planes.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace horopter {
namespace {

constexpr double kSamePlaneRad = 0.06;    // between the normals of faces on one plane
constexpr double kSamePlaneShare = 0.08;  // of the diameter: between their heights
constexpr int kPlanes = 2;                // of different heights
constexpr double kLevelM = 0.006;         // between these
// Of a face that lies on a plane: of 102 right ones of four data sets 100 lay within 1.6 degrees
// and 0.018 of the diameter. ADR 39.
constexpr double kLyingRad = 0.044;
constexpr double kLyingShare = 0.02;
// Right ones that lie on no known plane have 0.012 and less, turned ones that are put right later
// 0.22, wrong ones 0.52 and more; a round side's poses are up to 0.16 apart (kRollingPoses).
constexpr double kLeaningRad = 0.3;

// How many of the objects rest on the plane; -1 when one of them, or a camera, is below it.
int RestingOn(const StandingPlane& plane,
              std::span<const AspectSceneObject> objects,
              std::span<const AspectModel> models,
              const std::vector<std::optional<AspectSceneView>>& views) {
  if (!IsBelow(plane, views)) return -1;
  int resting = 0;
  for (const AspectSceneObject& o : objects) {
    const AspectModel& model = models[o.object];
    const double same = kSamePlaneShare * model.object->mesh.diameter_m;
    const Eigen::Vector3d center = o.scene_from_object * model.object->mesh.center.cast<double>();
    if (plane.normal.dot(center) < plane.offset_m) return -1;
    resting +=
        std::any_of(model.resting.begin(), model.resting.end(), [&](const RestingFace& face) {
          const Eigen::Vector3d up = o.scene_from_object.R * face.up;
          return up.dot(plane.normal) > std::cos(kSamePlaneRad) &&
                 std::abs(plane.normal.dot(o.scene_from_object.t) - face.height_m -
                          plane.offset_m) < same;
        });
  }
  return resting;
}

// How many of the objects have a resting face level with the plane, at whatever height: those that
// stand on others do.
int LevelWith(const StandingPlane& plane,
              std::span<const AspectSceneObject> objects,
              std::span<const AspectModel> models) {
  return static_cast<int>(
      std::count_if(objects.begin(), objects.end(), [&](const AspectSceneObject& o) {
        const std::vector<RestingFace>& resting = models[o.object].resting;
        return std::any_of(resting.begin(), resting.end(), [&](const RestingFace& face) {
          return (o.scene_from_object.R * face.up).dot(plane.normal) > std::cos(kSamePlaneRad);
        });
      }));
}

}  // namespace

SupportingPlane PlaneUnder(const Rigid3& scene_from_object, const RestingFace& face) {
  const Eigen::Vector3d normal = scene_from_object.R * face.up;
  return {normal, normal.dot(scene_from_object.t) - face.height_m};
}

bool IsBelow(const SupportingPlane& plane,
             const std::vector<std::optional<AspectSceneView>>& views) {
  return std::none_of(views.begin(), views.end(), [&](const auto& view) {
    return view && plane.normal.dot(view->camera_from_scene.Inverse().t) < plane.offset_m;
  });
}

std::vector<StandingPlane> PlanesUnder(std::span<const AspectSceneObject> objects,
                                       std::span<const AspectModel> models,
                                       const std::vector<std::optional<AspectSceneView>>& views) {
  StandingPlane best;
  int most_level = 0;
  std::vector<StandingPlane> all;
  for (const AspectSceneObject& o : objects) {
    for (const RestingFace& face : models[o.object].resting) {
      StandingPlane plane{PlaneUnder(o.scene_from_object, face)};
      plane.objects = RestingOn(plane, objects, models, views);
      const int level = LevelWith(plane, objects, models);
      const std::pair here(plane.objects, level), there(best.objects, most_level);
      // Of two heights the lower one: what is on it may carry the other.
      const bool lower = plane.normal.dot(best.normal) > std::cos(kSamePlaneRad) &&
                         plane.offset_m < best.offset_m - kLevelM;
      if (here > there || (here == there && best.objects > 0 && lower)) {
        best = plane;
        most_level = level;
      }
      all.push_back(plane);
    }
  }
  if (best.objects == 0) return {};
  std::vector<StandingPlane> out = {best};
  for (StandingPlane& plane : all) {
    if (static_cast<int>(out.size()) >= kPlanes) break;
    if (plane.normal.dot(best.normal) < std::cos(kSamePlaneRad)) continue;
    plane.normal = best.normal;
    const bool known = std::any_of(out.begin(), out.end(), [&](const StandingPlane& p) {
      return plane.offset_m < p.offset_m + kLevelM;
    });
    if (known) continue;
    plane.objects = 1;
    out.push_back(plane);
  }
  return out;
}

std::vector<SupportingPlane> PlanesToLieOn(std::span<const AspectSceneObject> objects,
                                           std::span<const AspectModel> models,
                                           const std::vector<std::optional<AspectSceneView>>& views,
                                           int but) {
  const std::vector<StandingPlane> under = PlanesUnder(objects, models, views);
  if (under.empty()) return {};
  const StandingPlane& base = under.front();
  std::vector<SupportingPlane> out;
  for (int i = 0; i < static_cast<int>(objects.size()); ++i) {
    if (i == but) continue;
    for (const RestingFace& face : models[objects[i].object].resting) {
      const SupportingPlane plane = PlaneUnder(objects[i].scene_from_object, face);
      const double cosine = plane.normal.dot(base.normal);
      if (std::abs(cosine) < std::cos(kSamePlaneRad)) continue;
      const double sign = cosine > 0.0 ? 1.0 : -1.0;  // below zero: a face on top of the object
      if (sign * plane.offset_m > base.offset_m - kLevelM)
        out.push_back({sign * plane.normal, sign * plane.offset_m});
    }
  }
  return out;
}

bool LiesOn(std::span<const SupportingPlane> planes,
            const Rigid3& scene_from_object,
            const AspectModel& model,
            double slack) {
  const double most_m = slack * kLyingShare * model.object->mesh.diameter_m;
  return std::any_of(model.resting.begin(), model.resting.end(), [&](const RestingFace& face) {
    const Eigen::Vector3d up = scene_from_object.R * face.up;
    return std::any_of(planes.begin(), planes.end(), [&](const SupportingPlane& plane) {
      return up.dot(plane.normal) > std::cos(slack * kLyingRad) &&
             std::abs(plane.normal.dot(scene_from_object.t) - face.height_m - plane.offset_m) <
                 most_m;
    });
  });
}

bool IsLevel(std::span<const SupportingPlane> planes,
             const Rigid3& scene_from_object,
             const AspectModel& model) {
  if (planes.empty()) return false;
  const SupportingPlane& lowest =
      *std::min_element(planes.begin(), planes.end(), [](const auto& a, const auto& b) {
        return a.offset_m < b.offset_m;
      });
  const double below_m = kLyingShare * model.object->mesh.diameter_m;
  return std::any_of(model.resting.begin(), model.resting.end(), [&](const RestingFace& face) {
    const Eigen::Vector3d up = scene_from_object.R * face.up;
    return lowest.normal.dot(scene_from_object.t) - face.height_m > lowest.offset_m - below_m &&
           std::any_of(planes.begin(), planes.end(), [&](const SupportingPlane& plane) {
             return up.dot(plane.normal) > std::cos(kLyingRad);
           });
  });
}

bool Leans(std::span<const SupportingPlane> planes,
           const Rigid3& scene_from_object,
           const AspectModel& model) {
  if (planes.empty() || model.resting.empty()) return false;
  return std::none_of(model.resting.begin(), model.resting.end(), [&](const RestingFace& face) {
    const Eigen::Vector3d up = scene_from_object.R * face.up;
    return std::any_of(planes.begin(), planes.end(), [&](const SupportingPlane& plane) {
      return up.dot(plane.normal) > std::cos(kLeaningRad);
    });
  });
}

}  // namespace horopter
