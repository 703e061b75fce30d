#include "server/vision/recognition/aspect_scenes/camera_search.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/geometry/nearest_point.h"
#include "server/vision/recognition/aspect_scenes/scene_completion.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/texture_structure.h"
#include "server/vision/recognition/aspect_scenes/transfer.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {
namespace {

constexpr double kSettledSearchScore = 0.3;  // of the best object: no further view need be searched
constexpr double kLeastQuick = 0.22, kLeastJoint = 0.25;  // AspectLinkOptions::min_quick, min_joint
// Depths of parts in the cameras' unit: of the points that they see, and of where their axes meet.
constexpr double kPointsBeyond = 1.4, kAxesBeyond = 3.0;
constexpr double kFarBaselines = 20.0;      // farther, cameras tell no depth
constexpr int kAttempts = 3;                // at a start
constexpr int kSearchedPeaks = 2;           // units tried of a hypothesis
constexpr std::size_t kAdjusted = 24;       // of a view's transferred hypotheses; chosen, for time
constexpr std::size_t kStarts = 3;          // scenes that are completed
constexpr double kReachPx[] = {6.0, 14.0};  // working px, least and most of what cameras are off
constexpr double kTextureSlack = 2.0;       // of LiesOn: points are known worse than faces
// No cameras are known better.
constexpr double kLeastTurnRad = 1e-4, kLeastPosition = 1e-3, kLeastLogFocal = 1e-3;

AspectLinkOptions ForKnownCameras(AspectLinkOptions options) {
  options.min_quick = std::min(options.min_quick, kLeastQuick);
  options.min_joint = std::min(options.min_joint, kLeastJoint);
  return options;
}

class CameraSearch {
 public:
  CameraSearch(const AspectLinkInput& input,
               const KnownCameras& cameras,
               const AspectLinkOptions& options,
               const StopRequested& stop,
               const StopRequested& cancelled)
      : in_(input),
        known_(cameras),
        options_(ForKnownCameras(options)),
        stop_(WithEffort(input, stop)),
        cancelled_(cancelled),
        links_(input, options_, stop_),
        objects_(input, options_, stop_),
        prior_{{},
               std::max(cameras.rotation_sigma_rad, kLeastTurnRad),
               std::max(cameras.position_sigma, kLeastPosition),
               cameras.scale_known},
        contours_(input.models),
        completion_(input, options_, links_, objects_, stop_, {&prior_, &contours_}) {
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
    transferring_.reach_px = ReachPx();
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
    if (IsStopRequested(cancelled_) || best.objects.empty()) return Nothing();
    DropContradicted(&best);  // and what stands in their places may be found
    completion_.AddStanding(&best);
    DropContradicted(&best);
    if (best.objects.empty()) return Nothing();
    completion_.Conclude(&best);
    FindLyingOnTexture(&best);
    return IsStopRequested(cancelled_) ? Nothing() : best;
  }

 private:
  // Returns whether more parts are seen than before.
  bool SearchView(int v, LinkedScene* best) {
    if (!cameras_[v]) return true;
    links_.Add(v, in_.search(v));
    // What is found first is completed whatever the hurry.
    const StopRequested& stop = best->objects.empty() ? cancelled_ : stop_;
    AddStarts(v, stop);
    LinkedScene seen = Seen(stop);
    const bool more = seen.objects.size() > best->objects.size();
    if (seen.score > best->score) *best = std::move(seen);
    return more;
  }

  // Whether texture is seen through a placed part, or the part reaches below the plane that texture
  // shows around it.
  bool TextureContradicts(const std::vector<std::optional<AspectSceneView>>& views,
                          const std::optional<TexturePlane>& plane,
                          const AspectSceneObject& placed) const {
    if (known_.points.empty()) return false;
    const RenderMesh& mesh = in_.models[placed.object].object->mesh;
    if (plane && IsUnderTexture(*plane, mesh, placed.scene_from_object)) return true;
    const std::vector<ObjectLayer> layers =
        LayersInViews(in_.images, views, mesh, placed.scene_from_object, kFineRenderPx);
    return CompareTexture(in_.images, views, layers, known_.points).Contradicts();
  }

  void DropContradicted(LinkedScene* scene) const {
    const auto plane = FirstPlaneOfTexture(scene->views, known_.points);
    const std::size_t dropped = std::erase_if(scene->objects, [&](const LinkedObject& o) {
      return TextureContradicts(scene->views, plane, {o.object, o.scene_from_object});
    });
    if (dropped > 0) scene->score = WorthOf(*scene);
  }

