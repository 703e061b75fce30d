#include "server/vision/recognition/scene_expansion.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/plane_points.h"
#include "server/vision/recognition/pose_refine.h"
#include "server/vision/recognition/scene_refine.h"
#include "server/vision/recognition/standing_plane.h"
#include "server/vision/recognition/support_surface.h"
#include "server/vision/recognition/verdict.h"
#include "server/vision/recognition/view_linking.h"

namespace horopter {
namespace {

// Two placements of one object are the same below these (with its symmetries).
constexpr double kSameDistanceM = 0.006;
constexpr double kSameTurnRad = 0.12;
// A plane is shared by objects whose stable plane agrees within these.
constexpr double kPlaneCos = 0.9945;  // 6 degrees
constexpr double kPlaneOffsetM = 0.008;
constexpr int kMinPlaneMatches = 20;
// A placement behind the plane must be so much surer than any on it to disprove the plane.
constexpr double kBehindFactor = 2.0;
constexpr double kMinRawScore = 0.35;  // placements below are not worth keeping

std::vector<KnownView> KnownViews(const JointContext& context, const SceneModel& scene) {
  std::vector<KnownView> known;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    known.push_back(
        {&context.views[v].maps, scene.views[v]->camera, scene.views[v]->camera_from_scene});
  }
  return known;
}

bool SamePlacement(const PreparedObject& object, const Rigid3& a, const Rigid3& b) {
  auto close = [&](const Rigid3& x) {
    if ((x * object.center - b * object.center).norm() > kSameDistanceM) return false;
    const double c = 0.5 * ((x.R.transpose() * b.R).trace() - 1.0);
    return c > std::cos(kSameTurnRad);
  };
  if (close(a)) return true;
  return std::any_of(object.model.symmetries.begin(),
                     object.model.symmetries.end(),
                     [&](const Rigid3& s) { return close(a * s); });
}

std::vector<FeatureView> FeatureViews(const JointContext& context, const SceneModel& scene) {
  std::vector<FeatureView> views;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    views.push_back({context.views[v].features,
                     scene.views[v]->camera,
                     scene.views[v]->camera_from_scene,
                     context.views[v].maps.working_from_image});
  }
  return views;
}

// Mean quick score over the views in which the object's centre is inside the image.
double QuickOverViews(const PreparedObject& object,
                      std::span<const KnownView> views,
                      const Rigid3& scene_from_object,
                      const ExpansionOptions& options) {
  double sum = 0.0;
  int n = 0;
  for (const KnownView& view : views) {
    const Rigid3 pose = view.camera_from_scene * scene_from_object;
    const Eigen::Vector3d c = pose * object.center;
    if (c.z() <= object.radius_m) return 0.0;
    const Eigen::Vector2d u = Project(view.camera, c);
    if (u.x() < 0 || u.y() < 0 || u.x() >= view.camera.width || u.y() >= view.camera.height)
      continue;
    sum += QuickScore(object, *view.maps, view.camera, pose, options.quick_reach_px, 0.2f);
    ++n;
  }
  return n > 0 ? sum / n : 0.0;
}

