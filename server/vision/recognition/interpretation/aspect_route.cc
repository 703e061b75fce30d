#include "server/vision/recognition/interpretation/aspect_route.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/aspect_scenes/rig_search.h"
#include "server/vision/recognition/aspect_search/object_ranking.h"
#include "server/vision/recognition/interpretation/aspect_decision.h"
#include "server/vision/recognition/interpretation/aspect_starts.h"
#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

constexpr int kLeading = 12;     // of a shortlist: these decide whether aspects come first
constexpr double kNearM = 1e-3;  // least depth that a size in the image is taken of
// Of cameras of a calibrated station: better than any part alone tells.
constexpr double kRigFocalLogSigma = 0.01;
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

// Scores of an object's views, -1 where it is not shown.
std::vector<double> ViewScores(const LinkedObject& o) {
  std::vector<double> out;
  for (std::size_t v = 0; v < o.views.size(); ++v)
    out.push_back(o.shown[v] ? o.views[v].score : -1.0);
  return out;
}

// The other route's object in this place of the images, -1: none.
int KnownInPlace(const JointContext& context,
                 const std::vector<std::optional<CalibratedCamera>>& views,
                 int object_index,
                 const Rigid3& scene_from_object,
                 const RecognitionResult& known) {
  const PreparedObject& object = *context.objects[object_index];
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v] || !known.views[v]) continue;
    const auto seen = [&](const CalibratedCamera& view, const Rigid3& pose) {
      return Project(view.camera, view.camera_from_scene * pose * object.center);
    };
    const double depth = (views[v]->camera_from_scene * scene_from_object * object.center).z();
    const double size =
        views[v]->camera.focal_px * object.model.diameter_m / std::max(depth, kNearM);
    const Eigen::Vector2d here = seen(*views[v], scene_from_object);
    for (std::size_t k = 0; k < known.objects.size(); ++k) {
      const SceneObject& other = known.objects[k];
      if (other.object == object_index &&
          (here - seen(*known.views[v], other.scene_from_object)).norm() <
              context.options.acceptance.aspects.same_place_share * size) {
        return static_cast<int>(k);
      }
    }
  }
  return -1;
}

// Of a scene that has at least half of what the other route found: its objects that got lost, in
// the frame of the others. What hides or prints cost them in these scores the table told.
void KeepKnown(const JointContext& context,
               const RecognitionResult& known,
               RecognitionResult* result) {
  std::vector<int> place(known.objects.size(), -1);  // of each known object in the result
  for (std::size_t i = 0; i < result->objects.size(); ++i) {
    SceneObject& o = result->objects[i];
    const int k = KnownInPlace(context, result->views, o.object, o.scene_from_object, known);
    if (k < 0 || place[k] >= 0) continue;
    place[k] = static_cast<int>(i);
  }
  const auto kept = std::find_if(place.begin(), place.end(), [](int p) { return p >= 0; });
  if (2 * std::count(place.begin(), place.end(), -1) > static_cast<std::ptrdiff_t>(place.size()) ||
      kept == place.end()) {
    return;
  }
  const Rigid3 here_from_known = result->objects[*kept].scene_from_object *
                                 known.objects[kept - place.begin()].scene_from_object.Inverse();
  for (std::size_t k = 0; k < place.size(); ++k) {
    if (place[k] >= 0) continue;
    SceneObject lost = known.objects[k];
    lost.scene_from_object = here_from_known * lost.scene_from_object;
    const auto center = [&](const SceneObject& o) {
      return Eigen::Vector3d(o.scene_from_object * context.objects[o.object]->center);
    };
    const bool taken =
        std::any_of(result->objects.begin(), result->objects.end(), [&](const SceneObject& o) {
          const double smaller = std::min(context.objects[o.object]->model.diameter_m,
                                          context.objects[lost.object]->model.diameter_m);
          return (center(o) - center(lost)).norm() <
                 context.options.acceptance.aspects.apart_share * smaller;
        });
    if (!taken) result->objects.push_back(std::move(lost));
  }
}

