#include "server/vision/recognition/options.h"

#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {

absl::Status Validate(const RecognitionOptions& options) {
  const RecognitionRoutes& r = options.routes;
  if (!(r.aspects || r.metric || r.projective))
    return absl::InvalidArgumentError("routes: none is on");
  const auto check = [](bool good, const char* field, double value) {
    return good ? absl::OkStatus()
                : absl::InvalidArgumentError(absl::StrCat(field, ": ", value, " is out of range"));
  };
  const auto positive = [](double x) { return x > 0.0 && std::isfinite(x); };
  const std::pair<const char*, double> sizes[] = {
      {"focal_start_widths", options.focal_start_widths},
      {"focal_log_sigma", options.focal_log_sigma},
      {"aspects.max_objects", options.aspects.max_objects},
      {"aspects.textured_share", options.aspects.textured_share},
      {"aspects.full_search_s", options.aspects.full_search_s},
      {"threads", options.threads}};
  for (const auto& [field, value] : sizes)
    HOROPTER_RETURN_IF_ERROR(check(positive(value), field, value));
  HOROPTER_RETURN_IF_ERROR(check(options.allowed_s >= 0.0 && std::isfinite(options.allowed_s),
                                 "allowed_s",
                                 options.allowed_s));
  HOROPTER_RETURN_IF_ERROR(
      check(options.effort >= 0.0 && std::isfinite(options.effort), "effort", options.effort));
  HOROPTER_RETURN_IF_ERROR(check(options.unknown_share > 0.0 && options.unknown_share < 1.0,
                                 "unknown_share",
                                 options.unknown_share));
  return Validate(options.acceptance);
}

}  // namespace horopter