std::vector<PlacedObject> PlacementsOfObject(const JointContext& context,
                                             const SceneModel& scene,
                                             int k,
                                             std::span<const KnownView> known,
                                             std::span<const TablePose> on_table,
                                             const ExpansionOptions& options) {
  const PreparedObject& object = *context.objects[k];
  struct Candidate {
    double quick;
    Rigid3 pose;
  };
  std::vector<Candidate> candidates;
  for (const TablePose& pose : on_table) {
    candidates.push_back(
        {QuickOverViews(object, known, pose.scene_from_object, options), pose.scene_from_object});
  }
  RefineOptions settle;
  settle.iterations = 3;
  settle.start_reach_px = 6.0;
  settle.focal_log_sigma = 0.0;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    const RecognizedView& view = *scene.views[v];
    const Rigid3 scene_from_camera = view.camera_from_scene.Inverse();
    const ViewHypotheses& hypotheses = context.hypotheses[v][k];
    for (const ViewHypothesis& h : options.use_pool ? hypotheses.pool : hypotheses.best) {
      const Rigid3 start = WithFocal(h.camera_from_object, h.camera.focal_px, view.camera.focal_px);
      const auto settled = RefineInView(object, context.views[v].maps, view.camera, start, settle);
      if (!settled) continue;
      const Rigid3 pose = scene_from_camera * settled->camera_from_object;
      const double quick = QuickOverViews(object, known, pose, options);
      if (quick >= options.min_quick) candidates.push_back({quick, pose});
    }
  }
  std::stable_sort(candidates.begin(), candidates.end(), [](const auto& x, const auto& y) {
    return x.quick > y.quick;
  });

  std::vector<PlacedObject> placed;
  VerifyScratch scratch;
  RefineOptions refine;
  refine.start_reach_px = 10.0;
  int tried = 0;
  std::vector<Rigid3> starts;
  for (const Candidate& c : candidates) {
    if (tried >= options.kept_per_object || IsStopRequested(context.stop)) break;
    if (std::any_of(starts.begin(), starts.end(), [&](const Rigid3& p) {
          return SamePlacement(object, p, c.pose);
        })) {
      continue;
    }
    starts.push_back(c.pose);
    ++tried;
    const auto refined = RefineInScene(object, known, c.pose, refine);
    if (!refined) continue;
    if (std::any_of(placed.begin(), placed.end(), [&](const PlacedObject& p) {
          return SamePlacement(object, p.scene_from_object, *refined);
        })) {
      continue;
    }
    PlacedObject p;
    p.object = k;
    p.scene_from_object = *refined;
    EvaluatePlacement(context, scene.views, {}, &scratch, &p);
    if (p.score >= kMinRawScore) placed.push_back(std::move(p));
  }
  return placed;
}

// What decides which placement is accepted next: sure and large ones first.
double Priority(const PlacedObject& p) {
  return (p.score - 0.45) * std::sqrt(std::max(0.0, p.total.supported));
}

bool IsUpright(const StablePose& pose, const Rigid3& scene_from_object, const ScenePlane& plane) {
  return (scene_from_object.R * pose.up).dot(plane.normal) > kPlaneCos;
}

bool RestsOn(const PreparedObject& object,
             const Rigid3& scene_from_object,
             const ScenePlane& plane) {
  return std::any_of(
      object.stable_poses.begin(), object.stable_poses.end(), [&](const StablePose& s) {
        const double height = plane.normal.dot(scene_from_object.t) - plane.offset_m - s.height_m;
        return IsUpright(s, scene_from_object, plane) && std::abs(height) < kPlaneOffsetM;
      });
}

// Whether the part is turned as it can rest on a level surface.
bool IsUprightPart(const PreparedObject& object,
                   const Rigid3& scene_from_object,
                   const ScenePlane& plane) {
  return std::any_of(object.stable_poses.begin(),
                     object.stable_poses.end(),
                     [&](const StablePose& s) { return IsUpright(s, scene_from_object, plane); });
}

// Whether a plane of matched texture carries parts. It may as well be a printed face of a part:
// then the surest placements lie behind it.
bool Supports(const JointContext& context,
              const ExpansionOptions& options,
              std::span<const PlacedObject> placements,
              const ScenePlane& plane) {
  double on = 0.0, behind = 0.0;
  for (const PlacedObject& p : placements) {
    if (p.gain <= 0 || p.score < options.accept_score) continue;
    const double height =
        HeightAbovePlane(*context.objects[p.object], p.scene_from_object, plane).lowest_m;
    if (std::abs(height) < options.plane_tolerance_m) on = std::max(on, Priority(p));
    if (height < -3 * options.plane_tolerance_m) behind = std::max(behind, Priority(p));
  }
  return behind <= kBehindFactor * on;
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

// Whether a part whose lowest point is at the height lies on top of an accepted one.
bool StandsOnPart(const JointContext& context,
                  const ExpansionOptions& options,
                  const SceneModel& scene,
                  const PlacedObject& p,
                  double height) {
  return std::any_of(scene.objects.begin(), scene.objects.end(), [&](const PlacedObject& o) {
    const PreparedObject &above = *context.objects[p.object], &below = *context.objects[o.object];
    const double top = HeightAbovePlane(below, o.scene_from_object, *scene.plane).highest_m;
    return std::abs(height - top) < options.plane_tolerance_m &&
           LiesOver(OutlineOnPlane(above, p.scene_from_object, *scene.plane),
                    OutlineOnPlane(below, o.scene_from_object, *scene.plane));
  });
}

}  // namespace

