#include "server/vision/recognition/initialization/plane_initialization.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/candidates/shortlist.h"
#include "server/vision/recognition/candidates/standing_poses.h"
#include "server/vision/recognition/initialization/view_linking.h"
#include "server/vision/recognition/scene/scene_refine.h"
#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

constexpr double kMinHypothesisScore = 0.42;  // joint; worse ones are not refined, for time

// An image edge that ends at a junction b, with the edges that go on from there.
struct SightedEdge {
  PlaneSighting a, b;
  HeightMask heights;
  struct Next {
    PlaneSighting c;
    HeightMask heights;
  };
  std::vector<Next> next;
};

// The same of a model: an edge a-b and the paths' edges b-c.
struct ModelEdgeEnd {
  int a = -1, b = -1, edge = -1;
  struct Next {
    int c = -1, edge = -1;
  };
  std::vector<Next> next;
};

// Both directions of every vertex path, grouped by their first edge: what the first edge says of a
// pose is worked out once.
std::vector<ModelEdgeEnd> EdgeEnds(const PreparedObject& object) {
  std::vector<ModelEdgeEnd> ends;
  std::map<std::pair<int, int>, std::size_t> at;  // by (edge, b)
  const auto add = [&](int a, int b, int edge, ModelEdgeEnd::Next next) {
    const auto [it, is_new] = at.try_emplace({edge, b}, ends.size());
    if (is_new) ends.push_back({a, b, edge, {}});
    ends[it->second].next.push_back(next);
  };
  for (const VertexPath& p : object.paths) {
    add(p.a, p.b, p.edge_ab, {p.c, p.edge_bc});
    add(p.c, p.b, p.edge_bc, {p.a, p.edge_ab});
  }
  return ends;
}

// The image's paths, grouped likewise; each path in one direction, the model's paths come in both.
std::vector<SightedEdge> SightEdges(const JointContext& context,
                                    std::span<const KnownView> views,
                                    std::size_t own,
                                    int view,
                                    double max_height,
                                    int max_paths) {
  const auto& flags = context.matching->segment_on_plane;
  std::vector<SightedEdge> out;
  std::map<std::pair<double, double>, std::map<std::pair<double, double>, std::size_t>> at;
  for (const ImagePath& p :
       FindImagePaths(*context.views[view].features,
                      view < static_cast<int>(flags.size()) ? flags[view] : std::vector<bool>{},
                      context.views[view].maps.working_from_image,
                      max_paths)) {
    PlaneSighting a, b, c;
    const PinholeCamera& camera = views[own].camera;
    const Rigid3& pose = views[own].camera_from_scene;
    if (!SightPlane(camera, pose, p.a, &a) || !SightPlane(camera, pose, p.b, &b) ||
        !SightPlane(camera, pose, p.c, &c)) {
      continue;
    }
    const auto [it, is_new] = at[{p.b.x(), p.b.y()}].try_emplace({p.a.x(), p.a.y()}, out.size());
    if (is_new) {
      out.push_back({a, b, SupportedHeights(views, own, a, b, max_height, max_height), {}});
    }
    out[it->second].next.push_back({c, SupportedHeights(views, own, b, c, max_height, max_height)});
  }
  return out;
}

// Votes of one view's paths for a standing part. eye: the camera's centre.
void VoteByPaths(const PreparedObject& object,
                 const StandingObject& standing,
                 const std::vector<ModelEdgeEnd>& ends,
                 const Eigen::Vector3d& eye,
                 const std::vector<SightedEdge>& edges,
                 double max_height,
                 double tolerance,
                 PoseVotes* votes) {
  for (const ModelEdgeEnd& end : ends) {
    const Eigen::Vector3d &a = standing.vertices[end.a], &b = standing.vertices[end.b];
    const bool level_ab = std::abs(a.z() - b.z()) < kLevel, upright = IsUpright(a, b);
    for (const SightedEdge& seen : edges) {
      const auto vote = [&](const PlaneYaw& yaw,
                            const ModelEdgeEnd::Next& next,
                            const SightedEdge::Next& seen_next) {
        const double share = b.z() * yaw.units_per_metre / max_height;
        if (level_ab && !seen.heights.At(share)) return;
        const bool level_bc = std::abs(standing.vertices[next.c].z() - b.z()) < kLevel;
        if (level_bc && !seen_next.heights.At(share)) return;
        if (EdgesVisible(object, standing, yaw, eye, end.edge, next.edge)) votes->Add(yaw, 1.0);
      };
      PlaneYaw yaws[2];
      if (upright) {
        for (const ModelEdgeEnd::Next& next : end.next) {
          const Eigen::Vector3d vertices[3] = {a, b, standing.vertices[next.c]};
          for (const SightedEdge::Next& seen_next : seen.next) {
            const PlaneSighting sightings[3] = {seen.a, seen.b, seen_next.c};
            const int n = PosesFromSightings(vertices, sightings, tolerance, yaws);
            for (int i = 0; i < n; ++i) vote(yaws[i], next, seen_next);
          }
        }
        continue;
      }
      const int n = YawsFromEdge(a, b, seen.a, seen.b, yaws);
      for (int i = 0; i < n; ++i) {
        if (level_ab && !seen.heights.At(b.z() * yaws[i].units_per_metre / max_height)) continue;
        for (const ModelEdgeEnd::Next& next : end.next) {
          const Eigen::Vector3d& c = standing.vertices[next.c];
          const double limit = tolerance * ((b - a).norm() + (c - b).norm());
          for (const SightedEdge::Next& seen_next : seen.next) {
            if (MissOf(yaws[i], c, seen_next.c) <= limit) vote(yaws[i], next, seen_next);
          }
        }
      }
    }
  }
}

