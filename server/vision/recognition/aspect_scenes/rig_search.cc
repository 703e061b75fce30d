#include "server/vision/recognition/aspect_scenes/rig_search.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "server/vision/recognition/aspect_scenes/place_contest.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/settled_scenes.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"
#include "server/vision/recognition/aspect_scenes/standing_search.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {
namespace {

// Places on the plane under the parts that are looked at closer, for parts that the searched images
// do not show well; chosen, for time.
constexpr int kStanding = 20;
// Least score of the best object. Cameras that no part has moved are not fitted by chance as those
// are that a part gave (0.65 there); chosen.
constexpr double kSettledRigScore = 0.5;
// What each view that shows the best object has of its score. A camera that was turned by half a
// degree shows next to nothing of it; chosen.
constexpr double kEvenViews = 0.7;
constexpr std::size_t kAgreeing = 2;  // least views that show a part where others do not
// Reach of the rounds in which a moved camera is found again, working pixels; half a degree is 8 -
// 15 of them.
constexpr double kMovedSearchPx[] = {24.0, 16.0, 10.0, 6.0, 4.0, 3.0, 3.0};

class RigSearch {
 public:
  RigSearch(const AspectLinkInput& input,
            const std::vector<std::optional<AspectSceneView>>& rig,
            const AspectLinkOptions& options,
            const StopRequested& stop)
      : in_(input),
        rig_(rig),
        options_(options),
        stop_(stop),
        links_(input, options, stop),
        objects_(input, options, stop),
        contest_(input, options, links_, objects_) {
    for (const AspectModel& model : in_.models) meshes_.push_back(&model.object->mesh);
  }

  LinkedScene Run() {
    const int views = static_cast<int>(in_.images.size());
    LinkedScene best = Nothing();
    std::vector<bool> searched(views, false);
    const auto search = [&](int v) {
      if (searched[v] || IsStopRequested(stop_)) return;
      searched[v] = true;
      links_.Add(v, in_.search(v));
    };
    // From the middle on, until nothing is in doubt. Several parts may hide others from an image.
    bool settled = false;
    for (int i = 0; i < views; ++i) {
      if (settled && (i > 1 || best.objects.size() < 2)) break;
      search((views / 2 + i) % views);
      best = Seen();
      settled = IsSettled(best) || (i > 0 && FindMoved(&best));
    }
    if (IsStopRequested(stop_) || !settled) return Nothing();
    AddStanding(&best);
    LinkedScene other = best;
    const bool contested = contest_.Contest(&other);
    if (contest_.ChooseTurns(&other) || contested) {
      other = Finished(SceneOf(other));
      if (other.score > best.score) best = std::move(other);
    }
    if (IsStopRequested(stop_) || !IsSettled(best)) return Nothing();
    contest_.FindBestCompeting(&best);
    best.agreement = objects_.WithGround(best);
    return best;
  }

 private:
  LinkedScene Nothing() const {
    LinkedScene out;
    out.views.resize(in_.images.size());
    return out;
  }

  bool IsSettled(const LinkedScene& scene) const {
    if (scene.objects.empty() || scene.agreement.Contradicts(kSettledSurface)) return false;
    return scene.objects.front().score >= kSettledRigScore && OddViews(scene).empty();
  }

  // Views that show each object they should show worse than most do. Those that show none of the
  // objects have left the scene, and are asked here again.
  std::vector<int> OddViews(const LinkedScene& scene) const {
    std::vector<bool> should(rig_.size(), false), does(rig_.size(), false);
    for (const LinkedObject& o : scene.objects) {
      const LinkedObject everywhere = objects_.JudgeOne(rig_, {o.object, o.scene_from_object});
      std::vector<double> scores;
      for (std::size_t v = 0; v < rig_.size(); ++v) {
        if (everywhere.shown[v]) scores.push_back(everywhere.views[v].score);
      }
      if (scores.empty()) continue;
      std::sort(scores.begin(), scores.end());
      const double least = kEvenViews * scores[scores.size() / 2];
      for (std::size_t v = 0; v < rig_.size(); ++v) {
        should[v] = should[v] || everywhere.shown[v];
        does[v] = does[v] || (everywhere.shown[v] && everywhere.views[v].score >= least);
      }
    }
    std::vector<int> odd;
    for (std::size_t v = 0; v < rig_.size(); ++v) {
      if (should[v] && !does[v]) odd.push_back(static_cast<int>(v));
    }
    return odd;
  }