std::optional<ScenePlane> PlaneFromMatches(
    const JointContext& context, const std::vector<std::optional<RecognizedView>>& views) {
  const PlanePoints points = FindPlanePoints(*context.matching, views);
  if (static_cast<int>(points.matches.size()) < kMinPlaneMatches) return std::nullopt;
  // plane.(X - anchor) = -1: the normal points from the plane to the anchor, the mean camera
  // centre.
  ScenePlane plane;
  const double norm = points.plane.norm();
  plane.normal = points.plane / norm;
  plane.offset_m = plane.normal.dot(points.anchor) - 1.0 / norm;
  return plane;
}

std::optional<ScenePlane> FindSupportPlane(const JointContext& context,
                                           const std::vector<std::optional<RecognizedView>>& views,
                                           std::span<const PlacedObject> placements,
                                           const ExpansionOptions& options) {
  std::vector<const PlacedObject*> voters;
  for (const PlacedObject& p : placements) {
    if (p.gain > 0 && p.score >= options.accept_score) voters.push_back(&p);
  }
  std::stable_sort(voters.begin(), voters.end(), [](const auto* x, const auto* y) {
    return Priority(*x) > Priority(*y);
  });
  if (static_cast<int>(voters.size()) > options.plane_voters) voters.resize(options.plane_voters);
  std::vector<Eigen::Vector3d> eyes;
  for (const auto& view : views) {
    if (view) eyes.push_back(view->camera_from_scene.Inverse().t);
  }
  std::optional<ScenePlane> best;
  double best_votes = 0.0;
  for (const PlacedObject* o : voters) {
    for (const StablePose& stable : context.objects[o->object]->stable_poses) {
      ScenePlane plane;
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
        if (!RestsOn(*context.objects[other->object], other->scene_from_object, plane)) continue;
        if (std::any_of(resting.begin(), resting.end(), [&](const PlacedObject* r) {
              return SharedVolume(*context.objects[r->object],
                                  r->scene_from_object,
                                  *context.objects[other->object],
                                  other->scene_from_object) > options.max_shared_volume;
            })) {
          continue;
        }
        resting.push_back(other);
        votes += Priority(*other);
      }
      if (resting.size() >= 2 && votes > best_votes) {
        best_votes = votes;
        best = plane;
      }
    }
  }
  return best;
}

