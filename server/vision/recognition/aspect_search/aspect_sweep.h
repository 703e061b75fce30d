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

// Votes of every expectation's part, as VoteForAspects gives them; of parts without one: none.
std::vector<std::vector<AspectVote>> SweepForAspects(const AspectImage& image,
                                                     const FragmentIndex& index,
                                                     std::span<const AspectExpectation> expected,
                                                     const AspectVoteOptions& votes = {},
                                                     const StopRequested& stop = {});

}  // namespace horopter
