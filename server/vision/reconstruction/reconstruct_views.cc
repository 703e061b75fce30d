#include <string>
#include <utility>

#include "server/base/status_macros.h"
#include "server/vision/reconstruction/plane_route.h"
#include "server/vision/reconstruction/reconstruction.h"
#include "server/vision/reconstruction/track_route.h"
#include "server/vision/reconstruction/view_registration.h"

namespace horopter {
namespace {

absl::Status ValidateInput(const MatchingResult& matching,
                           std::span<const ImageFeatures> features,
                           std::span<const ImageSize> sizes,
                           const ReconstructionOptions& options) {
  if (features.size() != sizes.size() || matching.component.size() != sizes.size() ||
      matching.view_from_plane.size() != sizes.size()) {
    return absl::InvalidArgumentError("reconstruction: " + std::to_string(sizes.size()) +
                                      " sizes, " + std::to_string(features.size()) +
                                      " feature sets and " +
                                      std::to_string(matching.component.size()) + " matched views");
  }
  if (sizes.size() > kMaxViews) {
    return absl::InvalidArgumentError("reconstruction: " + std::to_string(sizes.size()) +
                                      " views, at most " + std::to_string(kMaxViews));
  }
  for (const ImageSize& size : sizes) {
    if (size.width <= 0 || size.height <= 0)
      return absl::InvalidArgumentError("reconstruction: empty image size");
  }
  if (!(options.focal_prior_widths > 0.0) || !(options.focal_prior_log_sigma > 0.0)) {
    return absl::InvalidArgumentError("reconstruction: focal prior must be positive");
  }
  return absl::OkStatus();
}

bool HasViews(const Reconstruction& r) {
  for (const auto& view : r.views) {
    if (view) return true;
  }
  return false;
}

}  // namespace

absl::StatusOr<Reconstruction> ReconstructViews(const MatchingResult& matching,
                                                std::span<const ImageFeatures> features,
                                                std::span<const ImageSize> sizes,
                                                std::span<const ViewPrior> priors,
                                                const ReconstructionOptions& options,
                                                const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(ValidateInput(matching, features, sizes, options));
  HOROPTER_RETURN_IF_ERROR(Validate(priors, sizes.size()));
  HOROPTER_ASSIGN_OR_RETURN(Reconstruction result,
                            ReconstructFromPlane(matching, features, sizes, priors, options, stop));
  if (!result.trusted) {
    HOROPTER_ASSIGN_OR_RETURN(
        Reconstruction from_tracks,
        ReconstructFromTracks(matching, features, sizes, priors, options, stop));
    if (from_tracks.trusted || (!HasViews(result) && HasViews(from_tracks))) {
      result = std::move(from_tracks);
    } else {
      result.refusal += "; tracks: " + from_tracks.refusal;
    }
  }
  RegisterRemainingViews(matching, features, sizes, priors, options, stop, &result);
  if (IsStopRequested(stop)) return absl::CancelledError("reconstruction: cancelled");
  return result;
}

}  // namespace horopter
