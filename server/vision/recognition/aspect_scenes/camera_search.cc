#include "server/vision/recognition/aspect_scenes/camera_search.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_scenes/competing_parts.h"
#include "server/vision/recognition/aspect_scenes/faint_objects.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/standing_candidates.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"
#include "server/vision/recognition/aspect_scenes/transfer.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {
namespace {

// Places on the plane under the parts that are looked at closer, for parts that the searched images
// do not show well; chosen, for time.
constexpr int kStandingSearched = 20;
constexpr double kSettledSearchScore = 0.3;  // of the best object: no further view need be searched
// Cameras that know nothing of the parts leave chance little: the best wrong places of photographs
// score .10 - .20 in the mean of their views, right ones of scanned parts .35.
constexpr double kChanceOfView = 0.2;
constexpr double kLeastQuick = 0.22, kLeastJoint = 0.25;  // AspectLinkOptions::min_quick, min_joint
// Depths of parts in the cameras' unit: of the points that they see, and of where their axes meet.
constexpr double kPointsBeyond = 1.4, kAxesBeyond = 3.0;
constexpr double kDepthError = 1.18;   // of a single image's hypothesis
constexpr int kAttempts = 3;           // at a start
constexpr int kSearchedPeaks = 2;      // units tried of a hypothesis
constexpr std::size_t kAdjusted = 24;  // of a view's transferred hypotheses; chosen, for time
constexpr std::size_t kStarts = 3;     // scenes that are completed
constexpr int kRounds = 3;             // in which parts that are added move the cameras
// What a view should show, of what the middle one does; what shows less of all parts is no view.
constexpr double kOddShare = 0.35;
// Of the score that a part has where it is best: what has less is what it reaches where it is not.
constexpr double kAgainShare = 0.7;
constexpr double kReachPx[] = {6.0, 14.0};  // working px, least and most of what cameras are off
constexpr double kTrustedReachPx = 5.0;     // ... once a part has moved them
// No cameras are known better.
constexpr double kLeastTurnRad = 1e-4, kLeastPosition = 1e-3, kLeastLogFocal = 1e-3;
constexpr double kRowSigmaPx = 3.0;  // neighbouring rows err together

AspectLinkOptions ForKnownCameras(AspectLinkOptions options) {
  options.min_quick = std::min(options.min_quick, kLeastQuick);
  options.min_joint = std::min(options.min_joint, kLeastJoint);
  return options;
}

// What a scene explains above chance.
double WorthOf(const LinkedScene& scene) {
  double worth = 0.0;
  for (const LinkedObject& o : scene.objects) {
    for (std::size_t v = 0; v < o.views.size(); ++v) {
      if (o.shown[v]) worth += o.views[v].score - kChanceOfView;
    }
  }
  return worth;
}

class CameraSearch {
 public:
  CameraSearch(const AspectLinkInput& input,
               const KnownCameras& cameras,
               const AspectLinkOptions& options,
               const StopRequested& stop)
      : in_(input),
        known_(cameras),
        options_(ForKnownCameras(options)),
        stop_(stop),
        links_(input, options_, stop),
        objects_(input, options_, stop),
        prior_{{},
               std::max(cameras.rotation_sigma_rad, kLeastTurnRad),
               std::max(cameras.position_sigma, kLeastPosition),
               cameras.scale_known} {
    for (const AspectModel& model : in_.models) meshes_.push_back(&model.object->mesh);
    for (const auto& view : known_.views) {
      prior_.camera_from_world.emplace_back();
      cameras_.emplace_back();
      if (!view) continue;
      prior_.camera_from_world.back() = view->camera_from_scene;
      cameras_.back() = AspectSceneView{view->camera,
                                        view->camera_from_scene,
                                        std::log(view->camera.focal_px),
                                        std::max(view->focal_log_sigma, kLeastLogFocal)};
    }
    transferring_.reach_px = transferring_.shift_px = ReachPx();
  }

