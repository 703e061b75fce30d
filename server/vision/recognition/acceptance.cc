#include "server/vision/recognition/acceptance.h"

#include <cmath>
#include <initializer_list>
#include <string>
#include <string_view>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

enum class FieldRange { kShare, kPositive, kNotNegative };

struct RangedField {
  const char* name;
  double value;
  FieldRange range;
};

bool IsIn(FieldRange range, double x) {
  if (!std::isfinite(x)) return false;
  switch (range) {
    case FieldRange::kShare:
      return x >= 0.0 && x <= 1.0;
    case FieldRange::kPositive:
      return x > 0.0;
    case FieldRange::kNotNegative:
      return x >= 0.0;
  }
  return false;
}

// Errors: INVALID_ARGUMENT, "group.name: value is out of range", of the first that is not finite or
// not in its range.
absl::Status CheckFields(std::string_view group, std::initializer_list<RangedField> fields) {
  for (const RangedField& f : fields) {
    if (!IsIn(f.range, f.value))
      return absl::InvalidArgumentError(
          absl::StrCat(std::string(group), ".", f.name, ": ", f.value, " is out of range"));
  }
  return absl::OkStatus();
}

absl::Status CheckAcceptance(const SceneAcceptance& o) {
  return CheckFields(
      "acceptance.scene",
      {{"min_parallax_rad", o.min_parallax_rad, FieldRange::kNotNegative},
       {"ambiguity_gap", o.ambiguity_gap, FieldRange::kShare},
       {"min_segments", static_cast<double>(o.min_segments), FieldRange::kPositive}});
}

absl::Status CheckAcceptance(const AspectAcceptance& o) {
  return CheckFields("acceptance.aspects",
                     {{"min_probability", o.min_probability, FieldRange::kShare},
                      {"even_printed", o.even_printed, FieldRange::kShare},
                      {"missing_views_more", o.missing_views_more, FieldRange::kShare},
                      {"score_weight", o.score_weight, FieldRange::kPositive},
                      {"print_tells", o.print_tells, FieldRange::kShare},
                      {"print_views", static_cast<double>(o.print_views), FieldRange::kPositive},
                      {"surface_disagrees", o.surface_disagrees, FieldRange::kShare}});
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
  HOROPTER_RETURN_IF_ERROR(CheckAcceptance(options.scene));
  HOROPTER_RETURN_IF_ERROR(CheckAcceptance(options.aspects));
  HOROPTER_RETURN_IF_ERROR(CheckAcceptance(options.pose_choices));
  return CheckAcceptance(options.misfits);
}

}  // namespace horopter
