#include <algorithm>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "server/base/status_macros.h"
#include "server/vision/reconstruction/plane_route.h"
#include "server/vision/reconstruction/reconstruction.h"
#include "server/vision/reconstruction/track_route.h"
#include "server/vision/reconstruction/view_registration.h"

namespace horopter {
namespace {

constexpr int kMinSureViews = 3;              // beside a doubtful one, to tell that it is
constexpr double kDoubtfulFocalSigma = 0.05;  // of ln f; below it no view is doubtful
constexpr double kDoubtfulRatio = 3.0;        // to the median of the views

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

// Views that know their focal length far worse than the others do: few of their observations agree
// with the bundle, which may have settled them wrongly. Taken out, by view.
std::vector<std::optional<CalibratedView>> TakeDoubtfulViews(Reconstruction* r) {
  std::vector<double> sigmas;
  for (const auto& view : r->views) {
    if (view) sigmas.push_back(view->focal_log_sigma);
  }
  std::vector<std::optional<CalibratedView>> taken(r->views.size());
  if (static_cast<int>(sigmas.size()) < kMinSureViews + 1) return taken;
  std::nth_element(sigmas.begin(), sigmas.begin() + sigmas.size() / 2, sigmas.end());
  const double doubtful = std::max(kDoubtfulFocalSigma, kDoubtfulRatio * sigmas[sigmas.size() / 2]);
  for (std::size_t v = 0; v < taken.size(); ++v) {
    if (r->views[v] && r->views[v]->focal_log_sigma > doubtful) std::swap(taken[v], r->views[v]);
  }
  return taken;
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
  const auto before = TakeDoubtfulViews(&result);
  RegisterRemainingViews(matching, features, sizes, priors, options, stop, &result);
  for (std::size_t v = 0; v < before.size(); ++v) {
    std::optional<CalibratedView>& now = result.views[v];
    if (!before[v] || (now && now->focal_log_sigma < before[v]->focal_log_sigma)) continue;
    if (!now) ++result.counts["views"];
    now = before[v];
    result.view_refusals[v].clear();
  }
  if (IsStopRequested(stop)) return absl::CancelledError("reconstruction: cancelled");
  if (result.view_matches.empty()) {
    result.view_matches = CountViewMatches(result.points, result.views, features, result.rms_px);
  }
  return result;
}

}  // namespace horopter
