// What the images leave open about an answer: poses that only small features tell from it, with
// probabilities and the features that would decide.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "server/vision/recognition/aspects/aspect_image.h"
#include "server/vision/recognition/object/joint_context.h"

namespace horopter {

// A place where an answer and an alternative to it look different.
struct DecidingFeature {
  enum class Kind {
    kOutline,  // a contour: the part ends there, or stands before what lies behind
    kCrease,   // an edge between faces that both are seen
    kCircle    // the rim of a hole, boss or shaft
  };
  Kind kind = Kind::kOutline;
  bool only_in_alternative = false;                 // false: only in the answer
  Eigen::Vector3d place = Eigen::Vector3d::Zero();  // frame of the answered object, metres
  double size_m = 0.0;                              // extent; of circles the diameter
  double visible_px = 0.0;  // longest edge of it in one of the images, working pixels; 0: none
};

// What the images leave possible instead of an answered pose.
struct PoseChoice {
  int object = -1;  // index into the prepared objects; the answered one itself: another pose of it
  Rigid3 object_from_alternative;         // its frame in the answered object's frame
  double probability = 0.0;               // of all choices and the answer together 1
  std::vector<DecidingFeature> features;  // longest edges first
  std::vector<ViewDifference> views;      // by what it differs from the answer from around
};

// A pose that may stand in an answer's place, besides the turns of its near symmetries.
struct OtherPose {
  int object = -1;
  Rigid3 scene_from_object;
};

// What may stand in the place of one of the answer's objects.
struct RatedPose {
  int object = -1;
  Rigid3 scene_from_object;
  double log_odds = 0.0;        // of the answer against it
  bool near_symmetric = false;  // a turn of a near symmetry of the object
  bool repeated = false;  // ... that is another one but for its adjustment: no choice beside it
};
using RatedPoses = std::vector<RatedPose>;  // of one object, likeliest first

// The near symmetries of the answer's object number `place`, and `alternatives`. Empty for an
// object without aspects.
RatedPoses RatePoses(const JointContext& context,
                     std::span<const AspectImage> images,
                     const RecognitionResult& result,
                     int place,
                     std::span<const OtherPose> alternatives = {});

// The same with half turns: end for end and upside down, unless the part is sure of itself.
RatedPoses RateTurns(const JointContext& context,
                     std::span<const AspectImage> images,
                     const RecognitionResult& result,
                     int place);

// Of these what is likely enough to be said, likeliest first.
std::vector<PoseChoice> FindPoseAlternatives(const JointContext& context,
                                             std::span<const AspectImage> images,
                                             const RecognitionResult& result,
                                             int place,
                                             const RatedPoses& rated);

// "plate: 0.41 that it is turned by 180 degrees; a circle of 4.2 mm at (12.0, 3.1, 0.0) mm decides,
// which no image shows".
std::string DescribeChoice(const std::string& object_id, const PoseChoice& choice);

// Objects that the images show turned by one of their near symmetries rather than as answered are
// turned, and adjusted to the images again. The score of a whole part hardly tells such turns: what
// the part has in common with itself drowns the features that do. Returns what else may be in the
// place of each object.
std::vector<RatedPoses> TurnToLikeliest(const JointContext& context,
                                        std::span<const AspectImage> images,
                                        RecognitionResult* result);

// Poses of the answer's objects that are left open: named in `detail` and among the object's
// alternatives; where they are likely the answer is ambiguous. `rated` as TurnToLikeliest says.
void SayPoseAlternatives(const JointContext& context,
                         std::span<const AspectImage> images,
                         std::span<const RatedPoses> rated,
                         RecognitionResult* result);

}  // namespace horopter