  // Looks without the odd views, and by the best part for their cameras. Returns whether this
  // leaves no doubt; the rig is then as the images have it.
  bool FindMoved(LinkedScene* best) {
    if (best->objects.empty() || IsStopRequested(stop_)) return false;
    const std::vector<int> odd = OddViews(*best);
    if (odd.empty() || rig_.size() < odd.size() + kAgreeing) return false;
    const std::vector<std::optional<AspectSceneView>> given = rig_;
    for (const int v : odd) rig_[v].reset();
    const LinkedScene others = Seen();
    if (!others.objects.empty()) {
      const LinkedObject& first = others.objects.front();
      AspectAdjustmentOptions adjustment = options_.adjustment;
      adjustment.search_px.assign(std::begin(kMovedSearchPx), std::end(kMovedSearchPx));
      for (const int v : odd) {
        AspectScene one;
        one.views.resize(rig_.size());
        one.views[v] = given[v];
        one.objects = {{first.object, first.scene_from_object}};
        AdjustToEdges(in_.images, meshes_, adjustment, options_.threads, &one);
        rig_[v] = one.views[v];
      }
      LinkedScene again = Seen();
      if (IsSettled(again)) {
        *best = std::move(again);
        return true;
      }
    }
    rig_ = given;
    return false;
  }

  LinkedScene Finished(AspectScene scene) const {
    objects_.Sift(&scene);
    return objects_.Result(scene);
  }

  // What all views bear out of what those searched show.
  LinkedScene Seen() const {
    AspectScene scene;
    scene.views = rig_;
    std::vector<AspectSceneObject> candidates = links_.Carried(rig_);
    if (static_cast<int>(candidates.size()) > options_.carried) candidates.resize(options_.carried);
    objects_.Place(std::move(candidates), &scene);
    return Finished(std::move(scene));
  }

  // Parts on the plane under those found which no searched image showed well enough.
  void AddStanding(LinkedScene* best) const {
    if (options_.standing <= 0 || IsStopRequested(stop_)) return;
    AspectScene scene = SceneOf(*best);
    StandingSearchOptions search;
    search.threads = options_.threads;
    std::vector<AspectSceneObject> candidates;
    const std::vector<StandingPlane> planes = PlanesUnder(scene.objects, in_.models, scene.views);
    int most = 0;
    for (const StandingPlane& plane : planes) most = std::max(most, plane.objects);
    for (const StandingPlane& plane : planes) {
      if (plane.objects < most) continue;  // parts that stand on one plane say which it is
      int of_plane = 0;
      for (const StandingCandidate& c :
           FindStanding(in_.images, scene.views, in_.models, plane, scene.objects, search, stop_)) {
        if (of_plane >= std::min(kStanding, options_.standing)) break;
        if (!objects_.IsFree(scene.views, scene.objects, c.placed)) continue;
        candidates.push_back(c.placed);
        ++of_plane;
      }
    }
    const std::size_t before = scene.objects.size();
    objects_.Place(std::move(candidates), &scene);
    if (scene.objects.size() == before) return;
    LinkedScene more = Finished(std::move(scene));
    if (more.score > best->score) *best = std::move(more);
  }

  const AspectLinkInput& in_;
  std::vector<std::optional<AspectSceneView>> rig_;
  const AspectLinkOptions& options_;
  const StopRequested& stop_;
  std::vector<const RenderMesh*> meshes_;
  ViewLinks links_;
  SceneObjects objects_;
  PlaceContest contest_;
};

}  // namespace

LinkedScene FindInRig(const AspectLinkInput& input,
                      const std::vector<std::optional<AspectSceneView>>& rig,
                      const AspectLinkOptions& options,
                      const StopRequested& stop) {
  return RigSearch(input, rig, options, stop).Run();
}

}  // namespace horopter
