// Hypotheses of one object in one view: two connected image edges compared with two connected model
// edges (thesis 4.6), elliptic arcs against circles.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/recognition/candidates/image_paths.h"
#include "server/vision/recognition/scoring/pose_score.h"
#include "server/vision/recognition/scoring/view_evidence.h"
#include "server/vision/recognition/types.h"

namespace horopter {

struct ViewHypothesisOptions {
  int max_paths = 450;  // image paths tried; more: slower, finds smaller and more hidden parts
  float quick_reach_px = 6.0f;  // working pixels
  float give_up = 0.25f;        // mean support of the first quarter below which a pose is dropped
  int pool = 600;               // poses kept by quick score before non-maximum suppression
  int refined = 90;             // distinct poses refined
  int verified = 24;            // ... of which verified with hidden lines removed
  double distinct_px = 12.0;    // working pixels
  double min_radius_px = 12.0;  // projected radius of the part, working pixels
  double max_radius_px = 420.0;
  double focal_log_sigma = 0.35;
  // Arcs that are compared with circles of the part: angle, and width in working pixels.
  double min_sweep_rad = 1.6;
  double min_minor_px = 2.5;
  int turns = 24;  // about a circle's axis that are tried
};

// All hypotheses of one object in one view with the given start camera.
ViewHypotheses FindViewHypotheses(const PreparedObject& object,
                                  int object_index,
                                  const ViewEvidence& view,
                                  int view_index,
                                  const std::vector<ImagePath>& paths,
                                  const PinholeCamera& start,
                                  const ViewHypothesisOptions& options,
                                  const StopRequested& stop);

}  // namespace horopter
