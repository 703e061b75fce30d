// Accuracy of the answers of a run, where the sets have ground truth.
#pragma once

#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "client/load/load_items.h"
#include "client/load/load_report.h"

namespace horopter {

// Judges each different answer once.
class AccuracyJudge {
 public:
  explicit AccuracyJudge(const std::vector<LoadItem>& items) : items_(items) {}

  // answers[item][LoadReply::answer]. Nothing when no answered set has ground truth. Errors: those
  // of EvaluateBopResults.
  absl::StatusOr<std::optional<LoadAccuracy>> Judge(
      const LoadRun& run, const std::vector<std::vector<v1::RecognizeSceneResponse>>& answers);

 private:
  struct Scores {
    double targets = 0.0, ar = 0.0, recall_10px = 0.0, precision = 0.0;
    int estimates = 0, wrong = 0;
  };
  absl::StatusOr<Scores> ScoresOf(const LoadItem& item, const v1::RecognizeSceneResponse& answer);

  const std::vector<LoadItem>& items_;
  std::map<std::string, BopDataset> datasets_;
  std::map<std::pair<int, int>, Scores> scores_;  // by item and answer
};

}  // namespace horopter
