#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/pipeline.h"
#include "server/vision/matching/match_features.h"
#include "server/vision/reconstruction/grow_projective.h"
#include "server/vision/reconstruction/self_calibration.h"

namespace horopter {
namespace {

// Says where in the tree the field is that `status` names.
absl::Status Under(const char* branch, const absl::Status& status) {
  if (status.ok()) return status;
  return absl::Status(status.code(), absl::StrCat(branch, ".", status.message()));
}

}  // namespace

absl::Status Validate(const PipelineOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Under("features", Validate(options.features)));
  HOROPTER_RETURN_IF_ERROR(Under("matching.features", Validate(options.matching.features)));
  const ReconstructionOptions& reconstruction = options.reconstruction;
  HOROPTER_RETURN_IF_ERROR(Under("reconstruction.tracks", Validate(reconstruction.tracks)));
  HOROPTER_RETURN_IF_ERROR(
      Under("reconstruction.calibration", Validate(reconstruction.calibration)));
  HOROPTER_RETURN_IF_ERROR(Under("recognition", Validate(options.recognition)));
  const BottomUpOptions& bottom_up = options.bottom_up;
  HOROPTER_RETURN_IF_ERROR(Under("bottom_up.reconstruction", Validate(bottom_up.reconstruction)));
  HOROPTER_RETURN_IF_ERROR(Under("aspects.images", Validate(options.aspects.images)));
  HOROPTER_RETURN_IF_ERROR(Under("station", Validate(options.station)));
  if (options.threads < 1 || options.max_searched_objects < 1) {
    return absl::InvalidArgumentError(absl::StrCat("threads and max_searched_objects: need 1, got ",
                                                   options.threads,
                                                   " and ",
                                                   options.max_searched_objects));
  }
  return absl::OkStatus();
}

}  // namespace horopter