// Largest angle (radians) under which two views see one of the objects.
double Parallax(const LinkedScene& scene,
                std::span<const std::shared_ptr<const PreparedObject>> objects) {
  double least = 1.0;
  for (const LinkedObject& o : scene.objects) {
    const Eigen::Vector3d center = o.scene_from_object * objects[o.object]->center;
    std::vector<Eigen::Vector3d> rays;
    for (const auto& view : scene.views) {
      if (!view) continue;
      rays.push_back((center - view->camera_from_scene.Inverse().t).normalized());
      for (const Eigen::Vector3d& other : rays) least = std::min(least, other.dot(rays.back()));
    }
  }
  return std::acos(std::clamp(least, -1.0, 1.0));
}

SceneObject ToAnswer(const LinkedObject& o, double probability) {
  SceneObject out;
  out.object = o.object;
  out.scene_from_object = o.scene_from_object;
  out.score = probability;
  out.support = o.score;
  out.view_scores = ViewScores(o);
  return out;
}

// With its best competing placement where that is closer than `ambiguity_gap`.
void AddAnswer(const LinkedObject& o,
               double probability,
               double ambiguity_gap,
               RecognitionResult* result) {
  SceneObject answer = ToAnswer(o, probability);
  if (o.competing_object >= 0 && o.competing_score > o.score - ambiguity_gap) {
    answer.alternatives.push_back(o.competing_object);
    result->state = RecognitionState::kAmbiguous;
  }
  result->objects.push_back(std::move(answer));
}

std::vector<std::optional<CalibratedCamera>> RecognizedViews(const LinkedScene& scene) {
  std::vector<std::optional<CalibratedCamera>> out(scene.views.size());
  for (std::size_t v = 0; v < out.size(); ++v) {
    if (scene.views[v])
      out[v] = CalibratedCamera{scene.views[v]->camera, scene.views[v]->camera_from_scene};
  }
  return out;
}

// Notes the placements of the logged object whose value is below what is needed.
template <typename ValueOf>
void NoteBelow(const LinkedScene& scene,
               AcceptanceTest test,
               double needed,
               const ValueOf& value_of,
               RefusalLog* log) {
  if (log == nullptr) return;
  for (const LinkedObject& o : scene.objects) {
    if (o.object != log->object || value_of(o) >= needed) continue;
    log->refusals.push_back(
        {test, o.scene_from_object, RecognizedViews(scene), value_of(o), needed});
  }
}

