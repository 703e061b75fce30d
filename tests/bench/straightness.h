// The radial lens coefficient from the straightness of long edges.
#pragma once

#include <span>

#include "absl/status/statusor.h"
#include "server/vision/features/features.h"
#include "server/vision/geometry/pinhole_camera.h"

namespace horopter {

struct StraightnessOptions {
  double min_length_px = 50.0;  // shorter pieces of chain say too little
  // Deviation (rms) that the edges of the scene themselves have from a line. Higher: wider sigma.
  double edge_rms_px = 0.06;
  // Deviation of the principal point from the one given, in image widths, each coordinate.
  double center_sigma = 0.01;
  double max_k1 = 0.3;         // searched on both sides of 0
  double max_k1_sigma = 0.03;  // an estimate less certain is refused
  int min_lines = 3;           // at least so many must agree; higher: more refusals
  // One bent edge must not pass for a lens: what the lines say without their weightiest one must
  // agree (3 deviations) and have a deviation of at most this.
  double max_k1_sigma_without_best = 0.08;
  double min_agreement = 0.5;  // share of the information of all candidates that must agree
};

// Errors: INVALID_ARGUMENT naming the field.
absl::Status Validate(const StraightnessOptions& options);

struct StraightnessEstimate {
  double k1 = 0.0;        // in the units of PinholeCamera, for the focal length given
  double k1_sigma = 0.0;  // points, edges and principal point; the focal length counts as exact
  int candidates = 0;     // pieces of chain long enough to tell
  int lines = 0;          // of them, those that this k1 makes straight
  double k1_sigma_without_best = 0.0;  // of the lines without the weightiest
};

// Finds the k1 that makes the long pieces of chain straight. `camera` gives size, focal length and
// principal point; its k1 is not used. Only k1 / focal_px^2 can be seen, so with another focal
// length the k1 that comes out is scaled by the square of their ratio. Each piece gives its own k1
// with a deviation; the value most of them agree on (Tukey's loss, searched globally) is refined
// over them.
// Errors: INVALID_ARGUMENT for options, camera or points that are not finite; FAILED_PRECONDITION,
// with the numbers, when the pieces are too few, disagree or leave k1 too uncertain.
absl::StatusOr<StraightnessEstimate> EstimateRadialDistortion(std::span<const EdgeChain> chains,
                                                              const PinholeCamera& camera,
                                                              const StraightnessOptions& options);

}  // namespace horopter
