// Lines and vertices by the Hough transform: the comparison of the thesis (2.1.4, 2.4).
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/features/features.h"

namespace horopter {

struct HoughOptions {
  double angle_step_rad = 0.0175;   // of the accumulator: 1 degree
  double offset_step_px = 1.0;      // ... and across the lines
  double angle_spread_rad = 0.087;  // a point votes for lines this near to its gradient's normal
  double support_px = 1.5;          // points this near to a line belong to it
  double max_gap_px = 4.0;          // between neighbouring points of a segment
  double min_length_px = 10.0;      // of a segment
  double min_votes = 8.0;           // of a line; higher: fewer lines
  int max_lines = 1000;             // the strongest are kept
  double vertex_reach_px = 8.0;     // segments vote for vertices this far beyond their ends
  double vertex_width_px = 2.0;     // ... and this far beside them
  double vertex_min_votes = 1.3;    // of a vertex: two segments that cross give up to 2
  double vertex_min_angle_rad = 0.2618;  // 15 degrees, between the segments of a vertex
  double vertex_distance_px = 4.0;       // between vertices
};

// Errors: INVALID_ARGUMENT naming the field.
absl::Status Validate(const HoughOptions& options);

// A point that several segments vote for.
struct HoughVertex {
  Eigen::Vector2d point = Eigen::Vector2d::Zero();  // least squares over the segments' lines
  double votes = 0.0;
  std::vector<int> segments;
};

struct HoughFeatures {
  // Only start, end, rms_px, and contrast (mean gradient, grey levels per pixel) are set; brighter
  // side on the right. Strongest line first.
  std::vector<Segment> segments;
  std::vector<HoughVertex> vertices;  // strongest first
};

// Every point of a chain votes for the lines through it whose normal is near its gradient (with
// sign, so that the two edges of a thin bar do not add up). The strongest line is fitted to the
// points that support it (total least squares), cut into segments at gaps, its points' votes are
// taken back, and so on. Segments then vote for the pixels they pass, a little beyond their ends:
// local maxima that segments of different directions share are vertices.
// width, height: of the image, pixels. Time grows with points x spread and with points x lines;
// memory with the accumulators (about 3 bytes per pixel and 3 kB per pixel of the diagonal).
// Errors: INVALID_ARGUMENT for options, sizes outside 1 to 20000, chains without gradients or
// points that are not finite.
absl::StatusOr<HoughFeatures> DetectHoughLines(std::span<const EdgeChain> chains,
                                               int width,
                                               int height,
                                               const HoughOptions& options);

}  // namespace horopter
