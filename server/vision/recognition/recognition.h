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
#include "server/vision/recognition/aspects/searched_part.h"
#include "server/vision/recognition/options.h"
#include "server/vision/recognition/refusals.h"
#include "server/vision/recognition/types.h"
#include "server/vision/reconstruction/known_cameras.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

class KeyIndexSnapshot;           // invariant_matching/key_index.h
struct BottomUpOptions;           // initialization/bottom_up_route.h
struct AspectRecognitionOptions;  // object/aspect_options.h
struct AspectWork;                // interpretation/aspect_route.h

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
  // Where in the images parts are looked for, one per image; empty: everywhere.
  std::span<const std::optional<SearchedPart>> searched = {};
};

// In all images at once: what single images show, linked through the parts they have in common, and
// what the cameras of `reconstruction` and the structure of `matching` propose (RecognitionRoutes).
// log: keeps what is refused of one object; work: searches no image twice; both may be null.
// Errors: INVALID_ARGUMENT (sizes do not agree, options, an object without aspects), CANCELLED.
absl::StatusOr<RecognitionResult> RecognizeObjects(const RecognitionInput& input,
                                                   const RecognitionOptions& options,
                                                   const StopRequested& stop = {},
                                                   const StepListener& on_step = {},
                                                   RefusalLog* log = nullptr,
                                                   AspectWork* work = nullptr);

// Under cameras that are known before any part, one entry per image, by aspects, without matching
// and without linking views: what one image shows is transferred into all others. Nothing where
// fewer than two are known and where the images leave any doubt, of the parts or of the cameras:
// then RecognizeObjects is to be asked. Errors: INVALID_ARGUMENT (sizes do not agree, options),
// CANCELLED.
absl::StatusOr<RecognitionResult> RecognizeWithCameras(const RecognitionInput& input,
                                                       const KnownCameras& cameras,
                                                       const RecognitionOptions& options,
                                                       const StopRequested& stop = {},
                                                       const StepListener& on_step = {},
                                                       RefusalLog* log = nullptr,
                                                       AspectWork* work = nullptr);

// Boxes of what is small in each image, those of which most is expected first, for a search of
// these alone, enlarged (aspects/attention.h). work: of the images as a whole, or empty; most_side:
// share of the image's width.
std::vector<std::vector<ImageBox>> SmallThings(std::span<const cv::Mat> images,
                                               const AspectWork& work,
                                               double most_side,
                                               int most_of_an_image);

// Of a request, empty, for attempts that are given the same objects, hints and ground. What the
// attempts `before` on other cuts of the images took counts on (RecognitionOptions::effort).
std::shared_ptr<AspectWork> MakeAspectWork(const AspectWork* before = nullptr);

// Whether it is worth while to ask how the ground moves before aspects are searched: three images
// and more have so many edges that it must be textured (AspectRouteOptions::textured_share).
bool GroundComesFirst(std::span<const ImageFeatures> features, const AspectRouteOptions& options);

// How many of an answer's objects are right, as its probabilities say.
double ExpectedRight(const RecognitionResult& result);

// From the probabilities that objects are answered for to those that are told of them
// (SceneObject::score): that object and pose are right.
void StateProbabilities(RecognitionResult* result);

}  // namespace horopter
