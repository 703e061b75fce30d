// The values that recognition takes and gives, and that its rooms pass to each other.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "server/vision/geometry/calibrated_camera.h"
#include "server/vision/geometry/camera_prior.h"
#include "server/vision/geometry/view_difference.h"

namespace horopter {

struct PreparedObject;  // object/prepared_object.h: what recognition derives from an ObjectModel,
                        // once

// One pose of one object in one view, before the views are joined.
struct ViewHypothesis {
  int object = -1;  // index into the list of prepared objects
  int view = -1;
  PinholeCamera camera;       // with the focal length assumed or refined
  Rigid3 camera_from_object;  // metres
  double score = 0.0;         // 0..1, F1 of edge support
};

enum class AlternativeKind {
  kPose,         // the object in another pose
  kObject,       // another one of the catalog
  kMirrorImage,  // of the object, not enrolled
  kStretched,    // the object, but stretched along its axes
  kFeature,      // the object without one of its features, or with it elsewhere
  kSize          // another one of the catalog, of the same shape in another size
};

// What else may stand where an object was answered.
struct SceneAlternative {
  AlternativeKind kind = AlternativeKind::kPose;
  int object = -1;           // of kObject and kSize the other one, else the answered one
  double probability = 0.0;  // with the answer and all others at most 1; 0: not known
  // Of kPose, kObject, kMirrorImage: its frame in the answered object's frame.
  std::optional<Rigid3> object_from_alternative = {};
  // Of kFeature: its middle and extent, metres, object frame.
  Eigen::Vector3d feature_place = Eigen::Vector3d::Zero();
  double feature_size_m = 0.0;
  std::vector<ViewDifference> views = {};  // from around; empty: not asked
};

// An accepted object. scene: metric frame shared by all recognised views.
struct SceneObject {
  int object = -1;
  Rigid3 scene_from_object;
  double score = 0.0;    // probability that the answer is right, see interpretation/decision.h
  double support = 0.0;  // joint edge support over the views, 0..1
  std::vector<double> view_scores;  // per view; negative: not visible or camera not recovered
  // Objects the images do not tell apart from this one; its own index: another pose of itself.
  std::vector<int> alternatives;
  // That it is turned as it is, among the turns that the images leave open (pose_alternatives.h).
  double pose_probability = 1.0;
  // Those and all else that the images leave possible, with probabilities.
  std::vector<SceneAlternative> left_open = {};
};

enum class RecognitionState {
  kRecognized,    // at least one object
  kNothingFound,  // cameras or not: no catalog object has support
  kAmbiguous,     // objects found, but at least one has alternatives that the images do not exclude
  kTooFewFeatures,  // no view has enough edges
  kNoParallax,  // objects have support, but all views show them from one side: no depth, no answer
};

enum class RecognitionRoute {
  kNone,
  kAspects,  // contours of single images, views linked through the parts
};

struct RecognitionResult {
  RecognitionState state = RecognitionState::kNothingFound;
  std::string detail;  // numbers behind the state, readable
  std::vector<std::optional<CalibratedCamera>> views;
  std::vector<SceneObject> objects;
  RecognitionRoute route = RecognitionRoute::kNone;  // that found the first of the objects
  // Found under cameras that were known before, none of which was left out.
  bool under_known_cameras = false;
  int searched_objects = 0;                // by their contours
  bool effort_spent = false;               // RecognitionOptions::effort; what was found by then
  std::vector<ViewHypothesis> hypotheses;  // of single images, best first; for the stage report
  std::vector<SceneObject> verified;  // what was found before it was decided; for the stage report
  std::map<std::string, double> counts;

  // Views whose camera is known.
  int registered() const {
    return static_cast<int>(
        std::count_if(views.begin(), views.end(), [](const auto& v) { return v.has_value(); }));
  }
};

// Told the name of each step of recognition as it begins, on the calling thread; may be empty. No
// stage reads a clock: whoever wants times takes them here.
using StepListener = std::function<void(std::string_view step)>;

}  // namespace horopter
