#include "server/vision/recognition/aspect_scenes/aspect_linking.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "server/vision/recognition/aspect_scenes/doubtful_views.h"
#include "server/vision/recognition/aspect_scenes/scene_completion.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/scene_similarity.h"
#include "server/vision/recognition/aspect_scenes/settled_scenes.h"
#include "server/vision/recognition/aspect_scenes/surface_links.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"
#include "server/vision/recognition/aspect_scenes/view_search.h"
#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr int kAdjustedLinks = 10;  // links that are adjusted and compared with the images, of all
constexpr int kRescuePerObject = 120;  // poses of a found part refined in doubtful views
constexpr int kCompleted = 3;          // drafts, of those that explain ...
constexpr double kNearlyBest = 0.6;    // ... this share of what the best does
constexpr int kRescues = 2;            // rounds in which doubtful views are looked at again
constexpr int kDraftCarried = 8;       // hypotheses carried over before all views are there

constexpr double kOneCameraSigma = 0.02;  // of ln f
constexpr int kCoarsePoints = 120;        // of an object and view; chosen, for time

// A draft of a scene adjusted to the images at a coarse scale.
void AdjustCoarsely(const AspectLinkInput& input,
                    const AspectLinkOptions& options,
                    AspectScene* scene) {
  AspectAdjustmentOptions coarse = options.adjustment;
  coarse.render_px = kQuickRenderPx;
  coarse.search_px = {8.0, 5.0, 3.0};
  coarse.max_points = kCoarsePoints;
  std::vector<const RenderMesh*> meshes;
  for (const AspectModel& model : input.models) meshes.push_back(&model.object->mesh);
  AdjustToEdges(input.images, meshes, coarse, options.threads, scene);
}

// A scene of one part adjusted from the middle one of its focal lengths: a single image hardly says
// its own, and what is printed on the part is in its place only under the right one.
AspectScene FromOneFocal(const AspectLinkInput& input,
                         const AspectLinkOptions& options,
                         const AspectScene& scene) {
  std::vector<double> focals;
  for (const auto& view : scene.views) {
    if (view) focals.push_back(RelativeFocal(view->camera));
  }
  const AspectSceneObject& part = scene.objects.front();
  const Eigen::Vector3d center =
      part.scene_from_object * input.models[part.object].object->mesh.center.cast<double>();
  AspectScene out = WithOneFocal(scene, center, Median(&focals), kOneCameraSigma);
  AdjustCoarsely(input, options, &out);
  for (std::size_t v = 0; v < out.views.size(); ++v) {
    if (!out.views[v]) continue;
    out.views[v]->prior_log_focal = scene.views[v]->prior_log_focal;
    out.views[v]->log_focal_sigma = scene.views[v]->log_focal_sigma;
  }
  return out;
}

class Linker {
 public:
  Linker(const AspectLinkInput& input,
         const AspectLinkOptions& options,
         const StopRequested& stop,
         const StopRequested& cancelled)
      : in_(input),
        options_(options),
        stop_(stop),
        cancelled_(cancelled),
        links_(input, options, cancelled),
        search_(input, options, stop, &links_),
        objects_(input, options, stop),
        completion_(input, options, links_, objects_, stop) {}

  LinkedScene Run() {
    search_.SearchFirst();
    LinkedScene best = BestOf(Drafts(in_.starts));
    if (!IsCredible(best)) {
      LinkedScene linked = BestLinked();
      if (best.objects.empty() || linked.score > best.score) best = std::move(linked);
    }
    SearchAsNeeded(&best);
    FollowSurfaces(&best);
    search_.Forget();
    Rescue(&best);
    if (completion_.AddStanding(&best)) {
      // What was added may settle views that the others left in doubt.
      search_.Forget();
      Rescue(&best);
    }
    completion_.LeaveOutPoorViews(&best);
    completion_.Conclude(&best);
    return best;
  }

