#include "server/vision/recognition/initialization/bottom_up_route.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/camera_factors.h"
#include "server/vision/recognition/initialization/scene_decomposition.h"
#include "server/vision/reconstruction/grow_projective.h"

namespace horopter {
namespace {

// Corners nearer than this, of the distance to the cameras, are one
constexpr double kCornerShare = 0.005;
constexpr double kMinLogOdds = 0.0;      // of a hypothesis that is compared with the images
constexpr int kMinEdgeViews = 2;         // views in which both corners lie on one segment
constexpr double kWorkingWidth = 640.0;  // px; of the image that pixel thresholds are meant for
constexpr double kFewObjects = 40.0;     // in a catalog for which the options are meant
// Of a camera that a collineation gives, before the images refine it.
constexpr double kMaxSkew = 0.35;  // of the focal length; also of the aspect's logarithm
// Image widths; wider than lenses: structure is rough.
constexpr double kMinFocalWidths = 0.3, kMaxFocalWidths = 8.0;
constexpr double kMaxCentreOff = 0.35;  // of the principal point from the image's, in widths

struct Proposal {
  int object = -1;
  double units_per_metre = 1.0;
  Rigid3 world_from_object;  // metres
};

// The similarity taken apart: x_world = units R x + units t.
Proposal Propose(int object, const Eigen::Matrix4d& world_from_object) {
  Proposal out;
  out.object = object;
  out.units_per_metre = UnitsPerMetre(world_from_object);
  const Eigen::Matrix4d H = world_from_object / world_from_object(3, 3) / out.units_per_metre;
  out.world_from_object = {H.topLeftCorner<3, 3>(), H.topRightCorner<3, 1>()};
  return out;
}

template <typename T, typename Score>
void KeepBest(std::vector<T>* list, std::size_t count, Score score) {
  std::stable_sort(
      list->begin(), list->end(), [&](const T& a, const T& b) { return score(a) > score(b); });
  if (list->size() > count) list->resize(count);
}

// Mean distance of the cameras from what was reconstructed.
double ViewingDistance(const Reconstruction& reconstruction, std::span<const FeatureView> views) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const ReconstructedPoint& p : reconstruction.points)
    middle += p.point_in_world / static_cast<double>(reconstruction.points.size());
  double sum = 0.0;
  for (const FeatureView& v : views) sum += (v.camera_from_scene * middle).norm();
  return sum / static_cast<double>(views.size());
}

// Which tracks' junctions each segment of a view ends in.
std::map<int, std::vector<int>> TracksOfSegments(std::span<const FeatureTrack> points,
                                                 int view,
                                                 const ImageFeatures& features) {
  std::map<int, std::vector<int>> out;
  for (int track = 0; track < static_cast<int>(points.size()); ++track) {
    for (const FeatureTrack::Feature& f : points[track].features) {
      if (f.view != view) continue;
      for (const Junction::End& end : features.junctions[f.feature].ends) {
        if (!end.interior) out[end.segment].push_back(track);
      }
    }
  }
  return out;
}

// The camera in the object's own frame, metres; its principal point goes back to the prior one: a
// collineation of few corners says nothing of it, and a turn of the camera stands in for it.
std::optional<CalibratedCamera> CameraOfObject(const CameraMatrix& P, const PinholeCamera& start) {
  const auto factors = FactorCamera(P);
  if (!factors) return std::nullopt;
  const Eigen::Matrix3d& K = factors->K;
  const double fx = K(0, 0), fy = K(1, 1), focal = std::sqrt(fx * fy), width = start.width;
  if (!(std::abs(std::log(fx / fy)) < kMaxSkew && std::abs(K(0, 1)) < kMaxSkew * fx &&
        focal > kMinFocalWidths * width && focal < kMaxFocalWidths * width &&
        std::abs(K(0, 2) - start.cx) < kMaxCentreOff * width &&
        std::abs(K(1, 2) - start.cy) < kMaxCentreOff * width)) {
    return std::nullopt;
  }
  CalibratedCamera view;
  view.camera = start;
  view.camera.focal_px = focal;
  view.camera_from_scene = factors->camera_from_scene;
  // Turn so that the object's origin stays where it is in the image.
  const Eigen::Vector3d& t = view.camera_from_scene.t;
  if (!(t.z() > 0.0)) return std::nullopt;
  const Eigen::Vector3d seen = K * t;
  const Eigen::Vector3d ray(
      (seen.x() / seen.z() - start.cx) / focal, (seen.y() / seen.z() - start.cy) / focal, 1.0);
  const Eigen::Matrix3d turn = Eigen::Quaterniond::FromTwoVectors(t, ray).toRotationMatrix();
  view.camera_from_scene = {turn * view.camera_from_scene.R, turn * t};
  return view;
}

