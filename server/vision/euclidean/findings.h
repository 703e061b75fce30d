// What a metric scene cannot decide or contradicts, by name: never a silently bent scene.
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "server/vision/euclidean/scene_bundle.h"
#include "server/vision/euclidean/scene_covariance.h"
#include "server/vision/geometry/pose_perturbation.h"
#include "server/vision/recognition/acceptance.h"

namespace horopter {

enum class FindingKind {
  kSingleObject,        // scale, frame and cameras hang on one object
  kFrameBySymmetry,     // every object is symmetric: the frame is one of several equivalent ones
  kTurnUndetermined,    // rotation of an object about `direction`
  kShiftUndetermined,   // translation of an object along `direction`
  kFocalAndDepth,       // focal length and depth of a view compensate each other
  kScaleConflict,       // an object's size disagrees with the others, or with a reference
  kObjectRejected,      // an object's edges do not fit the cameras of the others; left out
  kReferenceConflict,   // references put the robot base in different places
  kExifContradicted,    // the focal length that a view's file gives does not fit the view
  kReferenceSymmetric,  // `value` poses of the base are the same to this reference
  kBaseUncertain,       // the robot's base is known worse than its grippers need
};

struct Finding {
  FindingKind kind = FindingKind::kSingleObject;
  int object = -1;  // index into the answer's objects; of kObjectRejected: of the catalog's
  int view = -1;
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();  // object frame, unit
  // Standard deviation (rad, m, of log f), the log of the ratio of scales, or the focal length.
  double value = 0.0;
  std::string detail;  // for people
};

// Where metres come from.
enum class ScaleSourceKind { kObject, kReferenceCameras, kKnownFocalLength };
struct ScaleSource {
  ScaleSourceKind kind = ScaleSourceKind::kObject;
  int index = -1;          // object or view
  double log_ratio = 0.0;  // of this source's metre to the answer's
  double log_sigma = 0.0;
  bool agrees = true;
};

struct FindingOptions {
  double turn_rad = 0.17;  // wider directions are undetermined
  double shift_diameters = 0.25;
  // A direction must stay known when the one edge in one view that says most about it is left out,
  // by edge points this near their place (working px). Higher: chance associations count.
  double agreed_px = 0.5;
  double focal_log = 0.05;
  double scale_sigmas = 4.0;  // a scale further off than this and `scale_log` disagrees
  double scale_log = 0.01;
  // Of the adjustment that lets the scales go.
  SceneBundleOptions scale_bundle{.max_iterations = 8, .fixed = {.scales = false}};
};

// Directions of the objects that the covariance leaves open (turns seen from the surest camera,
// shifts relative to the first other object, or the camera across its line of sight), and views
// whose focal length is open. Directions known by a single edge of a single view count as open.
std::vector<Finding> FindWeakDirections(const SceneBundle& bundle,
                                        const SceneCovariance& covariance,
                                        const FindingOptions& options);

// How large each object is relative to what it was enrolled as, the most agreed upon scale being 1;
// one entry per object. With the scales free the bundle is adjusted once more (a copy).
std::vector<ScaleSource> EstimateScales(const SceneBundle& bundle,
                                        const NoiseOptions& noise,
                                        const FindingOptions& options,
                                        int threads);

// Objects that do not fit the cameras of the others: the edges found scatter `factor` times as
// widely as the others' and more than `least_px`, or of the edges expected (`visible`) less than
// `least_found` times the others' share was found, in most of the views. Fewer than two others:
// none.
std::vector<int> FindMisfits(const SceneBundle& bundle,
                             std::span<const VisibleSamples> visible,
                             const MisfitAcceptance& acceptance);

}  // namespace horopter
