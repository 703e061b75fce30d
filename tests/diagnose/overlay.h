// Pictures of what the features stage saw and what the answer says, over the image.
#pragma once

#include <array>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/features/feature_graph.h"
#include "server/vision/features/features.h"
#include "server/vision/matching/matching.h"
#include "tests/diagnose/feature_report.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {

// One object drawn as wireframe.
struct DrawnObject {
  const ObjectModel* model = nullptr;
  PinholeCamera camera;
  Rigid3 camera_from_object;
};

// The image at half brightness and double size with: segments yellow (texture: grey-brown),
// junctions red circles (tees: small blue), arcs white.
cv::Mat DrawFeatures(const cv::Mat& image, const ImageFeatures& features);

// ... with the feature graph: segments coloured by direction, arcs white, shared junctions thick
// dots by type (L red, T blue, arrow and Y orange, X and more magenta), conic junctions cyan, lines
// between the middles of parallel (green) and collinear (yellow) segments.
cv::Mat DrawFeatureGraph(const cv::Mat& image,
                         const ImageFeatures& features,
                         const FeatureGraph& graph);

// Two views side by side with the junctions and segments that tracks of the matching join in both:
// one colour per track, thick when it is seen in >= 3 views. `views`: their numbers.
cv::Mat DrawTracks(const std::array<cv::Mat, 2>& images,
                   const std::array<ImageFeatures, 2>& features,
                   const std::array<int, 2>& views,
                   const MatchingResult& matching);

// ... with: true edges green where covered, red where missed (an edge below 70 % is thick); corners
// found green, missed red; wireframes of the answer magenta.
cv::Mat DrawTruth(const cv::Mat& image,
                  const ImageFeatures& features,
                  const TrueView& truth,
                  const FeatureFinding& finding,
                  const std::vector<DrawnObject>& answer);

}  // namespace horopter
