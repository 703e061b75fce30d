// Which catalog objects are in the scene, and where: hypotheses in single views, linked and judged
// over all views (thesis 4, frontend.md 4-5).
#pragma once

#include <Eigen/Core>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/features/features.h"
#include "server/vision/geometry/object_model.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"
#include "server/vision/matching/matching.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

struct PreparedObject;   // recognition/prepared_object.h: what recognition derives from an
                         // ObjectModel, once
class KeyIndexSnapshot;  // recognition/key_index.h

// What the caller happens to know about a camera. Unset fields are unknown.
struct CameraHint {
  std::optional<double> focal_px;
  std::optional<double> focal_log_sigma;  // default 0.02 when focal_px is given
  std::optional<Eigen::Vector2d> principal_point;
  std::optional<double> k1;
};

// One pose of one object in one view, before the views are joined.
struct ViewHypothesis {
  int object = -1;  // index into the list of prepared objects
  int view = -1;
  PinholeCamera camera;       // with the focal length assumed or refined
  Rigid3 camera_from_object;  // metres
  double score = 0.0;         // 0..1, F1 of edge support
};

struct RecognizedView {
  PinholeCamera camera;
  Rigid3 camera_from_scene;
};

// An accepted object. scene: metric frame shared by all recognised views.
struct SceneObject {
  int object = -1;
  Rigid3 scene_from_object;
  double score = 0.0;               // probability that the answer is right, see verdict.h
  double support = 0.0;             // joint edge support over the views, 0..1
  std::vector<double> view_scores;  // per view; negative: not visible or camera not recovered
  // Objects the images do not tell apart from this one; its own index: another pose of itself.
  std::vector<int> alternatives;
};

enum class RecognitionState {
  kRecognized,    // at least one object
  kNothingFound,  // cameras or not: no catalog object has support
  kAmbiguous,     // objects found, but at least one has alternatives that the images do not exclude
  kTooFewFeatures,  // no view has enough edges
  kNoParallax,  // objects have support, but all views show them from one side: no depth, no answer
};

// How a scene's first part, and with it metric cameras, is come by.
enum class RecognitionRoute {
  kNone,
  kTable,       // standing on the matched plane, in the cameras of the reconstruction
  kMetric,      // similarity invariants of corners in space, cameras known up to scale
  kViewLed,     // hypotheses of single views, linked
  kProjective,  // projective invariants of matched corners, nothing known of the cameras
};

struct RecognitionResult {
  RecognitionState state = RecognitionState::kNothingFound;
  std::string detail;  // numbers behind the state, readable
  std::vector<std::optional<RecognizedView>> views;
  std::vector<SceneObject> objects;
  RecognitionRoute route = RecognitionRoute::kNone;  // that found the first of the objects
  std::vector<ViewHypothesis> hypotheses;  // kept per view, best first; for the stage report
  std::vector<SceneObject> verified;  // joint hypotheses before consolidation; for the stage report
  std::map<std::string, double> counts;
};

// Which routes may be taken, by cost until a scene is found that chance does not explain: metric,
// table, views (if the table gave nothing), projective (if metric had no trusted cameras).
struct RecognitionRoutes {
  bool table = true;
  bool metric = true;
  bool view_led = true;
  bool projective = true;
};

struct RecognitionOptions {
  RecognitionRoutes routes;
  double focal_start_widths = 1.5;  // first focal length tried, in image widths
  double focal_log_sigma = 0.35;    // prior width of log f; larger: weaker prior
  int hypotheses_per_object = 8;    // distinct poses kept per object and view
  double accept_score = 0.55;  // joint support of an accepted object; higher: fewer, surer objects
  double accept_probability = 0.5;  // of the scene; higher: fewer, surer answers
  double ambiguity_gap = 0.03;      // a rival closer than this makes the answer ambiguous
  // ... and another pose of the same object, where it alone determines the cameras: these then
  // adapt to the wrong pose. On parts-dev such rivals of right poses lay 0.13 and more behind (one
  // of 25 by 0.06), on the dotted box of the real photographs the right pose 0.11 behind.
  double loose_ambiguity_gap = 0.12;
  double min_parallax_rad = 0.035;  // between two views of an object; less is no parallax
  int threads = 1;
  // Once it returns true no route, scale or round of search is begun any more, seeds that are
  // being looked for are left, and what was found is judged and answered. Empty: never.
  StopRequested hurry;
};

// Errors: INVALID_ARGUMENT, names the field: no route at all, values outside of their range.
absl::Status Validate(const RecognitionOptions& options);

struct RecognitionInput {
  std::span<const cv::Mat> images;
  std::span<const ImageFeatures> features;
  std::span<const CameraHint> hints;  // empty or one per image
  const MatchingResult* matching = nullptr;
  const Reconstruction* reconstruction = nullptr;
  std::span<const std::shared_ptr<const PreparedObject>> objects;
  // The catalog's keys, object i in slot slots[i]. Null: an index is built when it is asked for.
  const KeyIndexSnapshot* keys = nullptr;
  std::span<const int> slots;
};

// Told the name of each step of recognition as it begins, on the calling thread; may be empty. No
// stage reads a clock: whoever wants times takes them here.
using StepListener = std::function<void(std::string_view step)>;

// Errors: INVALID_ARGUMENT (sizes do not agree, options), CANCELLED.
absl::StatusOr<RecognitionResult> RecognizeObjects(const RecognitionInput& input,
                                                   const RecognitionOptions& options,
                                                   const StopRequested& stop = {},
                                                   const StepListener& on_step = {});

}  // namespace horopter