  // Parts that lie on what the texture says that things stand on.
  void FindLyingOnTexture(LinkedScene* scene) const {
    const std::vector<SupportingPlane> planes = PlanesOfTexture(scene->views, known_.points);
    for (LinkedObject& o : scene->objects) {
      o.lies = o.lies || LiesOn(planes, o.scene_from_object, in_.models[o.object], kTextureSlack);
    }
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
    for (const ReconstructedPoint& point : known_.points) {
      const double z = (*prior_.camera_from_world[v] * point.point_in_world).z();
      if (z > 0) depths.push_back(z);
    }
    if (depths.size() >= 10) {
      std::sort(depths.begin(), depths.end());
      return {depths[depths.size() / 50] / kPointsBeyond,
              depths[depths.size() - 1 - depths.size() / 50] * kPointsBeyond};
    }
    std::vector<SpaceLine> axes;
    double baseline = 0.0;
    for (const auto& pose : prior_.camera_from_world) {
      if (!pose) continue;
      axes.push_back({pose->Inverse().t, pose->R.row(2)});
      baseline = std::max(baseline,
                          (axes.back().origin - prior_.camera_from_world[v]->Inverse().t).norm());
    }
    const std::optional<Eigen::Vector3d> middle = NearestToLines(axes);
    double depth = middle ? (*prior_.camera_from_world[v] * *middle).z() : kFarBaselines * baseline;
    depth = std::clamp(depth, 0.5 * baseline, kFarBaselines * baseline);
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
  void AddStarts(int v, const StopRequested& stop) {
    const std::vector<AspectHypothesis>& list = links_.Hypotheses(v);
    const Transfer transfer(in_, cameras_, prior_, contours_, transferring_);
    std::vector<std::vector<TransferredObject>> of(list.size());
    ParallelFor(static_cast<int>(list.size()), options_.threads, [&](int i) {
      if (!IsStopRequested(stop))
        of[i] = transfer.Place(v, list[i], RangeOf(v, list[i]), LeastViews(), kSearchedPeaks);
    });
    std::vector<TransferredObject> all;
    for (std::size_t i = 0; i < list.size(); ++i) {
      for (TransferredObject& t : of[i]) {
        t.support += list[i].score;
        t.view = v;
        all.push_back(std::move(t));
      }
    }
    SortBySupport(&all);
    if (all.size() > kAdjusted) all.resize(kAdjusted);
    ParallelFor(static_cast<int>(all.size()), options_.threads, [&](int i) {
      if (!IsStopRequested(stop)) transfer.Adjust(&all[i]);
    });
    for (TransferredObject& t : all) starts_.push_back(std::move(t));
    FindCoinciding();
    SortBySupport(&starts_);
  }

  // Of what two images list of one part in one place neither knows of the other.
  void FindCoinciding() {
    for (TransferredObject& a : starts_) {
      a.coincides = a.coincides ||
                    std::any_of(starts_.begin(), starts_.end(), [&](const TransferredObject& b) {
                      return a.view != b.view && IsSame(a.scene, b.scene);
                    });
    }
  }

  // Of two images one other is all there is.
  int LeastViews() const { return std::min(2, known_.known() - 1); }

  // The best scene that starts with one of the parts transferred: those of most support, and beside
  // them the first that two images list, whatever its support.
  LinkedScene Seen(const StopRequested& stop) const {
    LinkedScene best = Nothing();
    std::vector<const TransferredObject*> tried;
    bool coincided = false;
    for (const TransferredObject& start : starts_) {
      if (IsStopRequested(best.objects.empty() ? stop : stop_)) break;
      const bool by_support = tried.size() < kStarts;
      if (!by_support && (coincided || !start.coincides)) continue;
      if (std::any_of(tried.begin(), tried.end(), [&](const TransferredObject* other) {
            return IsSame(start.scene, other->scene);
          }))
        continue;
      tried.push_back(&start);
      coincided = coincided || start.coincides;
      double unit_m = prior_.unit_m;
      std::optional<AspectScene> begun = Begun(start, &unit_m);
      if (!begun) continue;
      LinkedScene scene = completion_.Finish(*std::move(begun), unit_m);
      if (scene.score > best.score) best = std::move(scene);
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

  // A start adjusted, and its unit; nothing where the views do not bear it out. Views that
  // were pulled to other edges at first are looked for once more.
  std::optional<AspectScene> Begun(const TransferredObject& start, double* unit_m) const {
    TransferredObject again = start;
    std::optional<AspectScene> best;
    double best_score = options_.min_quick - kClearly;
    const Transfer transfer(in_, cameras_, prior_, contours_, transferring_);
    for (int i = 0; i < kAttempts; ++i) {
      if (i > 0) transfer.Adjust(&again);
      CamerasPrior here = prior_;
      here.unit_m = again.unit_m;
      completion_.Adjust(&again.scene, &here);
      again.unit_m = here.unit_m;
      const AspectSceneObject& placed = again.scene.objects.front();
      const double score = objects_.JudgeOne(again.scene.views, placed).score;
      if (score <= best_score) break;
      best_score = score;
      best = again.scene;
      *unit_m = here.unit_m;
    }
    if (best &&
        TextureContradicts(
            best->views, FirstPlaneOfTexture(best->views, known_.points), best->objects.front()))
      best.reset();
    return best;
  }

  const AspectLinkInput& in_;
  const KnownCameras& known_;
  const AspectLinkOptions options_;
  const StopRequested stop_;
  const StopRequested& cancelled_;
  ViewLinks links_;
  SceneObjects objects_;
  CamerasPrior prior_;
  ContourPoints contours_;
  SceneCompletion completion_;
  std::vector<std::optional<AspectSceneView>> cameras_;  // as they are given
  TransferOptions transferring_;
  std::vector<TransferredObject> starts_;  // of the views searched, best first
};

}  // namespace

LinkedScene FindInCameras(const AspectLinkInput& input,
                          const KnownCameras& cameras,
                          const AspectLinkOptions& options,
                          const StopRequested& stop,
                          const StopRequested& cancelled) {
  return CameraSearch(input, cameras, options, stop, cancelled).Run();
}

AspectScene StartInCameras(const AspectLinkInput& input,
                           const KnownCameras& cameras,
                           const AspectLinkOptions& options,
                           const StopRequested& stop) {
  return SceneOf(CameraSearch(input, cameras, options, stop, stop).FirstSeen());
}

}  // namespace horopter
