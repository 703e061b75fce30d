#include "server/vision/recognition/options.h"

#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {

absl::Status Validate(const RecognitionOptions& options) {
  const RecognitionRoutes& r = options.routes;
  if (!(r.table || r.view_led || r.metric || r.projective || r.aspects))
    return absl::InvalidArgumentError("routes: none is on");
  const auto check = [](bool good, const char* field, double value) {
    return good ? absl::OkStatus()
                : absl::InvalidArgumentError(absl::StrCat(field, ": ", value, " is out of range"));
  };
  const auto share = [](double x) { return x >= 0.0 && x <= 1.0; };
  const auto positive = [](double x) { return x > 0.0 && std::isfinite(x); };
  const std::pair<const char*, double> shares[] = {
      {"accept_score", options.accept_score},
      {"accept_probability", options.accept_probability},
      {"aspects.confirming_score", options.aspects.confirming_score},
      {"aspects.contradicting_score", options.aspects.contradicting_score},
      {"aspects.chance_score", options.aspects.chance_score},
      {"aspects.accept_probability", options.aspects.accept_probability},
      {"ambiguity_gap", options.ambiguity_gap},
      {"loose_ambiguity_gap", options.loose_ambiguity_gap}};
  for (const auto& [field, value] : shares)
    HOROPTER_RETURN_IF_ERROR(check(share(value), field, value));
  const std::pair<const char*, double> sizes[] = {
      {"focal_start_widths", options.focal_start_widths},
      {"focal_log_sigma", options.focal_log_sigma},
      {"hypotheses_per_object", options.hypotheses_per_object},
      {"aspects.max_objects", options.aspects.max_objects},
      {"aspects.judge_render_px", options.aspects.judge_render_px},
      {"threads", options.threads}};
  for (const auto& [field, value] : sizes)
    HOROPTER_RETURN_IF_ERROR(check(positive(value), field, value));
  return check(options.min_parallax_rad >= 0.0 && std::isfinite(options.min_parallax_rad),
               "min_parallax_rad",
               options.min_parallax_rad);
}

}  // namespace horopter
