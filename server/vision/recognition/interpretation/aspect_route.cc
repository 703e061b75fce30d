#include "server/vision/recognition/interpretation/aspect_route.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/aspect_scenes/camera_search.h"
#include "server/vision/recognition/aspect_search/object_ranking.h"
#include "server/vision/recognition/interpretation/aspect_answer.h"
#include "server/vision/recognition/interpretation/aspect_decision.h"
#include "server/vision/recognition/interpretation/aspect_starts.h"
#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

constexpr int kLeading = 12;  // of a shortlist: these decide whether aspects come first
// What few poses of a part miss other views list, or the search on planes finds: 24 and 25 parts
// with 5 and 3 each instead of 10 and 6 are answered as well in 40 scenes, in a tenth less time
// (ADR 60).
constexpr int kCoarsePoses = 125, kFinePoses = 75;
constexpr int kLeastCoarse = 5, kLeastFine = 3;
// Least joint score of the second attempt: true poses before terrazzo out of focus have .30 - .46.
constexpr double kFaintJoint = 0.25;

double AboveChance(const std::vector<double>& view_scores, double chance) {
  double sum = 0.0;
  for (const double score : view_scores) sum += std::max(0.0, score - chance);
  return sum;
}

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
    found = SearchImage(
        context, work->images[v], work->search, IsKnown(prior) ? &prior.camera : nullptr, find);
  }
  return *found;
}

