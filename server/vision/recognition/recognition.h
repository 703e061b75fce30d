// Which catalog objects are in the scene, and where: hypotheses in single views, linked and judged
// over all views (thesis 4).
#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <span>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/features/features.h"
#include "server/vision/matching/matching.h"
#include "server/vision/recognition/options.h"
#include "server/vision/recognition/types.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

class KeyIndexSnapshot;           // invariant_matching/key_index.h
struct BottomUpOptions;           // initialization/bottom_up_route.h
struct AspectRecognitionOptions;  // object/aspect_options.h

struct RecognitionInput {
  std::span<const cv::Mat> images;
  std::span<const ImageFeatures> features;
  std::span<const CameraHint> hints;               // empty or one per image
  const MatchingResult* matching = nullptr;        // null: features were not matched
  const Reconstruction* reconstruction = nullptr;  // null: none
  std::span<const std::shared_ptr<const PreparedObject>> objects;
  // The catalog's keys, object i in slot slots[i]. Null: an index is built when it is asked for.
  const KeyIndexSnapshot* keys = nullptr;
  std::span<const int> slots = {};
  const BottomUpOptions* bottom_up = nullptr;         // null: defaults
  const AspectRecognitionOptions* aspects = nullptr;  // null: defaults
  // Two cameras' places are known: a part alone is told from its copies in other sizes.
  bool scale_known = false;
  // How the textured ground moves from view to view (matching/ground_motion.h), one per image;
  // empty: as `matching` says.
  std::span<const std::optional<Eigen::Matrix3d>> ground = {};
};

// In all images at once: what single images show, linked through the parts they have in common, and
// what the cameras of `reconstruction` and the structure of `matching` propose (RecognitionRoutes).
// Errors: INVALID_ARGUMENT (sizes do not agree, options, an object without aspects), CANCELLED.
absl::StatusOr<RecognitionResult> RecognizeObjects(const RecognitionInput& input,
                                                   const RecognitionOptions& options,
                                                   const StopRequested& stop = {},
                                                   const StepListener& on_step = {});

// How many of an answer's objects are right, as its probabilities say.
double ExpectedRight(const RecognitionResult& result);

// From the probabilities that objects are answered for to those that are told of them
// (SceneObject::score): that object and pose are right.
void StateProbabilities(RecognitionResult* result);

}  // namespace horopter
