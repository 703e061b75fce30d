// What the features stage gives: edge chains, segments, arcs and junctions of one image
// (thesis 2.2-2.6).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/vision/features/feature_options.h"

namespace cv {
class Mat;
}

namespace horopter {

// Ordered sub-pixel edge points of one detector channel; consecutive points are <= 2 px apart.
struct EdgeChain {
  std::vector<Eigen::Vector2f> points;
  // Per point: gradient (grey levels per pixel, towards the brighter side) and the channel it is
  // of.
  std::vector<Eigen::Vector2f> gradients;
  std::vector<uint8_t> channels;
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
  // Standard deviations of the fitted line: across itself at its middle, and of its direction; the
  // two are independent.
  double offset_sigma_px = 0.0;
  double angle_sigma_rad = 0.0;
  int channel = 0;
  Eigen::Vector3f left_bgr =
      Eigen::Vector3f::Zero();  // median colour about 3 px to the left of start -> end
  Eigen::Vector3f right_bgr = Eigen::Vector3f::Zero();  // and to the right
  bool in_texture = false;  // belongs to fine texture; starts no hypothesis, is not deleted
  int arc = -1;             // index of the arc of which it is a chord; -1: of none

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

// What a junction looks like (thesis 2.5): two ends; an end on a passing segment; three ends within
// less than a half turn of each other, or all around; two segments that cross; more.
enum class JunctionType { kL, kT, kArrow, kY, kX, kMulti };

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
  JunctionType type = JunctionType::kL;
  double rms_px = 0.0;
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  // px^2, from the lines' deviations
};

// Where a segment's end meets an arc: the intersection of line and ellipse.
struct ConicJunction {
  int segment = -1;
  bool at_start = false;
  int arc = -1;
  double angle_rad = 0.0;   // parameter s on the ellipse
  bool at_arc_end = false;  // the arc ends here too: a corner; otherwise it passes: a T
  bool tangent = false;     // the segment runs on smoothly into the arc
  Eigen::Vector2d point = Eigen::Vector2d::Zero();
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  // px^2
};

struct ImageFeatures {
  int width = 0;
  int height = 0;
  std::vector<EdgeChain> chains;
  std::vector<Segment> segments;
  std::vector<EllipseArc> arcs;
  std::vector<Junction> junctions;
  std::vector<ConicJunction> conic_junctions;
  std::map<std::string, double> counts;  // for the stage report
};

// Options that find most: a field per channel and weak edges, two to four times slower in colour.
// Recognition does no better with them (tests/bench/results.md).
FeatureOptions CompleteFeatures();

// Errors: INVALID_ARGUMENT naming the field.
absl::Status Validate(const FeatureOptions& options);

// Detects the features of one image.
// image: CV_8UC1, CV_8UC3 (BGR) or the same with 16 bits, of which 65535 is taken for 255; at least
// 16x16 px. Errors: INVALID_ARGUMENT for another type or size, or options (see Validate). An image
// without structure gives empty lists, not an error.
absl::StatusOr<ImageFeatures> DetectFeatures(const cv::Mat& image, const FeatureOptions& options);

}  // namespace horopter
