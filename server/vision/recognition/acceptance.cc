#include "server/vision/recognition/acceptance.h"

#include <cmath>
#include <initializer_list>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

enum class Range { kShare, kPositive, kNotNegative };

struct Field {
  const char* name;
  double value;
  Range range;
};

bool IsIn(Range range, double x) {
  if (!std::isfinite(x)) return false;
  switch (range) {
    case Range::kShare:
      return x >= 0.0 && x <= 1.0;
    case Range::kPositive:
      return x > 0.0;
    case Range::kNotNegative:
      return x >= 0.0;
  }
  return false;
}

absl::Status CheckFields(const char* group, std::initializer_list<Field> fields) {
  for (const Field& f : fields) {
    if (!IsIn(f.range, f.value))
      return absl::InvalidArgumentError(
          absl::StrCat("acceptance.", group, ".", f.name, ": ", f.value, " is out of range"));
  }
  return absl::OkStatus();
}

absl::Status Check(const PlacementAcceptance& o) {
  return CheckFields("placements",
                     {{"min_score", o.min_score, Range::kShare},
                      {"off_plane_score", o.off_plane_score, Range::kShare},
                      {"plane_tolerance_m", o.plane_tolerance_m, Range::kPositive},
                      {"max_shared_volume", o.max_shared_volume, Range::kShare},
                      {"max_shared_edges", o.max_shared_edges, Range::kShare},
                      {"floating_log_odds", o.floating_log_odds, Range::kNotNegative},
                      {"hidden_score", o.hidden_score, Range::kShare},
                      {"hidden_sharpness", o.hidden_sharpness, Range::kShare},
                      {"hidden_slack", o.hidden_slack, Range::kShare},
                      {"sure_scene", o.sure_scene, Range::kShare},
                      {"upright_cos", o.upright_cos, Range::kShare},
                      {"same_plane_m", o.same_plane_m, Range::kPositive},
                      {"priority_score", o.priority_score, Range::kShare},
                      {"behind_factor", o.behind_factor, Range::kPositive}});
}

absl::Status Check(const SceneAcceptance& o) {
  return CheckFields("scene",
                     {{"min_probability", o.min_probability, Range::kShare},
                      {"min_object_probability", o.min_object_probability, Range::kShare},
                      {"max_focal_deviations", o.max_focal_deviations, Range::kPositive},
                      {"min_parallax_rad", o.min_parallax_rad, Range::kNotNegative},
                      {"ambiguity_gap", o.ambiguity_gap, Range::kShare},
                      {"loose_ambiguity_gap", o.loose_ambiguity_gap, Range::kShare},
                      {"min_segments", static_cast<double>(o.min_segments), Range::kPositive}});
}

absl::Status Check(const AlternativeAcceptance& o) {
  return CheckFields("alternatives",
                     {{"misfit_diameters", o.misfit_diameters, Range::kPositive},
                      {"min_shared_volume", o.min_shared_volume, Range::kShare},
                      {"max_score_deficit", o.max_score_deficit, Range::kShare},
                      {"most_per_object", static_cast<double>(o.most_per_object), Range::kPositive},
                      {"max_harm", o.max_harm, Range::kShare},
                      {"texture_weight", o.texture_weight, Range::kNotNegative},
                      {"clear_texture", o.clear_texture, Range::kNotNegative},
                      {"clear_lead", o.clear_lead, Range::kShare},
                      {"sharpness_weight", o.sharpness_weight, Range::kNotNegative}});
}

absl::Status Check(const AspectAcceptance& o) {
  return CheckFields(
      "aspects",
      {{"confirming_score", o.confirming_score, Range::kShare},
       {"contradicting_score", o.contradicting_score, Range::kShare},
       {"chance_score", o.chance_score, Range::kShare},
       {"score_weight", o.score_weight, Range::kPositive},
       {"even_lying", o.even_lying, Range::kShare},
       {"even_score", o.even_score, Range::kShare},
       {"even_alone", o.even_alone, Range::kShare},
       {"even_in_one_view", o.even_in_one_view, Range::kShare},
       {"sure_score", o.sure_score, Range::kShare},
       {"accompanied_score", o.accompanied_score, Range::kShare},
       {"companion_score", o.companion_score, Range::kShare},
       {"companion_lying", o.companion_lying, Range::kShare},
       {"company_parts", static_cast<double>(o.company_parts), Range::kPositive},
       {"company_lying", o.company_lying, Range::kShare},
       {"company_score", o.company_score, Range::kShare},
       {"company_even", o.company_even, Range::kShare},
       {"company_best_score", o.company_best_score, Range::kShare},
       {"company_probability", o.company_probability, Range::kShare},
       {"ground_agrees", o.ground_agrees, Range::kShare},
       {"even_on_ground", o.even_on_ground, Range::kShare},
       {"surface_disagrees", o.surface_disagrees, Range::kShare},
       {"disagreement_more", o.disagreement_more, Range::kShare},
       {"telling_texture", o.telling_texture, Range::kNotNegative},
       {"ground_disagrees", o.ground_disagrees, Range::kShare},
       {"missing_views_more", o.missing_views_more, Range::kShare},
       {"focal_spread_free", o.focal_spread_free, Range::kNotNegative},
       {"focal_spread_more", o.focal_spread_more, Range::kNotNegative},
       {"min_probability", o.min_probability, Range::kShare},
       {"sure_probability", o.sure_probability, Range::kShare},
       {"other_precision", o.other_precision, Range::kShare},
       {"accompanied_focal_share", o.accompanied_focal_share, Range::kNotNegative},
       {"accompanied_views", static_cast<double>(o.accompanied_views), Range::kPositive},
       {"same_place_share", o.same_place_share, Range::kShare},
       {"apart_share", o.apart_share, Range::kShare}});
}

absl::Status Check(const PoseChoiceAcceptance& o) {
  return CheckFields("pose_choices",
                     {{"min_probability", o.min_probability, Range::kShare},
                      {"found_contour", o.found_contour, Range::kShare},
                      {"found_crease", o.found_crease, Range::kShare},
                      {"independent_px", o.independent_px, Range::kPositive},
                      {"most_log_odds", o.most_log_odds, Range::kPositive},
                      {"turned_log_odds", o.turned_log_odds, Range::kNotNegative},
                      {"ambiguous_share", o.ambiguous_share, Range::kShare}});
}

absl::Status Check(const MisfitAcceptance& o) {
  return CheckFields("misfits",
                     {{"least_px", o.least_px, Range::kPositive},
                      {"factor", o.factor, Range::kPositive},
                      {"aspect_scatter", o.aspect_scatter, Range::kPositive},
                      {"found_px", o.found_px, Range::kPositive},
                      {"least_found", o.least_found, Range::kNotNegative},
                      {"min_samples", static_cast<double>(o.min_samples), Range::kPositive}});
}

}  // namespace

absl::Status Validate(const AcceptanceOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Check(options.placements));
  HOROPTER_RETURN_IF_ERROR(Check(options.scene));
  HOROPTER_RETURN_IF_ERROR(Check(options.alternatives));
  HOROPTER_RETURN_IF_ERROR(Check(options.aspects));
  HOROPTER_RETURN_IF_ERROR(Check(options.pose_choices));
  return Check(options.misfits);
}

}  // namespace horopter
