// Sub-pixel fit of a straight edge piece to the gradient peaks across it.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "server/vision/features/detection_channels.h"
#include "server/vision/features/edge_drawing.h"
#include "server/vision/features/features.h"

namespace horopter {

// One gradient peak on a segment.
struct GradientPeak {
  Eigen::Vector2f point = Eigen::Vector2f::Zero();
  float gradient = 0.0f;  // grey levels per pixel, positive towards the right of the segment
};

// A segment with the samples it was fitted to.
struct FittedSegment {
  Segment segment;
  std::vector<GradientPeak> samples;
};

// Searches the strongest gradient within +-3 px across the line at every pixel along it (parabola
// through the peak) and fits a line with Tukey weights. Draws its ends out while the same edge goes
// on. Orients the segment so that the brighter side is on its right. Empty when fewer than half of
// the positions have a peak of at least `min_gradient` or the line is shorter than `min_length_px`.
std::optional<FittedSegment> FitSegment(const RawLine& line,
                                        const DetectionChannel& channel,
                                        int channel_index,
                                        double min_gradient,
                                        double min_length_px);

// Fits a line to points [begin, end) of a linked chain and spans it over them; oriented and with
// the channel of the majority. Points next to a cut are left out: corners are rounded. Empty when
// the line is shorter than `min_length_px`, or its points are no straight edge.
std::optional<FittedSegment> FitChainPiece(const EdgeChain& chain,
                                           int begin,
                                           int end,
                                           double min_length_px);

// Refits the line to the samples (gradient-weighted, Tukey) and spans it over the projections of
// `ends`. Keeps the orientation of `like`. Used when pieces are joined.
Segment FitLineToSamples(const std::vector<GradientPeak>& samples,
                         const std::vector<Eigen::Vector2d>& ends,
                         const Segment& like);

}  // namespace horopter
