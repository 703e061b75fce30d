#include "server/vision/recognition/interpretation/aspect_route.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>
#include <utility>

#include "server/base/status_macros.h"
#include "server/vision/recognition/aspect_scenes/camera_search.h"
#include "server/vision/recognition/aspect_scenes/scene_search.h"
#include "server/vision/recognition/aspect_search/object_ranking.h"
#include "server/vision/recognition/interpretation/aspect_answer.h"
#include "server/vision/recognition/interpretation/aspect_decision.h"

namespace horopter {
namespace {

constexpr double kKnownLogSigma = 0.1;  // a focal length known better is not searched for

// What is known of the views' cameras before any part is.
std::vector<AspectViewPrior> ViewPriors(const JointContext& context,
                                        std::span<const AspectImage> images) {
  std::vector<AspectViewPrior> priors;
  for (std::size_t v = 0; v < images.size(); ++v) {
    priors.push_back({context.start_cameras[v], context.focal_log_sigma[v]});
    if (context.focal_log_sigma[v] < context.options.focal_log_sigma) continue;
    priors.back().camera.focal_px = NominalCamera(images[v]).focal_px;
    priors.back().log_focal_sigma = kNominalFocalLogSigma;
  }
  return priors;
}

// Whether the focal length is known so well that it is not searched for.
bool IsKnown(const AspectViewPrior& prior) {
  return prior.log_focal_sigma < kKnownLogSigma;
}

// A scene by the numbers of the catalog by those of the parts that are searched for; nothing when
// one of its objects is not.
std::optional<AspectScene> Searched(AspectScene scene, const AspectSearch& search) {
  for (AspectSceneObject& o : scene.objects) {
    const auto model = std::find(search.objects.begin(), search.objects.end(), o.object);
    if (model == search.objects.end()) return std::nullopt;
    o.object = static_cast<int>(model - search.objects.begin());
  }
  return scene;
}

// What few poses of a part miss other views list, or the search on planes finds: 24 and 25 parts
// with 5 and 3 each instead of 10 and 6 are answered as well in 40 scenes, in a tenth less time
// (ADR 60).
constexpr int kCoarsePoses = 125, kFinePoses = 75;
constexpr int kLeastCoarse = 5, kLeastFine = 3;

// Poses of each part that are refined in an image, of so many for all parts.
FindAspectOptions WithShares(FindAspectOptions find, std::size_t parts) {
  const auto share = [&](int of_all, int least, int most) {
    const int each = of_all / static_cast<int>(std::max<std::size_t>(parts, 1));
    return std::min(std::max(each, least), most);
  };
  find.coarse_per_object = share(kCoarsePoses, kLeastCoarse, find.coarse_per_object);
  find.fine_per_object = share(kFinePoses, kLeastFine, find.fine_per_object);
  return find;
}

std::vector<AspectHypothesis> SearchImage(const JointContext& context,
                                          const AspectImage& image,
                                          const AspectSearch& search,
                                          const PinholeCamera* known,
                                          FindAspectOptions find) {
  find = WithShares(find, search.index->models.size());
  if (IsBrief(context.options)) find = Brief(find);
  find.threads = find.votes.threads = context.options.threads;
  // Sizes are shares of the whole image's width, also where a part of it is searched.
  if (image.searched)
    find.votes.max_size_share *= image.image_width * image.working_from_image / image.width;
  return FindAspectHypotheses(image, *search.index, find, known, context.give_up).hypotheses;
}

// The same of one of the images, once.
const std::vector<AspectHypothesis>& SearchOnce(const JointContext& context,
                                                const AspectViewPrior& prior,
                                                const FindAspectOptions& find,
                                                int v,
                                                AspectWork* work) {
  std::optional<std::vector<AspectHypothesis>>& found = work->hypotheses[v];
  if (!found) {
    work->effort.Spend(kImageEffort);
    found = SearchImage(
        context, work->images[v], work->search, IsKnown(prior) ? &prior.camera : nullptr, find);
  }
  return *found;
}

// What was searched, and of the object that is explained what was found.
void ReportSearch(const AspectWork& work, RefusalLog* log, RecognitionResult* out) {
  out->searched_objects = static_cast<int>(work.search.objects.size());
  out->counts["aspects_searched"] = out->searched_objects;
  out->counts["search_effort"] = work.effort.spent();
  out->effort_spent = work.effort.IsSpent();
  out->counts["aspect_views_searched"] = static_cast<double>(std::count_if(
      work.hypotheses.begin(), work.hypotheses.end(), [](const auto& h) { return h.has_value(); }));
  for (std::size_t v = 0; v < work.hypotheses.size(); ++v) {
    if (!work.hypotheses[v]) continue;
    for (const AspectHypothesis& h : *work.hypotheses[v]) {
      const int object = work.search.objects[h.object];
      out->hypotheses.push_back(
          {object, static_cast<int>(v), h.camera, h.camera_from_object, h.score});
      if (log != nullptr && object == log->object)
        log->hypotheses.push_back(out->hypotheses.back());
    }
  }
}

// From numbers of the parts searched for to those of the catalog.
void ToCatalog(const AspectSearch& search, LinkedScene* scene) {
  for (LinkedObject& o : scene->objects) {
    o.object = search.objects[o.object];
    if (o.competing_object >= 0) o.competing_object = search.objects[o.competing_object];
  }
}

// What each call of the linking is given.
struct Linking {
  std::vector<AspectViewPrior> priors;
  std::vector<std::vector<AspectHypothesis>> none;
  AspectLinkOptions options;
  AspectLinkInput input;
};

std::unique_ptr<Linking> LinkingOf(const JointContext& context,
                                   const AspectRecognitionOptions& options,
                                   bool single_images,
                                   AspectWork* work) {
  auto out = std::make_unique<Linking>();
  work->hypotheses.resize(work->images.size());
  out->priors = ViewPriors(context, work->images);
  out->none.resize(work->images.size());
  out->options = options.link;
  out->options.threads = context.options.threads;
  out->input.images = work->images;
  out->input.priors = out->priors;
  out->input.hypotheses = out->none;
  out->input.models = work->search.index->models;
  out->input.effort = &work->effort;
  if (!single_images) return out;
  out->input.search = [&context, find = options.find, work, linking = out.get()](int v) {
    return SearchOnce(context, linking->priors[v], find, v, work);
  };
  return out;
}

constexpr double kMatchedCost = 0.2;  // of an image's search, beside the images searched

// What proposes scenes, by the numbers of what is searched for. All that is given outlives it.
std::vector<ListedScenes> ListsOf(const JointContext& context,
                                  const AspectStarts& starts,
                                  const AspectSearch& search,
                                  const Linking& linking) {
  std::vector<ListedScenes> out;
  if (starts.matched != nullptr) {
    out.emplace_back(kMatchedCost, [&] {
      AspectScene scene =
          StartInCameras(linking.input, *starts.matched, linking.options, context.give_up);
      std::vector<AspectScene> scenes;
      if (!scene.objects.empty()) scenes.push_back(std::move(scene));
      return scenes;
    });
  }
  for (const SceneList& list : starts.lists) {
    out.emplace_back(list.cost, [&context, &search, &list] {
      std::vector<AspectScene> scenes;
      for (AspectScene& scene : list.list()) {
        if (auto searched = Searched(std::move(scene), search))
          scenes.push_back(*std::move(searched));
      }
      BeginStep(context, "aspect_search");
      return scenes;
    });
  }
  return out;
}

}  // namespace

std::vector<std::optional<AspectSceneView>> SceneViews(
    const std::vector<std::optional<CalibratedCamera>>& views) {
  std::vector<std::optional<AspectSceneView>> out;
  for (const auto& view : views) {
    out.emplace_back();
    if (view) {
      out.back() = AspectSceneView{view->camera,
                                   view->camera_from_scene,
                                   std::log(view->camera.focal_px),
                                   kNominalFocalLogSigma};
    }
  }
  return out;
}

bool HaveAspects(PreparedObjects objects) {
  return std::all_of(
      objects.begin(), objects.end(), [](const auto& o) { return o->aspects != nullptr; });
}

absl::StatusOr<AspectSearch> ChooseObjects(const JointContext& context,
                                           std::span<const AspectImage> images,
                                           const ObjectRankingOptions& of_ranking) {
  const AspectRouteOptions& options = context.options.aspects;
  const int threads = context.options.threads;
  const std::shared_ptr<const CatalogAspects> catalog = SharedCatalogAspects(context.objects);
  AspectSearch search;
  if (static_cast<int>(context.objects.size()) <= options.max_objects) {
    BeginStep(context, "aspect_index");
    search.index = catalog->Search(threads);
    search.objects.resize(context.objects.size());
    std::iota(search.objects.begin(), search.objects.end(), 0);
    return search;
  }
  BeginStep(context, "aspect_ranking");
  ObjectRankingOptions rank = of_ranking;
  rank.votes.threads = threads;
  search.objects = RankObjects(images, *catalog->Ranking(threads), rank, context.give_up);
  if (IsStopRequested(context.stop))
    return absl::CancelledError("stopped while objects were ranked");
  BeginStep(context, "aspect_index");
  search.index = std::make_shared<const FragmentIndex>(
      MakeSearchIndex(context.objects, search.objects, threads));
  return search;
}

absl::StatusOr<RecognitionResult> RecognizeByAspects(const JointContext& context,
                                                     AspectWork* work,
                                                     const AspectStarts& starts,
                                                     RefusalLog* log,
                                                     const AspectRecognitionOptions& options) {
  BeginStep(context, "aspect_search");
  const auto linking = LinkingOf(context, options, starts.single_images, work);
  std::vector<ListedScenes> listed = ListsOf(context, starts, work->search, *linking);
  std::vector<SceneGenerator*> generators;
  for (ListedScenes& generator : listed) generators.push_back(&generator);
  linking->input.generators = generators;
  LinkedScene scene = SearchScene(linking->input, linking->options, context.give_up, context.stop);
  if (IsStopRequested(context.stop))
    return absl::CancelledError("stopped while aspects were linked");
  ToCatalog(work->search, &scene);
  RecognitionResult out = ToResult(context, scene, log);
  ReportSearch(*work, log, &out);
  return out;
}

absl::StatusOr<RecognitionResult> RecognizeByAspectsWithCameras(
    const JointContext& context,
    AspectWork* work,
    const KnownCameras& cameras,
    RefusalLog* log,
    const AspectRecognitionOptions& options) {
  BeginStep(context, "camera_search");
  const auto linking = LinkingOf(context, options, true, work);
  LinkedScene scene =
      FindInCameras(linking->input, cameras, linking->options, context.give_up, context.stop);
  if (IsStopRequested(context.stop))
    return absl::CancelledError("stopped while parts were looked for under known cameras");
  ToCatalog(work->search, &scene);
  RecognitionResult out = ToResult(context, scene, log, true);
  // What is not answered may be searched on, and is reported then.
  ReportSearch(*work, out.objects.empty() ? nullptr : log, &out);
  // A camera that was left out is somewhere else.
  const bool all_hold = scene.registered() == cameras.known();
  out.under_known_cameras = !out.objects.empty() && all_hold;
  return out;
}

}  // namespace horopter