// Distinct poses of one object, by the votes of all views.
std::vector<PooledPose> InitialPoses(const JointContext& context,
                                     std::span<const KnownView> views,
                                     const std::vector<std::vector<SightedEdge>>& edges,
                                     const PreparedObject& object,
                                     const PlaneSearchOptions& options) {
  const std::vector<ModelEdgeEnd> ends = EdgeEnds(object);
  const double max_height = MaxHeight(views);
  PosePool pool(options.min_quick);
  for (const StandingObject& standing : StandingObjects(object)) {
    if (IsStopRequested(context.give_up)) return {};
    PoseVotes votes(options.votes);
    for (std::size_t v = 0; v < views.size(); ++v) {
      VoteByPaths(object,
                  standing,
                  ends,
                  views[v].camera_from_scene.Inverse().t,
                  edges[v],
                  max_height,
                  options.path_tolerance,
                  &votes);
    }
    ScorePeaks(object,
               standing,
               views,
               votes.Peaks(options.min_path_votes, options.peaks),
               options.quick_reach_px,
               &pool);
  }
  return DistinctPoses(object, views, InTurn(std::move(pool).Sorted()), options.kept_per_object);
}

}  // namespace

std::optional<SceneModel> RefinedHypothesis(const JointContext& context,
                                            const Reconstruction& reconstruction,
                                            double units_per_metre,
                                            int object,
                                            const Rigid3& world_from_object) {
  SceneModel scene;
  scene.views.resize(reconstruction.views.size());
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!reconstruction.views[v]) continue;
    CalibratedCamera view = *reconstruction.views[v];
    view.camera_from_scene.t /= units_per_metre;
    scene.views[v] = view;
  }
  PlacedObject placed;
  placed.object = object;
  placed.scene_from_object = world_from_object;
  scene.objects.push_back(placed);
  SceneRefineOptions refine = context.options.search.scene_refine;
  refine.start_reach_px = refine.guess_reach_px;
  if (!RefineScene(context, refine, &scene)) return std::nullopt;
  VerifyScratch scratch;
  EvaluatePlacement(context, scene.views, {}, &scratch, &scene.objects[0]);
  scene.description_gain = scene.objects[0].description_gain;
  return scene;
}

std::vector<SceneModel> BestScales(std::vector<ScaledHypothesis> starts,
                                   int max_scales,
                                   std::size_t catalog) {
  const double penalty = MultipleTestingPenalty(catalog);
  const auto object_of = [](const ScaledHypothesis& s) { return s.scene.objects[0].object; };
  std::erase_if(starts, [](const ScaledHypothesis& s) { return s.scene.objects.empty(); });
  // EdgeLogLikelihoodRatio tells better than what is explained: among many objects some explain
  // much at any scale.
  const auto log_ratio_of = [&](const ScaledHypothesis& s) {
    return std::max(0.0, LogLikelihoodRatio(s.scene.objects[0]) - penalty);
  };
  // A scale is as good as the parts that share it; parts of one object vote once.
  std::vector<int> order;
  std::vector<double> votes(starts.size(), 0.0);
  for (std::size_t i = 0; i < starts.size(); ++i) {
    if (starts[i].scene.objects[0].score < kMinHypothesisScore) continue;
    order.push_back(static_cast<int>(i));
    std::map<int, double> of_object;
    for (const ScaledHypothesis& other : starts) {
      if (std::abs(std::log(starts[i].units_per_metre / other.units_per_metre)) > kDistinctScale)
        continue;
      double& vote = of_object[object_of(other)];
      vote = std::max(vote, log_ratio_of(other));
    }
    for (const auto& [object, vote] : of_object) votes[i] += vote;
  }
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return votes[a] + log_ratio_of(starts[a]) > votes[b] + log_ratio_of(starts[b]);
  });
  std::vector<SceneModel> out;
  std::vector<double> chosen;
  for (const int i : order) {
    if (static_cast<int>(out.size()) >= max_scales) break;
    const double units = starts[i].units_per_metre;
    if (std::any_of(chosen.begin(), chosen.end(), [&](double u) {
          return std::abs(std::log(u / units)) < kDistinctScale;
        })) {
      continue;
    }
    chosen.push_back(units);
    out.push_back(std::move(starts[i].scene));
  }
  return out;
}

