#include "server/vision/recognition/interpretation/aspect_route.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <opencv2/core/mat.hpp>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/aspects/object_ranking.h"
#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

constexpr int kLeading = 12;            // of a shortlist: these decide whether aspects come first
constexpr double kKnownLogSigma = 0.1;  // a focal length known better is not searched for

double AboveChance(const LinkedObject& o, double chance) {
  double sum = 0.0;
  for (std::size_t v = 0; v < o.views.size(); ++v) {
    if (o.shown[v]) sum += std::max(0.0, o.views[v].score - chance);
  }
  return sum;
}

std::vector<std::optional<AspectSceneView>> SceneViews(
    const std::vector<std::optional<CalibratedCamera>>& views) {
  std::vector<std::optional<AspectSceneView>> out;
  for (const auto& view : views) {
    out.emplace_back();
    if (view) {
      out.back() = AspectSceneView{
          view->camera, view->camera_from_scene, std::log(view->camera.focal_px), 0.35};
    }
  }
  return out;
}

// What one part alone must score, for the views it links and the cameras it says they have.
double EvenAlone(const LinkedScene& scene, const AspectAcceptance& options) {
  std::vector<double> logs;
  for (const auto& view : scene.views) {
    if (view) logs.push_back(std::log(view->camera.focal_px));
  }
  const double n = static_cast<double>(logs.size());
  if (logs.size() < 2) return options.even_in_one_view;
  const double mean = std::accumulate(logs.begin(), logs.end(), 0.0) / n;
  double squares = 0.0;
  for (const double l : logs) squares += (l - mean) * (l - mean);
  const double spread = std::sqrt(squares / n);
  const bool few = n < options.few_views_share * static_cast<double>(scene.views.size());
  return options.even_alone + (few ? options.few_views_more : 0.0) +
         options.focal_spread_more * std::max(0.0, spread - options.focal_spread_free);
}

double ObjectProbability(const LinkedObject& o,
                         const LinkedScene& scene,
                         const AspectAcceptance& options) {
  // Objects are best first. A second one of a part is what a view with a wrong camera makes of the
  // first: it must be as sure as one alone.
  const bool again = std::any_of(scene.objects.begin(), scene.objects.end(), [&](const auto& p) {
    return p.object == o.object && p.score > o.score;
  });
  const double alone = EvenAlone(scene, options);
  const double sure = options.sure_score + alone - options.even_alone;
  const bool beside = scene.registered() > 1 && !again && scene.objects.front().score >= sure &&
                      o.score < scene.objects.front().score;
  const double even = beside ? options.even_score : alone;
  return Logistic(options.score_weight * (o.score - even));
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
  for (std::size_t v = 0; v < o.views.size(); ++v)
    out.view_scores.push_back(o.shown[v] ? o.views[v].score : -1.0);
  return out;
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

RecognitionResult ToResult(const JointContext& context, const LinkedScene& scene, RefusalLog* log) {
  const AspectAcceptance& options = context.options.acceptance.aspects;
  const SceneAcceptance& of_scenes = context.options.acceptance.scene;
  RecognitionResult result;
  result.views.resize(scene.views.size());
  LinkedScene accepted = scene;
  NoteBelow(
      scene,
      AcceptanceTest::kChance,
      options.min_probability,
      [&](const LinkedObject& o) { return ObjectProbability(o, scene, options); },
      log);
  std::erase_if(accepted.objects, [&](const LinkedObject& o) {
    return ObjectProbability(o, scene, options) < options.min_probability;
  });
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
    SceneObject answer = ToAnswer(o, ObjectProbability(o, scene, options));
    if (o.runner_up_object >= 0 && o.runner_up > o.score - of_scenes.ambiguity_gap) {
      answer.alternatives.push_back(o.runner_up_object);
      result.state = RecognitionState::kAmbiguous;
    }
    result.objects.push_back(std::move(answer));
  }
  return result;
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
                                           std::span<const AspectImage> images) {
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
  ObjectRankingOptions rank;
  rank.objects = kShortlist;
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

std::vector<AspectImage> MakeAspectImages(std::span<const cv::Mat> images,
                                          bool drop_pattern,
                                          int threads) {
  std::vector<AspectImage> out(images.size());
  AspectImageOptions options;
  options.drop_pattern = drop_pattern;
  ParallelFor(static_cast<int>(images.size()), threads, [&](int i) {
    out[i] = MakeAspectImage(images[i], options);
  });
  return out;
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
    out.score += AboveChance(o, context.options.acceptance.aspects.chance_score);
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

absl::StatusOr<AspectAnswer> RecognizeByAspects(const JointContext& context,
                                                std::span<const AspectImage> images,
                                                const AspectSearch& search,
                                                RefusalLog* log,
                                                const AspectRecognitionOptions& options) {
  BeginStep(context, "aspect_search");
  std::vector<AspectViewPrior> priors;
  std::vector<std::vector<AspectHypothesis>> hypotheses;
  for (std::size_t v = 0; v < images.size(); ++v) {
    FindAspectOptions find = options.find;
    find.threads = find.votes.threads = context.options.threads;
    const PinholeCamera& start = context.start_cameras[v];
    const bool known = context.focal_log_sigma[v] < kKnownLogSigma;
    priors.push_back({start, context.focal_log_sigma[v]});
    if (!known) priors.back().camera.focal_px = NominalCamera(images[v]).focal_px;
    hypotheses.push_back(
        FindAspectHypotheses(
            images[v], *search.index, find, known ? &start : nullptr, context.give_up)
            .hypotheses);
    if (IsStopRequested(context.stop))
      return absl::CancelledError("stopped during the search for aspects");
  }
  BeginStep(context, "aspect_linking");
  AspectLinkOptions link = options.link;
  link.threads = context.options.threads;
  LinkedScene scene =
      LinkAspects({images, priors, hypotheses, search.index->parts}, link, context.give_up);
  if (IsStopRequested(context.stop))
    return absl::CancelledError("stopped while aspects were linked");
  for (LinkedObject& o : scene.objects) {
    o.object = search.objects[o.object];
    if (o.runner_up_object >= 0) o.runner_up_object = search.objects[o.runner_up_object];
  }
  AspectAnswer out;
  out.result = ToResult(context, scene, log);
  out.result.counts["aspects_searched"] = static_cast<double>(search.objects.size());
  for (std::size_t v = 0; log != nullptr && v < hypotheses.size(); ++v) {
    for (const AspectHypothesis& h : hypotheses[v]) {
      if (search.objects[h.object] != log->object) continue;
      log->hypotheses.push_back(
          {log->object, static_cast<int>(v), h.camera, h.camera_from_object, h.score});
    }
  }
  for (const LinkedObject& o : scene.objects)
    out.score += AboveChance(o, context.options.acceptance.aspects.chance_score);
  return out;
}

}  // namespace horopter
