#include "server/vision/recognition/aspect_scenes/surface_links.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/aspect_scenes/surface_agreement.h"
#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr std::size_t kObjects = 2;      // whose scenes are made; chosen, for time
constexpr std::size_t kPoses = 3;        // of an object in a view; chosen, for time
constexpr std::size_t kFirstStarts = 2;  // of the view that shows it best, from which scenes start
constexpr int kLeastLinkedViews = 3;     // two adapt to each other
constexpr std::size_t kAsked = 3;        // nearest views in number that a view is held against
// Of a view with those it is held against: right ones of printed boxes have 0.8 and more.
constexpr double kAgrees = 0.5;
constexpr double kOdd = 0.15;             // less than the middle one with all others: a poor pose
constexpr double kOneCameraSigma = 0.02;  // of ln f

// Views by their distance in number from one.
std::vector<int> ByNearness(int from, std::size_t count) {
  std::vector<int> out(count);
  std::iota(out.begin(), out.end(), 0);
  std::stable_sort(out.begin(), out.end(), [&](int a, int b) {
    return std::abs(a - from) < std::abs(b - from);
  });
  return out;
}

// A part as a view shows it, and the view's camera in the part's frame but for a turn.
struct Shown {
  const AspectImage* image = nullptr;
  PinholeCamera camera;
  Rigid3 camera_from_object;
  ObjectLayer layer;

  SeenObject Seen(const Rigid3& turn) const {
    return {image, camera, camera_from_object * turn, &layer};
  }
};

Shown ShownIn(const AspectLinkInput& input,
              int object,
              int view,
              const PinholeCamera& camera,
              const Rigid3& camera_from_object) {
  const AspectImage& image = input.images[view];
  const RenderMesh& mesh = input.models[object].object->mesh;
  return {&image,
          camera,
          camera_from_object,
          MakeObjectLayer(image, mesh, camera, camera_from_object, kQuickRenderPx)};
}

struct SurfaceTurn {
  Rigid3 turn;
  double correlation = 0.0;
  double stated = 0.0;  // of the first turn; 0 where it says nothing
};

// Of the turns of a view that by which it agrees best with the others.
std::optional<SurfaceTurn> BestTurn(const Shown& shown,
                                    std::span<const SeenObject> others,
                                    std::span<const Rigid3> turns) {
  std::optional<SurfaceTurn> best;
  double stated = 0.0;
  for (const Rigid3& turn : turns) {
    const SeenObject seen = shown.Seen(turn);
    double sum = 0.0;
    int told = 0;
    for (const SeenObject& other : others) {
      const std::optional<double> correlation = SurfaceCorrelation(seen, other);
      if (!correlation) continue;
      sum += *correlation;
      ++told;
    }
    if (told == 0) continue;
    if (&turn == turns.data()) stated = sum / told;
    if (!best || sum / told > best->correlation) best = {turn, sum / told, 0.0};
  }
  if (best) best->stated = stated;
  return best;
}

class SurfaceLinker {
 public:
  SurfaceLinker(const AspectLinkInput& input,
                const AspectLinkOptions& options,
                const ViewLinks& links,
                int object)
      : links_(links), object_(object), shown_(input.images.size()) {
    turns_ = {Rigid3{}};
    links.turns().AppendSpread(input.models[object].symmetries, &turns_);
    std::vector<std::pair<int, const AspectHypothesis*>> all;
    for (int v = 0; v < static_cast<int>(input.images.size()); ++v) {
      for (const AspectHypothesis* h : OutlinedIn(v)) all.emplace_back(v, h);
    }
    std::vector<Shown> shown(all.size());
    ParallelFor(static_cast<int>(all.size()), options.threads, [&](int i) {
      const auto& [v, h] = all[i];
      shown[i] = ShownIn(input, object, v, h->camera, h->camera_from_object);
    });
    for (std::size_t i = 0; i < all.size(); ++i)
      shown_[all[i].first].push_back(std::move(shown[i]));
  }

  // The scene that most views agree on; nothing when too few do.
  std::optional<AspectScene> Run(const StopRequested& stop) const {
    const auto first =
        std::max_element(shown_.begin(), shown_.end(), [&](const auto& a, const auto& b) {
          return BestOf(&a - shown_.data()) < BestOf(&b - shown_.data());
        });
    const int from = static_cast<int>(first - shown_.begin());
    std::optional<AspectScene> best;
    double most = 0.0;
    for (std::size_t i = 0; i < std::min(kFirstStarts, first->size()); ++i) {
      if (IsStopRequested(stop)) break;
      auto [scene, worth] = From(from, i);
      if (worth <= most) continue;
      most = worth;
      best = std::move(scene);
    }
    return best;
  }

 private:
  // Hypotheses of the object whose edges a view shows, inside of which it may show more.
  std::vector<const AspectHypothesis*> OutlinedIn(int v) const {
    std::vector<const AspectHypothesis*> out;
    for (const AspectHypothesis& h : links_.Hypotheses(v)) {
      if (out.size() >= kPoses) break;
      if (h.object == object_ && h.precision >= kPrintPrecision) out.push_back(&h);
    }
    return out;
  }

  // Hypotheses are listed best first.
  double BestOf(std::ptrdiff_t v) const {
    const auto outlined = OutlinedIn(static_cast<int>(v));
    return outlined.empty() ? 0.0 : outlined.front()->score;
  }

