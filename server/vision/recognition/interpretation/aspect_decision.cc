#include "server/vision/recognition/interpretation/aspect_decision.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>
#include <vector>

#include "server/vision/recognition/aspects/quantile.h"
#include "server/vision/recognition/interpretation/decision_cues.h"
#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

constexpr double kNever = 2.0;  // above all scores

// Deviation of the views' log focal lengths.
double FocalSpread(const LinkedScene& scene) {
  std::vector<double> logs;
  for (const auto& view : scene.views) {
    if (view) logs.push_back(std::log(view->camera.focal_px));
  }
  const double n = static_cast<double>(logs.size());
  const double mean = std::accumulate(logs.begin(), logs.end(), 0.0) / n;
  double squares = 0.0;
  for (const double l : logs) squares += (l - mean) * (l - mean);
  return std::sqrt(squares / n);
}

// Different parts of a scene that score so much, those that lie on a plane with others `lying`.
int ObjectsThatScore(const LinkedScene& scene, double score, double lying) {
  std::set<int> models;
  for (const LinkedObject& o : scene.objects) {
    if (o.score >= (o.lies ? lying : score)) models.insert(o.object);
  }
  return static_cast<int>(models.size());
}

// The ground around the first part has texture, and not where its cameras say. Two parts may tile
// the image of a third; of three, and of two that lie on a plane, the first may stand on something.
bool GroundContradicts(const LinkedScene& scene, const AspectAcceptance& options) {
  const auto lying = std::count_if(
      scene.objects.begin(), scene.objects.end(), [](const LinkedObject& o) { return o.lies; });
  return scene.registered() > 1 && scene.agreement.texture >= options.telling_texture &&
         scene.agreement.ground < options.ground_disagrees && lying < 2 &&
         ObjectsThatScore(scene, options.company_score, options.company_score) <
             options.company_objects;
}

// Three views and more agree on the texture of the plane that the first part rests on, and on its
// surface: its cameras hold for what is around it.
bool GroundAgrees(const LinkedScene& scene, const AspectAcceptance& options) {
  return scene.registered() >= options.accompanied_views &&
         scene.agreement.ground >= options.ground_agrees &&
         !scene.agreement.Contradicts(options.surface_disagrees) &&
         !GroundContradicts(scene, options);
}

// Three views and more show the same print on the part.
bool PrintTells(const LinkedObject& o, const LinkedScene& scene, const AspectAcceptance& options) {
  std::vector<double> print;
  for (std::size_t v = 0; v < o.views.size(); ++v) {
    if (o.shown[v]) print.push_back(o.views[v].print);
  }
  if (static_cast<int>(print.size()) < options.accompanied_views ||
      scene.agreement.Contradicts(options.surface_disagrees))
    return false;
  return Median(&print) >= options.print_tells;
}

// What one part alone must score, for the views it links and the cameras it says they have.
double EvenAlone(const LinkedObject& o, const LinkedScene& scene, const AspectAcceptance& options) {
  double even = EvenInViews(scene.registered(), static_cast<int>(scene.views.size()), options);
  if (scene.registered() < 2) return even;
  const ViewAgreement& views = scene.agreement;
  if (GroundAgrees(scene, options)) return options.even_on_ground;
  if (PrintTells(o, scene, options)) return even - options.even_alone + options.even_on_ground;
  if (views.Contradicts(options.surface_disagrees) || GroundContradicts(scene, options))
    even += options.disagreement_more;
  return even +
         options.focal_spread_more * std::max(0.0, FocalSpread(scene) - options.focal_spread_free);
}

// It leans although others lie on a plane together.
bool LeansBeside(const LinkedObject& o, const LinkedScene& scene) {
  return o.leans && std::count_if(scene.objects.begin(),
                                  scene.objects.end(),
                                  [](const LinkedObject& other) { return other.lies; }) > 1;
}

enum class Agreement {
  kNone,
  kPair,     // another part scores nearly as much as the best one
  kLying,    // several lie on a plane together
  kCompany,  // several score less
};

