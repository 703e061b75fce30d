#include "server/vision/recognition/acceptance.h"

#include <cmath>

#include "absl/strings/str_cat.h"

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

}  // namespace

absl::Status Validate(const AcceptanceOptions& options) {
  const PlacementAcceptance& p = options.placements;
  const SceneAcceptance& s = options.scene;
  const AlternativeAcceptance& a = options.alternatives;
  const AspectAcceptance& v = options.aspects;
  const PoseChoiceAcceptance& c = options.pose_choices;
  const Field fields[] = {
      {"placements.min_score", p.min_score, Range::kShare},
      {"placements.off_plane_score", p.off_plane_score, Range::kShare},
      {"placements.plane_tolerance_m", p.plane_tolerance_m, Range::kPositive},
      {"placements.max_shared_volume", p.max_shared_volume, Range::kShare},
      {"placements.max_shared_edges", p.max_shared_edges, Range::kShare},
      {"placements.floating_log_odds", p.floating_log_odds, Range::kNotNegative},
      {"placements.hidden_score", p.hidden_score, Range::kShare},
      {"placements.hidden_sharpness", p.hidden_sharpness, Range::kShare},
      {"placements.hidden_slack", p.hidden_slack, Range::kShare},
      {"placements.sure_scene", p.sure_scene, Range::kShare},
      {"scene.min_probability", s.min_probability, Range::kShare},
      {"scene.min_object_probability", s.min_object_probability, Range::kShare},
      {"scene.max_focal_deviations", s.max_focal_deviations, Range::kPositive},
      {"scene.min_parallax_rad", s.min_parallax_rad, Range::kNotNegative},
      {"scene.ambiguity_gap", s.ambiguity_gap, Range::kShare},
      {"scene.loose_ambiguity_gap", s.loose_ambiguity_gap, Range::kShare},
      {"alternatives.misfit_diameters", a.misfit_diameters, Range::kPositive},
      {"alternatives.min_shared_volume", a.min_shared_volume, Range::kShare},
      {"alternatives.max_score_deficit", a.max_score_deficit, Range::kShare},
      {"alternatives.most_per_object", static_cast<double>(a.most_per_object), Range::kPositive},
      {"alternatives.max_harm", a.max_harm, Range::kShare},
      {"alternatives.texture_weight", a.texture_weight, Range::kNotNegative},
      {"alternatives.clear_texture", a.clear_texture, Range::kNotNegative},
      {"alternatives.clear_lead", a.clear_lead, Range::kShare},
      {"alternatives.sharpness_weight", a.sharpness_weight, Range::kNotNegative},
      {"aspects.confirming_score", v.confirming_score, Range::kShare},
      {"aspects.contradicting_score", v.contradicting_score, Range::kShare},
      {"aspects.chance_score", v.chance_score, Range::kShare},
      {"aspects.score_weight", v.score_weight, Range::kPositive},
      {"aspects.even_score", v.even_score, Range::kShare},
      {"aspects.even_alone", v.even_alone, Range::kShare},
      {"aspects.even_in_one_view", v.even_in_one_view, Range::kShare},
      {"aspects.sure_score", v.sure_score, Range::kShare},
      {"aspects.accompanied_score", v.accompanied_score, Range::kShare},
      {"aspects.companion_score", v.companion_score, Range::kShare},
      {"aspects.few_views_share", v.few_views_share, Range::kShare},
      {"aspects.few_views_more", v.few_views_more, Range::kShare},
      {"aspects.focal_spread_free", v.focal_spread_free, Range::kNotNegative},
      {"aspects.focal_spread_more", v.focal_spread_more, Range::kNotNegative},
      {"aspects.min_probability", v.min_probability, Range::kShare},
      {"aspects.sure_probability", v.sure_probability, Range::kShare},
      {"aspects.other_precision", v.other_precision, Range::kShare},
      {"pose_choices.min_probability", c.min_probability, Range::kShare},
      {"pose_choices.found_contour", c.found_contour, Range::kShare},
      {"pose_choices.found_crease", c.found_crease, Range::kShare},
      {"pose_choices.independent_px", c.independent_px, Range::kPositive},
      {"pose_choices.most_log_odds", c.most_log_odds, Range::kPositive},
      {"pose_choices.ambiguous_share", c.ambiguous_share, Range::kShare}};
  for (const Field& f : fields) {
    if (!IsIn(f.range, f.value))
      return absl::InvalidArgumentError(
          absl::StrCat("acceptance.", f.name, ": ", f.value, " is out of range"));
  }
  return absl::OkStatus();
}

}  // namespace horopter
