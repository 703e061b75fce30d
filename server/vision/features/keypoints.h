// Points of an image's texture (SIFT; Lowe 2004), beside edges and what they make.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace cv {
class Mat;
}

namespace horopter {

inline constexpr int kDescriptorLength = 128;

// Points of one image or of a version of it, strongest first where they are many. Descriptors are
// integers, so that distances are exact on every machine.
struct KeypointSet {
  std::vector<Eigen::Vector2d> points;    // pixels
  std::vector<std::int16_t> descriptors;  // kDescriptorLength per point
  std::vector<std::int32_t> squared_norms;

  int size() const { return static_cast<int>(points.size()); }
};

struct KeypointOptions {
  int max_keypoints = 2000;  // the strongest stay; more: slower
  double contrast = 0.01;    // SIFT's threshold; lower: more, weaker points
  // Descriptors are square roots of shares (RootSIFT; Arandjelovic, Zisserman 2012): fewer wrong
  // matches between views far apart.
  bool root = false;
};

// grey: CV_8UC1; within: CV_8UC1 mask of the pixels whose points are wanted, empty: all. Images
// without texture or too small for one octave give an empty set. Large ones are searched in tiles,
// between which a call may be stopped (stop_scope.h).
KeypointSet DetectKeypoints(const cv::Mat& grey,
                            const cv::Mat& within,
                            const KeypointOptions& options);

}  // namespace horopter
