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

// How the gradients of a colour image become fields in which edges are linked.
enum class ColourGradient {
  // One field for each of B, G, R, 1.5 (R - G) and 1.5 ((R + G) / 2 - B): finds most, because two
  // edges 2 px apart rarely hide each other in every channel.
  kEachChannel,
  // One field: the strongest of the five, each over its own noise threshold.
  kStrongestChannel,
  // Root of the largest eigenvalue of J^T J over B, G, R (Di Zenzo 1986).
  kVectorValued,
  // (1 - s) x intensity gradient + s x colour gradient, s the saturation (thesis 2.2).
  kSaturationWeighted,
  // Of 0.114 B + 0.587 G + 0.299 R.
  kIntensity,
};

struct GradientOptions {
  ColourGradient colour = ColourGradient::kStrongestChannel;
  // A channel's threshold (of |dx| + |dy| summed over 3x3 pixels: 6 x the slope in grey levels per
  // pixel) is noise_factor x its median gradient, between the two bounds, but never below
  // noise_floor x the median that its quietest 5 % suggest: in an image full of noise a fixed
  // bound would make all of it an edge.
  double noise_factor = 5.0;
  double min_threshold = 6.0;
  double max_threshold = 20.0;
  double noise_floor = 2.2;
};

struct LinkingOptions {
  // Hysteresis in thresholds of the field: chains start at `high` and go on down to `low`. Higher:
  // fewer edges, more gaps.
  double high = 2.5;
  double low = 1.2;
  int max_gap_px = 4;     // pixels without a maximum across the edge that a chain may bridge
  double gap_low = 0.35;  // ... while the gradient is at least this many thresholds
  int min_chain_px = 8;   // shorter chains are dropped
};

struct SplitAndMergeOptions {
  double split_px = 1.4;  // a piece whose points leave its chord by more is cut; higher: fewer cuts
  double merge_rms_px = 0.7;  // neighbours that one line fits this well are joined again
  int min_points = 6;         // shorter pieces are left out of the result
};

// Which edge detector feeds the stage.
enum class EdgeDetector {
  // One gradient field over all channels, ridge linking, split and merge.
  kLinkedField,
  // EDLines (OpenCV) on five channels, joined: the recipe of the front-end study.
  kEdgeDrawingChannels,
};

// How chains are cut into pieces; see chain_splitting.h.
enum class ChainSplittingMethod {
  kSplitAndMerge,       // chord distance and joint line fits; straight pieces only
  kCurvatureThreshold,  // maxima of |curvature| above one threshold for all chains
  kCurvatureTemplates,  // correlation of the curvature with peaks and steps (thesis 2.3)
};

// When two pieces are the same straight edge.
enum class MergeTest {
  kTolerances,   // merge_angle_rad and merge_offset_px
  kStatistical,  // chi-square of offset and angle under the deviations of both (thesis 2.5)
};

// gradient_threshold to smoothing_sigma_px belong to kEdgeDrawingChannels and are the recipe of the
// front-end study: gradient 20, anchor 4, sigma 1.
struct FeatureOptions {
  EdgeDetector detector = EdgeDetector::kLinkedField;
  GradientOptions gradient;
  LinkingOptions linking;
  // Moves the points of kLinkedField to where the light has its step: see light_response.h.
  bool undo_response = true;
  ChainSplittingMethod splitting = ChainSplittingMethod::kSplitAndMerge;  // of kLinkedField
  SplitAndMergeOptions split;
  // Threshold of a channel's gradient (sum of |dx| + |dy| over 3x3 pixels: 6 x the slope per pixel)
  // = noise_factor x the channel's median gradient, between the two bounds: quiet images show
  // weaker edges. Higher: fewer, stronger edges.
  double gradient_threshold = 20.0;
  double min_gradient_threshold = 6.0;
  double noise_factor = 5.0;
  double anchor_threshold = 4.0;        // higher: fewer, longer chains
  double smoothing_sigma_px = 1.0;      // higher: less noise, rounder corners
  double min_segment_length_px = 10.0;  // shorter pieces are dropped
  MergeTest merge_test = MergeTest::kTolerances;
  double merge_chi_square = 13.8;          // of two degrees of freedom: 0.1 % of true pairs refused
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
