// Ellipses matched between views whose cameras are known, and the circles in space that they are
// images of (thesis 2.7, 3.3).
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/features/features.h"
#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/space_conic.h"
#include "server/vision/matching/matching.h"

namespace horopter {

struct ConicMatchingOptions {
  // Arcs of less are left out: what is not seen of the ellipse is a guess. Lower: more, less sure.
  double min_sweep_rad = 2.0;
  double min_semi_minor_px = 3.0;
  // Of both images from those of one circle, rms; the cameras' errors are in it. Larger: more
  // matches, more wrong ones.
  double gate_px = 1.2;
  double sigma_px = 0.4;  // of a point of an arc
};

// Match of two arcs (indices into ImageFeatures::arcs).
struct ConicMatch {
  int arc_a = -1;
  int arc_b = -1;
  double log_ratio = 0.0;  // log-likelihood ratio of being right; other views that agree included
  int other_views = 0;     // that show the circle as well
};

struct ConicPair {
  int view_a = -1;
  int view_b = -1;
  std::vector<ConicMatch> matches;
};

struct TrackedConic {
  FeatureTrack track;  // of arcs
  SpaceConic conic;    // in the cameras' frame
};

struct ConicMatching {
  std::vector<ConicPair> pairs;
  std::vector<TrackedConic> conics;  // seen by two views and more
};

// Points along what is seen of an arc, in the middle of equal steps.
ConicSight SightOfArc(const EllipseArc& arc, const CalibratedCamera& view);

// Two arcs match that are images of one circle in space, each arc once a pair; where that is in
// doubt, as along a row of like holes, a third view decides, and without one neither is kept.
// Tracks of three views and more may also be of ellipses. cameras: one per view, empty: not known;
// in any unit. Errors: INVALID_ARGUMENT for sizes that do not agree, CANCELLED.
absl::StatusOr<ConicMatching> MatchConics(std::span<const ImageFeatures> features,
                                          std::span<const std::optional<CalibratedCamera>> cameras,
                                          const ConicMatchingOptions& options = {},
                                          const StopRequested& stop = {});

}  // namespace horopter