AspectSceneView SceneView(const CalibratedCamera& view) {
  return {
      view.camera, view.camera_from_scene, std::log(view.camera.focal_px), kNominalFocalLogSigma};
}

int Registered(const AspectScene& scene) {
  return static_cast<int>(
      std::count_if(scene.views.begin(), scene.views.end(), [](const auto& v) { return !!v; }));
}

// The object at the origin of the scene.
AspectScene SceneOfCollineation(const JointContext& context,
                                const SceneStructure& structure,
                                const StructureHypothesis& h) {
  AspectScene scene;
  scene.views.resize(context.start_cameras.size());
  scene.objects.push_back({h.object, {}});
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!structure.cameras[v]) continue;
    const auto view = CameraOfObject(CameraMatrix(*structure.cameras[v] * h.structure_from_object),
                                     context.start_cameras[v]);
    if (view) scene.views[v] = SceneView(*view);
  }
  return scene;
}

// The reconstruction's cameras in the metres of a proposal.
AspectScene SceneOfProposal(const Reconstruction& reconstruction, const Proposal& p) {
  AspectScene scene;
  scene.views.resize(reconstruction.views.size());
  scene.objects.push_back({p.object, p.world_from_object});
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    if (!reconstruction.views[v]) continue;
    scene.views[v] = SceneView(*reconstruction.views[v]);
    scene.views[v]->camera_from_scene.t /= p.units_per_metre;
  }
  return scene;
}

}  // namespace

MetricRouteOptions BottomUpOptions::MetricDefaults() {
  MetricRouteOptions out;
  // The images tell which scale is right, not the structure.
  out.scale_log_odds = std::numeric_limits<double>::infinity();
  return out;
}

ProjectiveRouteOptions BottomUpOptions::ProjectiveDefaults() {
  ProjectiveRouteOptions out;
  out.tuples.max_sets = 6000;
  out.tuples.max_tuples = 4000;
  out.route.components.unions = 4;
  out.route.max_hits = 100000;
  return out;
}

absl::StatusOr<RouteCatalog> MakeRouteCatalog(
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    const KeyIndexSnapshot* index,
    std::span<const int> slots) {
  if (index != nullptr && slots.size() != objects.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat("slots: ", slots.size(), " for ", objects.size(), " objects"));
  }
  RouteCatalog out;
  std::vector<const ObjectKeys*> keys;
  for (std::size_t i = 0; i < objects.size(); ++i) {
    keys.push_back(&objects[i]->keys);
    out.objects.push_back(
        {&objects[i]->model, &objects[i]->keys, index != nullptr ? slots[i] : static_cast<int>(i)});
  }
  if (index != nullptr) {
    out.index = *index;
    return out;
  }
  HOROPTER_ASSIGN_OR_RETURN(KeyIndex built, KeyIndex::Build(keys, 0));
  out.index = built.Snapshot();
  return out;
}

std::vector<std::array<int, 2>> TrackEdges(std::span<const FeatureTrack> points,
                                           std::span<const ImageFeatures> features) {
  std::map<std::array<int, 2>, int> views;
  for (int v = 0; v < static_cast<int>(features.size()); ++v) {
    for (const auto& [segment, tracks] : TracksOfSegments(points, v, features[v])) {
      for (std::size_t k = 0; k < tracks.size(); ++k) {
        for (std::size_t l = 0; l < k; ++l) {
          if (tracks[k] == tracks[l]) continue;
          ++views[{std::min(tracks[k], tracks[l]), std::max(tracks[k], tracks[l])}];
        }
      }
    }
  }
  std::vector<std::array<int, 2>> out;
  for (const auto& [edge, count] : views) {
    if (count >= kMinEdgeViews) out.push_back(edge);
  }
  return out;
}

