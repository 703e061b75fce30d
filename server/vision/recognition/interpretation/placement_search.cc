#include "server/vision/recognition/interpretation/placement_search.h"

#include <algorithm>
#include <cmath>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/candidates/shortlist.h"
#include "server/vision/recognition/initialization/view_linking.h"
#include "server/vision/recognition/scoring/pose_refine.h"

namespace horopter {
namespace {

bool SamePlacement(const PreparedObject& object,
                   const PlacementSearchOptions& options,
                   const Rigid3& a,
                   const Rigid3& b) {
  auto close = [&](const Rigid3& x) {
    if ((x * object.center - b * object.center).norm() > options.same_distance_m) return false;
    const double c = 0.5 * ((x.R.transpose() * b.R).trace() - 1.0);
    return c > std::cos(options.same_turn_rad);
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
    views.push_back({{scene.views[v]->camera, scene.views[v]->camera_from_scene},
                     context.views[v].features,
                     context.views[v].maps.working_from_image});
  }
  return views;
}

// Mean quick score over the views in which the object's centre is inside the image.
double QuickOverViews(const PreparedObject& object,
                      std::span<const KnownView> views,
                      const Rigid3& scene_from_object,
                      float reach_px) {
  double sum = 0.0;
  int n = 0;
  for (const KnownView& view : views) {
    const Rigid3 pose = view.camera_from_scene * scene_from_object;
    const Eigen::Vector3d c = pose * object.center;
    if (c.z() <= object.radius_m) return 0.0;
    const Eigen::Vector2d u = Project(view.camera, c);
    if (u.x() < 0 || u.y() < 0 || u.x() >= view.camera.width || u.y() >= view.camera.height)
      continue;
    sum += QuickScore(object, *view.maps, view.camera, pose, reach_px, 0.2f);
    ++n;
  }
  return n > 0 ? sum / n : 0.0;
}

struct Candidate {
  double quick = 0.0;
  Rigid3 pose;  // scene from object
};

// Poses of an object, best quick score first: those on the plane, and hypotheses of single views
// settled in these.
std::vector<Candidate> CandidatesOf(const JointContext& context,
                                    const HypothesisTable& table,
                                    const SceneModel& scene,
                                    int k,
                                    std::span<const KnownView> known,
                                    std::span<const PlanePose> on_plane,
                                    bool use_pool) {
  const PlacementSearchOptions& options = context.options.search.placements;
  const PreparedObject& object = *context.objects[k];
  std::vector<Candidate> candidates;
  for (const PlanePose& pose : on_plane) {
    candidates.push_back(
        {QuickOverViews(object, known, pose.scene_from_object, options.quick_reach_px),
         pose.scene_from_object});
  }
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!scene.views[v]) continue;
    const CalibratedCamera& view = *scene.views[v];
    const Rigid3 scene_from_camera = view.camera_from_scene.Inverse();
    const ViewHypotheses& hypotheses = table[v][k];
    for (const ViewHypothesis& h : use_pool ? hypotheses.pool : hypotheses.best) {
      const Rigid3 start = WithFocal(h.camera_from_object, h.camera.focal_px, view.camera.focal_px);
      const auto settled =
          RefineInView(object, context.views[v].maps, view.camera, start, options.settle);
      if (!settled) continue;
      const Rigid3 pose = scene_from_camera * settled->camera_from_object;
      const double quick = QuickOverViews(object, known, pose, options.quick_reach_px);
      if (quick >= options.min_quick) candidates.push_back({quick, pose});
    }
  }
  std::stable_sort(candidates.begin(), candidates.end(), [](const auto& x, const auto& y) {
    return x.quick > y.quick;
  });
  return candidates;
}

