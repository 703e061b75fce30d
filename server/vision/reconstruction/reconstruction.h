// Cameras from matches alone, before any part is recognised (thesis 3).
#pragma once

#include <Eigen/Core>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/matching/matching.h"
#include "server/vision/reconstruction/calibrated_scene.h"
#include "server/vision/reconstruction/image_size.h"
#include "server/vision/reconstruction/reconstruction_options.h"
#include "server/vision/reconstruction/view_matches.h"
#include "server/vision/reconstruction/view_prior.h"

namespace horopter {

struct ReconstructedPoint {
  Eigen::Vector3d point_in_world = Eigen::Vector3d::Zero();
  std::vector<std::pair<int, int>>
      observations;  // (view, junction index) or (view, -1) for plane points
  bool on_plane = false;
  std::vector<Eigen::Vector2d> pixels;  // of the observations where they are texture, else none
};

// world: z = 0 is the supporting plane when has_plane, else a plane through the middle of what was
// seen, facing the cameras; z up towards the cameras. Its unit is no metre: whoever takes a view
// into a metric scene scales its translation.
struct Reconstruction {
  bool has_plane = false;
  std::vector<std::optional<CalibratedView>> views;  // scene: this world; empty: not registered
  std::vector<ReconstructedPoint> points;
  double rms_px = 0.0;
  bool trusted =
      false;  // focal lengths and rotations are determined by the images, not by the prior
  std::string refusal;  // why not, in numbers, when nothing was reconstructed or it is not trusted
  std::vector<std::string> view_refusals;  // per view; empty: registered
  std::vector<ViewMatches> view_matches;   // per view: what its camera rests on
  std::map<std::string, double> counts;
};

// Reconstructs cameras and points from the matches: over the supporting plane where views share
// one, else from tracks of junctions and segments; views left over are registered to what the
// others gave. "Not enough" is a result with `refusal`, not an error. priors: one per view or none;
// what they say of focal length, principal point and k1 is believed to its deviation, their poses
// are not used: the frame is the plane's. Errors: INVALID_ARGUMENT for sizes that do not agree and
// priors that are none, CANCELLED.
absl::StatusOr<Reconstruction> ReconstructViews(const MatchingResult& matching,
                                                std::span<const ImageFeatures> features,
                                                std::span<const ImageSize> sizes,
                                                std::span<const ViewPrior> priors,
                                                const ReconstructionOptions& options,
                                                const StopRequested& stop = {});

}  // namespace horopter
