// What the features stage gives: edge chains, segments, arcs and junctions of one image
// (thesis 2.2-2.6).
#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace cv {
class Mat;
}

namespace horopter {

// Ordered sub-pixel edge points of one detector channel; consecutive points are <= 2 px apart.
struct EdgeChain {
  std::vector<Eigen::Vector2f> points;
  bool closed = false;
  int channel = 0;
};

// A straight piece of edge, sub-pixel. Walking from start to end, the brighter side is on the right
// (image axes, y down) in the channel it was found in; `contrast` is the mean grey-level step of
// that channel.
struct Segment {
  Eigen::Vector2d start = Eigen::Vector2d::Zero();
  Eigen::Vector2d end = Eigen::Vector2d::Zero();
  double contrast = 0.0;
  double rms_px = 0.0;  // of the edge points about the line
  int channel = 0;
  Eigen::Vector3f left_bgr =
      Eigen::Vector3f::Zero();  // median colour about 3 px to the left of start -> end
  Eigen::Vector3f right_bgr = Eigen::Vector3f::Zero();  // and to the right
  bool in_texture = false;  // belongs to fine texture; starts no hypothesis, is not deleted

  double Length() const { return (end - start).norm(); }
};

// Elliptic arc: x = center + R(angle) (a cos s, b sin s), s from start to start + sweep (radians).
struct EllipseArc {
  Eigen::Vector2d center = Eigen::Vector2d::Zero();
  double semi_major_px = 0.0;
  double semi_minor_px = 0.0;
  double angle_rad = 0.0;
  double start_rad = 0.0;
  double sweep_rad = 0.0;
  double rms_px = 0.0;
};

// Where segments meet. `ends` names which end of each segment meets here. At a T the segment that
// passes through is named with `interior` set (then at_start means nothing).
struct Junction {
  struct End {
    int segment = -1;
    bool at_start = false;
    bool interior = false;
  };
  Eigen::Vector2d point = Eigen::Vector2d::Zero();
  std::vector<End> ends;
  double rms_px = 0.0;
};

struct ImageFeatures {
  int width = 0;
  int height = 0;
  std::vector<EdgeChain> chains;
  std::vector<Segment> segments;
  std::vector<EllipseArc> arcs;
  std::vector<Junction> junctions;
  std::map<std::string, double> counts;  // for the stage report
};

// The defaults are the recipe of the front-end study: EDLines on five channels, gradient 20, anchor
// 4, sigma 1.
struct FeatureOptions {
  // Threshold of a channel's gradient (sum of |dx| + |dy| over 3x3 pixels: 6 x the slope per pixel)
  // = noise_factor x the channel's median gradient, between the two bounds: quiet images show
  // weaker edges. Higher: fewer, stronger edges.
  double gradient_threshold = 20.0;
  double min_gradient_threshold = 6.0;
  double noise_factor = 5.0;
  double anchor_threshold = 4.0;           // higher: fewer, longer chains
  double smoothing_sigma_px = 1.0;         // higher: less noise, rounder corners
  double min_segment_length_px = 12.0;     // shorter pieces are dropped
  double merge_angle_rad = 0.0524;         // 3 degrees
  double merge_offset_px = 1.5;            // lateral
  double merge_gap_px = 10.0;              // along
  double junction_gap_px = 14.0;           // end to intersection, at most
  double junction_gap_fraction = 0.35;     // ... and at most this share of the segment
  double junction_min_angle_rad = 0.2618;  // 15 degrees
  double texture_max_length_px = 40.0;     // longer segments are never texture
  double texture_density = 0.07;  // points of short chains per pixel; higher: fewer segments marked
  int max_arcs = 400;             // the longest are kept
  int max_segments = 4000;        // the strongest are kept; the cut is said in counts
};

// Detects the features of one image.
// image: CV_8UC1 or CV_8UC3 (BGR), at least 16x16 px. Errors: INVALID_ARGUMENT for another type or
// size. An image without structure gives empty lists, not an error.
absl::StatusOr<ImageFeatures> DetectFeatures(const cv::Mat& image, const FeatureOptions& options);

}  // namespace horopter
