// horopter-diagnose DATASET SPLIT: how much of what is needed survives each stage, against ground
// truth.
#include <CLI/CLI.hpp>
#include <fstream>
#include <iostream>
#include <opencv2/core/utility.hpp>

#include "client/bop_dataset.h"
#include "server/pipeline/pipeline.h"
#include "tests/diagnose/diagnose_scene.h"

namespace horopter {
namespace {

struct Arguments {
  std::string dataset;
  std::string json_file;
  std::vector<int> scenes;
  DiagnoseOptions options;
};

int Fail(const absl::Status& status) {
  std::cerr << "horopter-diagnose: " << std::string(status.message()) << "\n";
  return 1;
}

int Run(const Arguments& arguments) {
  const absl::StatusOr<BopDataset> dataset = ReadBopDataset(arguments.dataset);
  if (!dataset.ok()) {
    return Fail(dataset.status());
  }
  std::vector<int> ids = arguments.scenes;
  if (ids.empty()) {
    const absl::StatusOr<std::vector<int>> listed =
        ListBopScenes(arguments.dataset, arguments.options.split);
    if (!listed.ok()) {
      return Fail(listed.status());
    }
    ids = *listed;
  }
  const absl::StatusOr<TrueModels> models = ReadTrueModels(*dataset);
  if (!models.ok()) {
    return Fail(models.status());
  }
  CatalogSnapshot catalog;
  for (const auto& [obj_id, model] : *models) {  // ascending obj_id: ordered by catalog id
    if (arguments.options.features_only) {
      break;
    }
    auto prepared = PrepareCatalogObject(model);
    if (!prepared.ok()) {
      return Fail(prepared.status());
    }
    catalog.objects.push_back(*std::move(prepared));
  }
  std::vector<SceneReport> reports;
  for (int id : ids) {
    const absl::StatusOr<BopScene> scene =
        ReadBopScene(arguments.dataset, arguments.options.split, id);
    if (!scene.ok()) {
      return Fail(scene.status());
    }
    absl::StatusOr<SceneReport> report = DiagnoseScene(*scene, *models, catalog, arguments.options);
    if (!report.ok()) {
      return Fail(report.status());
    }
    std::cerr << "scene " << id << ": " << report->figures["seconds"] << " s\n";
    reports.push_back(*std::move(report));
  }
  PrintTable(reports, std::cout);
  if (!arguments.json_file.empty()) {
    std::ofstream file(arguments.json_file);
    file << ToJson(reports);
    if (!file.flush()) {
      return Fail(absl::UnavailableError("cannot write " + arguments.json_file));
    }
  }
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  CLI::App app("Says per scene what survives each stage, and which stage lost each missed object.");
  horopter::Arguments arguments;
  app.add_option("DATASET", arguments.dataset, "Folder in BOP layout")->required();
  app.add_option("SPLIT", arguments.options.split, "Split, e.g. val")->required();
  app.add_option("--scenes", arguments.scenes, "Only these, e.g. 1,2")->delimiter(',');
  app.add_option("--json", arguments.json_file, "Also write the report here");
  app.add_option("--overlay",
                 arguments.options.overlay_folder,
                 "Write pictures and the feature graph per view here");
  app.add_option("--threads", arguments.options.threads, "Per scene")->check(CLI::PositiveNumber);
  app.add_flag("--features-only", arguments.options.features_only, "Stop after the first stage");
  bool every_channel = false;
  app.add_flag("--every-channel",
               every_channel,
               "Features from a field per colour channel, weak edges kept: slower, finds more");
  CLI11_PARSE(app, argc, argv);
  if (every_channel) {
    arguments.options.features = horopter::CompleteFeatures();
  }
  cv::setNumThreads(1);  // the stages run their own threads; times are comparable
  return horopter::Run(arguments);
}
