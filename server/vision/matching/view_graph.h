// Which pairs of views are worth comparing: those that seem to show the same (few views: all).
#pragma once

#include <opencv2/core/mat.hpp>
#include <span>
#include <utility>
#include <vector>

#include "server/vision/matching/junction_patches.h"
#include "server/vision/matching/matching_options.h"
#include "server/vision/matching/plane_homography.h"

namespace horopter {

// A view as overlap is judged by: a few keypoints of its locally normalised image at reduced size,
// and what its junctions look like.
struct OverlapSketch {
  KeypointSet keypoints;
  std::vector<JunctionPatch::Code> junctions;  // of the patches that are not empty, at most 150
};
// image: CV_8UC1 or CV_8UC3. patches: of its junctions, upright.
OverlapSketch SketchForOverlap(const cv::Mat& image,
                               std::span<const JunctionPatch> patches,
                               const MatchingOptions& options = {});

// Keypoints and junctions of the two that are each other's nearest and clearly so: a vote count,
// cheap and with wrong votes among them; only its order means anything.
int CountOverlapVotes(const OverlapSketch& a, const OverlapSketch& b);

struct ViewOverlap {
  int view_a = -1;
  int view_b = -1;
  double score = 0.0;
};

// The spanning tree of highest scores and the `best` partners of every view, in ascending order;
// first < second. Scores that tie are taken nearest in the given order first; overlaps that are
// missing count as 0, ones that are not finite or name no view are ignored.
std::vector<std::pair<int, int>> ChooseViewPairs(int views,
                                                 std::span<const ViewOverlap> overlaps,
                                                 const ViewGraphOptions& options);

}  // namespace horopter
