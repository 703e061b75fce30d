// Request and answer of the pipeline, free of any wire format.
#pragma once

#include <Eigen/Core>
#include <map>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>
#include <vector>

#include "server/pipeline/base_frame.h"
#include "server/pipeline/camera_basis.h"
#include "server/pipeline/expected_parts.h"
#include "server/pipeline/station.h"
#include "server/vision/euclidean/euclidean.h"
#include "server/vision/explanation/explanation.h"
#include "server/vision/geometry/image_regions.h"
#include "server/vision/matching/matching.h"
#include "server/vision/recognition/recognition.h"
#include "server/vision/reconstruction/reconstruction.h"

namespace horopter {

// An object of the catalog whose pose in the robot's base frame is known (a fixture).
struct ReferenceObject {
  std::string object_id;
  Rigid3 base_from_object;
  // Standard deviations of that pose: of the rotation about each axis, of each coordinate. 0:
  // exact.
  double rotation_sigma_rad = 0.0;
  double position_sigma_m = 0.0;
};

// The robot's tools; see Gripper in recognition.proto.
struct GripperTools {
  std::optional<GripperShape> parallel_jaw;
  std::optional<SuctionShape> suction;
  std::optional<double> approach_m;
};

struct SceneRequest {
  std::vector<cv::Mat> images;    // CV_8UC1 or CV_8UC3 (BGR)
  std::vector<CameraHint> hints;  // empty or one per image
  // Empty or one per image; where cameras are in the robot's base frame. Two or more also measure
  // the scale. References that contradict each other give no base frame.
  std::vector<std::optional<CameraPoseHint>> camera_poses;
  std::vector<std::string> candidates;  // empty: the whole catalog
  std::optional<ReferenceObject> reference;
  std::vector<ReferenceObject> further_references;  // only with `reference`
  std::optional<GripperTools> gripper;              // empty: the options' own
  // Id of an object that is looked for too and of which the answer says why it is, or is not, in
  // it; empty: none.
  std::string explained;
  bool unexplained_edges = false;  // SceneAnswer::unexplained_edges is wanted
  std::string variants;            // of the methods, see variants.h; empty: the options as they are
  std::optional<StationRequest> station;  // whose cameras took the images
  std::vector<ExpectedPart> expected_parts;
  // Where in the images parts are looked for, empty or one per image; nullopt: in all of it.
  std::vector<std::optional<SearchedPart>> searched;
  std::vector<SpaceBox> space_boxes;            // to be placed in the images first, see PlaceBoxes
  double unknown_share = kNominalUnknownShare;  // RecognitionOptions::unknown_share
};

// Why an answer is less than objects with poses in every frame that was asked for; see SceneReason
// in recognition.proto.
enum class ReasonKind {
  kNothingFound,
  kAmbiguous,  // objects with alternatives
  kScaleConflict,
  kTooFewFeatures,
  kNoParallax,         // images too alike to measure depth between parts
  kReferenceNotFound,  // objects recognised, the reference is not among them: no base frame
  kReferenceConflict,
  kEmptyCatalog,
  kUnrelatedImages,     // show nothing of what the others show
  kHintContradicted,    // what the caller says of a lens contradicts the images
  kReferenceAmbiguous,  // references leave several poses of the base open: no base frame
};
struct AnswerReason {
  ReasonKind kind = ReasonKind::kNothingFound;
  std::string detail;  // for people
};

// A stage, route or step that was cut short or never begun.
enum class UnsearchedCause { kTime, kCatalogSize, kUnavailable };
struct UnsearchedStep {
  UnsearchedCause cause = UnsearchedCause::kTime;
  std::string step;
};

struct StageReport {
  // features, matching, reconstruction, recognition, euclidean, explanation
  std::string stage;
  double seconds = 0.0;
  std::map<std::string, double> counts;
};

// What else the images leave possible where an object was answered; see SceneAlternative.
struct AnswerAlternative {
  AlternativeKind kind = AlternativeKind::kPose;
  std::string object_id;
  double probability = 0.0;
  std::optional<Rigid3> scene_from_object;
  Eigen::Vector3d feature_place = Eigen::Vector3d::Zero();
  double feature_size_m = 0.0;
  // Where a camera would see it differ most from the answer, and by how much (ViewDifference).
  std::optional<Rigid3> scene_from_camera;
  double differing_px = 0.0;
};

struct AnswerObject {
  std::string object_id;
  int instance = 0;  // 0-based among the objects of the same id, best score first
  double score = 0.0;
  Rigid3 scene_from_object;
  Matrix6d covariance = Matrix6d::Zero();    // see PosedObject
  std::vector<double> view_scores;           // negative: not visible or camera not recovered
  std::vector<std::string> alternatives;     // ids the images do not exclude
  std::vector<AnswerAlternative> left_open;  // likeliest first
  std::vector<SceneGrasp> grasps;            // those that can be reached, surest first
  GraspCounts grasp_counts;                  // what became of the others
  // Per image: covariance of camera_from_object; empty: camera not recovered.
  std::vector<std::optional<Matrix6d>> camera_covariances;
  std::optional<UncertainPose> base_from_object;  // when the base frame is known
};

// A Finding in terms of the answer.
struct AnswerFinding {
  FindingKind kind = FindingKind::kSingleObject;
  std::string object_id;  // empty: of no object
  int instance = 0;
  int image = -1;
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();  // object frame
  double value = 0.0;                                   // see Finding
  double turn_rad = 0.0;                                // of kBaseUncertain, beside its metres
  std::string detail;
};
// What the caller says of an image's lens does not fit the image; what the image shows without it,
// pixels.
struct ContradictedHint {
  int image = -1;
  double focal_px = 0.0;
  Eigen::Vector2d principal_point = Eigen::Vector2d::Zero();
  std::string detail;
};
// A pose of the base that agrees with all that is said of it, by an instance of a reference and one
// of its symmetries (0: identity, k: ObjectModel::symmetries[k-1]).
struct AnswerBase {
  Rigid3 base_from_scene;
  std::string object_id;
  int instance = 0;
  int symmetry = 0;
};
struct AnswerScale {
  ScaleSourceKind kind = ScaleSourceKind::kObject;
  std::string object_id;
  int instance = 0;
  int image = -1;
  double log_ratio = 0.0;  // see ScaleSource
  double log_sigma = 0.0;
  bool agrees = true;
};

// An Explanation in terms of the answer.
struct AnswerExplanation {
  std::string object_id;
  std::string other_id;  // object that has its place; empty: none
  Explanation found;
};

// All that are given, in their order.
std::vector<ReferenceObject> ReferencesOf(const SceneRequest& request);

// Points of edges of one image, pixels.
using EdgeLines = std::vector<std::vector<Eigen::Vector2d>>;

struct SceneAnswer {
  bool time_limited = false;          // it hurried or searched briefly: more time may give more
  std::vector<AnswerReason> reasons;  // each kind at most once; see AddReason
  std::vector<UnsearchedStep> unsearched;
  std::vector<std::optional<PosedCamera>> cameras;     // one per image; empty: not recovered
  std::vector<std::vector<CameraBasis>> camera_bases;  // one list per image, or none
  std::vector<bool> unrelated_images;                  // one per image, or none
  // One per image, or none: whether a focal length that its file gives was believed.
  std::vector<bool> presumed_focal;
  std::vector<AnswerObject> objects;
  // Joint covariance of all scene_from_object, six rows per object in the order of `objects`.
  Eigen::MatrixXd joint_covariance;
  // When a reference was given and found; without one, when posed cameras were recovered.
  std::optional<Rigid3> base_from_scene;
  std::vector<AnswerBase> base_alternatives;  // of kReferenceAmbiguous
  // Where references say that the cameras are in the base, one per image; empty: they leave it
  // open, or there are none. Also where that contradicts the camera poses of the request.
  std::vector<std::optional<UncertainPose>> base_from_camera_by_reference;
  std::optional<ExpectedReport> expected;  // of expected_parts; indices into `objects`
  std::optional<SupportingPlane> plane;    // that the objects stand on, in the scene frame
  std::optional<AnswerExplanation> explanation;
  // One entry per image; empty unless asked for.
  std::vector<EdgeLines> unexplained_edges;
  std::vector<AnswerFinding> findings;
  std::vector<ContradictedHint> contradicted_hints;
  std::vector<AnswerScale> scales;
  std::vector<StageReport> stages;
};

// Adds the reason in the order of ReasonKind; of a kind that is there the details are joined.
void AddReason(ReasonKind kind, const std::string& detail, SceneAnswer* answer);
bool HasReason(const SceneAnswer& answer, ReasonKind kind);
// The details of all reasons, for people.
std::string ReasonsText(const SceneAnswer& answer);

// What every stage saw, for the stage report and overlays.
struct SceneTrace {
  std::vector<ImageFeatures> features;
  MatchingResult matching;
  Reconstruction reconstruction;
  RecognitionResult recognition;
  std::optional<MetricScene> metric;
};

}  // namespace horopter
