#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "client/answer_text.h"
#include "client/bop_dataset.h"
#include "client/bop_evaluate.h"
#include "client/bop_request.h"
#include "client/bop_results.h"
#include "client/commands.h"
#include "client/convert.h"
#include "client/interrupt.h"
#include "client/output.h"
#include "client/progress.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr char kNoTargets[] = "none";

std::string Summary(const v1::RecognizeSceneResponse& response) {
  std::string objects;
  for (const v1::RecognizedObject& o : response.objects()) {
    absl::StrAppend(
        &objects, " ", IdOfResource(o.object()), "(", std::round(o.score() * 100.0) / 100.0, ")");
  }
  const auto cameras = std::count_if(response.cameras().begin(),
                                     response.cameras().end(),
                                     [](const v1::Camera& c) { return c.recovered(); });
  return absl::StrCat(OutcomeText(response),
                      ", cameras ",
                      cameras,
                      "/",
                      response.cameras_size(),
                      ",",
                      objects.empty() ? " no objects" : objects);
}

// The sets of images to ask for, in order: those of a target file, else the scenes.
absl::StatusOr<std::vector<BopImageSet>> SetsOf(const DatasetRecognizeArguments& arguments) {
  std::vector<BopImageSet> sets;
  const std::string targets = arguments.targets.empty()
                                  ? MultiviewTargetsOf(arguments.dataset, arguments.split)
                                  : arguments.targets;
  if (!targets.empty() && targets != kNoTargets) {
    HOROPTER_ASSIGN_OR_RETURN(sets, ReadBopTargets(targets));
    Say("%zu sets of images by %s\n", sets.size(), targets.c_str());
  } else if (arguments.scenes.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<int> scenes,
                              ListBopScenes(arguments.dataset, arguments.split));
    for (const int id : scenes) sets.push_back({id, {}, {}});
  } else {
    for (const int id : arguments.scenes) sets.push_back({id, {}, {}});
  }
  std::erase_if(sets, [&](const BopImageSet& set) {
    const std::vector<int>& wanted = arguments.scenes;
    return !wanted.empty() && std::find(wanted.begin(), wanted.end(), set.scene_id) == wanted.end();
  });
  return sets;
}

nlohmann::json SceneJson(const BopScene& scene,
                         double seconds,
                         const absl::StatusOr<v1::RecognizeSceneResponse>& response) {
  nlohmann::json json = {{"scene", scene.scene_id}, {"tier", scene.tier}, {"seconds", seconds}};
  if (!response.ok()) {
    json["error"] = response.status().ToString();
    return json;
  }
  json["state"] = OutcomeText(*response);
  json["request_id"] = response->request_id();
  json["objects"] = nlohmann::json::array();
  for (const v1::RecognizedObject& o : response->objects()) {
    json["objects"].push_back({{"id", IdOfResource(o.object())}, {"score", o.score()}});
  }
  return json;
}

nlohmann::json ScoresToJson(const BopScores& s) {
  return {{"scenes", s.scenes},
          {"targets", s.targets},
          {"AR", s.ar},
          {"MSPD", s.ar_mspd},
          {"MSSD", s.ar_mssd},
          {"R10", s.recall_10px},
          {"own10", s.own_10px},
          {"precision", s.precision},
          {"rel_mm", s.rel_mm},
          {"rel_deg", s.rel_deg},
          {"f_err", s.focal_error},
          {"s_per_set", s.seconds_per_set}};
}

// The scene's own means, and the single values that intervals over scenes need.
nlohmann::json SceneScoresToJson(const BopSceneScores& s) {
  nlohmann::json json = ScoresToJson(s.scores);
  json.update({{"tier", s.tier},
               {"R@10", s.scores.recall_10px},
               {"false", s.false_estimates},
               {"estimates", nlohmann::json::array()},
               {"rel_mm_values", s.rel_mm},
               {"rel_deg_values", s.rel_deg},
               {"f_err_values", s.focal_error}});
  for (const BopScoredEstimate& e : s.estimates) {
    json["estimates"].push_back({{"image", e.im_id},
                                 {"object", e.obj_id},
                                 {"score", e.score},
                                 {"right", e.right},
                                 {"own_px", e.own_px}});
  }
  return json;
}

