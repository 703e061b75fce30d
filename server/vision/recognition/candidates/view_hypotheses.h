// Hypotheses of one object in one view: two connected image edges compared with two connected model
// edges (thesis 4.6), elliptic arcs against circles.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/recognition/candidates/image_paths.h"
#include "server/vision/recognition/scoring/pose_score.h"
#include "server/vision/recognition/scoring/view_evidence.h"
#include "server/vision/recognition/search_options.h"
#include "server/vision/recognition/types.h"

namespace horopter {

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
