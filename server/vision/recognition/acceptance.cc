#include "server/vision/recognition/acceptance.h"

#include "server/base/status_macros.h"
#include "server/vision/recognition/field_ranges.h"

namespace horopter {
namespace {

absl::Status CheckAcceptance(const PlacementAcceptance& o) {
  return CheckFields("acceptance.placements",
                     {{"min_score", o.min_score, FieldRange::kShare},
                      {"off_plane_score", o.off_plane_score, FieldRange::kShare},
                      {"plane_tolerance_m", o.plane_tolerance_m, FieldRange::kPositive},
                      {"max_shared_volume", o.max_shared_volume, FieldRange::kShare},
                      {"max_shared_edges", o.max_shared_edges, FieldRange::kShare},
                      {"floating_log_odds", o.floating_log_odds, FieldRange::kNotNegative},
                      {"hidden_score", o.hidden_score, FieldRange::kShare},
                      {"hidden_sharpness", o.hidden_sharpness, FieldRange::kShare},
                      {"hidden_slack", o.hidden_slack, FieldRange::kShare},
                      {"sure_scene", o.sure_scene, FieldRange::kShare},
                      {"upright_cos", o.upright_cos, FieldRange::kShare},
                      {"same_plane_m", o.same_plane_m, FieldRange::kPositive},
                      {"priority_score", o.priority_score, FieldRange::kShare},
                      {"behind_factor", o.behind_factor, FieldRange::kPositive}});
}

absl::Status CheckAcceptance(const SceneAcceptance& o) {
  return CheckFields(
      "acceptance.scene",
      {{"min_probability", o.min_probability, FieldRange::kShare},
       {"min_object_probability", o.min_object_probability, FieldRange::kShare},
       {"max_focal_deviations", o.max_focal_deviations, FieldRange::kPositive},
       {"min_parallax_rad", o.min_parallax_rad, FieldRange::kNotNegative},
       {"ambiguity_gap", o.ambiguity_gap, FieldRange::kShare},
       {"loose_ambiguity_gap", o.loose_ambiguity_gap, FieldRange::kShare},
       {"min_segments", static_cast<double>(o.min_segments), FieldRange::kPositive}});
}

absl::Status CheckAcceptance(const AlternativeAcceptance& o) {
  return CheckFields(
      "acceptance.alternatives",
      {{"misfit_diameters", o.misfit_diameters, FieldRange::kPositive},
       {"min_shared_volume", o.min_shared_volume, FieldRange::kShare},
       {"max_score_deficit", o.max_score_deficit, FieldRange::kShare},
       {"most_per_object", static_cast<double>(o.most_per_object), FieldRange::kPositive},
       {"max_harm", o.max_harm, FieldRange::kShare},
       {"texture_weight", o.texture_weight, FieldRange::kNotNegative},
       {"clear_texture", o.clear_texture, FieldRange::kNotNegative},
       {"clear_lead", o.clear_lead, FieldRange::kShare},
       {"sharpness_weight", o.sharpness_weight, FieldRange::kNotNegative}});
}

absl::Status CheckAcceptance(const AspectAcceptance& o) {
  return CheckFields(
      "acceptance.aspects",
      {{"confirming_score", o.confirming_score, FieldRange::kShare},
       {"contradicting_score", o.contradicting_score, FieldRange::kShare},
       {"chance_score", o.chance_score, FieldRange::kShare},
       {"min_fitted_probability", o.min_fitted_probability, FieldRange::kShare},
       {"score_weight", o.score_weight, FieldRange::kPositive},
       {"even_lying", o.even_lying, FieldRange::kShare},
       {"even_score", o.even_score, FieldRange::kShare},
       {"even_level", o.even_level, FieldRange::kShare},
       {"surface_level", o.surface_level, FieldRange::kShare},
       {"even_lying_surface", o.even_lying_surface, FieldRange::kShare},
       {"surface_tells", o.surface_tells, FieldRange::kShare},
       {"surface_pairs", static_cast<double>(o.surface_pairs), FieldRange::kPositive},
       {"even_leaning", o.even_leaning, FieldRange::kShare},
       {"even_alone", o.even_alone, FieldRange::kShare},
       {"even_in_one_view", o.even_in_one_view, FieldRange::kShare},
       {"sure_score", o.sure_score, FieldRange::kShare},
       {"accompanied_score", o.accompanied_score, FieldRange::kShare},
       {"companion_score", o.companion_score, FieldRange::kShare},
       {"companion_lying", o.companion_lying, FieldRange::kShare},
       {"company_parts", static_cast<double>(o.company_objects), FieldRange::kPositive},
       {"company_lying", o.company_lying, FieldRange::kShare},
       {"pair_lying", o.pair_lying, FieldRange::kShare},
       {"pair_surface", o.pair_surface, FieldRange::kShare},
       {"company_score", o.company_score, FieldRange::kShare},
       {"company_even", o.company_even, FieldRange::kShare},
       {"company_best_score", o.company_best_score, FieldRange::kShare},
       {"company_probability", o.company_probability, FieldRange::kShare},
       {"ground_agrees", o.ground_agrees, FieldRange::kShare},
       {"print_tells", o.print_tells, FieldRange::kShare},
       {"even_on_ground", o.even_on_ground, FieldRange::kShare},
       {"surface_disagrees", o.surface_disagrees, FieldRange::kShare},
       {"disagreement_more", o.disagreement_more, FieldRange::kShare},
       {"telling_texture", o.telling_texture, FieldRange::kNotNegative},
       {"ground_disagrees", o.ground_disagrees, FieldRange::kShare},
       {"missing_views_more", o.missing_views_more, FieldRange::kShare},
       {"focal_spread_free", o.focal_spread_free, FieldRange::kNotNegative},
       {"focal_spread_more", o.focal_spread_more, FieldRange::kNotNegative},
       {"min_probability", o.min_probability, FieldRange::kShare},
       {"sure_probability", o.sure_probability, FieldRange::kShare},
       {"other_precision", o.other_precision, FieldRange::kShare},
       {"accompanied_focal_share", o.accompanied_focal_share, FieldRange::kNotNegative},
       {"accompanied_views", static_cast<double>(o.accompanied_views), FieldRange::kPositive},
       {"same_place_share", o.same_place_share, FieldRange::kShare},
       {"apart_share", o.apart_share, FieldRange::kShare}});
}

absl::Status CheckAcceptance(const PoseChoiceAcceptance& o) {
  return CheckFields("acceptance.pose_choices",
                     {{"min_probability", o.min_probability, FieldRange::kShare},
                      {"found_contour", o.found_contour, FieldRange::kShare},
                      {"found_crease", o.found_crease, FieldRange::kShare},
                      {"independent_px", o.independent_px, FieldRange::kPositive},
                      {"most_log_odds", o.most_log_odds, FieldRange::kPositive},
                      {"turned_log_odds", o.turned_log_odds, FieldRange::kNotNegative},
                      {"ambiguous_share", o.ambiguous_share, FieldRange::kShare},
                      {"most", static_cast<double>(o.most), FieldRange::kPositive},
                      {"most_tried", static_cast<double>(o.most_tried), FieldRange::kPositive},
                      {"turns", static_cast<double>(o.turns), FieldRange::kPositive}});
}

absl::Status CheckAcceptance(const MisfitAcceptance& o) {
  return CheckFields("acceptance.misfits",
                     {{"least_px", o.least_px, FieldRange::kPositive},
                      {"factor", o.factor, FieldRange::kPositive},
                      {"aspect_scatter", o.aspect_scatter, FieldRange::kPositive},
                      {"found_px", o.found_px, FieldRange::kPositive},
                      {"least_found", o.least_found, FieldRange::kNotNegative},
                      {"min_samples", static_cast<double>(o.min_samples), FieldRange::kPositive}});
}

}  // namespace

absl::Status Validate(const AcceptanceOptions& options) {
  HOROPTER_RETURN_IF_ERROR(CheckAcceptance(options.placements));
  HOROPTER_RETURN_IF_ERROR(CheckAcceptance(options.scene));
  HOROPTER_RETURN_IF_ERROR(CheckAcceptance(options.alternatives));
  HOROPTER_RETURN_IF_ERROR(CheckAcceptance(options.aspects));
  HOROPTER_RETURN_IF_ERROR(CheckAcceptance(options.pose_choices));
  return CheckAcceptance(options.misfits);
}

}  // namespace horopter
