#include "server/vision/recognition/interpretation/aspect_decision.h"

#include <algorithm>
#include <vector>

#include "server/vision/recognition/aspects/quantile.h"
#include "server/vision/recognition/interpretation/decision_cues.h"
#include "server/vision/recognition/interpretation/log_odds.h"

namespace horopter {
namespace {

// Three views and more show the same print on the part.
bool PrintTells(const LinkedObject& o, const LinkedScene& scene, const AspectAcceptance& options) {
  std::vector<double> print;
  for (std::size_t v = 0; v < o.views.size(); ++v) {
    if (o.shown[v]) print.push_back(o.views[v].print);
  }
  if (static_cast<int>(print.size()) < options.print_views ||
      scene.agreement.Contradicts(options.surface_disagrees))
    return false;
  return Median(&print) >= options.print_tells;
}

// What one image of several shows and none of the others bears out: a picture of a part on a page
// looks so, as the other images see the page from aside. How likely that is, chosen.
constexpr double kPictureShare = 0.9;
bool IsOneOfSeveral(const LinkedScene& scene) {
  constexpr std::size_t kSeveral = 3;
  return scene.registered() == 1 && scene.views.size() >= kSeveral;
}

double ProbabilityOfScene(const LinkedObject& o,
                          const LinkedScene& scene,
                          const AspectAcceptance& options) {
  const double fitted = Logistic(FittedLogOdds(CuesOf(o, scene)));
  if (!PrintTells(o, scene, options)) return fitted;
  // No scene that the fit has seen shows print.
  const double missing = 1.0 - scene.registered() / static_cast<double>(scene.views.size());
  const double even = options.even_printed + missing * options.missing_views_more;
  return std::max(fitted, Logistic(options.score_weight * (o.score - even)));
}

}  // namespace

double ProbabilityUnderCameras(const LinkedObject& o, const LinkedScene& scene) {
  return Logistic(FittedLogOdds(CameraCuesOf(o, scene)));
}

double AspectProbability(const LinkedObject& o,
                         const LinkedScene& scene,
                         const AspectAcceptance& options) {
  const double probability = ProbabilityOfScene(o, scene, options);
  return IsOneOfSeveral(scene) ? WithUnknownShare(probability, kPictureShare) : probability;
}

}  // namespace horopter