std::vector<PlacedObject> CollectPlacements(const JointContext& context,
                                            const JointContext& search,
                                            const SceneModel& scene,
                                            const std::vector<SearchSurface>& surfaces,
                                            std::span<const PlacedObject> earlier,
                                            const ExpansionOptions& options) {
  const std::vector<KnownView> known = KnownViews(context, scene);
  const std::vector<KnownView> searched = KnownViews(search, scene);
  std::vector<std::vector<PlacedObject>> per_object(context.objects.size());
  std::optional<TableSearch> table;
  if (options.use_table && scene.plane && !surfaces.empty())
    table.emplace(search, scene, surfaces, options.table);
  const std::vector<FeatureView> views = FeatureViews(search, scene);
  const std::vector<SpaceCorner> corners = FindSpaceCorners(views);
  const std::vector<SpaceCircle> circles = FindSpaceCircles(views);
  ParallelFor(static_cast<int>(per_object.size()), options.threads, [&](int k) {
    if (IsStopRequested(context.stop)) return;
    std::vector<TablePose> on_table;
    if (table) on_table = table->Find(k);
    const PreparedObject& object = *context.objects[k];
    std::vector<PooledPose> in_space = PosesFromCorners(object, searched, corners, options.corners);
    for (PooledPose& p : PosesFromCircles(object, searched, circles, options.corners))
      in_space.push_back(std::move(p));
    std::stable_sort(in_space.begin(), in_space.end(), [](const auto& x, const auto& y) {
      return x.quick > y.quick;
    });
    for (const PooledPose& p :
         SettledPoses(object, searched, std::move(in_space), options.corners.settle)) {
      on_table.push_back({p.table_from_object, p.quick});
    }
    for (const PlacedObject& p : earlier) {
      if (p.object == k) on_table.push_back({p.scene_from_object});
    }
    per_object[k] = PlacementsOfObject(context, scene, k, known, on_table, options);
  });
  std::vector<PlacedObject> all;
  for (auto& list : per_object) {
    for (PlacedObject& p : list) all.push_back(std::move(p));
  }
  std::stable_sort(
      all.begin(), all.end(), [](const auto& x, const auto& y) { return x.score > y.score; });
  return all;
}

void Consolidate(const JointContext& context,
                 const ExpansionOptions& options,
                 std::vector<PlacedObject> candidates,
                 SceneModel* scene) {
  const std::vector<PlacedObject> before = std::move(scene->objects);
  scene->objects.clear();
  scene->gain = 0.0;
  scene->plane = PlaneFromMatches(context, scene->views);
  if (scene->plane) scene->plane = PlaneUnderParts(context, before, *scene->plane);
  if (scene->plane && !Supports(context, options, candidates, *scene->plane)) scene->plane.reset();
  if (!scene->plane) scene->plane = FindSupportPlane(context, scene->views, candidates, options);
  std::vector<DepthBuffer> occluders;
  for (const ViewEvidence& view : context.views)
    occluders.push_back(MakeDepthBuffer(view.maps.width, view.maps.height));
  VerifyScratch scratch;
  ExplainedSegments explained, taken;
  for (const ViewEvidence& view : context.views) taken.emplace_back(view.segment_samples.size(), 0);
  std::vector<bool> stale(candidates.size(), false);
  std::vector<bool> dead(candidates.size(), false);
  auto acceptable = [&](const PlacedObject& p) {
    if (p.score < options.accept_score) return false;
    if (!scene->plane) return p.gain > 0;
    const double height =
        HeightAbovePlane(*context.objects[p.object], p.scene_from_object, *scene->plane).lowest_m;
    if (height < -2 * options.plane_tolerance_m) return false;  // below the table
    if (p.score >= options.off_plane_score) return p.gain > 0;
    if (!IsUprightPart(*context.objects[p.object], p.scene_from_object, *scene->plane))
      return false;
    if (Evidence(p.score, p.total.Sharpness()) >= options.floating_evidence) return p.gain > 0;
    // Camouflaged parts lack edges that they should show: what they stand on speaks for them.
    return height < options.plane_tolerance_m || StandsOnPart(context, options, *scene, p, height);
  };
  while (!IsStopRequested(context.stop)) {
    int best = -1;
    for (int i = 0; i < static_cast<int>(candidates.size()); ++i) {
      if (dead[i]) continue;
      if (stale[i]) {
        EvaluatePlacement(context, scene->views, occluders, &scratch, &candidates[i], &explained);
        stale[i] = false;
        // One scene feature serves one object.
        if (SharedEdges(explained, taken) > options.max_shared_edges) {
          dead[i] = true;
          continue;
        }
      }
      if (!acceptable(candidates[i])) continue;
      if (best < 0 || Priority(candidates[i]) > Priority(candidates[best])) best = i;
    }
    if (best < 0) break;
    const PlacedObject accepted = candidates[best];
    PlacedObject again = accepted;
    EvaluatePlacement(context, scene->views, occluders, &scratch, &again, &explained);
    for (std::size_t v = 0; v < taken.size(); ++v) {
      for (std::size_t i = 0; i < explained[v].size(); ++i) taken[v][i] |= explained[v][i];
    }
    const PreparedObject& object = *context.objects[accepted.object];
    scene->objects.push_back(accepted);
    scene->gain += std::max(0.0, accepted.gain);
    dead[best] = true;
    for (std::size_t v = 0; v < occluders.size(); ++v) {
      if (!scene->views[v]) continue;
      RenderDepth(object.model.mesh,
                  WorkingCamera(scene->views[v]->camera, context.views[v].maps),
                  scene->views[v]->camera_from_scene * accepted.scene_from_object,
                  &occluders[v]);
    }
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      if (dead[i]) continue;
      stale[i] = true;
      if (SharedVolume(object,
                       accepted.scene_from_object,
                       *context.objects[candidates[i].object],
                       candidates[i].scene_from_object) > options.max_shared_volume) {
        dead[i] = true;
      }
    }
  }
}