 private:
  // An initial hypothesis' scene before other hypotheses are carried over, and what it explains.
  struct Draft {
    AspectScene scene;
    double score = 0.0;
  };

  // What links of views lead to.
  LinkedScene BestLinked() const {
    std::vector<Draft> drafts;
    for (const GrownScene& start : links_.InitialScenes()) {
      if (static_cast<int>(drafts.size()) >= kAdjustedLinks || IsLate(drafts)) break;
      AspectScene scene;
      scene.views = start.views;
      for (const GrownObject& o : start.objects) scene.objects.push_back(o.placed);
      links_.AdjustToHypotheses(start, &scene);
      std::optional<Draft> draft = DraftOf(std::move(scene), drafts);
      if (draft) drafts.push_back(*std::move(draft));
    }
    LinkedScene linked = BestOf(std::move(drafts));
    if (linked.views.empty()) linked.views.resize(in_.images.size());
    return linked;
  }

  // The drafts completed that explain nearly as much as the best; the best of these.
  LinkedScene BestOf(std::vector<Draft> drafts) const {
    LinkedScene best;
    std::stable_sort(drafts.begin(), drafts.end(), [](const Draft& a, const Draft& b) {
      return a.score > b.score;
    });
    for (std::size_t i = 0; i < std::min<std::size_t>(drafts.size(), kCompleted); ++i) {
      if (drafts[i].score < kNearlyBest * drafts.front().score) break;
      if (IsStopRequested(stop_) && !best.objects.empty()) break;
      if (IsWithin(drafts[i].scene, SceneOf(best), in_.models))
        continue;  // it would grow into the same
      LinkedScene scene = Completed(drafts[i].scene);
      if (scene.score > best.score) best = std::move(scene);
    }
    return best;
  }

  bool IsSettled(const LinkedScene& scene) const {
    return horopter::IsSettled(scene, in_.models, objects_);
  }

  // The other views are looked at for what those searched show, while that leaves no doubt. What
  // else there is, the search on planes finds as well as one more view would (ADR 61). Doubtful
  // scenes are linked again with all views searched.
  void SearchAsNeeded(LinkedScene* best) {
    if (search_.AllSearched()) return;
    while (!search_.AllSearched() && IsCredible(*best) && !IsStopRequested(stop_)) {
      AddUnsearched(best);
      if (IsSettled(*best)) break;
      search_.SearchNext();
    }
    if (!IsSettled(*best) && !IsStopRequested(stop_)) {
      search_.SearchRest();
      LinkedScene other = BestLinked();
      if (other.score > best->score) *best = std::move(other);
    }
  }

  // Of a part that is printed all over edges explain too little in any two views.
  void FollowSurfaces(LinkedScene* best) const {
    if (!options_.printed_surfaces || IsCredible(*best) || IsStopRequested(stop_)) return;
    for (const AspectScene& scene : ScenesBySurface(in_, options_, links_, stop_)) {
      for (AspectScene start : {scene, FromOneFocal(in_, options_, scene)}) {
        AdjustCoarsely(in_, options_, &start);
        LinkedScene other = Completed(std::move(start));
        if (other.score > best->score) *best = std::move(other);
      }
    }
  }

  void AddUnsearched(LinkedScene* best) {
    search_.SearchUnsearchedFor(*best, kQuickPerObject);
    LinkedScene more = Completed(SceneOf(*best));
    if (more.score > best->score) *best = std::move(more);
  }

  // The first draft is looked for whatever the hurry.
  bool IsLate(const std::vector<Draft>& drafts) const {
    return IsStopRequested(drafts.empty() ? cancelled_ : stop_);
  }

  // What others propose: as it is where an adjustment that knows nothing of their cameras loses
  // what the images show.
  std::vector<Draft> Drafts(std::span<const AspectScene> starts) const {
    std::vector<Draft> drafts;
    for (const AspectScene& start : starts) {
      if (IsLate(drafts)) break;
      std::optional<Draft> draft = DraftOf(start, drafts);
      if (!draft) continue;
      Draft as_is{start};
      as_is.score = objects_.Sift(&as_is.scene);
      drafts.push_back(std::move(as_is.score > draft->score ? as_is : *draft));
    }
    return drafts;
  }

