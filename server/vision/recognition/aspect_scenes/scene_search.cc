#include "server/vision/recognition/aspect_scenes/scene_search.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "server/vision/recognition/aspect_scenes/doubtful_views.h"
#include "server/vision/recognition/aspect_scenes/reunited_views.h"
#include "server/vision/recognition/aspect_scenes/scene_completion.h"
#include "server/vision/recognition/aspect_scenes/scene_generator.h"
#include "server/vision/recognition/aspect_scenes/scene_objects.h"
#include "server/vision/recognition/aspect_scenes/scene_similarity.h"
#include "server/vision/recognition/aspect_scenes/settled_scenes.h"
#include "server/vision/recognition/aspect_scenes/view_links.h"
#include "server/vision/recognition/aspect_scenes/view_search.h"

namespace horopter {
namespace {

constexpr int kRescuePerObject = 120;  // poses of a found part refined in doubtful views
constexpr int kCompleted = 3;          // drafts, of those that explain ...
constexpr double kNearlyBest = 0.6;    // ... this share of what the best does
constexpr int kRescues = 2;            // rounds in which doubtful views are looked at again
constexpr std::size_t kReunited = 2;   // scenes that are completed
constexpr int kDraftCarried = 8;       // hypotheses carried over before all views are there

class SceneSearch {
 public:
  SceneSearch(const AspectLinkInput& input,
              const AspectLinkOptions& options,
              const StopRequested& stop,
              const StopRequested& cancelled)
      : in_(input),
        options_(options),
        cancelled_(cancelled),
        over_(WithEffort(input, stop)),
        links_(input, options, cancelled),
        search_(input, options, over_, &links_),
        objects_(input, options, over_),
        completion_(input, options, links_, objects_, over_),
        pairs_(links_),
        surfaces_(input, options, links_, over_),
        generators_(input.generators.begin(), input.generators.end()) {
    generators_.push_back(&pairs_);
    generators_.push_back(&surfaces_);
    std::stable_sort(
        generators_.begin(),
        generators_.end(),
        [](const SceneGenerator* a, const SceneGenerator* b) { return a->cost() < b->cost(); });
  }

  LinkedScene Run() {
    search_.SearchFirst();
    LinkedScene best;
    best.views.resize(in_.images.size());
    Ask(false, &best);
    SearchAsNeeded(&best);
    search_.Forget();
    Rescue(&best);
    if (completion_.AddStanding(&best)) {
      // What was added may settle views that the others left in doubt.
      search_.Forget();
      Rescue(&best);
    }
    if (Reunite(&best)) completion_.AddStanding(&best);
    completion_.LeaveOutPoorViews(&best);
    completion_.Conclude(&best);
    return best;
  }

 private:
  // A proposed scene before other hypotheses are carried over, and what it explains.
  struct Draft {
    AspectScene scene;
    double score = 0.0;
  };

  bool IsOver() const { return IsStopRequested(over_); }

  // Generators that take less first, while the best scene is not credible or, once all images are
  // searched, is in doubt.
  void Ask(bool in_doubt, LinkedScene* best) {
    for (SceneGenerator* generator : generators_) {
      if (IsCredible(*best) && !in_doubt) return;
      if (!generator->Applies(*best)) continue;
      SpendEffort(in_, generator->cost());
      LinkedScene other = BestOf(DraftsOf(generator));
      if (!other.objects.empty() && (best->objects.empty() || other.score > best->score))
        *best = std::move(other);
    }
  }

  std::vector<Draft> DraftsOf(SceneGenerator* generator) const {
    std::vector<Draft> drafts;
    while (drafts.size() < generator->most() && !IsLate(drafts)) {
      std::optional<Proposal> proposal = generator->Propose();
      if (!proposal) break;
      std::optional<Draft> draft = DraftOf(proposal->scene, drafts);
      if (!draft) continue;
      if (proposal->as_it_is) {
        Draft as_is{std::move(proposal->scene)};
        as_is.score = objects_.Sift(&as_is.scene);
        if (as_is.score > draft->score) draft = std::move(as_is);
      }
      drafts.push_back(*std::move(draft));
    }
    return drafts;
  }

  // The drafts completed that explain nearly as much as the best; the best of these.
  LinkedScene BestOf(std::vector<Draft> drafts) const {
    LinkedScene best;
    std::stable_sort(drafts.begin(), drafts.end(), [](const Draft& a, const Draft& b) {
      return a.score > b.score;
    });
    for (std::size_t i = 0; i < std::min<std::size_t>(drafts.size(), kCompleted); ++i) {
      if (drafts[i].score < kNearlyBest * drafts.front().score) break;
      if (IsOver() && !best.objects.empty()) break;
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
    while (!search_.AllSearched() && IsCredible(*best) && !IsOver()) {
      AddUnsearched(best);
      if (IsSettled(*best)) break;
      search_.SearchNext();
    }
    if (!IsSettled(*best) && !IsOver()) {
      search_.SearchRest();
      Ask(true, best);
    }
  }

  void AddUnsearched(LinkedScene* best) {
    search_.SearchUnsearchedFor(*best, kQuickPerObject);
    LinkedScene more = Completed(SceneOf(*best));
    if (more.score > best->score) *best = std::move(more);
  }

  // The first draft is looked for whatever the hurry.
  bool IsLate(const std::vector<Draft>& drafts) const {
    return IsStopRequested(drafts.empty() ? cancelled_ : over_);
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
    while (!scene->objects.empty() && !IsOver()) {
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
      if (trusted.registered() == static_cast<int>(best->views.size()) || IsOver()) return;
      std::vector<bool> missing;
      for (const auto& view : trusted.views) missing.push_back(!view);
      search_.SearchFor(trusted, missing, kRescuePerObject);
      LinkedScene more = Completed(SceneOf(trusted));
      if (more.score <= best->score) return;
      *best = std::move(more);
    }
  }

  // Whether one object each explains as well what two of a part do, each in views of its own.
  bool Reunite(LinkedScene* best) {
    for (AspectScene& scene : ReunitedScenes(*best, in_.models, kReunited)) {
      if (IsOver()) return false;
      LinkedScene more = completion_.Finish(std::move(scene));
      if (more.score <= best->score) continue;
      *best = std::move(more);
      return true;
    }
    return false;
  }

  const AspectLinkInput& in_;
  const AspectLinkOptions& options_;
  const StopRequested& cancelled_;
  const StopRequested over_;
  ViewLinks links_;
  ViewSearch search_;
  SceneObjects objects_;
  SceneCompletion completion_;
  LinkedPairs pairs_;
  LinkedSurfaces surfaces_;
  std::vector<SceneGenerator*> generators_;  // those that take less first
};

}  // namespace

LinkedScene SearchScene(const AspectLinkInput& input,
                        const AspectLinkOptions& options,
                        const StopRequested& stop,
                        const StopRequested& cancelled) {
  return SceneSearch(input, options, stop, cancelled).Run();
}

}  // namespace horopter
