// Is what the euclidean stage states true?
//   euclidean_report DATASET SPLIT     whole pipeline, against ground truth
//   euclidean_report --synthetic N     N scenes of synthetic parts; degenerate sets; flips
#include <Eigen/Geometry>
#include <cstring>
#include <iostream>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgcodecs.hpp>

#include "server/pipeline/pipeline.h"
#include "server/vision/euclidean/representative.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "tests/bench/pose_coverage.h"
#include "tests/support/synthetic_metric_scene.h"
#include "tests/support/synthetic_part.h"

namespace horopter {
namespace {

int ReportDataset(const std::string& folder, const std::string& split) {
  const auto dataset = ReadBopDataset(folder);
  const auto ids = ListBopScenes(folder, split);
  if (!dataset.ok() || !ids.ok()) {
    std::cerr << (dataset.ok() ? ids.status() : dataset.status()) << "\n";
    return 1;
  }
  const auto models = ReadTrueModels(*dataset);
  if (!models.ok()) {
    std::cerr << models.status() << "\n";
    return 1;
  }
  CatalogSnapshot catalog;
  std::vector<int> obj_ids;
  for (const auto& [id, model] : *models) {
    auto prepared = PrepareCatalogObject(model);
    if (!prepared.ok()) {
      std::cerr << prepared.status() << "\n";
      return 1;
    }
    catalog.objects.push_back(*std::move(prepared));
    obj_ids.push_back(id);
  }
  CoverageReport report;
  for (const int id : *ids) {
    const auto scene = ReadBopScene(folder, split, id);
    if (!scene.ok()) {
      std::cerr << scene.status() << "\n";
      return 1;
    }
    SceneRequest request;
    for (const BopImage& image : scene->images) request.images.push_back(cv::imread(image.path));
    const auto result = RecognizeScene(request, catalog, {});
    if (!result.ok() || !result->trace.metric) {
      std::cout << "scene " << id << ": " << (result.ok() ? "no answer" : "failed") << "\n";
      continue;
    }
    const MetricScene& metric = *result->trace.metric;
    std::vector<const ObjectModel*> of_answer;
    std::vector<int> ids_of_answer;
    for (const PosedObject& o : metric.objects) {
      of_answer.push_back(&catalog.objects[o.object]->model);
      ids_of_answer.push_back(obj_ids[o.object]);
    }
    CheckScene(metric, of_answer, ids_of_answer, *scene, &report);
    CheckSceneGrasps(metric, of_answer, ids_of_answer, *scene, {}, &report);
    for (const AnswerFinding& f : result->answer.findings) {
      std::cout << "scene " << id << ": " << f.object_id << " " << f.detail << "\n";
    }
  }
  PrintCoverage(report, std::cout);
  return 0;
}

using Part = std::shared_ptr<const PreparedObject>;

// Truth of a synthetic scene against the statements, over `scenes` seeds.
void CountSynthetic(int scenes) {
  const std::vector<Part> parts = {
      PrepareObject(LBracket()).value(),
      PrepareObject(Wedge()).value(),
      PrepareObject(Prism("profile", {{0, 0}, {0.06, 0}, {0.05, 0.03}, {0.01, 0.045}}, 0.03))
          .value(),
      PrepareObject(Prism("step", {{0, 0}, {0.05, 0}, {0.05, 0.04}, {0.02, 0.055}}, 0.06)).value()};
  CoverageReport report;
  int flagged = 0, refused = 0;
  for (int i = 0; i < scenes; ++i) {
    MetricSceneOptions options;
    options.seed = static_cast<unsigned>(i + 1);
    options.parts.assign(parts.begin(), parts.begin() + 1 + i % 4);
    options.views = 3 + i % 4;
    options.table = i % 3 != 0 || options.parts.size() < 2;
    options.end_sigma_px = 0.1 + 0.1 * (i % 5);
    const MetricSceneTruth truth = MakeMetricScene(options);
    const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
    if (!metric.ok()) {
      ++refused;
      continue;
    }
    for (const Finding& f : metric->findings) {
      if (f.kind == FindingKind::kTurnUndetermined || f.kind == FindingKind::kShiftUndetermined ||
          f.kind == FindingKind::kScaleConflict || f.kind == FindingKind::kObjectRejected) {
        ++flagged;
        break;
      }
    }
    TransformGraph graph;
    const SceneFrames frames = AddSceneFrames(*metric, &graph);
    const auto add =
        [&](int a, int b, const Rigid3& truth_a_from_b, std::size_t k, std::vector<PoseCheck>* to) {
          PoseCheck check =
              CheckPose(*graph.Between(a, b), truth_a_from_b, truth.objects[k]->center);
          check.tier = std::to_string(truth.objects.size());
          to->push_back(check);
        };
    for (std::size_t k = 0; k < metric->objects.size(); ++k) {
      for (std::size_t v = 0; v < truth.cameras.size(); ++v) {
        add(frames.cameras[v],
            frames.objects[k],
            truth.camera_from_world[v] * truth.world_from_object[k],
            k,
            &report.cameras);
      }
      if (k == 0) continue;
      add(frames.objects[0],
          frames.objects[k],
          truth.world_from_object[0].Inverse() * truth.world_from_object[k],
          k,
          &report.reference);
    }
    for (std::size_t v = 0; v < truth.cameras.size(); ++v) {
      report.focal.push_back(
          {std::to_string(truth.objects.size()),
           i,
           static_cast<int>(v),
           std::log(metric->cameras[v]->camera.focal_px / truth.cameras[v].focal_px),
           metric->cameras[v]->focal_log_sigma});
    }
    report.objects += static_cast<int>(metric->objects.size());
  }
  std::cout << scenes << " synthetic scenes (tier: objects in it), " << refused << " refused, "
            << flagged << " with a false alarm\n";
  PrintCoverage(report, std::cout);
}

bool Has(const MetricScene& metric, FindingKind kind) {
  for (const Finding& f : metric.findings) {
    if (f.kind == kind) return true;
  }
  return false;
}

// Whether an image shows a vertex of the first part.
bool ShowsAVertex(const MetricSceneTruth& truth) {
  for (std::size_t v = 0; v < truth.cameras.size(); ++v) {
    const PinholeCamera& camera = truth.cameras[v];
    for (const Eigen::Vector3d& x : truth.objects[0]->model.vertices) {
      const Eigen::Vector3d p = truth.camera_from_world[v] * (truth.world_from_object[0] * x);
      const Eigen::Vector2d u = Project(camera, p);
      if (p.z() > 0.0 && u.x() > 0.0 && u.y() > 0.0 && u.x() < camera.width &&
          u.y() < camera.height) {
        return true;
      }
    }
  }
  return false;
}

// How many of `repeats` scenes of one degenerate kind are named as such, and how many like them
// that are not degenerate (aim 0).
void CountDegenerate(int repeats) {
  struct Case {
    const char* name;
    MetricSceneOptions options;
    FindingKind expected;
    bool no_vertex = false;  // scenes that show one are passed over
  };
  std::vector<Case> cases(4);
  cases[0] = {"surface of revolution", {}, FindingKind::kTurnUndetermined};
  cases[0].options.parts = {PrepareObject(LBracket()).value(),
                            PrepareObject(Cylinder(0.02, 0.05)).value()};
  cases[1] = {"bar that no image ends", {}, FindingKind::kShiftUndetermined};
  cases[1].options.parts = {
      PrepareObject(Prism("bar", {{-1, -0.015}, {1, -0.015}, {1, 0.015}, {-1, 0.015}}, 0.02))
          .value()};
  cases[1].options.start_turn_rad = 0.0005;
  cases[1].no_vertex = true;
  cases[2] = {"small part, narrow view", {}, FindingKind::kFocalAndDepth};
  cases[2].options.parts = {PrepareObject(Scaled(LBracket(), 0.5)).value()};
  cases[2].options.min_focal_widths = 4.0;
  cases[2].options.max_focal_widths = 5.0;
  cases[2].options.distance_m = 2.0;
  cases[2].options.table = false;
  cases[3] = {"bar with both ends in view", {}, FindingKind::kShiftUndetermined};
  cases[3].options.parts = {
      PrepareObject(
          Prism("bar", {{-0.1, -0.015}, {0.1, -0.015}, {0.1, 0.015}, {-0.1, 0.015}}, 0.02))
          .value()};
  for (Case& c : cases) {
    int flagged = 0, refused = 0;
    c.options.seed = 1000;
    for (int i = 0; i < repeats; ++c.options.seed) {
      const MetricSceneTruth truth = MakeMetricScene(c.options);
      if (c.no_vertex && ShowsAVertex(truth)) continue;
      ++i;
      const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
      if (!metric.ok()) {
        ++refused;
        continue;
      }
      flagged += Has(*metric, c.expected);
    }
    std::cout << c.name << ": named in " << flagged << " of " << repeats << ", refused " << refused
              << "\n";
  }
}

// Noisy repeats of one scene with a symmetric part, recognised in any of its representatives.
void CountFlips(int scenes, int repeats) {
  ObjectModel square = Prism("square", {{0, 0}, {0.05, 0}, {0.05, 0.05}, {0, 0.05}}, 0.03);
  for (int i = 1; i < 4; ++i) {
    const Eigen::Matrix3d R = RotationFromVector({0, 0, 0.5 * M_PI * i});
    const Eigen::Vector3d c(0.025, 0.025, 0.0);
    square.symmetries.push_back({R, c - R * c});
  }
  MetricSceneOptions options;
  options.parts = {PrepareObject(LBracket()).value(), PrepareObject(square).value()};
  options.views = 3;
  int flips = 0, done = 0;
  for (int s = 0; s < scenes; ++s) {
    std::optional<Eigen::Matrix3d> first;
    options.seed = static_cast<unsigned>(500 + s);
    const MetricSceneTruth base = MakeMetricScene(options);
    for (int i = 0; i < repeats; ++i) {
      MetricSceneTruth truth = base;
      std::mt19937 rng(static_cast<unsigned>(s * repeats + i));
      std::normal_distribution<double> noise(0.0, 0.3), turn(0.0, 0.003);
      for (ImageFeatures& f : truth.features) {
        for (Segment& segment : f.segments) {
          segment.start += Eigen::Vector2d(noise(rng), noise(rng));
          segment.end += Eigen::Vector2d(noise(rng), noise(rng));
        }
      }
      Rigid3& pose = truth.recognition.objects[1].scene_from_object;
      if (const int k = i % 4; k > 0) pose = pose * square.symmetries[k - 1];
      pose.R = RotationFromVector({turn(rng), turn(rng), turn(rng)}) * pose.R;
      const auto metric = RefineMetricScene(truth.Input(), truth.recognition, {});
      if (!metric.ok()) continue;
      ++done;
      const Eigen::Matrix3d R = metric->objects[1].scene_from_object.R;
      if (!first) first = R;
      flips += Eigen::AngleAxisd(first->transpose() * R).angle() > 0.5;
    }
  }
  std::cout << "representative flips: " << flips << " in " << done << " noisy repeats of " << scenes
            << " scenes\n";
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  cv::setNumThreads(1);
  if (argc == 3 && std::strcmp(argv[1], "--synthetic") == 0) {
    const int scenes = std::atoi(argv[2]);
    horopter::CountSynthetic(scenes);
    horopter::CountDegenerate(std::max(1, scenes / 10));
    horopter::CountFlips(10, std::max(1, scenes / 10));
    return 0;
  }
  if (argc != 3) {
    std::cerr << "euclidean_report DATASET SPLIT | --synthetic N\n";
    return 2;
  }
  return horopter::ReportDataset(argv[1], argv[2]);
}