// What was searched, and of the object that is explained what was found.
void ReportSearch(const AspectWork& work, RefusalLog* log, RecognitionResult* out) {
  out->searched_objects = static_cast<int>(work.search.objects.size());
  out->counts["aspects_searched"] = out->searched_objects;
  out->counts["aspect_views_searched"] = static_cast<double>(std::count_if(
      work.hypotheses.begin(), work.hypotheses.end(), [](const auto& h) { return h.has_value(); }));
  for (std::size_t v = 0; log != nullptr && v < work.hypotheses.size(); ++v) {
    if (!work.hypotheses[v]) continue;
    for (const AspectHypothesis& h : *work.hypotheses[v]) {
      if (work.search.objects[h.object] != log->object) continue;
      log->hypotheses.push_back(
          {log->object, static_cast<int>(v), h.camera, h.camera_from_object, h.score});
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

int MiddleView(const std::vector<std::optional<AspectSceneView>>& views) {
  std::vector<int> registered;
  for (int v = 0; v < static_cast<int>(views.size()); ++v) {
    if (views[v]) registered.push_back(v);
  }
  return registered[registered.size() / 2];
}

}  // namespace

bool HaveAspects(PreparedObjects objects) {
  return std::all_of(
      objects.begin(), objects.end(), [](const auto& o) { return o->aspects != nullptr; });
}

bool AreRich(PreparedObjects objects, const AspectRouteOptions& options) {
  if (objects.empty()) return false;
  std::vector<std::size_t> edges;
  for (const auto& o : objects) edges.push_back(o->model.edges.size());
  const auto asked = static_cast<int>(objects.size()) > options.max_objects
                         ? edges.end() - 1
                         : edges.begin() + edges.size() / 2;
  std::nth_element(edges.begin(), asked, edges.end());
  return static_cast<int>(*asked) >= options.rich_edges;
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
    HOROPTER_ASSIGN_OR_RETURN(search.index, catalog->Search(threads));
    search.objects.resize(context.objects.size());
    std::iota(search.objects.begin(), search.objects.end(), 0);
    search.rich = AreRich(context.objects, options);
    return search;
  }
  BeginStep(context, "aspect_ranking");
  HOROPTER_ASSIGN_OR_RETURN(const auto ranking, catalog->Ranking(threads));
  ObjectRankingOptions rank = of_ranking;
  rank.votes.threads = threads;
  search.objects = RankObjects(images, *ranking, rank, context.give_up);
  if (IsStopRequested(context.stop))
    return absl::CancelledError("stopped while objects were ranked");
  std::vector<std::shared_ptr<const PreparedObject>> leading;
  for (const int i : search.objects) {
    if (static_cast<int>(leading.size()) < kLeading) leading.push_back(context.objects[i]);
  }
  search.rich = AreRich(leading, options);
  BeginStep(context, "aspect_index");
  HOROPTER_ASSIGN_OR_RETURN(FragmentIndex index,
                            MakeSearchIndex(context.objects, search.objects, threads));
  search.index = std::make_shared<const FragmentIndex>(std::move(index));
  return search;
}

AspectJudgement JudgeAnswer(const JointContext& context,
                            std::span<const AspectImage> images,
                            const RecognitionResult& answer,
                            const AspectRecognitionOptions& options) {
  AspectJudgement out;
  AspectScene scene;
  scene.views = SceneViews(answer.views);
  for (const SceneObject& o : answer.objects)
    scene.objects.push_back({o.object, o.scene_from_object});
  std::vector<const RenderMesh*> meshes;
  for (const auto& o : context.objects) meshes.push_back(&o->aspects->object.mesh);
  SceneJudgementOptions judging = options.judging;
  judging.render_px = context.options.aspects.judge_render_px;
  judging.threads = context.options.threads;
  out.objects = JudgeScene(images, meshes, scene, judging);
  std::vector<double> scores;
  for (const LinkedObject& o : out.objects) {
    out.score += AboveChance(ViewScores(o), context.options.acceptance.aspects.chance_score);
    scores.push_back(o.score);
  }
  if (!scores.empty()) {
    const auto middle = scores.begin() + scores.size() / 2;
    std::nth_element(scores.begin(), middle, scores.end());
    out.median = *middle;
  }
  return out;
}

void RefuseContradicted(const AspectJudgement& judgement,
                        bool aspects_find_something,
                        const AspectAcceptance& options,
                        RefusalLog* log,
                        RecognitionResult* answer) {
  const double least =
      aspects_find_something ? options.contradicting_score : options.confirming_score;
  if (answer->objects.empty() || judgement.median >= least) return;
  for (const SceneObject& o : answer->objects) {
    if (log == nullptr || o.object != log->object) continue;
    log->refusals.push_back({AcceptanceTest::kContradiction,
                             o.scene_from_object,
                             answer->views,
                             judgement.median,
                             least});
  }
  answer->objects.clear();
  answer->views.assign(answer->views.size(), std::nullopt);
  answer->state = RecognitionState::kNothingFound;
  answer->route = RecognitionRoute::kNone;
  answer->detail = "the edges that the cameras should see of what fits are not in the images";
}

absl::StatusOr<RecognitionResult> RecognizeByAspects(const JointContext& context,
                                                     AspectWork* work,
                                                     const AspectStarts& starts,
                                                     RefusalLog* log,
                                                     const AspectRecognitionOptions& options) {
  BeginStep(context, "aspect_search");
  const std::span<const AspectImage> images = work->images;
  const AspectSearch& search = work->search;
  work->hypotheses.resize(images.size());
  const std::vector<AspectViewPrior> priors = ViewPriors(context, images);
  const std::vector<std::vector<AspectHypothesis>> none(images.size());
  const auto search_view = [&](int v) {
    return SearchOnce(context, priors[v], options.find, v, work);
  };
  AspectLinkOptions link = options.link;
  link.threads = context.options.threads;
  AspectScene start;
  if (starts.known != nullptr) start = KnownScene(*starts.known, search).value_or(AspectScene{});
  LinkedScene scene = LinkAspects({images, priors, none, search.index->models, &start, search_view},
                                  link,
                                  context.give_up,
                                  context.stop);
  if (starts.matched != nullptr) {
    const std::vector<AspectViewPrior> seen = ViewPriors(*starts.matched, images);
    if (std::any_of(seen.begin(), seen.end(), IsKnown)) {
      const auto under = [&](int v) { return Under(seen[v], search_view(v)); };
      LinkedScene other = LinkAspects({images, seen, none, search.index->models, &start, under},
                                      link,
                                      context.give_up,
                                      context.stop);
      if (other.score > scene.score) scene = std::move(other);
    }
  }
  if (IsStopRequested(context.stop))
    return absl::CancelledError("stopped while aspects were linked");
  ToCatalog(search, &scene);
  RecognitionResult out = ToResult(context, scene, starts.known, log);
  if (out.objects.empty() && starts.without_ground && !IsStopRequested(context.give_up)) {
    link.min_quick -= link.min_joint - kFaintJoint;
    link.min_joint = kFaintJoint;
    link.follow_leads = false;
    LinkedScene faint =
        LinkAspects({images, priors, none, search.index->models, &start, search_view},
                    link,
                    context.give_up,
                    context.stop);
    if (IsStopRequested(context.stop))
      return absl::CancelledError("stopped while faint aspects were linked");
    ToCatalog(search, &faint);
    RecognitionResult more = ToResult(context, faint, starts.known, log);
    if (!more.objects.empty()) out = std::move(more);
  }
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
  const std::span<const AspectImage> images = work->images;
  work->hypotheses.resize(images.size());
  const std::vector<AspectViewPrior> priors = ViewPriors(context, images);
  const std::vector<std::vector<AspectHypothesis>> none(images.size());
  const auto search_view = [&](int v) {
    return SearchOnce(context, priors[v], options.find, v, work);
  };
  AspectLinkOptions link = options.link;
  link.threads = context.options.threads;
  LinkedScene scene =
      FindInCameras({images, priors, none, work->search.index->models, nullptr, search_view},
                    cameras,
                    link,
                    context.give_up);
  if (IsStopRequested(context.stop))
    return absl::CancelledError("stopped while parts were looked for under known cameras");
  ToCatalog(work->search, &scene);
  RecognitionResult out = ToResult(context, scene, nullptr, log, true);
  // What is not answered may be searched on, and is reported then.
  ReportSearch(*work, out.objects.empty() ? nullptr : log, &out);
  // A camera that was left out is somewhere else.
  const bool all_hold = scene.registered() == cameras.known();
  out.under_known_cameras = !out.objects.empty() && all_hold;
  return out;
}

absl::Status AddOthers(const JointContext& context,
                       std::span<const AspectImage> images,
                       const AspectSearch& search,
                       RecognitionResult* answer,
                       const AspectRecognitionOptions& options) {
  const AspectAcceptance& acceptance = context.options.acceptance.aspects;
  const std::optional<AspectScene> known = KnownScene(*answer, search);
  if (!known || known->objects.empty()) return absl::OkStatus();
  answer->searched_objects = static_cast<int>(search.objects.size());
  answer->counts["aspects_searched"] = answer->searched_objects;
  BeginStep(context, "aspect_others");
  AspectLinkOptions link = options.link;
  link.threads = context.options.threads;
  std::vector<AspectViewPrior> priors(images.size());
  std::vector<std::vector<AspectHypothesis>> hypotheses(images.size());
  const AspectLinkInput input{images, priors, hypotheses, search.index->models, &*known};
  // The middle view shows what most others show.
  const int v = MiddleView(known->views);
  hypotheses[v] = SearchImage(context, images[v], search, &known->views[v]->camera, options.find);
  LinkedScene others = FindOthers(input, link, context.give_up);
  if (IsStopRequested(context.stop))
    return absl::CancelledError("stopped while more objects were looked for");
  ToCatalog(search, &others);
  for (const LinkedObject& o : others.objects) {
    if (o.precision < acceptance.other_precision && !(o.lies && SurfaceTells(o, acceptance)))
      continue;
    double even = EvenBeside(o, acceptance);
    if (o.leans && known->objects.size() > 1) even = acceptance.even_leaning;
    const double probability = Logistic(acceptance.score_weight * (o.score - even));
    if (probability < acceptance.min_probability) continue;
    AddAnswer(o, probability, context.options.acceptance.scene.ambiguity_gap, answer);
  }
  return absl::OkStatus();
}

}  // namespace horopter