std::vector<PlacedObject> PlacementsOfObject(const JointContext& context,
                                             const HypothesisTable& hypotheses,
                                             const SceneModel& scene,
                                             int k,
                                             std::span<const KnownView> known,
                                             std::span<const PlanePose> on_plane,
                                             bool use_pool) {
  const PlacementSearchOptions& options = context.options.search.placements;
  const PreparedObject& object = *context.objects[k];
  std::vector<PlacedObject> placed;
  VerifyScratch scratch;
  int tried = 0;
  std::vector<Rigid3> starts;
  for (const Candidate& c :
       CandidatesOf(context, hypotheses, scene, k, known, on_plane, use_pool)) {
    if (tried >= options.kept_per_object || IsStopRequested(context.stop)) break;
    if (std::any_of(starts.begin(), starts.end(), [&](const Rigid3& p) {
          return SamePlacement(object, options, p, c.pose);
        })) {
      continue;
    }
    starts.push_back(c.pose);
    ++tried;
    const auto refined = RefineInScene(object, known, c.pose, options.refine);
    if (!refined) continue;
    if (std::any_of(placed.begin(), placed.end(), [&](const PlacedObject& p) {
          return SamePlacement(object, options, p.scene_from_object, *refined);
        })) {
      continue;
    }
    PlacedObject p;
    p.object = k;
    p.scene_from_object = *refined;
    EvaluatePlacement(context, scene.views, {}, &scratch, &p);
    if (p.score >= options.min_raw_score) placed.push_back(std::move(p));
  }
  return placed;
}

}  // namespace

std::vector<PlacedObject> CollectPlacements(const JointContext& context,
                                            const JointContext& search,
                                            const HypothesisTable& hypotheses,
                                            const SceneModel& scene,
                                            const std::vector<SearchSurface>& surfaces,
                                            std::span<const PlacedObject> earlier,
                                            const PlacementRound& round,
                                            std::vector<bool>* shortlist) {
  const EdgeSearchOptions& options = context.options.search;
  const int threads = round.thorough ? context.options.threads : 1;
  const std::vector<KnownView> known = KnownViews(context, scene);
  const std::vector<KnownView> searched = KnownViews(search, scene);
  std::vector<std::vector<PlacedObject>> per_object(context.objects.size());
  std::optional<PlaneSearch> plane_search;
  if (round.search_plane && scene.plane && !surfaces.empty()) {
    plane_search.emplace(
        search, scene, surfaces, round.first ? options.plane_first_look : options.plane);
  }
  const std::vector<FeatureView> views = FeatureViews(search, scene);
  const std::vector<SpaceCorner> corners = FindSpaceCorners(views, options.space_corners);
  const std::vector<SpaceCircle> circles = FindSpaceCircles(views, options.space_circles);
  const int objects = static_cast<int>(per_object.size());
  const Shortlist promising = PromisingInSpace(
      context.objects, searched, corners, circles, *shortlist, options.shortlist, threads);
  if (shortlist->empty()) *shortlist = promising.shortlist;
  ParallelFor(objects, threads, [&](int k) {
    if (IsStopRequested(context.stop)) return;
    std::vector<PlanePose> suggested;
    if (promising.searched[k]) {
      if (plane_search) suggested = plane_search->Find(k);
      const PreparedObject& object = *context.objects[k];
      for (const PooledPose& p :
           SettledPoses(object,
                        searched,
                        PosesInSpace(object, searched, corners, circles, options.corners),
                        options.corners.settle)) {
        suggested.push_back({p.plane_from_object, p.quick});
      }
    }
    for (const PlacedObject& p : earlier) {
      if (p.object == k) suggested.push_back({p.scene_from_object});
    }
    per_object[k] =
        PlacementsOfObject(context, hypotheses, scene, k, known, suggested, round.thorough);
  });
  std::vector<PlacedObject> all;
  for (auto& list : per_object) {
    for (PlacedObject& p : list) all.push_back(std::move(p));
  }
  std::stable_sort(
      all.begin(), all.end(), [](const auto& x, const auto& y) { return x.score > y.score; });
  return all;
}

}  // namespace horopter