// Other parts that agree with the best one on the cameras of enough views, which are much alike:
// cameras that adapted to a wrong part leave nothing for others.
Agreement AgreementOf(const LinkedScene& scene, const AspectAcceptance& options) {
  if (scene.registered() < options.accompanied_views ||
      FocalSpread(scene) > options.accompanied_focal_share * options.focal_spread_free)
    return Agreement::kNone;
  const double best = scene.objects.front().score;
  if (best >= options.accompanied_score && !GroundContradicts(scene, options) &&
      ObjectsThatScore(scene, options.companion_score, options.companion_lying) > 1)
    return Agreement::kPair;
  if (ObjectsThatScore(scene, kNever, options.company_lying) >= options.company_objects)
    return Agreement::kLying;
  if (ObjectsThatScore(scene, kNever, options.pair_lying) > 1 &&
      scene.agreement.surface.pairs > 0 && scene.agreement.surface.mean >= options.pair_surface)
    return Agreement::kLying;
  if (best >= options.company_best_score &&
      ObjectsThatScore(scene, options.company_score, options.company_score) >=
          options.company_objects)
    return Agreement::kCompany;
  return Agreement::kNone;
}

// By hand-set thresholds over the score.
double ByThresholds(const LinkedObject& o,
                    const LinkedScene& scene,
                    const AspectAcceptance& options) {
  // Objects are best first. A second one of a part is what a view with a wrong camera makes of the
  // first: it must be as sure as one alone, but where other parts leave no doubt of the cameras.
  const bool again = std::any_of(scene.objects.begin(), scene.objects.end(), [&](const auto& p) {
    return p.object == o.object && p.score > o.score;
  });
  const bool one_of_many =
      o.lies && ObjectsThatScore(scene, options.company_score, options.company_lying) >=
                    options.company_objects;
  const double alone = EvenAlone(o, scene, options);
  const double sure = GroundAgrees(scene, options)
                          ? options.even_on_ground
                          : options.sure_score + std::max(0.0, alone - options.even_alone);
  const bool beside = scene.registered() > 1 && scene.objects.front().score >= sure &&
                      o.score < scene.objects.front().score;
  const double least = LeansBeside(o, scene) ? options.even_leaning : 0.0;
  const auto probability = [&](double even) {
    return Logistic(options.score_weight * (o.score - std::max(even, least)));
  };
  const double by_itself = probability(alone);
  const bool seen_lying = o.lies && SurfaceTells(o, options);
  if (again && !one_of_many && !seen_lying) return by_itself;
  const Agreement agreement = AgreementOf(scene, options);
  const double shared = probability(EvenBeside(o, options));
  if (beside || agreement == Agreement::kPair) return shared;
  if (agreement == Agreement::kNone) return by_itself;
  const double in_company =
      agreement == Agreement::kLying ? shared : probability(options.company_even);
  return std::max(by_itself, std::min(options.company_probability, in_company));
}

}  // namespace

double EvenInViews(int registered, int views, const AspectAcceptance& options) {
  const double missing = 1.0 - registered / static_cast<double>(views);
  return (registered < 2 ? options.even_in_one_view : options.even_alone) +
         missing * options.missing_views_more;
}

bool SurfaceTells(const LinkedObject& o, const AspectAcceptance& options) {
  return o.surface_pairs >= options.surface_pairs && o.surface >= options.surface_tells;
}

double EvenBeside(const LinkedObject& o, const AspectAcceptance& options) {
  if (!o.lies) {
    const bool level =
        o.level && o.surface_pairs >= options.surface_pairs && o.surface >= options.surface_level;
    return level ? options.even_level : options.even_score;
  }
  return SurfaceTells(o, options) ? options.even_lying_surface : options.even_lying;
}

double ProbabilityUnderCameras(const LinkedObject& o, const LinkedScene& scene) {
  return Logistic(FittedLogOdds(CameraCuesOf(o, scene)));
}

double NeededProbability(const AspectAcceptance& options) {
  return options.decision == AspectAcceptance::Decision::kFitted ? options.min_fitted_probability
                                                                 : options.min_probability;
}

double AspectProbability(const LinkedObject& o,
                         const LinkedScene& scene,
                         const AspectAcceptance& options) {
  if (options.decision == AspectAcceptance::Decision::kThresholds)
    return ByThresholds(o, scene, options);
  const double fitted = Logistic(FittedLogOdds(CuesOf(o, scene)));
  // No scene that the fit has seen shows print.
  return PrintTells(o, scene, options) ? std::max(fitted, ByThresholds(o, scene, options)) : fitted;
}

}  // namespace horopter
