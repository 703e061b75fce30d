#include <algorithm>
#include <iterator>
#include <opencv2/core.hpp>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/base/stop_scope.h"
#include "server/vision/features/arcs.h"
#include "server/vision/features/chain_splitting.h"
#include "server/vision/features/co_conic.h"
#include "server/vision/features/conic_junctions.h"
#include "server/vision/features/detection_channels.h"
#include "server/vision/features/edge_chains.h"
#include "server/vision/features/edge_cover.h"
#include "server/vision/features/edge_drawing.h"
#include "server/vision/features/edge_gradient.h"
#include "server/vision/features/edge_linking.h"
#include "server/vision/features/features.h"
#include "server/vision/features/image_strips.h"
#include "server/vision/features/junctions.h"
#include "server/vision/features/light_response.h"
#include "server/vision/features/segment_fit.h"
#include "server/vision/features/segment_merging.h"
#include "server/vision/features/side_colours.h"
#include "server/vision/features/split_and_merge.h"
#include "server/vision/features/texture.h"

namespace horopter {
namespace {

constexpr int kMinSidePx = 16;  // of an image; smaller ones hold no edge of the least length
constexpr int kSplitChainsPerLook = 16;  // at the stop flag
// A piece of which other pieces cover more than this tells nothing new.
constexpr double kMaxCoveredShare = 0.85;
// The detector's gradient is a sum over 3x3 pixels (6 x the slope per pixel); a peak of the fit
// must reach half of the detector's threshold.
constexpr double kPeakPerThreshold = 0.5 / 6.0;

// Quiet channels show weaker edges.
double ChannelThreshold(const DetectionChannel& channel, const FeatureOptions& options) {
  return std::clamp(options.noise_factor * channel.median_gradient,
                    std::min(options.min_gradient_threshold, options.gradient_threshold),
                    options.gradient_threshold);
}

struct Pieces {
  std::vector<EdgeChain> chains;
  std::vector<FittedSegment> segments;
  std::vector<EllipseArc> arcs;
  double lines_detected = 0.0;
};

double CoveredShare(const EdgeChain& chain, const ChainPiece& piece, const EdgeCover& cover) {
  int covered = 0;
  for (int i = piece.begin; i < piece.end; ++i) {
    covered += cover.Covers(chain.points[i], EdgeCover::EdgeDirection(chain.gradients[i])) ? 1 : 0;
  }
  return static_cast<double>(covered) / (piece.end - piece.begin);
}

absl::StatusOr<Pieces> DetectByLinking(const cv::Mat& image, const FeatureOptions& options) {
  Pieces pieces;
  const std::vector<GradientField> fields = MakeGradientFields(image, options.gradient);
  for (const GradientField& field : fields) {
    std::vector<EdgeChain> chains = LinkEdges(field, options.linking);
    std::move(chains.begin(), chains.end(), std::back_inserter(pieces.chains));
  }
  if (options.undo_response) {
    UndoResponse(image, EstimateBlur(image, pieces.chains), &pieces.chains);
  }
  SortLongestFirst(&pieces.chains);
  // What another channel has already given is not fitted again.
  EdgeCover cover(image.cols, image.rows);
  StopPacer pacer(kSplitChainsPerLook);
  for (const EdgeChain& chain : pieces.chains) {
    pacer.Step();
    absl::StatusOr<std::vector<ChainPiece>> cut =
        SplitChain(chain.points, chain.closed, options.splitting);
    if (!cut.ok()) {
      return cut.status();
    }
    for (const ChainPiece& piece : *cut) {
      if (piece.curved) continue;  // FindArcs reads the chains themselves
      pieces.lines_detected += 1.0;
      if (CoveredShare(chain, piece, cover) > kMaxCoveredShare) {
        continue;
      }
      std::optional<FittedSegment> fitted =
          FitChainPiece(chain, piece.begin, piece.end, options.min_segment_length_px);
      if (!fitted) {
        continue;
      }
      for (int i = piece.begin; i < piece.end; ++i) {
        cover.Mark(chain.points[i], EdgeCover::EdgeDirection(chain.gradients[i]));
      }
      pieces.segments.push_back(*std::move(fitted));
    }
  }
  LeaveIfStopped();
  pieces.arcs = FindArcs(pieces.chains, fields, image.cols, image.rows, options.arcs);
  pieces.chains = JoinLinkedChains(std::move(pieces.chains), image.cols, image.rows);
  return pieces;
}

absl::StatusOr<Pieces> DetectByChannels(const cv::Mat& image, const FeatureOptions& options) {
  const std::vector<DetectionChannel> channels =
      MakeDetectionChannels(image, options.smoothing_sigma_px);
  Pieces pieces;
  std::vector<DrawnEdges> edges;
  for (size_t c = 0; c < channels.size(); ++c) {
    const double threshold = ChannelThreshold(channels[c], options);
    edges.push_back(DrawEdges(channels[c].grey, threshold, options));
    pieces.lines_detected += static_cast<double>(edges.back().lines.size());
    for (const RawLine& line : edges.back().lines) {
      if (std::optional<FittedSegment> piece = FitSegment(line,
                                                          channels[c],
                                                          static_cast<int>(c),
                                                          threshold * kPeakPerThreshold,
                                                          options.min_segment_length_px)) {
        pieces.segments.push_back(*std::move(piece));
      }
    }
  }
  pieces.chains = JoinChains(edges, channels);
  LeaveIfStopped();
  pieces.arcs = FindArcs(pieces.chains,
                         MakeGradientFields(image, options.gradient),
                         image.cols,
                         image.rows,
                         options.arcs);
  return pieces;
}

absl::StatusOr<ImageFeatures> Detect(const cv::Mat& image, const FeatureOptions& options) {
  ImageFeatures features;
  features.width = image.cols;
  features.height = image.rows;
  HOROPTER_ASSIGN_OR_RETURN(Pieces pieces,
                            options.detector == EdgeDetector::kLinkedField
                                ? DetectByLinking(image, options)
                                : DetectByChannels(image, options));
  LeaveIfStopped();
  features.counts["lines_detected"] = pieces.lines_detected;
  features.counts["lines_fitted"] = static_cast<double>(pieces.segments.size());
  features.segments = MergeSegments(std::move(pieces.segments), options);
  features.counts["segments_cut"] = 0.0;
  const auto limit = static_cast<size_t>(options.max_segments);
  if (features.segments.size() > limit) {
    features.counts["segments_cut"] = static_cast<double>(features.segments.size() - limit);
    features.segments.resize(limit);  // strongest first
  }
  LeaveIfStopped();
  features.arcs = std::move(pieces.arcs);
  features.counts["arcs_straight"] =
      ReconcileArcs(options.co_conic, &features.arcs, &features.segments);
  MeasureSideColours(image, &features.segments);
  LeaveIfStopped();
  features.junctions = FindJunctions(features.segments, options);
  features.conic_junctions =
      FindConicJunctions(features.segments, features.arcs, options.conic_junctions);
  LeaveIfStopped();
  features.chains = std::move(pieces.chains);
  features.counts["segments_in_texture"] = MarkTexture(features.chains,
                                                       features.junctions,
                                                       options,
                                                       features.width,
                                                       features.height,
                                                       &features.segments);
  features.counts["arcs"] = static_cast<double>(features.arcs.size());
  features.counts["segments"] = static_cast<double>(features.segments.size());
  features.counts["junctions"] = static_cast<double>(features.junctions.size());
  features.counts["conic_junctions"] = static_cast<double>(features.conic_junctions.size());
  features.counts["chains"] = static_cast<double>(features.chains.size());
  return features;
}

}  // namespace

FeatureOptions CompleteFeatures() {
  FeatureOptions options;
  options.gradient.colour = ColourGradient::kEachChannel;
  options.linking.high = 1.4;
  options.linking.low = 0.7;
  return options;
}

absl::Status Validate(const FeatureOptions& options) {
  const auto refuse = [](const char* field, double value) {
    return absl::InvalidArgumentError(absl::StrCat(field, ": out of range: ", value));
  };
  // Written so that NaN is refused too.
  if (!(options.linking.high > 0.0)) return refuse("linking.high", options.linking.high);
  if (!(options.linking.low > 0.0 && options.linking.low <= options.linking.high)) {
    return refuse("linking.low", options.linking.low);
  }
  if (!(options.gradient.min_threshold > 0.0)) {
    return refuse("gradient.min_threshold", options.gradient.min_threshold);
  }
  if (!(options.gradient.max_threshold >= options.gradient.min_threshold)) {
    return refuse("gradient.max_threshold", options.gradient.max_threshold);
  }
  HOROPTER_RETURN_IF_ERROR(Validate(options.splitting));
  if (!(options.min_segment_length_px >= 0.0)) {
    return refuse("min_segment_length_px", options.min_segment_length_px);
  }
  if (!(options.merge_chi_square > 0.0)) {
    return refuse("merge_chi_square", options.merge_chi_square);
  }
  if (options.max_segments < 0) return refuse("max_segments", options.max_segments);
  if (options.arcs.max_arcs < 0) return refuse("arcs.max_arcs", options.arcs.max_arcs);
  return absl::OkStatus();
}

absl::StatusOr<ImageFeatures> DetectFeatures(const cv::Mat& image, const FeatureOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  const bool deep = image.type() == CV_16UC1 || image.type() == CV_16UC3;
  if (image.type() != CV_8UC1 && image.type() != CV_8UC3 && !deep) {
    return absl::InvalidArgumentError(
        absl::StrCat("image: need 8 or 16 bits, grey or BGR, got OpenCV type ", image.type()));
  }
  if (image.cols < kMinSidePx || image.rows < kMinSidePx) {
    return absl::InvalidArgumentError(
        absl::StrCat("image: need at least 16x16 px, got ", image.cols, "x", image.rows));
  }
  try {
    if (!deep) return Detect(image, options);
    return Detect(ConvertInStrips(image, CV_8U, 255.0 / 65535.0), options);
  } catch (const cv::Exception& error) {
    return absl::InternalError(std::string("feature detection: ") + error.what());
  }
}

}  // namespace horopter
