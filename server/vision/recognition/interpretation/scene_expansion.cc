#include "server/vision/recognition/interpretation/scene_expansion.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/initialization/view_linking.h"
#include "server/vision/recognition/interpretation/decision.h"
#include "server/vision/recognition/scene/plane_points.h"
#include "server/vision/recognition/scene/scene_refine.h"
#include "server/vision/recognition/scene/standing_plane.h"
#include "server/vision/recognition/scene/support_surface.h"
#include "server/vision/recognition/scoring/log_odds.h"
#include "server/vision/recognition/scoring/pose_refine.h"

namespace horopter {
namespace {

constexpr int kMinPlaneMatches = 20;  // of fewer the plane's tilt is not told
// Of the circles that objects keep to in an image: depth (radii) from which the stretch covers the
// perspective of a sphere (with the lens's bend), and how far beside an edge image edges are
// explained, working pixels.
constexpr double kFarRadii = 3.0;
constexpr double kStretch = 1.35;
constexpr double kExplainReachPx = 8.0;

// What decides which placement is accepted next: sure and large ones first.
double Priority(const PlacementAcceptance& acceptance, const PlacedObject& p) {
  return (p.score - acceptance.priority_score) * std::sqrt(std::max(0.0, p.total.supported));
}

bool IsUpright(const PlacementAcceptance& acceptance,
               const StablePose& pose,
               const Rigid3& scene_from_object,
               const SupportingPlane& plane) {
  return (scene_from_object.R * pose.up).dot(plane.normal) > acceptance.upright_cos;
}

bool RestsOn(const PlacementAcceptance& acceptance,
             const PreparedObject& object,
             const Rigid3& scene_from_object,
             const SupportingPlane& plane) {
  return std::any_of(
      object.stable_poses.begin(), object.stable_poses.end(), [&](const StablePose& s) {
        const double height = plane.normal.dot(scene_from_object.t) - plane.offset_m - s.height_m;
        return IsUpright(acceptance, s, scene_from_object, plane) &&
               std::abs(height) < acceptance.same_plane_m;
      });
}

// Whether the part is turned as it can rest on a level surface.
bool IsUprightObject(const PlacementAcceptance& acceptance,
                     const PreparedObject& object,
                     const Rigid3& scene_from_object,
                     const SupportingPlane& plane) {
  return std::any_of(
      object.stable_poses.begin(), object.stable_poses.end(), [&](const StablePose& s) {
        return IsUpright(acceptance, s, scene_from_object, plane);
      });
}

// Whether a plane of matched texture carries parts. It may as well be a printed face of a part:
// then the surest placements lie behind it.
bool Supports(const JointContext& context,
              std::span<const PlacedObject> placements,
              const SupportingPlane& plane) {
  const PlacementAcceptance& acceptance = context.options.acceptance.placements;
  double on = 0.0, behind = 0.0;
  for (const PlacedObject& p : placements) {
    if (p.description_gain <= 0 || p.score < acceptance.min_score) continue;
    const double height =
        HeightAbovePlane(*context.objects[p.object], p.scene_from_object, plane).lowest_m;
    if (std::abs(height) < acceptance.plane_tolerance_m) on = std::max(on, Priority(acceptance, p));
    if (height < -3 * acceptance.plane_tolerance_m)
      behind = std::max(behind, Priority(acceptance, p));
  }
  return behind <= acceptance.behind_factor * on;
}

// Share of what `explained` holds that is taken already; 0 when it holds nothing.
double SharedEdges(const ExplainedSegments& explained, const ExplainedSegments& taken) {
  int own = 0, shared = 0;
  for (std::size_t v = 0; v < explained.size(); ++v) {
    for (std::size_t i = 0; i < explained[v].size(); ++i) {
      own += explained[v][i];
      shared += explained[v][i] & taken[v][i];
    }
  }
  return own > 0 ? static_cast<double>(shared) / own : 0.0;
}

// Whether two objects may meet in the image of some registered view: by circles about their
// projections. Where they do not, neither hides the other nor explains its edges.
bool MeetInView(const JointContext& context,
                const std::vector<std::optional<CalibratedCamera>>& views,
                const PlacedObject& a,
                const PlacedObject& b) {
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    const PinholeCamera camera = WorkingCamera(views[v]->camera, context.views[v].maps);
    Eigen::Vector2d middle[2];
    double reach = kExplainReachPx;
    for (const PlacedObject* o : {&a, &b}) {
      const PreparedObject& object = *context.objects[o->object];
      const Eigen::Vector3d p =
          views[v]->camera_from_scene * (o->scene_from_object * object.center);
      // Near objects and oblique rays stretch the circle.
      if (p.z() < kFarRadii * object.radius_m) return true;
      const Eigen::Vector2d u = Project(camera, p);
      (o == &a ? middle[0] : middle[1]) = u;
      reach +=
          kStretch * camera.focal_px * object.radius_m * p.squaredNorm() / (p.z() * p.z() * p.z());
    }
    if ((middle[0] - middle[1]).norm() < reach) return true;
  }
  return false;
}

// Whether a part whose lowest point is at the height lies on top of an accepted one.
bool StandsOnObject(const JointContext& context,
                    const SceneModel& scene,
                    const PlacedObject& p,
                    double height) {
  const PlacementAcceptance& acceptance = context.options.acceptance.placements;
  return std::any_of(scene.objects.begin(), scene.objects.end(), [&](const PlacedObject& o) {
    const PreparedObject &above = *context.objects[p.object], &below = *context.objects[o.object];
    const double top = HeightAbovePlane(below, o.scene_from_object, *scene.plane).highest_m;
    return std::abs(height - top) < acceptance.plane_tolerance_m &&
           LiesOver(OutlineOnPlane(above, p.scene_from_object, *scene.plane),
                    OutlineOnPlane(below, o.scene_from_object, *scene.plane));
  });
}

// Whether a placement may join the scene as it is: support enough for how it stands.
bool IsAcceptable(const JointContext& context, const SceneModel& scene, const PlacedObject& p) {
  const PlacementAcceptance& acceptance = context.options.acceptance.placements;
  if (p.score < acceptance.min_score) return false;
  if (!scene.plane) return p.description_gain > 0;
  const double height =
      HeightAbovePlane(*context.objects[p.object], p.scene_from_object, *scene.plane).lowest_m;
  if (height < -2 * acceptance.plane_tolerance_m) return false;  // below the supporting plane
  if (p.score >= acceptance.off_plane_score) return p.description_gain > 0;
  if (!IsUprightObject(acceptance, *context.objects[p.object], p.scene_from_object, *scene.plane))
    return false;
  if (EdgeLogLikelihoodRatio(p.score, p.total.Sharpness()) >= acceptance.floating_log_odds)
    return p.description_gain > 0;
  // Camouflaged parts lack edges that they should show: what they stand on speaks for them.
  return height < acceptance.plane_tolerance_m || StandsOnObject(context, scene, p, height);
}

// What the accepted parts hide and which image edges they explain.
class Accepted {
 public:
  Accepted(const JointContext& context, const std::vector<std::optional<CalibratedCamera>>& views)
      : context_(context), views_(views) {
    for (const ViewEvidence& view : context.views) {
      occluders_.push_back(MakeDepthBuffer(view.maps.width, view.maps.height));
      taken_.emplace_back(view.segment_samples.size(), 0);
    }
  }