std::vector<AspectScene> MetricScenes(const JointContext& context,
                                      std::span<const ImageFeatures> features,
                                      const Reconstruction& reconstruction,
                                      const RouteCatalog& catalog,
                                      const BottomUpOptions& options) {
  BeginStep(context, "metric_route");
  std::vector<FeatureView> views;
  for (std::size_t v = 0; v < reconstruction.views.size(); ++v) {
    if (!reconstruction.views[v]) continue;
    const double working = std::min(1.0, kWorkingWidth / std::max(1, features[v].width));
    views.push_back({*reconstruction.views[v], &features[v], working});
  }
  if (views.size() < 2) return {};
  SpaceCornerOptions corners = options.corners;
  corners.same_point_m = kCornerShare * ViewingDistance(reconstruction, views);
  const auto found = StructureOfCorners(views, FindSpaceCorners(views, corners), options.structure);
  if (!found.ok()) return {};
  // Among many objects more fit by chance: as many again with every doubling.
  const double doublings = std::log2(static_cast<double>(catalog.objects.size()) / kFewObjects);
  const int share = 1 + static_cast<int>(std::max(0.0, doublings));
  MetricRouteOptions metric = options.metric;
  metric.route.judged_modes *= share;
  metric.route.kept *= share;
  const auto hypotheses =
      MetricHypotheses(found->structure, catalog.index, catalog.objects, metric, context.give_up);
  if (!hypotheses.ok()) return {};
  const Eigen::Matrix4d world_from_structure = found->structure_from_scene.inverse();
  std::vector<StructureHypothesis> best = hypotheses->found.hypotheses;
  std::erase_if(best, [&](const auto& h) { return h.log_odds < kMinLogOdds; });
  KeepBest(&best, share * options.refined, [](const auto& h) { return h.log_odds; });
  std::vector<AspectScene> scenes;
  for (const StructureHypothesis& h : best) {
    scenes.push_back(SceneOfProposal(
        reconstruction, Propose(h.object, world_from_structure * h.structure_from_object)));
  }
  return scenes;
}

std::vector<AspectScene> ProjectiveScenes(const JointContext& context,
                                          std::span<const ImageFeatures> features,
                                          const MatchingResult& matching,
                                          const RouteCatalog& catalog,
                                          const BottomUpOptions& options) {
  BeginStep(context, "projective_route");
  std::vector<ImageSize> sizes;
  for (const ImageFeatures& f : features) sizes.push_back({f.width, f.height});
  const MatchedTracks matched = TracksOfMatches(matching, MatchedPairs::kAll, features, sizes);
  if (matched.tracks.points == 0) return {};
  // What cannot be had is no error: there is nothing to propose then.
  const auto scene = ReconstructProjective(matched.tracks, options.reconstruction, context.give_up);
  if (!scene.ok() || scene->outcome != ProjectiveOutcome::kReconstructed) return {};
  const auto structure =
      ProjectiveStructure(matched.tracks, scene->scene, TrackEdges(matched.points, features));
  if (!structure.ok()) return {};
  const auto found = ProjectiveHypotheses(
      *structure, catalog.index, catalog.objects, options.projective, context.give_up);
  if (!found.ok()) return {};
  std::vector<StructureHypothesis> hypotheses = found->hypotheses;
  std::erase_if(hypotheses, [&](const auto& h) { return h.log_odds < kMinLogOdds; });
  KeepBest(&hypotheses, options.refined, [](const auto& h) { return h.log_odds; });
  std::vector<AspectScene> scenes;
  if (auto decomposed = SceneByDecomposition(
          context.objects, context.start_cameras, *structure, hypotheses, options))
    scenes.push_back(*std::move(decomposed));
  for (const StructureHypothesis& h : hypotheses)
    scenes.push_back(SceneOfCollineation(context, *structure, h));
  std::erase_if(scenes, [](const AspectScene& s) { return Registered(s) < 2; });
  return scenes;
}

}  // namespace horopter
