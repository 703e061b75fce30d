#include "server/vision/recognition/table_seeds.h"

#include <algorithm>
#include <cmath>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/scene_refine.h"
#include "server/vision/recognition/standing_poses.h"
#include "server/vision/recognition/view_linking.h"

namespace horopter {
namespace {

constexpr double kMinSeedScore = 0.42;

struct SightedPath {
  TableSighting points[3];
  HeightMask heights_ab;
  HeightMask heights_bc;
};

// Votes of one view's paths for a standing part.
void VoteByPaths(const PreparedObject& object,
                 const StandingPart& part,
                 const Eigen::Vector3d& eye,
                 const std::vector<SightedPath>& paths,
                 double max_height,
                 double tolerance,
                 PoseVotes* votes) {
  for (const VertexPath& path : object.paths) {
    for (const bool reversed : {false, true}) {
      const Eigen::Vector3d vertices[3] = {part.vertices[reversed ? path.c : path.a],
                                           part.vertices[path.b],
                                           part.vertices[reversed ? path.a : path.c]};
      const bool level_ab = std::abs(vertices[0].z() - vertices[1].z()) < kLevel;
      const bool level_bc = std::abs(vertices[2].z() - vertices[1].z()) < kLevel;
      for (const SightedPath& seen : paths) {
        TableYaw yaws[2];
        const int n = PosesFromSightings(vertices, seen.points, tolerance, yaws);
        for (int i = 0; i < n; ++i) {
          const double share = yaws[i].units_per_metre / max_height;
          if (level_ab && !seen.heights_ab.At(share * vertices[1].z())) continue;
          if (level_bc && !seen.heights_bc.At(share * vertices[1].z())) continue;
          if (EdgesVisible(object, part, yaws[i], eye, path.edge_ab, path.edge_bc))
            votes->Add(yaws[i], 1.0);
        }
      }
    }
  }
}

}  // namespace

std::optional<SceneModel> RefinedSeed(const JointContext& context,
                                      const Reconstruction& reconstruction,
                                      double units_per_metre,
                                      int object,
                                      const Rigid3& world_from_object) {
  SceneModel scene;
  scene.views.resize(reconstruction.views.size());
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!reconstruction.views[v]) continue;
    RecognizedView view{reconstruction.views[v]->camera,
                        reconstruction.views[v]->camera_from_world};
    view.camera_from_scene.t /= units_per_metre;
    scene.views[v] = view;
  }
  PlacedObject placed;
  placed.object = object;
  placed.scene_from_object = world_from_object;
  scene.objects.push_back(placed);
  SceneRefineOptions refine;
  refine.start_reach_px = 12.0;
  if (!RefineScene(context, refine, &scene)) return std::nullopt;
  VerifyScratch scratch;
  EvaluatePlacement(context, scene.views, {}, &scratch, &scene.objects[0]);
  scene.gain = scene.objects[0].gain;
  return scene;
}