void AddHiddenParts(const JointContext& context,
                    const ExpansionOptions& options,
                    std::span<const PlacedObject> candidates,
                    SceneModel* scene) {
  if (!scene->plane || scene->objects.size() < 2) return;
  if (SceneProbability(context, *scene) < options.sure_scene) return;
  const ScenePlane plane = PlaneUnderParts(context, scene->objects, *scene->plane);
  scene->plane = plane;
  const std::vector<KnownView> known = KnownViews(context, *scene);
  std::vector<DepthBuffer> occluders;
  for (const ViewEvidence& view : context.views)
    occluders.push_back(MakeDepthBuffer(view.maps.width, view.maps.height));
  ExplainedSegments explained, taken;
  for (const ViewEvidence& view : context.views) taken.emplace_back(view.segment_samples.size(), 0);
  VerifyScratch scratch;
  const auto take = [&](PlacedObject p) {
    EvaluatePlacement(context, scene->views, occluders, &scratch, &p, &explained);
    for (std::size_t v = 0; v < taken.size(); ++v) {
      for (std::size_t i = 0; i < explained[v].size(); ++i) taken[v][i] |= explained[v][i];
      if (!scene->views[v]) continue;
      RenderDepth(context.objects[p.object]->model.mesh,
                  WorkingCamera(scene->views[v]->camera, context.views[v].maps),
                  scene->views[v]->camera_from_scene * p.scene_from_object,
                  &occluders[v]);
    }
  };
  for (const PlacedObject& o : scene->objects) take(o);
  for (const PlacedObject& candidate : candidates) {
    if (IsStopRequested(context.stop)) return;
    if (candidate.score < options.hidden_score - options.hidden_slack) continue;
    const PreparedObject& object = *context.objects[candidate.object];
    // The cameras have moved since it was found.
    const auto refined = RefineInScene(object, known, candidate.scene_from_object, {});
    if (!refined) continue;
    PlacedObject p = candidate;
    p.scene_from_object = *refined;
    const Rigid3& pose = p.scene_from_object;
    const double height = HeightAbovePlane(object, pose, plane).lowest_m;
    if (!IsUprightPart(object, pose, plane)) continue;
    if (std::abs(height) > options.plane_tolerance_m &&
        !StandsOnPart(context, options, *scene, p, height)) {
      continue;
    }
    if (std::any_of(scene->objects.begin(), scene->objects.end(), [&](const PlacedObject& o) {
          return SharedVolume(*context.objects[o.object], o.scene_from_object, object, pose) >
                 options.max_shared_volume;
        })) {
      continue;
    }
    EvaluatePlacement(context, scene->views, occluders, &scratch, &p, &explained);
    if (p.score < options.hidden_score || p.total.Sharpness() < options.hidden_sharpness) continue;
    if (SharedEdges(explained, taken) > options.max_shared_edges) continue;
    scene->objects.push_back(p);
    take(p);
  }
}

}  // namespace horopter
