#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <optional>

#include "absl/strings/str_cat.h"
#include "client/bop_dataset.h"
#include "client/bop_evaluate.h"
#include "client/bop_results.h"
#include "client/commands.h"
#include "client/convert.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

// 12 for "objects/obj_000012"; nothing for an object that is not of a dataset.
std::optional<int> BopIdOf(const std::string& resource) {
  const std::string id = IdOfResource(resource);
  constexpr char kPrefix[] = "obj_";
  const std::string digits = id.rfind(kPrefix, 0) == 0 ? id.substr(sizeof(kPrefix) - 1) : "";
  if (digits.empty() || digits.size() > 9 ||
      digits.find_first_not_of("0123456789") != std::string::npos) {
    return std::nullopt;
  }
  return std::stoi(digits);
}

// The images of a scene that are sent; `most` > 0 takes that many, spread evenly.
std::vector<const BopImage*> ImagesToSend(const BopScene& scene, int most) {
  std::vector<const BopImage*> images;
  for (const BopImage& image : scene.images) {
    if (!image.path.empty()) images.push_back(&image);
  }
  const size_t n = images.size(), keep = static_cast<size_t>(std::max(0, most));
  if (keep == 0 || keep >= n) return images;
  std::vector<const BopImage*> kept;
  for (size_t i = 0; i < keep; ++i) {
    kept.push_back(images[keep == 1 ? 0 : i * (n - 1) / (keep - 1)]);
  }
  return kept;
}

void AddAnswer(const BopScene& scene,
               const std::vector<const BopImage*>& images,
               const v1::RecognizeSceneResponse& response,
               double seconds,
               BopResults& results) {
  for (size_t i = 0; i < images.size(); ++i) {
    const int index = static_cast<int>(i);
    if (index < response.cameras_size() && response.cameras(index).recovered()) {
      const v1::Camera& camera = response.cameras(index);
      Eigen::Matrix3d K;
      K << camera.focal_px(), 0, camera.principal_point_x_px(), 0, camera.focal_px(),
          camera.principal_point_y_px(), 0, 0, 1;
      results.cameras[scene.scene_id][images[i]->im_id] = K;
    }
    for (const v1::RecognizedObject& object : response.objects()) {
      const std::optional<int> obj_id = BopIdOf(object.object());
      if (!obj_id || index >= object.images_size() ||
          !object.images(index).has_camera_from_object()) {
        continue;
      }
      results.estimates.push_back({scene.scene_id,
                                   images[i]->im_id,
                                   *obj_id,
                                   object.score(),
                                   FromProto(object.images(index).camera_from_object()),
                                   seconds});
    }
  }
}

std::string Summary(const v1::RecognizeSceneResponse& response) {
  std::string objects;
  for (const v1::RecognizedObject& o : response.objects()) {
    absl::StrAppend(
        &objects, " ", IdOfResource(o.object()), "(", std::round(o.score() * 100.0) / 100.0, ")");
  }
  const auto cameras = std::count_if(response.cameras().begin(),
                                     response.cameras().end(),
                                     [](const v1::Camera& c) { return c.recovered(); });
  return absl::StrCat(v1::SceneState_Name(response.state()).substr(12),
                      ", cameras ",
                      cameras,
                      "/",
                      response.cameras_size(),
                      ",",
                      objects.empty() ? " no objects" : objects);
}

nlohmann::json ToJson(const BopScores& s) {
  return {{"scenes", s.scenes},
          {"targets", s.targets},
          {"AR", s.ar},
          {"MSPD", s.ar_mspd},
          {"MSSD", s.ar_mssd},
          {"R10", s.recall_10px},
          {"precision", s.precision},
          {"rel_mm", s.rel_mm},
          {"rel_deg", s.rel_deg},
          {"f_err", s.focal_error},
          {"s_per_set", s.seconds_per_set}};
}

void PrintScores(const std::string& tier, const BopScores& s) {
  std::printf("%5s %6d %7d %6.3f %6.3f %6.3f %6.3f %6.3f %7.2f %7.2f %6.3f %7.2f\n",
              tier.c_str(),
              s.scenes,
              s.targets,
              s.ar,
              s.ar_mspd,
              s.ar_mssd,
              s.recall_10px,
              s.precision,
              s.rel_mm,
              s.rel_deg,
              s.focal_error,
              s.seconds_per_set);
}

}  // namespace

absl::Status DatasetRecognize(HoropterClient& client, const DatasetRecognizeArguments& arguments) {
  std::vector<int> scenes = arguments.scenes;
  if (scenes.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(scenes, ListBopScenes(arguments.dataset, arguments.split));
  }
  BopResults results;
  // An output that cannot be written should fail before the work, not after it.
  HOROPTER_RETURN_IF_ERROR(WriteBopResults(results, arguments.out));
  absl::Status first_error;
  for (size_t k = 0; k < scenes.size(); ++k) {
    HOROPTER_ASSIGN_OR_RETURN(const BopScene scene,
                              ReadBopScene(arguments.dataset, arguments.split, scenes[k]));
    const auto images = ImagesToSend(scene, arguments.max_images);
    v1::RecognizeSceneRequest request;
    for (const BopImage* image : images) {
      HOROPTER_ASSIGN_OR_RETURN(*request.add_images()->mutable_content(),
                                ReadFileBytes(image->path));
    }
    const auto start = std::chrono::steady_clock::now();
    const auto response = client.RecognizeScene(request);
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    std::printf("[%zu/%zu] scene %d (%s), %zu images, %.1f s: %s\n",
                k + 1,
                scenes.size(),
                scene.scene_id,
                scene.tier.c_str(),
                images.size(),
                seconds,
                response.ok() ? Summary(*response).c_str() : response.status().ToString().c_str());
    std::fflush(stdout);
    if (!response.ok()) {
      if (absl::IsUnavailable(response.status())) return response.status();
      if (first_error.ok()) first_error = response.status();
      continue;
    }
    AddAnswer(scene, images, *response, seconds, results);
    HOROPTER_RETURN_IF_ERROR(
        WriteBopResults(results, arguments.out));  // an interrupted run keeps its scenes
  }
  std::printf("%zu rows in %s\n", results.estimates.size(), arguments.out.c_str());
  return first_error;
}

absl::Status DatasetEvaluate(const DatasetEvaluateArguments& arguments) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset dataset, ReadBopDataset(arguments.dataset));
  HOROPTER_ASSIGN_OR_RETURN(const BopResults results, ReadBopResults(arguments.results));
  BopEvaluateOptions options;
  options.scenes = {arguments.scenes.begin(), arguments.scenes.end()};
  HOROPTER_ASSIGN_OR_RETURN(const BopEvaluation evaluation,
                            EvaluateBopResults(dataset, arguments.split, results, options));
  if (arguments.json) {
    nlohmann::json json;
    for (const auto& [tier, scores] : evaluation.tiers) json["tiers"][tier] = ToJson(scores);
    json["tiers"]["ALL"] = ToJson(evaluation.all);
    for (const auto& [id, s] : evaluation.scenes) {
      json["scenes"][std::to_string(id)] = {
          {"tier", s.tier}, {"AR", s.ar}, {"R@10", s.recall_10px}, {"false", s.false_estimates}};
    }
    std::printf("%s\n", json.dump(1).c_str());
    return absl::OkStatus();
  }
  std::printf("%5s %6s %7s %6s %6s %6s %6s %6s %7s %7s %6s %7s\n",
              "tier",
              "scenes",
              "targets",
              "AR",
              "MSPD",
              "MSSD",
              "R@10",
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