  // A scene adjusted to the images, with what its views show of other objects; nothing where it is
  // one of the drafts.
  std::optional<Draft> DraftOf(AspectScene scene, std::span<const Draft> drafts) const {
    if (std::any_of(drafts.begin(), drafts.end(), [&](const Draft& other) {
          return IsWithin(scene, other.scene, in_.models);
        }))
      return std::nullopt;
    AdjustCoarsely(in_, options_, &scene);
    if (objects_.Sift(&scene) > 0.0) completion_.AddCarried(kDraftCarried, &scene);
    const double score = objects_.Sift(&scene);
    return Draft{std::move(scene), score};
  }

  // A draft with the other views added one by one, each held against the images before the next.
  LinkedScene Completed(AspectScene scene) const {
    AddViews(&scene);
    return completion_.Finish(std::move(scene));
  }

  void AddViews(AspectScene* scene) const {
    std::vector<bool> wanted(scene->views.size(), true);
    while (!scene->objects.empty() && !IsStopRequested(stop_)) {
      GrownScene grown;
      grown.views = scene->views;
      for (const AspectSceneObject& o : scene->objects)
        grown.objects.push_back({o, std::vector<int>(scene->views.size(), -1)});
      const int v = links_.Grow(wanted, &grown);
      if (v < 0) break;
      wanted[v] = false;
      AspectScene more;
      more.views = grown.views;
      more.objects = scene->objects;
      AdjustCoarsely(in_, options_, &more);
      objects_.Sift(&more);
      completion_.AddCarried(kDraftCarried, &more);
      objects_.Sift(&more);
      if (more.objects.empty() || !more.views[v]) continue;
      *scene = std::move(more);
    }
  }

  // Looks again at the views that have no camera or a doubtful one, while that explains more. What
  // is not credible is not worth the time: it came out no better in 52 scenes (ADR 61).
  void Rescue(LinkedScene* best) {
    if (!options_.doubtful_views || !IsCredible(*best)) return;
    for (int round = 0; round < kRescues; ++round) {
      const LinkedScene trusted = WithoutDoubtfulViews(*best, in_.models, links_);
      if (trusted.registered() == static_cast<int>(best->views.size()) || IsStopRequested(stop_))
        return;
      std::vector<bool> missing;
      for (const auto& view : trusted.views) missing.push_back(!view);
      search_.SearchFor(trusted, missing, kRescuePerObject);
      LinkedScene more = Completed(SceneOf(trusted));
      if (more.score <= best->score) return;
      *best = std::move(more);
    }
  }

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const StopRequested& stop_;
  const StopRequested& cancelled_;
  ViewLinks links_;
  ViewSearch search_;
  SceneObjects objects_;
  SceneCompletion completion_;
};

}  // namespace

int LinkedScene::registered() const {
  return static_cast<int>(
      std::count_if(views.begin(), views.end(), [](const auto& v) { return v.has_value(); }));
}

void SortBestFirst(LinkedScene* scene) {
  std::stable_sort(scene->objects.begin(), scene->objects.end(), [](const auto& a, const auto& b) {
    return a.score > b.score;
  });
}

AspectScene SceneOf(const LinkedScene& linked) {
  AspectScene scene;
  scene.views = linked.views;
  for (const LinkedObject& o : linked.objects)
    scene.objects.push_back({o.object, o.scene_from_object});
  return scene;
}

LinkedScene LinkAspects(const AspectLinkInput& input,
                        const AspectLinkOptions& options,
                        const StopRequested& stop,
                        const StopRequested& cancelled) {
  return Linker(input, options, stop, cancelled).Run();
}

}  // namespace horopter
