// What wrong hints do: every scene of a split is recognised with hints that are right, and wrong by
// steps, of all cameras.
//
//   hint_report DATASET SPLIT [--scenes 1,5] [--images N] [--kinds focal,whole] [--quick] [--test]
//
// Prints a line an answer: scene, hint, how far its objects are off (the true pose by the nearest
// of the object's symmetries, in the camera's frame), score, whether a finding says that the images
// contradict the hint, and the distance of the test. Last: answers with a score above 0.9 that are
// more than 10 mm or 5 degrees off and have no finding (there must be none), and right hints that
// were contradicted.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/pipeline/hint_check.h"
#include "server/pipeline/pipeline.h"

namespace horopter {
namespace {

constexpr double kMostM = 0.010, kMostDeg = 5.0, kSure = 0.9;

// What is said of the cameras, and how wrong it is.
struct Lie {
  std::string kind;       // focal: focal length; whole: also principal point and k1; none
  double factor = 1.0;    // of the focal length
  double shift_px = 0.0;  // of the principal point, along x
};

struct Arguments {
  std::string dataset, split;
  std::vector<int> scenes;
  size_t images = 0;
  std::vector<std::string> kinds = {"none", "focal", "whole"};
  bool quick = false, test = false;
};

Arguments Parse(int argc, char** argv) {
  Arguments a;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const auto list = [&] { return std::vector<std::string>(absl::StrSplit(argv[++i], ',')); };
    if (word == "--scenes" && i + 1 < argc) {
      for (const std::string& s : list()) a.scenes.push_back(std::atoi(s.c_str()));
    } else if (word == "--images" && i + 1 < argc) {
      a.images = std::strtoul(argv[++i], nullptr, 10);
    } else if (word == "--kinds" && i + 1 < argc) {
      a.kinds = list();
    } else if (word == "--quick") {
      a.quick = true;
    } else if (word == "--test") {
      a.test = true;
    } else if (a.dataset.empty()) {
      a.dataset = word;
    } else {
      a.split = word;
    }
  }
  return a;
}

std::vector<Lie> LiesOf(const Arguments& a) {
  std::vector<double> factors = {1.0, 1.02, 0.98, 1.05, 0.95, 1.2, 0.8, 2.0, 0.5};
  if (a.quick) factors = {1.0, 1.02, 0.95, 1.2, 0.5, 2.0};
  std::vector<Lie> lies;
  for (const std::string& kind : a.kinds) {
    if (kind == "none") {
      lies.push_back({kind});
      continue;
    }
    for (const double f : factors) lies.push_back({kind, f, 0.0});
    if (kind == "focal") continue;
    for (const double px : {10.0, 100.0}) lies.push_back({kind, 1.0, px});
  }
  return lies;
}

SceneRequest RequestOf(const BopScene& scene, const Lie& lie) {
  SceneRequest request;
  for (const BopImage& image : scene.images) {
    request.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
    CameraHint hint;
    if (lie.kind != "none") hint.focal_px = lie.factor * image.camera.focal_px;
    if (lie.kind == "whole") {
      hint.principal_point = Eigen::Vector2d(image.camera.cx + lie.shift_px, image.camera.cy);
      hint.k1 = image.distortion.empty() ? 0.0 : image.distortion[0];
    }
    if (lie.kind != "none") request.hints.push_back(hint);
  }
  return request;
}

struct Error {
  double metres = 1e9, degrees = 180.0;
};

// Of an answered object in the first camera that was recovered, to the nearest instance of it.
Error ErrorOf(const AnswerObject& object,
              const SceneAnswer& answer,
              const BopScene& scene,
              const ObjectModel& model) {
  Error best;
  for (size_t v = 0; v < answer.cameras.size(); ++v) {
    if (!answer.cameras[v]) continue;
    Error of_view;
    const Rigid3 found = answer.cameras[v]->camera_from_scene * object.scene_from_object;
    for (const BopInstance& instance : scene.images[v].instances) {
      if (BopObjectName(instance.obj_id) != object.object_id) continue;
      for (size_t s = 0; s <= model.symmetries.size(); ++s) {
        const Rigid3 truth = s == 0 ? instance.camera_from_object
                                    : instance.camera_from_object * model.symmetries[s - 1];
        const double metres = (found.t - truth.t).norm();
        const double degrees =
            Eigen::AngleAxisd(found.R * truth.R.transpose()).angle() * 180.0 / M_PI;
        if (metres + 0.01 * degrees < of_view.metres + 0.01 * of_view.degrees)
          of_view = {metres, degrees};
      }
    }
    // The worst view counts.
    if (best.metres > 1e8) best = of_view;
    best = {std::max(best.metres, of_view.metres), std::max(best.degrees, of_view.degrees)};
  }
  return best;
}

// One recognition, and every hint against it.
absl::Status ReportTest(const BopScene& scene, const CatalogSnapshot& catalog, const Arguments& a) {
  PipelineOptions options;
  options.euclidean.camera_evidence = true;
  options.euclidean.lens.estimate = false;
  const absl::StatusOr<PipelineResult> result =
      RecognizeScene(RequestOf(scene, {"none"}), catalog, options);
  if (!result.ok()) return result.status();
  std::printf("%5d %d objects", scene.scene_id, static_cast<int>(result->answer.objects.size()));
  if (result->trace.metric) {
    const CameraEvidence& evidence = result->trace.metric->evidence;
    for (const Lie& lie : LiesOf(a)) {
      if (lie.kind == "none") continue;
      const std::vector<CameraHint> hints = RequestOf(scene, lie).hints;
      const HintTest test = TestHints(hints, evidence);
      if (lie.kind == "focal" && lie.factor == 1.0) {
        if (const auto factor = CommonFocalFactor(hints, evidence))
          std::printf(" factor %+.4f +- %.4f |", factor->log, factor->sigma);
      }
      std::printf(" %s %.2f%+.0f: %.2f%s",
                  lie.kind.c_str(),
                  lie.factor,
                  lie.shift_px,
                  test.limit > 0.0 ? test.squared / test.limit : 0.0,
                  test.agrees ? "" : "!");
    }
  }
  std::printf("\n");
  std::fflush(stdout);
  return absl::OkStatus();
}

int Run(const Arguments& a) {
  const absl::StatusOr<BopDataset> dataset = ReadBopDataset(a.dataset);
  if (!dataset.ok()) return std::fprintf(stderr, "%s\n", dataset.status().ToString().c_str()), 1;
  CatalogSnapshot catalog;
  for (const BopObject& object : dataset->objects) {
    const bool mesh = object.cad_path.empty();
    CadImportOptions import;
    import.unit = std::string(mesh ? "mm" : "");
    absl::StatusOr<CadImport> cad = ImportCad(mesh ? object.mesh_path : object.cad_path, import);
    if (!cad.ok()) return std::fprintf(stderr, "%s\n", cad.status().ToString().c_str()), 1;
    cad->model.id = BopObjectName(object.obj_id);
    catalog.objects.push_back(PrepareCatalogObject(std::move(cad->model)).value());
  }
  const auto model_of = [&](const std::string& id) -> const ObjectModel& {
    return (*std::find_if(catalog.objects.begin(),
                          catalog.objects.end(),
                          [&](const auto& o) { return o->model.id == id; }))
        ->model;
  };
  std::vector<int> scenes = a.scenes;
  if (scenes.empty()) scenes = ListBopScenes(a.dataset, a.split).value();
  int wrong = 0, alarms = 0;
  std::printf("scene kind   factor shift object      score   mm      deg  found hints\n");
  for (const int id : scenes) {
    BopScene scene = ReadBopScene(a.dataset, a.split, id).value();
    if (a.images > 0 && scene.images.size() > a.images) scene.images.resize(a.images);
    if (a.test) {
      const absl::Status status = ReportTest(scene, catalog, a);
      if (!status.ok()) return std::fprintf(stderr, "%s\n", status.ToString().c_str()), 1;
      continue;
    }
    for (const Lie& lie : LiesOf(a)) {
      const auto result = RecognizeScene(RequestOf(scene, lie), catalog, {});
      if (!result.ok()) return std::fprintf(stderr, "%s\n", result.status().ToString().c_str()), 1;
      const SceneAnswer& answer = result->answer;
      const bool told = HasReason(answer, ReasonKind::kHintContradicted);
      std::string tests;
      for (const StageReport& stage : answer.stages) {
        if (stage.stage == "hints")
          absl::StrAppend(&tests, " ", stage.counts.at("squared"), "/", stage.counts.at("limit"));
      }
      alarms += told && lie.factor == 1.0 && lie.shift_px == 0.0;
      if (answer.objects.empty())
        std::printf("%5d %-6s %6.2f %5.0f none%s%s\n",
                    id,
                    lie.kind.c_str(),
                    lie.factor,
                    lie.shift_px,
                    told ? " contradicted" : "",
                    tests.c_str());
      for (const AnswerObject& object : answer.objects) {
        const Error error = ErrorOf(object, answer, scene, model_of(object.object_id));
        const bool bad =
            object.score > kSure && !told && (error.metres > kMostM || error.degrees > kMostDeg);
        wrong += bad;
        std::printf("%5d %-6s %6.2f %5.0f %s %6.3f %7.1f %6.1f %s%s%s\n",
                    id,
                    lie.kind.c_str(),
                    lie.factor,
                    lie.shift_px,
                    object.object_id.c_str(),
                    object.score,
                    1e3 * error.metres,
                    error.degrees,
                    told ? "contradicted" : "-",
                    tests.c_str(),
                    bad ? " WRONG" : "");
      }
      std::fflush(stdout);
    }
  }
  std::printf(
      "sure, wrong and without a finding: %d; right hints contradicted: %d\n", wrong, alarms);
  return wrong > 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  const horopter::Arguments arguments = horopter::Parse(argc, argv);
  if (arguments.split.empty()) {
    std::fprintf(stderr,
                 "hint_report DATASET SPLIT [--scenes 1,5] [--images N] [--kinds ..] [--quick]\n");
    return 2;
  }
  return horopter::Run(arguments);
}