  // As a start: without what is looked for once parts are found.
  LinkedScene FirstSeen() {
    LinkedScene best = Nothing();
    const int views = static_cast<int>(in_.images.size());
    for (int i = 0; i < views && !IsSettled(best) && !IsStopRequested(stop_); ++i)
      SearchView((views / 2 + i) % views, &best);
    return best;
  }

  LinkedScene Run() {
    const int views = static_cast<int>(in_.images.size());
    LinkedScene best = Nothing();
    // From the middle on, until parts are found and a further view shows no other.
    bool new_parts = true;
    for (int i = 0; i < views && !IsStopRequested(stop_); ++i) {
      if (IsSettled(best) && !new_parts) break;
      new_parts = SearchView((views / 2 + i) % views, &best);
    }
    if (IsStopRequested(stop_) || best.objects.empty()) return Nothing();
    AddStanding(&best);
    if (IsStopRequested(stop_) || best.objects.empty()) return Nothing();
    AddFaint(&best);
    FindBestCompeting(in_, options_, links_, objects_, &best);
    best.agreement = objects_.WithGround(best);
    return best;
  }

 private:
  // Returns whether more parts are seen than before.
  bool SearchView(int v, LinkedScene* best) {
    if (!cameras_[v]) return true;
    links_.Add(v, in_.search(v));
    searched_.push_back(v);
    AddStarts(v);
    LinkedScene seen = Seen();
    const bool more = seen.objects.size() > best->objects.size();
    if (WorthOf(seen) > WorthOf(*best)) *best = std::move(seen);
    return more;
  }

  LinkedScene Nothing() const {
    LinkedScene out;
    out.views.resize(in_.images.size());
    return out;
  }

  static bool IsSettled(const LinkedScene& scene) {
    return !scene.objects.empty() && scene.objects.front().score >= kSettledSearchScore;
  }

  // Two deviations of the cameras' turns, in the middle one of the images.
  double ReachPx() const {
    double focal = 0.0;
    for (std::size_t v = 0; v < cameras_.size(); ++v) {
      if (cameras_[v])
        focal = std::max(focal, cameras_[v]->camera.focal_px * in_.images[v].working_from_image);
    }
    return std::clamp(2.0 * focal * prior_.rotation_sigma_rad, kReachPx[0], kReachPx[1]);
  }

  // Where a view's parts may be, in the cameras' unit.
  std::pair<double, double> DepthsIn(int v) const {
    std::vector<double> depths;
    for (const Eigen::Vector3d& x : known_.points_in_world) {
      const double z = (*prior_.camera_from_world[v] * x).z();
      if (z > 0) depths.push_back(z);
    }
    if (depths.size() >= 10) {
      std::sort(depths.begin(), depths.end());
      return {depths[depths.size() / 50] / kPointsBeyond,
              depths[depths.size() - 1 - depths.size() / 50] * kPointsBeyond};
    }
    // The point that is nearest to all axes: sum of (I - a a') (x - c) = 0.
    Eigen::Matrix3d A = Eigen::Matrix3d::Identity() * 1e-9;
    Eigen::Vector3d b = Eigen::Vector3d::Zero();
    double baseline = 0.0;
    for (const auto& pose : prior_.camera_from_world) {
      if (!pose) continue;
      const Eigen::Vector3d axis = pose->R.row(2), center = pose->Inverse().t;
      const Eigen::Matrix3d off = Eigen::Matrix3d::Identity() - axis * axis.transpose();
      A += off;
      b += off * center;
      baseline = std::max(baseline, (center - prior_.camera_from_world[v]->Inverse().t).norm());
    }
    double depth = (*prior_.camera_from_world[v] * Eigen::Vector3d(A.ldlt().solve(b))).z();
    depth = std::clamp(depth, 0.5 * baseline, 20.0 * baseline);
    return {depth / kAxesBeyond, depth * kAxesBeyond};
  }

