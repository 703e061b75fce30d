// What makes an edge one of a textured ground by its motion (plane_edges.h).
#pragma once

#include "absl/status/status.h"

namespace horopter {

struct PlaneEdgeOptions {
  double tolerance_px = 1.4;  // working px: a homography and an edge are so exact; chosen
  // Of the views that a homography takes an edge into, in so many it must be met, or in all; of
  // three and more some may hide it.
  int min_views = 2;
  int may_miss = 1;
  // A ground covers this share of the image (in blocks) with edges, and leaves no more room between
  // them: the radius of discs that touch an edge at its better side, px, of the middle one. Others
  // hide no parts; or they are no ground but faces of parts. Seen: .29 - .68, 0 - 7 px. ADR 56.
  double min_coverage = 0.3;
  double max_room_px = 12.0;
  // An edge beside which there is so many times the usual room, which counts for so much at least,
  // is the outline of what lies flat on the ground; chosen.
  double outline_room = 3.0;
  double least_room_px = 5.0;
  // Where the tests of the image alone drop this share of the ground's edges they are enough. ADR
  // 59.
  double told_alone = 0.95;
};

// Errors: INVALID_ARGUMENT, names the field.
absl::Status Validate(const PlaneEdgeOptions& options);

}  // namespace horopter
