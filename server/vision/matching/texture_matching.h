// Texture points (SIFT) matched between views, before anything is known of the cameras: what
// photographs of printed, scratched, wooden things have and plain tables lack.
#pragma once

#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "server/base/stop_token.h"
#include "server/vision/features/keypoints.h"
#include "server/vision/matching/matching.h"
#include "server/vision/matching/matching_options.h"

namespace cv {
class Mat;
}

namespace horopter {

// Two views whose texture points agree on one epipolar geometry.
struct TexturePair {
  int view_a = -1;
  int view_b = -1;
  std::vector<std::pair<int, int>> matches;  // keypoints in a and b that agree, likeliest first
  // Of these, how many one homography explains: all of them where the scene is a plane or the
  // camera only turned.
  int on_homography = 0;
  int still = 0;  // matches that were left out because they stand still while the others move
};

struct TextureMatching {
  std::vector<KeypointSet> keypoints;  // per view
  std::vector<double> sigma_px;        // per view: deviation of a keypoint's coordinates
  std::vector<TexturePair> pairs;      // accepted ones only
  std::vector<FeatureTrack> tracks;    // of keypoints, in two views and more; at most one in a view
  std::map<std::string, double> counts;
};

// Matches N views of one static scene by their texture points; where something moves before a
// background that stands still in the images, by what moves. images: CV_8UC1 or CV_8UC3. Once
// `stop` asks, what was found so far; tracks then are none.
TextureMatching MatchTexture(std::span<const cv::Mat> images,
                             const TextureOptions& options,
                             const ViewGraphOptions& graph,
                             int threads,
                             const StopRequested& stop = {});

}  // namespace horopter