  // Verifies a part behind the accepted ones; the share of the edges it explains that they explain
  // already.
  double Judge(PlacedObject* p) {
    EvaluatePlacement(context_, views_, occluders_, &scratch_, p, &explained_);
    return SharedEdges(explained_, taken_);
  }

  void Add(PlacedObject p) {
    Judge(&p);
    for (std::size_t v = 0; v < taken_.size(); ++v) {
      for (std::size_t i = 0; i < explained_[v].size(); ++i) taken_[v][i] |= explained_[v][i];
      if (!views_[v]) continue;
      RenderDepth(context_.objects[p.object]->model.mesh,
                  WorkingCamera(views_[v]->camera, context_.views[v].maps),
                  views_[v]->camera_from_scene * p.scene_from_object,
                  &occluders_[v]);
    }
  }

 private:
  const JointContext& context_;
  const std::vector<std::optional<CalibratedCamera>>& views_;
  std::vector<DepthBuffer> occluders_;  // per view
  ExplainedSegments taken_, explained_;
  VerifyScratch scratch_;
};

}  // namespace

std::vector<KnownView> KnownViews(const JointContext& context, const SceneModel& scene) {
  std::vector<KnownView> known;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    known.push_back(
        {{scene.views[v]->camera, scene.views[v]->camera_from_scene}, &context.views[v].maps});
  }
  return known;
}