std::vector<SceneModel> TableSeeds(const JointContext& context,
                                   const Reconstruction& reconstruction,
                                   const TableSearchOptions& options,
                                   int max_scales) {
  BeginStep(context, "table_sightings");
  std::vector<KnownView> views;
  std::vector<int> index;
  for (std::size_t v = 0; v < reconstruction.views.size(); ++v) {
    if (!reconstruction.views[v]) continue;
    const ReconstructedView& view = *reconstruction.views[v];
    views.push_back({&context.views[v].maps, view.camera, view.camera_from_world});
    index.push_back(static_cast<int>(v));
  }
  if (views.size() < 2) return {};
  const double max_height = MaxHeight(views);
  if (!(max_height > 0)) return {};
  std::vector<std::vector<SightedPath>> paths(views.size());
  ParallelFor(static_cast<int>(views.size()), context.options.threads, [&](int i) {
    const int v = index[i];
    const auto& flags = context.matching->segment_on_plane;
    for (const ImagePath& p :
         FindImagePaths(*context.views[v].features,
                        v < static_cast<int>(flags.size()) ? flags[v] : std::vector<bool>{},
                        context.views[v].maps.working_from_image,
                        options.max_paths)) {
      SightedPath seen;
      const PinholeCamera& camera = views[i].camera;
      const Rigid3& pose = views[i].camera_from_scene;
      if (!SightTable(camera, pose, p.a, &seen.points[0]) ||
          !SightTable(camera, pose, p.b, &seen.points[1]) ||
          !SightTable(camera, pose, p.c, &seen.points[2])) {
        continue;
      }
      seen.heights_ab = SupportedHeights(views, i, seen.points[0], seen.points[1], max_height, max_height);
      seen.heights_bc = SupportedHeights(views, i, seen.points[1], seen.points[2], max_height, max_height);
      paths[i].push_back(seen);
    }
  });

  BeginStep(context, "table_votes");
  const int objects = static_cast<int>(context.objects.size());
  std::vector<std::vector<PooledPose>> found(objects);
  ParallelFor(objects, context.options.threads, [&](int k) {
    const PreparedObject& object = *context.objects[k];
    const std::vector<StandingPart> parts = StandingParts(object);
    PosePool pool(options.min_quick);
    for (const StandingPart& part : parts) {
      if (IsStopRequested(context.stop)) return;
      PoseVotes votes;
      for (std::size_t v = 0; v < views.size(); ++v) {
        VoteByPaths(object, part, views[v].camera_from_scene.Inverse().t, paths[v], max_height, options.path_tolerance, &votes);
      }
      ScorePeaks(object,
                 part,
                 views,
                 votes.Peaks(options.min_path_votes, options.peaks),
                 options.quick_reach_px,
                 &pool);
    }
    found[k] =
        DistinctPoses(object, views, InTurn(std::move(pool).Sorted()), options.kept_per_object);
  });

  BeginStep(context, "table_seeds");
  std::vector<std::pair<int, PooledPose>> best;
  for (int k = 0; k < objects; ++k) {
    for (const PooledPose& p : found[k]) best.push_back({k, p});
  }
  std::stable_sort(best.begin(), best.end(), [](const auto& a, const auto& b) {
    return a.second.quick > b.second.quick;
  });
  if (static_cast<int>(best.size()) > options.refined_seeds) best.resize(options.refined_seeds);
  std::vector<SceneModel> scenes(best.size());
  std::vector<double> units(best.size(), 1.0);
  ParallelFor(static_cast<int>(best.size()), context.options.threads, [&](int i) {
    if (IsStopRequested(context.stop)) return;
    auto scene = RefinedSeed(context,
                             reconstruction,
                             best[i].second.units_per_metre,
                             best[i].first,
                             best[i].second.table_from_object);
    if (!scene) return;
    units[i] = best[i].second.units_per_metre;
    scenes[i] = *std::move(scene);
  });
  // A scale is as good as the parts that share it explain; parts of one object vote once.
  std::vector<int> order;
  std::vector<double> votes(scenes.size(), 0.0);
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    if (scenes[i].objects.empty() || scenes[i].objects[0].score < kMinSeedScore) continue;
    order.push_back(static_cast<int>(i));
    std::vector<double> of_object(objects, 0.0);
    for (std::size_t j = 0; j < scenes.size(); ++j) {
      if (scenes[j].objects.empty()) continue;
      if (std::abs(std::log(units[i] / units[j])) > kDistinctScale) continue;
      double& vote = of_object[best[j].first];
      vote = std::max(vote, scenes[j].gain * (scenes[j].objects[0].score > kMinSeedScore));
    }
    for (double v : of_object) votes[i] += v;
  }
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return votes[a] + scenes[a].gain > votes[b] + scenes[b].gain;
  });
  std::vector<SceneModel> out;
  std::vector<double> chosen;
  for (int i : order) {
    if (static_cast<int>(out.size()) >= max_scales) break;
    if (std::any_of(chosen.begin(), chosen.end(), [&](double u) {
          return std::abs(std::log(u / units[i])) < kDistinctScale;
        })) {
      continue;
    }
    chosen.push_back(units[i]);
    out.push_back(scenes[i]);
  }
  return out;
}

}  // namespace horopter
