// Reports the cameras that matching and reconstruction give before any part is known, or those of
// another program, against the truth of a data set in BOP layout:
//   cameras_report [--given FILE | --texture-by WAY] [--json FILE] [--threads N] DATASET SPLIT
//   [SCENE...]
// --texture-by gives the cameras of the texture's tracks alone, by one of the two ways to
// reconstruct from them: "incremental" (Euclidean, the one that is used) or "projective" (then
// self-calibrated). cameras_report.py runs it over many sets, and COLMAP beside it.
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "server/base/status_macros.h"
#include "server/vision/matching/texture_matching.h"
#include "server/vision/reconstruction/self_calibration.h"
#include "server/vision/reconstruction/texture_route.h"
#include "server/vision/reconstruction/texture_tracks.h"
#include "tests/diagnose/reduced_images.h"
#include "tests/diagnose/relative_cameras.h"
#include "tests/diagnose/true_world.h"

namespace horopter {
namespace {

using Json = nlohmann::ordered_json;

struct Arguments {
  std::string dataset, split;
  std::vector<int> scenes;
  std::string given_file;  // empty: our own
  std::string texture_by;  // empty: as the pipeline does
  std::string json_file;
  int threads = 2;
};

// Cameras of a scene, whosever they are.
struct SceneCameras {
  std::vector<std::optional<EstimatedCamera>> views;
  double seconds = 0.0;  // of the processor, all threads
  bool trusted = true;
  std::string reason;  // why there are none, or none to trust
  std::vector<ViewMatches> matches;
};

double ProcessorSeconds() {
  rusage usage = {};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

void Take(const Reconstruction& found, SceneCameras* out) {
  for (const auto& view : found.views) {
    out->views.emplace_back();
    if (!view) continue;
    out->views.back() =
        EstimatedCamera{view->camera, view->camera_from_scene, view->focal_log_sigma};
  }
  out->trusted = found.trusted;
  out->matches = found.view_matches;
}

std::vector<ImageSize> SizesOf(const std::vector<cv::Mat>& images) {
  std::vector<ImageSize> sizes;
  for (const cv::Mat& image : images) sizes.push_back({image.cols, image.rows});
  return sizes;
}

// The projective way over the texture's tracks: grown, then self-calibrated, each view with its own
// focal length.
absl::StatusOr<SceneCameras> ProjectiveCameras(const TextureMatching& texture,
                                               std::span<const ImageSize> sizes) {
  const ReconstructionOptions options;
  SelfCalibrationOptions calibration = options.calibration;
  calibration.bundle.focal_prior_widths = options.focal_prior_widths;
  calibration.bundle.focal_prior_log_sigma = options.focal_prior_log_sigma;
  SceneCameras out;
  out.views.resize(sizes.size());
  if (texture.tracks.empty()) {
    out.trusted = false;
    out.reason = "no two views share texture";
    return out;
  }
  HOROPTER_ASSIGN_OR_RETURN(
      const TracksResult found,
      ReconstructTracks(TracksOfTexture(texture, sizes), {}, options.tracks, calibration));
  for (size_t v = 0; v < found.metric.scene.views.size(); ++v) {
    const auto& view = found.metric.scene.views[v];
    if (view)
      out.views[v] = EstimatedCamera{view->camera, view->camera_from_scene, view->focal_log_sigma};
  }
  out.trusted = found.metric.outcome == MetricOutcome::kMetric;
  out.reason = found.projective.outcome == ProjectiveOutcome::kReconstructed
                   ? found.metric.reason
                   : found.projective.reason;
  return out;
}

// Of the texture's tracks alone, by one of the two ways.
absl::StatusOr<SceneCameras> TextureCameras(const std::vector<cv::Mat>& images,
                                            const std::string& way,
                                            int threads) {
  const MatchingOptions options;
  const std::vector<ImageSize> sizes = SizesOf(images);
  const TextureMatching texture = MatchTexture(images, options.texture, options.views, threads);
  // What they share, matching, is not counted.
  const double begin = ProcessorSeconds();
  SceneCameras out;
  if (way == "projective") {
    HOROPTER_ASSIGN_OR_RETURN(out, ProjectiveCameras(texture, sizes));
  } else {
    HOROPTER_ASSIGN_OR_RETURN(
        const Reconstruction found,
        ReconstructFromTexture(texture, sizes, {}, ReconstructionOptions().texture));
    Take(found, &out);
    out.reason = found.refusal;
  }
  out.seconds = ProcessorSeconds() - begin;
  return out;
}

// The stages as the pipeline calls them, without a word about the cameras: from texture, and where
// that does not tell from corners and edges.
absl::StatusOr<SceneCameras> OwnCameras(const std::vector<cv::Mat>& images, int threads) {
  SceneCameras out;
  MatchingOptions options;
  options.threads = threads;
  const double begin = ProcessorSeconds();
  const std::vector<ImageSize> sizes = SizesOf(images);
  const TextureMatching texture =
      MatchTexture(images, options.texture, options.views, options.threads);
  HOROPTER_ASSIGN_OR_RETURN(
      const Reconstruction from_texture,
      ReconstructFromTexture(texture, sizes, {}, ReconstructionOptions().texture));
  if (from_texture.trusted) {
    out.seconds = ProcessorSeconds() - begin;
    Take(from_texture, &out);
    return out;
  }
  std::vector<ImageFeatures> features;
  for (const cv::Mat& image : images) {
    HOROPTER_ASSIGN_OR_RETURN(ImageFeatures one, DetectFeatures(image, FeatureOptions()));
    features.push_back(std::move(one));
  }
  HOROPTER_ASSIGN_OR_RETURN(const MatchingResult matching, MatchViews(images, features, options));
  HOROPTER_ASSIGN_OR_RETURN(
      const Reconstruction found,
      ReconstructViews(matching, features, sizes, {}, ReconstructionOptions()));
  out.seconds = ProcessorSeconds() - begin;
  Take(found, &out);
  out.reason = "texture: " + from_texture.refusal;
  if (!found.refusal.empty()) out.reason += "; features: " + found.refusal;
  return out;
}

// {"scenes": {"1": {"seconds": s, "reason": text, "images": {"000000.png": {"focal_px", "cx", "cy",
// "k1", "R" (9, row-major), "t" (3)}}}}}; image files by their names, camera_from_world.
absl::StatusOr<SceneCameras> GivenCameras(const Json& file, const BopScene& scene) {
  SceneCameras out;
  out.views.resize(scene.images.size());
  try {
    const std::string id = std::to_string(scene.scene_id);
    if (!file.at("scenes").contains(id)) {
      return absl::NotFoundError("no cameras are given of scene " + id);
    }
    const Json& given = file["scenes"][id];
    out.seconds = given.at("seconds").get<double>();
    out.reason = given.value("reason", "");
    for (size_t v = 0; v < scene.images.size(); ++v) {
      const std::string& path = scene.images[v].path;
      const std::string name = path.substr(path.rfind('/') + 1);
      if (!given.at("images").contains(name)) continue;
      const Json& image = given["images"][name];
      EstimatedCamera camera;
      camera.camera = scene.images[v].camera;  // its size
      camera.camera.focal_px = image.at("focal_px").get<double>();
      camera.camera.cx = image.at("cx").get<double>();
      camera.camera.cy = image.at("cy").get<double>();
      camera.camera.k1 = image.at("k1").get<double>();
      for (int k = 0; k < 9; ++k) camera.camera_from_world.R(k / 3, k % 3) = image.at("R").at(k);
      for (int k = 0; k < 3; ++k) camera.camera_from_world.t[k] = image.at("t").at(k);
      out.views[v] = camera;
    }
  } catch (const Json::exception& e) {
    return absl::InvalidArgumentError(std::string("cameras that are given: ") + e.what());
  }
  return out;
}

Json Figure(const std::optional<double>& value) {
  return value ? Json(*value) : Json(nullptr);
}

Json Row(const BopScene& scene, const TrueWorld& world, const SceneCameras& cameras) {
  const CameraErrors errors = CompareRelative(cameras.views, world.scene);
  Json row = {{"scene", scene.scene_id},
              {"tier", scene.tier},
              {"images", scene.images.size()},
              {"images_with_truth", PosedImages(world.scene)},
              {"truth_px", Figure(world.rms_px)},
              {"registered", errors.registered},
              {"trusted", cameras.trusted},
              {"rotation_deg", Figure(errors.MedianRotation())},
              {"rotation_max_deg", Figure(errors.WorstRotation())},
              {"baseline_deg", Figure(errors.MedianBaseline())},
              {"focal_error", Figure(errors.MedianFocal())},
              {"focal_error_max", Figure(errors.WorstFocal())},
              {"focal_sigmas", errors.focal_in_sigmas},
              {"seconds", cameras.seconds},
              {"reason", cameras.reason}};
  row["views"] = Json::array();
  for (const ViewMatches& view : cameras.matches) {
    const char* const source[] = {"none", "texture", "features"};
    row["views"].push_back({{"source", source[static_cast<int>(view.source)]},
                            {"matches", view.matches},
                            {"rms_px", view.rms_px}});
  }
  return row;
}

std::string Text(const Json& value, double scale, const char* form) {
  if (value.is_null()) return "-";
  char text[32];
  std::snprintf(text, sizeof text, form, scale * value.get<double>());
  return text;
}

void Print(const Json& row) {
  std::printf("%4d %-4s %d of %d%s  f %s %% (max %s)  rotation %s deg (max %s)  %.2f s  %s\n",
              row["scene"].get<int>(),
              row["tier"].get<std::string>().c_str(),
              row["registered"].get<int>(),
              row["images"].get<int>(),
              row["trusted"].get<bool>() ? " trusted" : "",
              Text(row["focal_error"], 100.0, "%.1f").c_str(),
              Text(row["focal_error_max"], 100.0, "%.1f").c_str(),
              Text(row["rotation_deg"], 1.0, "%.2f").c_str(),
              Text(row["rotation_max_deg"], 1.0, "%.2f").c_str(),
              row["seconds"].get<double>(),
              row["reason"].get<std::string>().c_str());
  std::fflush(stdout);
}

// Ours see images as the pipeline makes them; others have seen the files.
absl::StatusOr<Json> ReportScene(const Arguments& arguments,
                                 const TrueModels& models,
                                 const Json& given,
                                 int id) {
  HOROPTER_ASSIGN_OR_RETURN(const BopScene scene,
                            ReadBopScene(arguments.dataset, arguments.split, id));
  if (!given.is_null()) {
    HOROPTER_ASSIGN_OR_RETURN(const SceneCameras cameras, GivenCameras(given, scene));
    return Row(scene, CompleteTruth(scene, models), cameras);
  }
  HOROPTER_ASSIGN_OR_RETURN(const ReducedScene reduced, ReadReduced(scene));
  HOROPTER_ASSIGN_OR_RETURN(
      const SceneCameras cameras,
      arguments.texture_by.empty()
          ? OwnCameras(reduced.images, arguments.threads)
          : TextureCameras(reduced.images, arguments.texture_by, arguments.threads));
  return Row(scene, CompleteTruth(reduced.scene, models), cameras);
}

absl::Status Report(Arguments arguments) {
  HOROPTER_ASSIGN_OR_RETURN(const BopDataset dataset, ReadBopDataset(arguments.dataset));
  HOROPTER_ASSIGN_OR_RETURN(const TrueModels models, ReadTrueModels(dataset));
  if (arguments.scenes.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(arguments.scenes, ListBopScenes(arguments.dataset, arguments.split));
  }
  Json given;
  if (!arguments.given_file.empty()) {
    std::ifstream file(arguments.given_file);
    given = Json::parse(file, nullptr, false);
    if (!file || given.is_discarded()) {
      return absl::InvalidArgumentError(arguments.given_file + ": not JSON");
    }
  }
  Json rows = Json::array();
  for (const int id : arguments.scenes) {
    HOROPTER_ASSIGN_OR_RETURN(Json row, ReportScene(arguments, models, given, id));
    Print(row);
    rows.push_back(std::move(row));
  }
  if (arguments.json_file.empty()) return absl::OkStatus();
  std::ofstream file(arguments.json_file);
  file << Json({{"scenes", rows}}).dump(1) << "\n";
  if (!file.flush()) return absl::UnavailableError("cannot write " + arguments.json_file);
  return absl::OkStatus();
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  CLI::App app("Cameras before any part is known, against the truth of a data set.");
  horopter::Arguments arguments;
  app.add_option("DATASET", arguments.dataset, "Folder in BOP layout")->required();
  app.add_option("SPLIT", arguments.split, "Split, e.g. val")->required();
  app.add_option("SCENES", arguments.scenes, "Only these");
  CLI::Option* const given =
      app.add_option("--given", arguments.given_file, "Cameras of another program instead of ours");
  app.add_option("--texture-by", arguments.texture_by, "Of the texture's tracks alone, by this way")
      ->check(CLI::IsMember({"incremental", "projective"}))
      ->excludes(given);
  app.add_option("--json", arguments.json_file, "Also write the report here");
  app.add_option("--threads", arguments.threads, "Per scene")->check(CLI::PositiveNumber);
  CLI11_PARSE(app, argc, argv);
  cv::setNumThreads(1);  // the stages run their own threads
  const absl::Status status = horopter::Report(arguments);
  if (status.ok()) return 0;
  std::cerr << "cameras_report: " << std::string(status.message()) << "\n";
  return 1;
}