RecognitionResult ToResult(const JointContext& context,
                           const LinkedScene& scene,
                           const RecognitionResult* known,
                           RefusalLog* log,
                           bool in_rig = false) {
  const AspectAcceptance& options = context.options.acceptance.aspects;
  const SceneAcceptance& of_scenes = context.options.acceptance.scene;
  const auto views = RecognizedViews(scene);
  const auto probability = [&](const LinkedObject& o) {
    if (in_rig) return ProbabilityInRig(o, scene, options);
    const int k =
        known == nullptr ? -1 : KnownInPlace(context, views, o.object, o.scene_from_object, *known);
    return std::max(AspectProbability(o, scene, options), k >= 0 ? known->objects[k].score : 0.0);
  };
  RecognitionResult result;
  result.views.resize(scene.views.size());
  LinkedScene accepted = scene;
  NoteBelow(scene, AcceptanceTest::kChance, options.min_probability, probability, log);
  std::erase_if(accepted.objects,
                [&](const LinkedObject& o) { return probability(o) < options.min_probability; });
  if (accepted.objects.empty()) {
    if (!scene.objects.empty()) {
      const LinkedObject& best = scene.objects.front();
      result.detail =
          absl::StrFormat("%s fits best with %.2f of its edges' score, but so may chance",
                          context.objects[best.object]->model.id,
                          best.score);
    }
    return result;
  }
  const double parallax = Parallax(accepted, context.objects);
  if (scene.registered() > 1 && parallax < of_scenes.min_parallax_rad) {
    constexpr double kDegrees = 180.0 / std::numbers::pi;
    result.state = RecognitionState::kNoParallax;
    NoteBelow(
        accepted,
        AcceptanceTest::kParallax,
        of_scenes.min_parallax_rad,
        [&](const LinkedObject&) { return parallax; },
        log);
    result.detail = absl::StrFormat("the views see the objects within %.1f degrees, need %.1f",
                                    kDegrees * parallax,
                                    kDegrees * of_scenes.min_parallax_rad);
    return result;
  }
  result.route = RecognitionRoute::kAspects;
  result.state = RecognitionState::kRecognized;
  result.views = RecognizedViews(scene);
  for (const LinkedObject& o : accepted.objects) {
    AddAnswer(o, probability(o), of_scenes.ambiguity_gap, &result);
  }
  if (known != nullptr) KeepKnown(context, *known, &result);
  return result;
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
                        double least,
                        RefusalLog* log,
                        RecognitionResult* answer) {
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
                                                     std::span<const AspectImage> images,
                                                     const AspectSearch& search,
                                                     const AspectStarts& starts,
                                                     RefusalLog* log,
                                                     const AspectRecognitionOptions& options) {
  BeginStep(context, "aspect_search");
  const std::vector<AspectViewPrior> priors = ViewPriors(context, images);
  const std::vector<std::vector<AspectHypothesis>> none(images.size());
  std::vector<std::vector<AspectHypothesis>> hypotheses(images.size());
  std::vector<bool> searched(images.size(), false);
  const auto search_view = [&](int v) {
    if (!searched[v]) {
      hypotheses[v] = SearchImage(context,
                                  images[v],
                                  search,
                                  IsKnown(priors[v]) ? &priors[v].camera : nullptr,
                                  options.find);
    }
    searched[v] = true;
    return hypotheses[v];
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
  out.counts["aspects_searched"] = static_cast<double>(search.objects.size());
  out.counts["aspect_views_searched"] =
      static_cast<double>(std::count(searched.begin(), searched.end(), true));
  for (std::size_t v = 0; log != nullptr && v < hypotheses.size(); ++v) {
    for (const AspectHypothesis& h : hypotheses[v]) {
      if (search.objects[h.object] != log->object) continue;
      log->hypotheses.push_back(
          {log->object, static_cast<int>(v), h.camera, h.camera_from_object, h.score});
    }
  }
  return out;
}

absl::StatusOr<RecognitionResult> RecognizeByAspectsInRig(const JointContext& context,
                                                          std::span<const AspectImage> images,
                                                          const AspectSearch& search,
                                                          std::span<const CalibratedCamera> rig,
                                                          RefusalLog* log,
                                                          const AspectRecognitionOptions& options) {
  BeginStep(context, "rig_search");
  std::vector<AspectViewPrior> priors;
  for (const CalibratedCamera& camera : rig) priors.push_back({camera.camera, kRigFocalLogSigma});
  std::vector<std::optional<AspectSceneView>> views = SceneViews({rig.begin(), rig.end()});
  for (auto& view : views) view->log_focal_sigma = kRigFocalLogSigma;
  const std::vector<std::vector<AspectHypothesis>> none(images.size());
  int searched = 0;
  const auto search_view = [&](int v) {
    ++searched;
    return SearchImage(context, images[v], search, &rig[v].camera, options.find);
  };
  AspectLinkOptions link = options.link;
  link.threads = context.options.threads;
  LinkedScene scene = FindInRig({images, priors, none, search.index->models, nullptr, search_view},
                                views,
                                link,
                                context.give_up);
  if (IsStopRequested(context.stop))
    return absl::CancelledError("stopped while parts were looked for in the rig");
  ToCatalog(search, &scene);
  RecognitionResult out = ToResult(context, scene, nullptr, log, true);
  out.counts["aspects_searched"] = static_cast<double>(search.objects.size());
  out.counts["aspect_views_searched"] = searched;
  out.counts["in_rig"] = out.objects.empty() ? 0.0 : 1.0;
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
