#include "server/vision/recognition/search_options.h"

#include <string>

#include "server/base/status_macros.h"
#include "server/vision/recognition/field_ranges.h"

namespace horopter {
namespace {

absl::Status Check(const std::string& name, const RefineOptions& o) {
  return CheckFields(name,
                     {{"iterations", static_cast<double>(o.iterations), FieldRange::kPositive},
                      {"start_reach_px", o.start_reach_px, FieldRange::kPositive},
                      {"end_reach_px", o.end_reach_px, FieldRange::kPositive},
                      {"focal_log_sigma", o.focal_log_sigma, FieldRange::kNotNegative},
                      {"focal_prior_px", o.focal_prior_px, FieldRange::kNotNegative}});
}

absl::Status Check(const std::string& name, const SceneRefineOptions& o) {
  return CheckFields(
      name,
      {{"iterations", static_cast<double>(o.iterations), FieldRange::kPositive},
       {"start_reach_px", o.start_reach_px, FieldRange::kPositive},
       {"guess_reach_px", o.guess_reach_px, FieldRange::kPositive},
       {"end_reach_px", o.end_reach_px, FieldRange::kPositive},
       {"plane_matches", static_cast<double>(o.plane_matches), FieldRange::kNotNegative},
       {"plane_weight", o.plane_weight, FieldRange::kNotNegative}});
}

absl::Status Check(const std::string& name, const StandingPlaneOptions& o) {
  return CheckFields(name,
                     {{"near_m", o.near_m, FieldRange::kPositive},
                      {"upright_rad", o.upright_rad, FieldRange::kPositive},
                      {"foot_sigma_m", o.foot_sigma_m, FieldRange::kPositive},
                      {"tilt_sigma_rad", o.tilt_sigma_rad, FieldRange::kPositive},
                      {"offset_sigma_m", o.offset_sigma_m, FieldRange::kPositive},
                      {"robust_scale_m", o.robust_scale_m, FieldRange::kPositive},
                      {"min_parts", static_cast<double>(o.min_objects), FieldRange::kPositive}});
}

absl::Status Check(const std::string& name, const SurfaceTextureOptions& o) {
  return CheckFields(name,
                     {{"spacing", o.spacing, FieldRange::kPositive},
                      {"half_window", static_cast<double>(o.half_window), FieldRange::kPositive},
                      {"min_deviation", o.min_deviation, FieldRange::kPositive},
                      {"min_correlation", o.min_correlation, FieldRange::kShare},
                      {"max_correlation", o.max_correlation, FieldRange::kShare},
                      {"shift_px", o.shift_px, FieldRange::kPositive},
                      {"shift_loss", o.shift_loss, FieldRange::kPositive},
                      {"max_depth_share", o.max_depth_share, FieldRange::kPositive}});
}

absl::Status Check(const std::string& name, const ViewHypothesisOptions& o) {
  HOROPTER_RETURN_IF_ERROR(Check(name + ".refine", o.refine));
  return CheckFields(name,
                     {{"max_paths", static_cast<double>(o.max_paths), FieldRange::kPositive},
                      {"quick_reach_px", o.quick_reach_px, FieldRange::kPositive},
                      {"give_up", o.give_up, FieldRange::kShare},
                      {"pool", static_cast<double>(o.pool), FieldRange::kPositive},
                      {"refined", static_cast<double>(o.refined), FieldRange::kNotNegative},
                      {"verified", static_cast<double>(o.verified), FieldRange::kNotNegative},
                      {"distinct_px", o.distinct_px, FieldRange::kPositive},
                      {"min_radius_px", o.min_radius_px, FieldRange::kPositive},
                      {"max_radius_px", o.max_radius_px, FieldRange::kPositive},
                      {"min_sweep_rad", o.min_sweep_rad, FieldRange::kPositive},
                      {"min_minor_px", o.min_minor_px, FieldRange::kPositive},
                      {"turns", static_cast<double>(o.turns), FieldRange::kPositive}});
}

absl::Status Check(const std::string& name, const SpaceCornerOptions& o) {
  return CheckFields(name,
                     {{"reach_px", o.reach_px, FieldRange::kPositive},
                      {"direction_rad", o.direction_rad, FieldRange::kPositive},
                      {"min_parallax_rad", o.min_parallax_rad, FieldRange::kPositive},
                      {"min_plane_angle_rad", o.min_plane_angle_rad, FieldRange::kPositive},
                      {"same_point_m", o.same_point_m, FieldRange::kPositive},
                      {"max_corners", static_cast<double>(o.max_corners), FieldRange::kPositive}});
}

absl::Status Check(const std::string& name, const SpaceCircleOptions& o) {
  return CheckFields(name,
                     {{"reach_px", o.reach_px, FieldRange::kPositive},
                      {"radius_log", o.radius_log, FieldRange::kNotNegative},
                      {"normal_rad", o.normal_rad, FieldRange::kPositive},
                      {"min_sweep_rad", o.min_sweep_rad, FieldRange::kPositive},
                      {"min_minor_px", o.min_minor_px, FieldRange::kPositive},
                      {"min_parallax_rad", o.min_parallax_rad, FieldRange::kPositive},
                      {"max_circles", static_cast<double>(o.max_circles), FieldRange::kPositive}});
}

absl::Status Check(const std::string& name, const SettleOptions& o) {
  HOROPTER_RETURN_IF_ERROR(Check(name + ".refine", o.refine));
  return CheckFields(name,
                     {{"settled", static_cast<double>(o.settled), FieldRange::kNotNegative},
                      {"kept", static_cast<double>(o.kept), FieldRange::kNotNegative},
                      {"settled_reach_px", o.settled_reach_px, FieldRange::kPositive}});
}

absl::Status Check(const std::string& name, const CornerSearchOptions& o) {
  HOROPTER_RETURN_IF_ERROR(Check(name + ".settle", o.settle));
  return CheckFields(name,
                     {{"angle_rad", o.angle_rad, FieldRange::kPositive},
                      {"length_share", o.length_share, FieldRange::kShare},
                      {"length_slack_m", o.length_slack_m, FieldRange::kNotNegative},
                      {"min_length_share", o.min_length_share, FieldRange::kShare},
                      {"radius_log", o.radius_log, FieldRange::kNotNegative},
                      {"turns", static_cast<double>(o.turns), FieldRange::kPositive},
                      {"quick_reach_px", o.quick_reach_px, FieldRange::kPositive},
                      {"min_quick", o.min_quick, FieldRange::kShare},
                      {"near_best", o.near_best, FieldRange::kShare}});
}

absl::Status Check(const std::string& name, const PoseVoteOptions& o) {
  return CheckFields(name,
                     {{"cell_m", o.cell_m, FieldRange::kPositive},
                      {"cell_rad", o.cell_rad, FieldRange::kPositive},
                      {"cell_log", o.cell_log, FieldRange::kPositive}});
}

absl::Status Check(const std::string& name, const PlaneSearchOptions& o) {
  HOROPTER_RETURN_IF_ERROR(Check(name + ".settle", o.settle));
  HOROPTER_RETURN_IF_ERROR(Check(name + ".votes", o.votes));
  return CheckFields(
      name,
      {{"max_paths", static_cast<double>(o.max_paths), FieldRange::kPositive},
       {"path_tolerance", o.path_tolerance, FieldRange::kShare},
       {"quick_reach_px", o.quick_reach_px, FieldRange::kPositive},
       {"min_quick", o.min_quick, FieldRange::kShare},
       {"known_reach_px", o.known_reach_px, FieldRange::kPositive},
       {"kept_per_object", static_cast<double>(o.kept_per_object), FieldRange::kNotNegative},
       {"refined_initial", static_cast<double>(o.refined_initial), FieldRange::kPositive},
       {"min_edge_px", o.min_edge_px, FieldRange::kPositive},
       {"min_partial", o.min_partial, FieldRange::kShare},
       {"min_path_votes", o.min_path_votes, FieldRange::kPositive},
       {"min_edge_votes", o.min_edge_votes, FieldRange::kPositive},
       {"peaks", static_cast<double>(o.peaks), FieldRange::kPositive},
       {"peaks_over", static_cast<double>(o.peaks_over), FieldRange::kPositive}});
}

absl::Status Check(const std::string& name, const ShortlistOptions& o) {
  HOROPTER_RETURN_IF_ERROR(Check(name + ".corners", o.corners));
  return CheckFields(
      name,
      {{"searched", static_cast<double>(o.searched), FieldRange::kPositive},
       {"refined", static_cast<double>(o.refined), FieldRange::kNotNegative},
       {"corners_asked", static_cast<double>(o.corners_asked), FieldRange::kPositive},
       {"circles_asked", static_cast<double>(o.circles_asked), FieldRange::kPositive},
       {"plane_paths_asked", static_cast<double>(o.plane_paths_asked), FieldRange::kPositive},
       {"paths_asked", static_cast<double>(o.paths_asked), FieldRange::kPositive}});
}

absl::Status Check(const std::string& name, const RigInitializationOptions& o) {
  return CheckFields(name,
                     {{"hypotheses_per_object",
                       static_cast<double>(o.hypotheses_per_object),
                       FieldRange::kPositive},
                      {"scale_steps", static_cast<double>(o.scale_steps), FieldRange::kPositive},
                      {"nearest", o.nearest, FieldRange::kPositive},
                      {"farthest", o.farthest, FieldRange::kPositive},
                      {"reach_px", o.reach_px, FieldRange::kPositive},
                      {"min_quick", o.min_quick, FieldRange::kShare},
                      {"refined", static_cast<double>(o.refined), FieldRange::kNotNegative}});
}

absl::Status Check(const std::string& name, const PlacementSearchOptions& o) {
  HOROPTER_RETURN_IF_ERROR(Check(name + ".settle", o.settle));
  HOROPTER_RETURN_IF_ERROR(Check(name + ".refine", o.refine));
  return CheckFields(
      name,
      {{"kept_per_object", static_cast<double>(o.kept_per_object), FieldRange::kNotNegative},
       {"same_distance_m", o.same_distance_m, FieldRange::kPositive},
       {"same_turn_rad", o.same_turn_rad, FieldRange::kPositive},
       {"min_raw_score", o.min_raw_score, FieldRange::kShare},
       {"quick_reach_px", o.quick_reach_px, FieldRange::kPositive},
       {"min_quick", o.min_quick, FieldRange::kShare},
       {"sure_log_odds", o.sure_log_odds, FieldRange::kPositive},
       {"doubtful_score", o.doubtful_score, FieldRange::kShare},
       {"max_surfaces", static_cast<double>(o.max_surfaces), FieldRange::kPositive},
       {"plane_voters", static_cast<double>(o.plane_voters), FieldRange::kPositive}});
}

}  // namespace

absl::Status Validate(const EdgeSearchOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Check("search.views", options.views));
  HOROPTER_RETURN_IF_ERROR(Check("search.linking", options.linking));
  HOROPTER_RETURN_IF_ERROR(Check("search.scene_refine", options.scene_refine));
  HOROPTER_RETURN_IF_ERROR(Check("search.space_corners", options.space_corners));
  HOROPTER_RETURN_IF_ERROR(Check("search.space_circles", options.space_circles));
  HOROPTER_RETURN_IF_ERROR(Check("search.corners", options.corners));
  HOROPTER_RETURN_IF_ERROR(Check("search.plane", options.plane));
  HOROPTER_RETURN_IF_ERROR(Check("search.plane_first_look", options.plane_first_look));
  HOROPTER_RETURN_IF_ERROR(Check("search.shortlist", options.shortlist));
  HOROPTER_RETURN_IF_ERROR(Check("search.rig", options.rig));
  HOROPTER_RETURN_IF_ERROR(Check("search.standing_plane", options.standing_plane));
  HOROPTER_RETURN_IF_ERROR(Check("search.texture", options.texture));
  HOROPTER_RETURN_IF_ERROR(Check("search.placements", options.placements));
  return CheckFields(
      "search",
      {{"plane_scales", static_cast<double>(options.plane_scales), FieldRange::kPositive}});
}

}  // namespace horopter