  UnitRange RangeOf(int v, const AspectHypothesis& h) const {
    if (prior_.scale_known) return {1.0 / kDepthError, kDepthError, true};
    const Eigen::Vector3d center = in_.models[h.object].object->mesh.center.cast<double>();
    const double depth_m =
        (WithFocal(h.camera_from_object, h.camera.focal_px, cameras_[v]->camera.focal_px) * center)
            .z();
    const auto [nearest, farthest] = DepthsIn(v);
    return {depth_m / farthest, depth_m / nearest};
  }

  // What view v shows, in all other views.
  void AddStarts(int v) {
    const std::vector<AspectHypothesis>& list = links_.Hypotheses(v);
    Transfer transfer(in_, cameras_, prior_, transferring_);
    for (const AspectHypothesis& h : list) transfer.Prepare(h.object);
    std::vector<std::vector<TransferredObject>> of(list.size());
    ParallelFor(static_cast<int>(list.size()), options_.threads, [&](int i) {
      if (!IsStopRequested(stop_))
        of[i] = transfer.Place(v, list[i], RangeOf(v, list[i]), LeastViews(), kSearchedPeaks);
    });
    std::vector<TransferredObject> all;
    for (std::size_t i = 0; i < list.size(); ++i) {
      for (TransferredObject& t : of[i]) {
        t.support += list[i].score;
        all.push_back(std::move(t));
      }
    }
    SortBySupport(&all);
    if (all.size() > kAdjusted) all.resize(kAdjusted);
    ParallelFor(static_cast<int>(all.size()), options_.threads, [&](int i) {
      if (!IsStopRequested(stop_)) transfer.Adjust(&all[i]);
    });
    for (TransferredObject& t : all) starts_.push_back(std::move(t));
    SortBySupport(&starts_);
  }

  // Of two images one other is all there is.
  int LeastViews() const { return std::min(2, known_.known() - 1); }

  static void SortBySupport(std::vector<TransferredObject>* list) {
    std::stable_sort(list->begin(), list->end(), [](const auto& a, const auto& b) {
      return a.support > b.support;
    });
  }

  // The best scene that starts with one of the parts transferred.
  LinkedScene Seen() const {
    LinkedScene best = Nothing();
    std::vector<const TransferredObject*> tried;
    for (const TransferredObject& start : starts_) {
      if (tried.size() >= kStarts || IsStopRequested(stop_)) break;
      if (std::any_of(tried.begin(), tried.end(), [&](const TransferredObject* other) {
            return IsSame(start.scene, other->scene);
          }))
        continue;
      tried.push_back(&start);
      LinkedScene scene = Grown(start);
      if (WorthOf(scene) > WorthOf(best)) best = std::move(scene);
    }
    return best;
  }

  // Whether two starts place one part alike.
  bool IsSame(const AspectScene& a, const AspectScene& b) const {
    const AspectSceneObject &x = a.objects.front(), &y = b.objects.front();
    if (x.object != y.object) return false;
    double off = 0.0;
    for (std::size_t v = 0; v < a.views.size(); ++v) {
      if (!a.views[v]) continue;
      const Rigid3 in_a = a.views[v]->camera_from_scene * x.scene_from_object;
      const Rigid3 in_b = b.views[v]->camera_from_scene * y.scene_from_object;
      const AspectModel& model = in_.models[x.object];
      off = std::max(off,
                     PoseDistancePx(model, a.views[v]->camera, in_a, b.views[v]->camera, in_b) /
                         SizePx(model, a.views[v]->camera, in_a));
    }
    return off < kOtherPoseShare;
  }

  void Adjust(AspectScene* scene, CamerasPrior* prior) const {
    AspectAdjustmentOptions adjustment = options_.adjustment;
    adjustment.sigma_px = kRowSigmaPx;
    AdjustToEdges(in_.images, meshes_, adjustment, options_.threads, scene, prior);
  }

