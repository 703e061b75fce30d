// Runs one scene through the stages and compares every stage with the ground truth.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "server/vision/features/features.h"
#include "tests/diagnose/ground_truth.h"
#include "tests/diagnose/scene_report.h"

namespace horopter {

struct CatalogSnapshot;

struct DiagnoseOptions {
  std::string split;
  bool features_only = false;
  FeatureOptions features;
  std::string overlay_folder;  // empty: no pictures
  int threads = 2;
};

// Errors: those of the readers and stages; INVALID_ARGUMENT when the scene has no ground truth.
absl::StatusOr<SceneReport> DiagnoseScene(const BopScene& scene,
                                          const TrueModels& models,
                                          const CatalogSnapshot& catalog,
                                          const DiagnoseOptions& options);

}  // namespace horopter
