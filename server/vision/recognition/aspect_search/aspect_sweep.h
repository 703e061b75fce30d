// A part that other views show, looked for in one more image at every place: where its contours are
// too broken for fragments, but pose and size are roughly known.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/recognition/aspect_search/aspect_votes.h"

namespace horopter {

// What other views say of a part.
struct AspectExpectation {
  int model = -1;                                // of the index
  std::vector<Eigen::Matrix3f> rotations;        // camera_from_object in the other views
  float min_size_px = 0.0f, max_size_px = 0.0f;  // of its diameter, working pixels
};

struct AspectSweepOptions {
  double reach_rad = 0.9;      // between a pose and one of those expected
  double turn_step_rad = 0.2;  // about the line of sight
  double size_step = 1.15;
  double place_share = 0.11;  // of the size: between places
  double tau_share = 0.10;    // of the size: an edge farther away supports nothing at first
  double min_support_6 = 0.5, min_support_16 = 0.5;
  int climbed = 4000;  // of an expectation
};

// Votes of every expectation's part, as VoteForAspects gives them; of parts without one: none.
std::vector<std::vector<AspectVote>> SweepForAspects(const AspectImage& image,
                                                     const FragmentIndex& index,
                                                     std::span<const AspectExpectation> expected,
                                                     const AspectVoteOptions& votes = {},
                                                     const AspectSweepOptions& options = {},
                                                     const StopRequested& stop = {});

}  // namespace horopter