std::optional<SupportingPlane> PlaneFromMatches(
    const JointContext& context, const std::vector<std::optional<CalibratedCamera>>& views) {
  const PlanePoints points = FindPlanePoints(*context.matching, views);
  if (static_cast<int>(points.matches.size()) < kMinPlaneMatches) return std::nullopt;
  // plane.(X - anchor) = -1: the normal points from the plane to the anchor, the mean camera
  // centre.
  SupportingPlane plane;
  const double norm = points.plane.norm();
  plane.normal = points.plane / norm;
  plane.offset_m = plane.normal.dot(points.anchor) - 1.0 / norm;
  return plane;
}

std::optional<SupportingPlane> PlaneOfPlacements(
    const JointContext& context,
    const std::vector<std::optional<CalibratedCamera>>& views,
    std::span<const PlacedObject> placements) {
  const PlacementAcceptance& acceptance = context.options.acceptance.placements;
  std::vector<const PlacedObject*> voters;
  for (const PlacedObject& p : placements) {
    if (p.description_gain > 0 && p.score >= acceptance.min_score) voters.push_back(&p);
  }
  std::stable_sort(voters.begin(), voters.end(), [&](const auto* x, const auto* y) {
    return Priority(acceptance, *x) > Priority(acceptance, *y);
  });
  const int most = context.options.search.placements.plane_voters;
  if (static_cast<int>(voters.size()) > most) voters.resize(most);
  std::vector<Eigen::Vector3d> eyes;
  for (const auto& view : views) {
    if (view) eyes.push_back(view->camera_from_scene.Inverse().t);
  }
  std::optional<SupportingPlane> best;
  double best_votes = 0.0;
  for (const PlacedObject* o : voters) {
    for (const StablePose& stable : context.objects[o->object]->stable_poses) {
      SupportingPlane plane;
      plane.normal = o->scene_from_object.R * stable.up;
      plane.offset_m = plane.normal.dot(o->scene_from_object.t) - stable.height_m;
      if (std::any_of(eyes.begin(), eyes.end(), [&](const auto& eye) {
            return plane.normal.dot(eye) < plane.offset_m;
          })) {
        continue;
      }
      std::vector<const PlacedObject*> resting;
      double votes = 0.0;
      for (const PlacedObject* other : voters) {
        if (!RestsOn(acceptance, *context.objects[other->object], other->scene_from_object, plane))
          continue;
        if (std::any_of(resting.begin(), resting.end(), [&](const PlacedObject* r) {
              return SharedVolume(*context.objects[r->object],
                                  r->scene_from_object,
                                  *context.objects[other->object],
                                  other->scene_from_object) > acceptance.max_shared_volume;
            })) {
          continue;
        }
        resting.push_back(other);
        votes += Priority(acceptance, *other);
      }
      if (resting.size() >= 2 && votes > best_votes) {
        best_votes = votes;
        best = plane;
      }
    }
  }
  return best;
}