void PrintScores(const std::string& tier, const BopScores& s) {
  Say("%5s %6d %7d %6.3f %6.3f %6.3f %6.3f %6.3f %6.3f %7.2f %7.2f %6.3f %7.2f\n",
      tier.c_str(),
      s.scenes,
      s.targets,
      s.ar,
      s.ar_mspd,
      s.ar_mssd,
      s.recall_10px,
      s.own_10px,
      s.precision,
      s.rel_mm,
      s.rel_deg,
      s.focal_error,
      s.seconds_per_set);
}

}  // namespace

absl::Status DatasetRecognize(HoropterClient& client, const DatasetRecognizeArguments& arguments) {
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<BopImageSet> sets, SetsOf(arguments));
  BopResults results;
  // An output that cannot be written should fail before the work, not after it.
  HOROPTER_RETURN_IF_ERROR(WriteBopResults(results, arguments.out));
  absl::Status first_error;
  for (size_t k = 0; k < sets.size(); ++k) {
    HOROPTER_ASSIGN_OR_RETURN(const BopScene scene,
                              ReadBopScene(arguments.dataset,
                                           arguments.split,
                                           sets[k].scene_id,
                                           ReadForRecognition(arguments.hints, arguments.regions)));
    HOROPTER_RETURN_IF_ERROR(CheckSet(scene, sets[k]));
    const auto images = ImagesToSend(scene, arguments.max_images, sets[k]);
    HOROPTER_ASSIGN_OR_RETURN(v1::RecognizeSceneRequest request,
                              SceneRequestOf(images, arguments.hints));
    for (int i = 0; i < request.images_size(); ++i) {
      v1::SceneImage& image = *request.mutable_images(i);
      image.set_cropped(arguments.cropped);
      AddTrueRegions(
          arguments.regions, arguments.region_margin, *images[static_cast<size_t>(i)], &image);
    }
    const auto start = std::chrono::steady_clock::now();
    const auto response = client.RecognizeScene(request);
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    Say("[%zu/%zu] scene %d (%s), %zu images, %.1f s: %s\n",
        k + 1,
        sets.size(),
        scene.scene_id,
        scene.tier.c_str(),
        images.size(),
        seconds,
        response.ok() ? Summary(*response).c_str() : response.status().ToString().c_str());
    SayJson(SceneJson(scene, seconds, response));
    if (!response.ok()) {
      if (absl::IsUnavailable(response.status()) || Interrupted()) return response.status();
      if (first_error.ok()) first_error = response.status();
      continue;
    }
    AddAnswer(scene.scene_id, ReportedIds(images), *response, seconds, results);
    HOROPTER_RETURN_IF_ERROR(
        WriteBopResults(results, arguments.out));  // an interrupted run keeps its scenes
  }
  Say("%zu rows in %s\n", results.estimates.size(), arguments.out.c_str());
  SayJson({{"rows", results.estimates.size()}, {"out", arguments.out}});
  return first_error;
}

absl::Status DatasetEvaluate(const DatasetEvaluateArguments& arguments) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset dataset, ReadBopDataset(arguments.dataset));
  HOROPTER_ASSIGN_OR_RETURN(const BopResults results, ReadBopResults(arguments.results));
  BopEvaluateOptions options;
  options.scenes = {arguments.scenes.begin(), arguments.scenes.end()};
  options.min_visib = arguments.min_visib;
  HOROPTER_ASSIGN_OR_RETURN(const BopEvaluation evaluation,
                            EvaluateBopResults(dataset, arguments.split, results, options));
  if (JsonOutput()) {
    nlohmann::json json;
    for (const auto& [tier, scores] : evaluation.tiers) json["tiers"][tier] = ScoresToJson(scores);
    json["tiers"]["ALL"] = ScoresToJson(evaluation.all);
    for (const auto& [id, s] : evaluation.scenes) {
      json["scenes"][std::to_string(id)] = SceneScoresToJson(s);
    }
    std::printf("%s\n", json.dump(1).c_str());
    return absl::OkStatus();
  }
  Say("%5s %6s %7s %6s %6s %6s %6s %6s %6s %7s %7s %6s %7s\n",
      "tier",
      "scenes",
      "targets",
      "AR",
      "MSPD",
      "MSSD",
      "R@10",
      "own10",
      "prec",
      "rel-mm",
      "rel-deg",
      "f-err",
      "s/set");
  for (const auto& [tier, scores] : evaluation.tiers) PrintScores(tier, scores);
  PrintScores("ALL", evaluation.all);
  return absl::OkStatus();
}

}  // namespace horopter
