// What recognition answers with all parts of a scene enrolled, and what with none of them: found,
// wrong, how far the scores can be believed, and what each answered object rests on. The stages
// before recognition run once a scene.
//
//   recognition_report DATASET SPLIT [--scenes 1,2] [--trials all,none,one,half]
//                      [--distractors PATH] [--keep FILE.db] [--csv FILE]
//                      [--routes table,views,metric,projective,aspects] [--steps]
//     --trials   all: every part enrolled; none: none of the scene's; one: each of the scene's left
//                out in turn; half: three random halves of `none`
//     --routes   that may find a scene's first part; default: all of them
//     --distractors PATH   objects of another dataset (synthetic_parts), or of a catalog file that
//                --keep wrote, stand in every catalog
//     --keep     writes the distractors into a new catalog file: preparing 1,000 takes minutes
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <iostream>
#include <limits>
#include <numeric>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <set>

#include "absl/strings/str_format.h"
#include "client/bop_dataset.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/recognition/invariant_matching/key_index.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "tests/bench/enrolled.h"
#include "tests/diagnose/ground_truth.h"
#include "tests/diagnose/object_report.h"

namespace horopter {
namespace {

constexpr double kRightPx = 10.0;  // MSPD at 640 px image width, median over the views
constexpr int kHalves = 3;
constexpr double kPartVisible = 0.1;  // a target is seen to this in two views at least

struct Arguments {
  std::string dataset, split, distractors, keep, csv;
  std::vector<int> scenes;
  std::set<std::string> trials = {"all", "none"};
  std::set<std::string> routes = {"table", "views", "metric", "projective", "aspects"};
  bool steps = false, accept_all = false;
};

// The stages before recognition.
struct FrontEnd {
  std::vector<cv::Mat> images;
  std::vector<ImageFeatures> features;
  MatchingResult matching;
  Reconstruction reconstruction;
};

absl::StatusOr<FrontEnd> RunFrontEnd(const BopScene& scene) {
  FrontEnd front;
  std::vector<ImageSize> sizes;
  for (const BopImage& image : scene.images) {
    front.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
    if (front.images.back().empty()) {
      return absl::InvalidArgumentError(image.path + ": not an image");
    }
    auto features = DetectFeatures(front.images.back(), {});
    if (!features.ok()) {
      return features.status();
    }
    front.features.push_back(*std::move(features));
    sizes.push_back({front.images.back().cols, front.images.back().rows});
  }
  MatchingOptions options;
  options.threads = 2;
  auto matching = MatchViews(front.images, front.features, options, {});
  if (!matching.ok()) {
    return matching.status();
  }
  front.matching = *std::move(matching);
  auto reconstruction = ReconstructViews(front.matching, front.features, sizes, {}, {}, {});
  if (!reconstruction.ok()) {
    return reconstruction.status();
  }
  front.reconstruction = *std::move(reconstruction);
  return front;
}

struct Sums {
  int scenes = 0, targets = 0, found = 0, answered = 0, wrong = 0;
  std::vector<double> cpu_seconds;
  std::vector<std::pair<double, bool>>
      stated;  // score of each answered object, whether it is right
};

// CPU seconds of all threads by step.
struct StepTimes {
  void Begin(std::string_view step) {
    const std::clock_t now = std::clock();
    if (!current.empty()) seconds[current] += static_cast<double>(now - since) / CLOCKS_PER_SEC;
    current = std::string(step);
    since = now;
  }
  std::map<std::string, double> seconds;
  std::string current;
  std::clock_t since = 0;
};

struct Bench {
  const BopScene* scene = nullptr;
  const TrueModels* models = nullptr;
  const FrontEnd* front = nullptr;
  const KeyIndexSnapshot* keys = nullptr;
  RecognitionOptions options;
  bool steps = false;
  std::ostream* csv = nullptr;
};

// Median error of an answered object against an instance, over the registered views that see it;
// infinite where the ids differ.
double ErrorPx(const Bench& bench,
               const RecognitionResult& result,
               const SceneObject& answered,
               const std::string& id,
               int instance) {
  std::vector<double> errors;
  for (size_t v = 0; v < bench.scene->images.size(); ++v) {
    const BopImage& image = bench.scene->images[v];
    const BopInstance& truth = image.instances[instance];
    if (BopObjectName(truth.obj_id) != id) {
      return std::numeric_limits<double>::infinity();
    }
    if (truth.visib_fract < kPartVisible || !result.views[v]) {
      continue;
    }
    errors.push_back(
        ProjectionError(bench.models->at(truth.obj_id),
                        result.views[v]->camera,
                        result.views[v]->camera_from_scene * answered.scene_from_object,
                        image,
                        truth.camera_from_object));
  }
  if (errors.empty()) {
    return std::numeric_limits<double>::infinity();
  }
  std::nth_element(errors.begin(), errors.begin() + errors.size() / 2, errors.end());
  return errors[errors.size() / 2];
}

bool IsTarget(const BopScene& scene, int instance) {
  int seen = 0;
  for (const BopImage& image : scene.images) {
    seen += image.instances[instance].visib_fract >= kPartVisible ? 1 : 0;
  }
  return seen >= 2;
}

void RunTrial(const Bench& bench, const std::string& trial, const Enrolled& catalog, Sums* sums) {
  const auto& objects = catalog.objects;
  const FrontEnd& front = *bench.front;
  RecognitionInput input;
  input.images = front.images;
  input.features = front.features;
  input.matching = &front.matching;
  input.reconstruction = &front.reconstruction;
  input.objects = objects;
  input.keys = bench.keys;
  input.slots = catalog.slots;
  const std::clock_t start = std::clock();
  StepTimes steps;
  const auto result =
      RecognizeObjects(input, bench.options, {}, [&](std::string_view step) { steps.Begin(step); });
  steps.Begin("");
  sums->cpu_seconds.push_back(static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC);
  ++sums->scenes;
  if (!result.ok()) {
    std::cerr << result.status() << "\n";
    return;
  }
  const int instances = static_cast<int>(bench.scene->images[0].instances.size());
  std::set<int> served;
  JointContext context;
  context.objects = objects;
  for (const ImageFeatures& f : front.features) {
    context.views.push_back(BuildViewEvidence(f, 2));
  }
  for (const SceneObject& answered : result->objects) {
    const std::string id = objects[answered.object]->model.id;
    double best = std::numeric_limits<double>::infinity();
    int best_instance = -1;
    for (int i = 0; i < instances; ++i) {
      const double error = ErrorPx(bench, *result, answered, id, i);
      if (served.count(i) == 0 && error < best) {
        best = error;
        best_instance = i;
      }
    }
    const bool right = best < kRightPx;
    if (right) {
      served.insert(best_instance);
      sums->found += IsTarget(*bench.scene, best_instance) ? 1 : 0;
    }
    ++sums->answered;
    sums->wrong += right ? 0 : 1;
    PlacedObject placed;
    placed.object = answered.object;
    placed.scene_from_object = answered.scene_from_object;
    VerifyScratch scratch;
    EvaluatePlacement(context, result->views, {}, &scratch, &placed);
    double worst = 1.0;
    int seen = 0;
    for (double s : answered.view_scores) {
      if (s >= 0) {
        worst = std::min(worst, s);
        ++seen;
      }
    }
    const EdgeSupport& t = placed.total;
    const std::string line = absl::StrFormat(
        "%d,%s,%s,%d,%s,%d,%.1f,%.3f,%.3f,%d,%d,%d,%.0f,%.3f,%.3f,%.0f,%d,%d,%d,%.3f,%.3f",
        bench.scene->scene_id,
        bench.scene->tier,
        trial,
        static_cast<int>(objects.size()),
        id,
        right ? 1 : 0,
        std::min(best, 9999.0),
        answered.support,
        worst,
        seen,
        result->registered(),
        static_cast<int>(result->views.size()),
        t.supported,
        t.Precision(),
        t.RecallInside(),
        placed.description_gain,
        static_cast<int>(result->objects.size()),
        front.reconstruction.trusted ? 1 : 0,
        static_cast<int>(answered.alternatives.size()),
        t.Sharpness(),
        answered.score);
    sums->stated.emplace_back(answered.score, right);
    if (bench.csv != nullptr) {
      *bench.csv << line << "\n";
    }
    if (!right) {
      std::cout << "wrong: " << line << "\n";
    }
  }
  for (int i = 0; i < instances; ++i) {
    const int obj_id = bench.scene->images[0].instances[i].obj_id;
    const bool enrolled = std::any_of(objects.begin(), objects.end(), [&](const auto& o) {
      return o->model.id == BopObjectName(obj_id);
    });
    if (!enrolled || !IsTarget(*bench.scene, i)) {
      continue;
    }
    ++sums->targets;
    if (served.count(i) == 0) {
      std::cout << "missed: " << bench.scene->scene_id << " " << BopObjectName(obj_id) << "\n";
    }
  }
  if (bench.steps) {
    for (const auto& [step, seconds] : steps.seconds) {
      std::cout << absl::StrFormat("  %s %.2f", step, seconds);
    }
    std::cout << std::endl;
  }
  if (trial == "all" || !result->objects.empty()) {
    std::cout << bench.scene->scene_id << " " << trial << ": " << result->objects.size()
              << " objects, state " << static_cast<int>(result->state) << ", route "
              << static_cast<int>(result->route) << ", " << sums->cpu_seconds.back() << " s CPU "
              << result->detail << std::endl;
  }
}

void Print(const std::string& name, const Sums& sums) {
  if (sums.scenes == 0) {
    return;
  }
  std::vector<double> cpu = sums.cpu_seconds;
  std::sort(cpu.begin(), cpu.end());
  std::cout << absl::StrFormat("%s: %d scenes, found %d of %d, answered %d, wrong %d, CPU %.2f s\n",
                               name,
                               sums.scenes,
                               sums.found,
                               sums.targets,
                               sums.answered,
                               sums.wrong,
                               cpu[cpu.size() / 2]);
}

// Reliability diagram: of the objects answered with scores of a bin, what they state in the mean
// and the share that is right; the gap is weighted by their number.
void PrintReliability(const std::map<std::string, Sums>& sums) {
  constexpr double kEnds[] = {0.0, 0.5, 0.7, 0.9, 0.97, 1.0};
  double gap = 0.0;
  int all = 0;
  for (std::size_t b = 0; b + 1 < std::size(kEnds); ++b) {
    int n = 0, right = 0;
    double stated = 0.0;
    for (const auto& [name, of_trial] : sums) {
      for (const auto& [score, is_right] : of_trial.stated) {
        if (score < kEnds[b] || (score >= kEnds[b + 1] && b + 2 < std::size(kEnds))) continue;
        ++n;
        right += is_right ? 1 : 0;
        stated += score;
      }
    }
    if (n == 0) continue;
    std::cout << absl::StrFormat("score %.2f - %.2f: %d objects, stated %.3f, right %.3f\n",
                                 kEnds[b],
                                 kEnds[b + 1],
                                 n,
                                 stated / n,
                                 static_cast<double>(right) / n);
    gap += std::abs(stated - right);
    all += n;
  }
  if (all > 0)
    std::cout << absl::StrFormat("mean gap of stated and right: %.3f of %d\n", gap / all, all);
}

RecognitionOptions OptionsOf(const Arguments& arguments) {
  RecognitionOptions options;
  options.threads = 2;
  options.routes.supporting_plane = arguments.routes.count("table") > 0;
  options.routes.aspects = arguments.routes.count("aspects") > 0;
  options.routes.view_led = arguments.routes.count("views") > 0;
  options.routes.metric = arguments.routes.count("metric") > 0;
  options.routes.projective = arguments.routes.count("projective") > 0;
  if (arguments.accept_all) options.acceptance.scene.min_probability = 0.0;
  return options;
}

absl::Status Run(const Arguments& arguments) {
  TrueModels models;
  Enrolled all;
  absl::Status status = AddPrepared(arguments.dataset, &all, &models);
  const size_t own = all.objects.size();
  if (status.ok() && !arguments.distractors.empty()) {
    status = arguments.distractors.ends_with(".db")
                 ? AddKept(arguments.distractors, &all)
                 : AddPrepared(arguments.distractors, &all, nullptr);
  }
  if (status.ok() && !arguments.keep.empty()) {
    status = Keep(all, own, arguments.keep);
  }
  if (!status.ok()) {
    return status;
  }
  std::vector<const ObjectKeys*> keys;
  for (const auto& o : all.objects) {
    keys.push_back(&o->keys);
  }
  auto index = KeyIndex::Build(keys, 0, 2);
  if (!index.ok()) {
    return index.status();
  }
  const KeyIndexSnapshot snapshot = index->Snapshot();
  std::vector<int> ids = arguments.scenes;
  if (ids.empty()) {
    auto listed = ListBopScenes(arguments.dataset, arguments.split);
    if (!listed.ok()) {
      return listed.status();
    }
    ids = *listed;
  }
  std::ofstream csv;
  if (!arguments.csv.empty()) {
    csv.open(arguments.csv);
    csv << "scene,tier,trial,objects,id,right,error_px,support,worst_view,seen,registered,views,"
           "supported,precision,recall_inside,gain,answered,trusted,alternatives,sharpness,score\n";
  }
  std::map<std::string, Sums> sums;  // by trial and tier
  for (int id : ids) {
    auto scene = ReadBopScene(arguments.dataset, arguments.split, id);
    if (!scene.ok()) {
      return scene.status();
    }
    auto front = RunFrontEnd(*scene);
    if (!front.ok()) {
      return front.status();
    }
    const Bench bench{&*scene,
                      &models,
                      &*front,
                      &snapshot,
                      OptionsOf(arguments),
                      arguments.steps,
                      csv.is_open() ? &csv : nullptr};
    std::set<std::string> present;
    for (const BopInstance& i : scene->images[0].instances) {
      present.insert(BopObjectName(i.obj_id));
    }
    const auto without = [&](const std::set<std::string>& left_out) {
      Enrolled rest;
      for (size_t i = 0; i < all.objects.size(); ++i) {
        if (left_out.count(all.objects[i]->model.id) == 0) {
          rest.Add(all, i);
        }
      }
      return rest;
    };
    const Enrolled none = without(present);
    const auto wanted = [&](const char* trial) { return arguments.trials.count(trial) > 0; };
    if (wanted("all")) {
      RunTrial(bench, "all", all, &sums["all " + scene->tier]);
    }
    if (wanted("none")) {
      RunTrial(bench, "none", none, &sums["none " + scene->tier]);
    }
    for (const std::string& left_out : wanted("one") ? present : std::set<std::string>{}) {
      RunTrial(bench, "one", without({left_out}), &sums["one " + scene->tier]);
    }
    std::mt19937 rng(id);
    for (int i = 0; i < (wanted("half") ? kHalves : 0); ++i) {
      std::vector<size_t> order(none.objects.size());
      std::iota(order.begin(), order.end(), 0);
      std::shuffle(order.begin(), order.end(), rng);
      Enrolled half;
      for (size_t k = 0; k < order.size() / 2; ++k) {
        half.Add(none, order[k]);
      }
      RunTrial(bench, "half", half, &sums["half " + scene->tier]);
    }
  }
  for (const auto& [name, sum] : sums) {
    Print(name, sum);
  }
  PrintReliability(sums);
  return absl::OkStatus();
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  CLI::App app("Recognition with all parts of a scene enrolled, and with none of them.");
  horopter::Arguments arguments;
  app.add_option("DATASET", arguments.dataset, "Folder in BOP layout")->required();
  app.add_option("SPLIT", arguments.split, "Split, e.g. val")->required();
  app.add_option("--scenes", arguments.scenes, "Only these, e.g. 1,2")->delimiter(',');
  app.add_option("--distractors", arguments.distractors, "Dataset whose objects are enrolled too");
  app.add_option("--keep", arguments.keep, "Catalog file that is made of the distractors");
  app.add_option("--csv", arguments.csv, "One line per answered object");
  app.add_option("--trials", arguments.trials, "Of all, none, one, half; default all,none")
      ->delimiter(',')
      ->check(CLI::IsMember({"all", "none", "one", "half"}));
  app.add_option(
         "--routes", arguments.routes, "Of table, views, metric, projective, aspects; default all")
      ->delimiter(',')
      ->check(CLI::IsMember({"table", "views", "metric", "projective", "aspects"}));
  app.add_flag("--accept-all",
               arguments.accept_all,
               "Answer whatever the scene's probability, for fit_decision.py");
  app.add_flag("--steps", arguments.steps, "CPU seconds of each step");
  CLI11_PARSE(app, argc, argv);
  cv::setNumThreads(1);
  const absl::Status status = horopter::Run(arguments);
  if (!status.ok()) {
    std::cerr << "recognition_report: " << status.message() << "\n";
    return 1;
  }
  return 0;
}