namespace {

// Poses of objects by number, each the first of a scene that is refined; empty scenes where none
// is.
std::vector<ScaledHypothesis> RefinedPoses(const JointContext& context,
                                           const Reconstruction& reconstruction,
                                           const std::vector<std::pair<int, PooledPose>>& best) {
  std::vector<SceneModel> scenes(best.size());
  std::vector<double> units(best.size(), 1.0);
  ParallelFor(static_cast<int>(best.size()), context.options.threads, [&](int i) {
    if (IsStopRequested(context.give_up)) return;
    auto scene = RefinedHypothesis(context,
                                   reconstruction,
                                   best[i].second.units_per_metre,
                                   best[i].first,
                                   best[i].second.plane_from_object);
    if (!scene) return;
    units[i] = best[i].second.units_per_metre;
    scenes[i] = *std::move(scene);
  });
  std::vector<ScaledHypothesis> starts;
  for (std::size_t i = 0; i < scenes.size(); ++i)
    starts.push_back({std::move(scenes[i]), units[i]});
  return starts;
}

// The objects whose poses have the best quick scores.
std::vector<bool> MostPromising(const std::vector<std::vector<PooledPose>>& ranked, int most) {
  std::vector<double> promise(ranked.size(), 0.0);
  for (std::size_t k = 0; k < ranked.size(); ++k) {
    for (const PooledPose& p : ranked[k]) promise[k] = std::max(promise[k], p.quick);
  }
  std::vector<bool> wanted(ranked.size(), false);
  for (const int k : Largest(promise, most)) wanted[k] = true;
  return wanted;
}

}  // namespace

std::vector<SceneModel> PlaneInitialScenes(const JointContext& context,
                                           const Reconstruction& reconstruction) {
  const PlaneSearchOptions& options = context.options.search.plane;
  const ShortlistOptions& shortlist = context.options.search.shortlist;
  BeginStep(context, "plane_sightings");
  std::vector<KnownView> views;
  std::vector<int> index;
  for (std::size_t v = 0; v < reconstruction.views.size(); ++v) {
    if (!reconstruction.views[v]) continue;
    views.push_back({*reconstruction.views[v], &context.views[v].maps});
    index.push_back(static_cast<int>(v));
  }
  if (views.size() < 2) return {};
  const double max_height = MaxHeight(views);
  if (!(max_height > 0)) return {};
  using SightedViews = std::vector<std::vector<SightedEdge>>;
  const auto sight = [&](int max_paths) {
    SightedViews edges(views.size());
    ParallelFor(static_cast<int>(views.size()), context.options.threads, [&](int i) {
      edges[i] = SightEdges(context, views, i, index[i], max_height, max_paths);
    });
    return edges;
  };
  const auto find = [&](const SightedViews& edges, const std::vector<bool>& wanted) {
    std::vector<std::vector<PooledPose>> found(context.objects.size());
    ParallelFor(static_cast<int>(found.size()), context.options.threads, [&](int k) {
      if (wanted[k]) found[k] = InitialPoses(context, views, edges, *context.objects[k], options);
    });
    return found;
  };
  const int objects = static_cast<int>(context.objects.size());
  const SightedViews edges = sight(options.max_paths);

  BeginStep(context, "plane_votes");
  std::vector<bool> wanted(objects, true);
  if (objects > shortlist.searched)
    wanted = MostPromising(find(sight(shortlist.plane_paths_asked), wanted), shortlist.searched);
  const std::vector<std::vector<PooledPose>> found = find(edges, wanted);

  BeginStep(context, "plane_hypotheses");
  std::vector<std::pair<int, PooledPose>> best;
  for (int k = 0; k < objects; ++k) {
    for (const PooledPose& p : found[k]) best.push_back({k, p});
  }
  std::stable_sort(best.begin(), best.end(), [](const auto& a, const auto& b) {
    return a.second.quick > b.second.quick;
  });
  if (static_cast<int>(best.size()) > options.refined_initial) best.resize(options.refined_initial);
  std::vector<ScaledHypothesis> starts = RefinedPoses(context, reconstruction, best);
  if (IsStopRequested(context.give_up)) return {};  // a part of them may lack the right ones
  return BestScales(std::move(starts), context.options.search.plane_scales, context.objects.size());
}

}  // namespace horopter