void Consolidate(const JointContext& context,
                 std::vector<PlacedObject> candidates,
                 SceneModel* scene) {
  const PlacementAcceptance& acceptance = context.options.acceptance.placements;
  const std::vector<PlacedObject> before = std::move(scene->objects);
  scene->objects.clear();
  scene->description_gain = 0.0;
  scene->plane = PlaneFromMatches(context, scene->views);
  if (scene->plane) scene->plane = PlaneUnderObjects(context, before, *scene->plane);
  if (scene->plane && !Supports(context, candidates, *scene->plane)) scene->plane.reset();
  if (!scene->plane) scene->plane = PlaneOfPlacements(context, scene->views, candidates);
  Accepted accepted_objects(context, scene->views);
  std::vector<bool> stale(candidates.size(), false);
  std::vector<bool> dead(candidates.size(), false);
  while (!IsStopRequested(context.stop)) {
    int best = -1;
    for (int i = 0; i < static_cast<int>(candidates.size()); ++i) {
      if (dead[i]) continue;
      if (stale[i]) {
        stale[i] = false;
        // One scene feature serves one object.
        if (accepted_objects.Judge(&candidates[i]) > acceptance.max_shared_edges) {
          dead[i] = true;
          continue;
        }
      }
      if (!IsAcceptable(context, *scene, candidates[i])) continue;
      if (best < 0 || Priority(acceptance, candidates[i]) > Priority(acceptance, candidates[best]))
        best = i;
    }
    if (best < 0) break;
    const PlacedObject accepted = candidates[best];
    accepted_objects.Add(accepted);
    const PreparedObject& object = *context.objects[accepted.object];
    scene->objects.push_back(accepted);
    scene->description_gain += std::max(0.0, accepted.description_gain);
    dead[best] = true;
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      if (dead[i] || !MeetInView(context, scene->views, accepted, candidates[i])) continue;
      stale[i] = true;
      if (SharedVolume(object,
                       accepted.scene_from_object,
                       *context.objects[candidates[i].object],
                       candidates[i].scene_from_object) > acceptance.max_shared_volume) {
        dead[i] = true;
      }
    }
  }
}

void AddHiddenObjects(const JointContext& context,
                      std::span<const PlacedObject> candidates,
                      SceneModel* scene) {
  const PlacementAcceptance& acceptance = context.options.acceptance.placements;
  if (!scene->plane || scene->objects.size() < 2) return;
  if (SceneProbability(context, *scene) < acceptance.sure_scene) return;
  const SupportingPlane plane = PlaneUnderObjects(context, scene->objects, *scene->plane);
  scene->plane = plane;
  const std::vector<KnownView> known = KnownViews(context, *scene);
  Accepted accepted_objects(context, scene->views);
  for (const PlacedObject& o : scene->objects) accepted_objects.Add(o);
  for (const PlacedObject& candidate : candidates) {
    if (IsStopRequested(context.stop)) return;
    if (candidate.score < acceptance.hidden_score - acceptance.hidden_slack) continue;
    const PreparedObject& object = *context.objects[candidate.object];
    // The cameras have moved since it was found.
    const auto refined = RefineInScene(
        object, known, candidate.scene_from_object, context.options.search.placements.refine);
    if (!refined) continue;
    PlacedObject p = candidate;
    p.scene_from_object = *refined;
    const Rigid3& pose = p.scene_from_object;
    const double height = HeightAbovePlane(object, pose, plane).lowest_m;
    if (!IsUprightObject(acceptance, object, pose, plane)) continue;
    if (std::abs(height) > acceptance.plane_tolerance_m &&
        !StandsOnObject(context, *scene, p, height)) {
      continue;
    }
    if (std::any_of(scene->objects.begin(), scene->objects.end(), [&](const PlacedObject& o) {
          return SharedVolume(*context.objects[o.object], o.scene_from_object, object, pose) >
                 acceptance.max_shared_volume;
        })) {
      continue;
    }
    const double shared = accepted_objects.Judge(&p);
    if (p.score < acceptance.hidden_score || p.total.Sharpness() < acceptance.hidden_sharpness)
      continue;
    if (shared > acceptance.max_shared_edges) continue;
    scene->objects.push_back(p);
    accepted_objects.Add(p);
  }
}

}  // namespace horopter