  // From one pose in a view on, each view by the pose and turn that agrees best with those before.
  std::pair<AspectScene, double> From(int from, std::size_t pose) const {
    std::vector<std::optional<SeenObject>> chosen(shown_.size());
    chosen[from] = shown_[from][pose].Seen(Rigid3{});
    double worth = 0.0;
    for (const int v : ByNearness(from, shown_.size())) {
      if (v == from || shown_[v].empty()) continue;
      std::vector<SeenObject> others;
      for (const int w : ByNearness(v, chosen.size())) {
        if (chosen[w] && others.size() < kAsked) others.push_back(*chosen[w]);
      }
      double agrees = kAgrees;
      for (const Shown& shown : shown_[v]) {
        const std::optional<SurfaceTurn> turn = BestTurn(shown, others, turns_);
        if (!turn || turn->correlation < agrees) continue;
        agrees = turn->correlation;
        chosen[v] = shown.Seen(turn->turn);
      }
      if (chosen[v]) worth += agrees;
    }
    DropOdd(&chosen);
    AspectScene scene;
    scene.views.resize(shown_.size());
    int views = 0;
    for (std::size_t v = 0; v < chosen.size(); ++v) {
      if (!chosen[v]) continue;
      AspectHypothesis h;
      h.camera = chosen[v]->camera;
      h.camera_from_object = chosen[v]->camera_from_scene;
      scene.views[v] = links_.ViewOf(static_cast<int>(v), h);
      ++views;
    }
    scene.objects = {{object_, Rigid3{}}};
    return {std::move(scene), views >= kLeastLinkedViews ? worth : 0.0};
  }

  // A view that agrees less with the others than they do among themselves does without.
  static void DropOdd(std::vector<std::optional<SeenObject>>* chosen) {
    std::vector<std::pair<double, std::size_t>> means;
    for (std::size_t v = 0; v < chosen->size(); ++v) {
      if (!(*chosen)[v]) continue;
      double sum = 0.0;
      int told = 0;
      for (std::size_t w = 0; w < chosen->size(); ++w) {
        if (w == v || !(*chosen)[w]) continue;
        const auto correlation = SurfaceCorrelation(*(*chosen)[v], *(*chosen)[w]);
        sum += correlation.value_or(0.0);
        told += correlation.has_value();
      }
      if (told > 0) means.emplace_back(sum / told, v);
    }
    if (means.size() <= static_cast<std::size_t>(kLeastLinkedViews)) return;
    std::sort(means.begin(), means.end());
    const double middle = means[means.size() / 2].first;
    for (const auto& [mean, v] : means) {
      if (mean < middle - kOdd) (*chosen)[v].reset();
    }
  }

  const ViewLinks& links_;
  int object_;
  std::vector<Rigid3> turns_;
  std::vector<std::vector<Shown>> shown_;  // of each view
};

// Parts whose outline three views and more, and half of all, show; the best ones first.
std::vector<int> OutlinedObjects(const AspectLinkInput& input, const ViewLinks& links) {
  const int models = static_cast<int>(input.models.size());
  std::vector<double> worth(models, 0.0);
  std::vector<int> views(models, 0);
  for (int v = 0; v < static_cast<int>(input.images.size()); ++v) {
    std::vector<double> best(models, 0.0);
    for (const AspectHypothesis& h : links.Hypotheses(v)) {
      if (h.precision >= kPrintPrecision) best[h.object] = std::max(best[h.object], h.score);
    }
    for (int o = 0; o < models; ++o) {
      worth[o] += best[o];
      views[o] += best[o] > 0.0;
    }
  }
  std::vector<int> out;
  for (int o = 0; o < models; ++o) {
    if (views[o] >= kLeastLinkedViews && 2 * views[o] >= static_cast<int>(input.images.size()) &&
        input.models[o].round.empty())
      out.push_back(o);
  }
  std::stable_sort(out.begin(), out.end(), [&](int a, int b) { return worth[a] > worth[b]; });
  if (out.size() > kObjects) out.resize(kObjects);
  return out;
}

}  // namespace

std::optional<SurfaceChoice> ChooseBySurface(
    const AspectLinkInput& input,
    const std::vector<std::optional<AspectSceneView>>& views,
    const AspectSceneObject& placed,
    int view,
    std::span<const PoseInView> poses,
    const LinkTurns& turns) {
  const AspectModel& model = input.models[placed.object];
  if ((poses.size() < 2 && model.symmetries.empty()) || !model.round.empty()) return std::nullopt;
  std::vector<Shown> near;
  for (const int w : ByNearness(view, views.size())) {
    if (!views[w] || w == view || near.size() >= kAsked) continue;
    near.push_back(ShownIn(input,
                           placed.object,
                           w,
                           views[w]->camera,
                           views[w]->camera_from_scene * placed.scene_from_object));
  }
  std::vector<SeenObject> others;
  for (const Shown& other : near) others.push_back(other.Seen(Rigid3{}));
  std::vector<Rigid3> allowed = {Rigid3{}};
  turns.AppendSpread(model.symmetries, &allowed);
  std::optional<SurfaceChoice> best;
  double stated = 0.0;
  for (std::size_t p = 0; p < poses.size(); ++p) {
    const Shown shown =
        ShownIn(input, placed.object, view, poses[p].camera, poses[p].camera_from_object);
    const std::optional<SurfaceTurn> turn = BestTurn(shown, others, allowed);
    if (!turn) continue;
    if (p == 0) stated = turn->stated;
    if (!best || turn->correlation > best->correlation)
      best = SurfaceChoice{p, turn->turn, turn->correlation, 0.0};
  }
  if (best) best->stated = stated;
  return best;
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

std::vector<AspectScene> ScenesBySurface(const AspectLinkInput& input,
                                         const AspectLinkOptions& options,
                                         const ViewLinks& links,
                                         const StopRequested& stop) {
  std::vector<AspectScene> out;
  for (const int object : OutlinedObjects(input, links)) {
    if (IsStopRequested(stop)) break;
    if (auto scene = SurfaceLinker(input, options, links, object).Run(stop))
      out.push_back(std::move(*scene));
  }
  return out;
}

}  // namespace horopter
