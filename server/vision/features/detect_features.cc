#include <algorithm>
#include <opencv2/core.hpp>
#include <string>

#include "absl/status/status.h"
#include "server/vision/features/arcs.h"
#include "server/vision/features/detection_channels.h"
#include "server/vision/features/edge_chains.h"
#include "server/vision/features/edge_drawing.h"
#include "server/vision/features/features.h"
#include "server/vision/features/junctions.h"
#include "server/vision/features/segment_fit.h"
#include "server/vision/features/segment_merging.h"
#include "server/vision/features/side_colours.h"
#include "server/vision/features/texture.h"

namespace horopter {
namespace {

constexpr int kMinSidePx = 16;
// The detector's gradient is a sum over 3x3 pixels (6 x the slope per pixel); a peak of the fit
// must reach half of the detector's threshold.
constexpr double kPeakPerThreshold = 0.5 / 6.0;

// Quiet channels show weaker edges.
double ChannelThreshold(const DetectionChannel& channel, const FeatureOptions& options) {
  return std::clamp(options.noise_factor * channel.median_gradient,
                    std::min(options.min_gradient_threshold, options.gradient_threshold),
                    options.gradient_threshold);
}

ImageFeatures Detect(const cv::Mat& image, const FeatureOptions& options) {
  ImageFeatures features;
  features.width = image.cols;
  features.height = image.rows;
  const std::vector<DetectionChannel> channels =
      MakeDetectionChannels(image, options.smoothing_sigma_px);
  std::vector<DrawnEdges> edges;
  std::vector<FittedSegment> pieces;
  double raw = 0.0;
  for (size_t c = 0; c < channels.size(); ++c) {
    const double threshold = ChannelThreshold(channels[c], options);
    edges.push_back(DrawEdges(channels[c].grey, threshold, options));
    raw += static_cast<double>(edges.back().lines.size());
    for (const RawLine& line : edges.back().lines) {
      if (std::optional<FittedSegment> piece = FitSegment(line,
                                                          channels[c],
                                                          static_cast<int>(c),
                                                          threshold * kPeakPerThreshold,
                                                          options.min_segment_length_px)) {
        pieces.push_back(*std::move(piece));
      }
    }
  }
  features.counts["lines_detected"] = raw;
  features.counts["lines_fitted"] = static_cast<double>(pieces.size());
  features.segments = MergeSegments(std::move(pieces), options);
  features.counts["segments_cut"] = 0.0;
  const auto limit = static_cast<size_t>(options.max_segments);
  if (features.segments.size() > limit) {
    features.counts["segments_cut"] = static_cast<double>(features.segments.size() - limit);
    features.segments.resize(limit);  // strongest first
  }
  MeasureSideColours(image, &features.segments);
  features.junctions = FindJunctions(features.segments, options);
  features.chains = JoinChains(edges, channels);
  features.counts["segments_in_texture"] = MarkTexture(features.chains,
                                                       features.junctions,
                                                       options,
                                                       features.width,
                                                       features.height,
                                                       &features.segments);
  features.arcs = FindArcs(features.chains, options.max_arcs);
  features.counts["arcs"] = static_cast<double>(features.arcs.size());
  features.counts["segments"] = static_cast<double>(features.segments.size());
  features.counts["junctions"] = static_cast<double>(features.junctions.size());
  features.counts["chains"] = static_cast<double>(features.chains.size());
  return features;
}

}  // namespace

absl::StatusOr<ImageFeatures> DetectFeatures(const cv::Mat& image, const FeatureOptions& options) {
  if (image.type() != CV_8UC1 && image.type() != CV_8UC3) {
    return absl::InvalidArgumentError("image: need 8-bit grey or BGR, got OpenCV type " +
                                      std::to_string(image.type()));
  }
  if (image.cols < kMinSidePx || image.rows < kMinSidePx) {
    return absl::InvalidArgumentError("image: need at least 16x16 px, got " +
                                      std::to_string(image.cols) + "x" +
                                      std::to_string(image.rows));
  }
  try {
    return Detect(image, options);
  } catch (const cv::Exception& error) {
    return absl::InternalError(std::string("feature detection: ") + error.what());
  }
}

}  // namespace horopter