  // A start adjusted, with the prior's unit; nothing where the views do not bear it out. Views that
  // were pulled to other edges at first are looked for once more.
  std::optional<AspectScene> Begun(const TransferredObject& start, CamerasPrior* prior) const {
    TransferredObject again = start;
    std::optional<AspectScene> best;
    double best_score = options_.min_quick - kClearly;
    Transfer transfer(in_, cameras_, prior_, transferring_);
    transfer.Prepare(start.scene.objects.front().object);
    for (int i = 0; i < kAttempts; ++i) {
      if (i > 0) transfer.Adjust(&again);
      CamerasPrior here = prior_;
      here.unit_m = again.unit_m;
      Adjust(&again.scene, &here);
      again.unit_m = here.unit_m;
      const double score = objects_.JudgeOne(again.scene.views, again.scene.objects.front()).score;
      if (score <= best_score) break;
      best_score = score;
      best = again.scene;
      prior->unit_m = here.unit_m;
    }
    return best;
  }

  // What the searched views show, under a scene's cameras and unit, best first.
  std::vector<AspectSceneObject> Transferred(const AspectScene& scene,
                                             const CamerasPrior& prior) const {
    const std::vector<std::optional<AspectSceneView>> cameras = scene.views;
    TransferOptions transferring = transferring_;
    transferring.reach_px = kTrustedReachPx;
    Transfer transfer(in_, cameras, prior, transferring);
    std::vector<TransferredObject> candidates;
    for (const int v : searched_) {
      const std::vector<AspectHypothesis>& list = links_.Hypotheses(v);
      for (const AspectHypothesis& h : list) transfer.Prepare(h.object);
      std::vector<std::vector<TransferredObject>> of(list.size());
      ParallelFor(static_cast<int>(list.size()), options_.threads, [&](int i) {
        const UnitRange range{prior.unit_m / kDepthError, prior.unit_m * kDepthError, true};
        of[i] = transfer.Place(v, list[i], range, 1, 1);
        for (TransferredObject& t : of[i]) t.support += list[i].score;
      });
      for (auto& found : of) candidates.insert(candidates.end(), found.begin(), found.end());
    }
    SortBySupport(&candidates);
    std::vector<AspectSceneObject> placed;
    for (const TransferredObject& c : candidates) {
      if (static_cast<int>(placed.size()) >= options_.carried) break;
      if (objects_.IsFree(scene.views, scene.objects, c.scene.objects.front()))
        placed.push_back(c.scene.objects.front());
    }
    return placed;
  }

  // With what else the views show under these cameras and their unit.
  LinkedScene Grown(const TransferredObject& start) const {
    CamerasPrior prior = prior_;
    std::optional<AspectScene> begun = Begun(start, &prior);
    if (!begun) return Nothing();
    AspectScene scene = *std::move(begun);
    // Parts that are added say more of the cameras, and these of further parts.
    for (int round = 0; round < kRounds && !IsStopRequested(stop_); ++round) {
      const std::size_t before = scene.objects.size();
      objects_.Place(Transferred(scene, prior), &scene);
      if (scene.objects.size() == before) break;
      Adjust(&scene, &prior);
    }
    return Finished(scene);
  }

  LinkedScene Finished(const AspectScene& scene) const {
    LinkedScene out = objects_.Result(scene);
    LeaveOutOddViews(&out);
    const std::vector<LinkedObject> all = out.objects;
    std::erase_if(out.objects, [&](const LinkedObject& o) {
      return std::any_of(all.begin(), all.end(), [&](const LinkedObject& p) {
        return p.object == o.object && o.score < kAgainShare * p.score;
      });
    });
    return out;
  }

