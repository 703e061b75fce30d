#include "client/load/load_accuracy.h"

#include <cmath>
#include <set>

#include "client/bop_evaluate.h"
#include "client/bop_request.h"
#include "server/base/status_macros.h"

namespace horopter {

absl::StatusOr<AccuracyJudge::Scores> AccuracyJudge::ScoresOf(
    const LoadItem& item, const v1::RecognizeSceneResponse& answer) {
  if (!datasets_.contains(item.dataset)) {
    HOROPTER_ASSIGN_OR_RETURN(datasets_[item.dataset], ReadBopDataset(item.dataset));
  }
  BopResults results;
  AddAnswer(item.scene_id, item.im_ids, answer, -1.0, results);
  // All images of the scene are targets, also those that were not sent: the same of all runs.
  BopEvaluateOptions options;
  options.scenes = {item.scene_id};
  HOROPTER_ASSIGN_OR_RETURN(
      const BopEvaluation evaluation,
      EvaluateBopResults(datasets_[item.dataset], item.split, results, options));
  Scores scores;
  const auto number = [](double x) { return std::isfinite(x) ? x : 0.0; };
  scores.targets = evaluation.all.targets;
  scores.ar = number(evaluation.all.ar);
  scores.recall_10px = number(evaluation.all.recall_10px);
  scores.precision = number(evaluation.all.precision);
  scores.estimates = static_cast<int>(results.estimates.size());
  for (const auto& [id, scene] : evaluation.scenes) scores.wrong += scene.false_estimates;
  return scores;
}

absl::StatusOr<std::optional<LoadAccuracy>> AccuracyJudge::Judge(
    const LoadRun& run, const std::vector<std::vector<v1::RecognizeSceneResponse>>& answers) {
  LoadAccuracy accuracy;
  double targets = 0.0, estimates = 0.0;
  std::set<int> sets;
  for (const LoadSample& sample : run.samples) {
    const auto item = static_cast<size_t>(sample.item);
    if (sample.reply.answer < 0 || items_[item].dataset.empty()) continue;
    const std::pair<int, int> key(sample.item, sample.reply.answer);
    auto known = scores_.find(key);
    if (known == scores_.end()) {
      const auto& answer = answers[item][static_cast<size_t>(sample.reply.answer)];
      HOROPTER_ASSIGN_OR_RETURN(const Scores judged, ScoresOf(items_[item], answer));
      known = scores_.emplace(key, judged).first;
    }
    const Scores& s = known->second;
    sets.insert(sample.item);
    ++accuracy.answers;
    accuracy.wrong += s.wrong;
    accuracy.different += sample.reply.answer > 0 ? 1 : 0;
    accuracy.ar += s.targets * s.ar;
    accuracy.recall_10px += s.targets * s.recall_10px;
    accuracy.precision += s.estimates * s.precision;
    targets += s.targets;
    estimates += s.estimates;
  }
  if (accuracy.answers == 0) return std::nullopt;
  accuracy.sets = static_cast<int>(sets.size());
  if (targets > 0.0) accuracy.ar /= targets, accuracy.recall_10px /= targets;
  if (estimates > 0.0) accuracy.precision /= estimates;
  return accuracy;
}

}  // namespace horopter