  // Views whose cameras are somewhere else: they show next to nothing of what they should.
  void LeaveOutOddViews(LinkedScene* scene) const {
    std::vector<bool> should(scene->views.size(), false), does(scene->views.size(), false);
    for (const LinkedObject& o : scene->objects) {
      std::vector<double> scores;
      for (std::size_t v = 0; v < o.views.size(); ++v) {
        if (o.shown[v]) scores.push_back(o.views[v].score);
      }
      if (scores.empty()) continue;
      std::nth_element(scores.begin(), scores.begin() + scores.size() / 2, scores.end());
      const double least = kOddShare * scores[scores.size() / 2];
      for (std::size_t v = 0; v < o.views.size(); ++v) {
        should[v] = should[v] || o.shown[v];
        does[v] = does[v] || (o.shown[v] && o.views[v].score >= least);
      }
    }
    AspectScene without = SceneOf(*scene);
    bool any = false;
    for (std::size_t v = 0; v < should.size(); ++v) {
      if (!without.views[v] || !should[v] || does[v]) continue;
      without.views[v].reset();
      any = true;
    }
    if (!any) return;
    *scene = objects_.Result(without);
    if (scene->registered() < 2) *scene = Nothing();
  }

  // Parts that say little by their edges.
  void AddFaint(LinkedScene* best) const {
    if (!options_.faint_parts || options_.standing <= 0 || !MayShowFaintObjects(*best) ||
        IsStopRequested(stop_))
      return;
    const AspectScene scene = SceneOf(*best);
    CamerasPrior prior = prior_;
    prior.unit_m = 1.0;  // the scene is in metres
    std::vector<AspectSceneObject> candidates = Transferred(scene, prior);
    const std::vector<AspectSceneObject> standing =
        FreeStanding(in_,
                     options_,
                     objects_,
                     PlanesUnder(scene.objects, in_.models, scene.views),
                     scene,
                     options_.standing,
                     stop_);
    candidates.insert(candidates.end(), standing.begin(), standing.end());
    AddFaintObjects(in_, options_, objects_, std::move(candidates), best);
    SortBestFirst(best);
  }

  // Parts on the plane under those found which no searched image showed well enough.
  void AddStanding(LinkedScene* best) const {
    if (options_.standing <= 0 || IsStopRequested(stop_)) return;
    AspectScene scene = SceneOf(*best);
    std::vector<StandingPlane> planes = PlanesUnder(scene.objects, in_.models, scene.views);
    int most = 0;
    for (const StandingPlane& plane : planes) most = std::max(most, plane.objects);
    // Parts that stand on one plane say which it is.
    std::erase_if(planes, [&](const StandingPlane& plane) { return plane.objects < most; });
    std::vector<AspectSceneObject> candidates =
        FreeStanding(in_,
                     options_,
                     objects_,
                     planes,
                     scene,
                     std::min(kStandingSearched, options_.standing),
                     stop_);
    const std::size_t before = scene.objects.size();
    objects_.Place(std::move(candidates), &scene);
    if (scene.objects.size() == before) return;
    LinkedScene more = Finished(scene);
    if (WorthOf(more) > WorthOf(*best)) *best = std::move(more);
  }

  const AspectLinkInput& in_;
  const KnownCameras& known_;
  const AspectLinkOptions options_;
  const StopRequested& stop_;
  std::vector<const RenderMesh*> meshes_;
  ViewLinks links_;
  SceneObjects objects_;
  CamerasPrior prior_;
  std::vector<std::optional<AspectSceneView>> cameras_;  // as they are given
  TransferOptions transferring_;
  std::vector<int> searched_;
  std::vector<TransferredObject> starts_;  // of the views searched, best first
};

}  // namespace

LinkedScene FindInCameras(const AspectLinkInput& input,
                          const KnownCameras& cameras,
                          const AspectLinkOptions& options,
                          const StopRequested& stop) {
  return CameraSearch(input, cameras, options, stop).Run();
}

AspectScene StartInCameras(const AspectLinkInput& input,
                           const KnownCameras& cameras,
                           const AspectLinkOptions& options,
                           const StopRequested& stop) {
  return SceneOf(CameraSearch(input, cameras, options, stop).FirstSeen());
}

}  // namespace horopter
