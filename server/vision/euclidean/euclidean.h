// One metric frame for cameras and objects, with covariance (thesis 5).
#pragma once

#include <Eigen/Core>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/base/stop_token.h"
#include "server/vision/euclidean/camera_group.h"
#include "server/vision/euclidean/findings.h"
#include "server/vision/euclidean/grasps.h"
#include "server/vision/euclidean/lens_terms.h"
#include "server/vision/euclidean/scene_covariance.h"
#include "server/vision/euclidean/shared_camera.h"
#include "server/vision/euclidean/supporting_plane_search.h"
#include "server/vision/euclidean/texture_points.h"
#include "server/vision/euclidean/transform_graph.h"
#include "server/vision/geometry/pose_perturbation.h"
#include "server/vision/recognition/recognition.h"

namespace horopter {

struct PosedCamera : CalibratedCamera {
  double focal_log_sigma = 0.0;
  LensTerms lens;  // beyond camera.k1
};

struct PosedObject {
  int object = -1;  // of the catalog
  Rigid3 scene_from_object;
  // Of the perturbation of scene_from_object (see pose_perturbation.h). The scene frame is the
  // first object's: its own covariance is zero.
  Matrix6d covariance = Matrix6d::Zero();
  double score = 0.0;
  std::vector<double> view_scores;
  std::vector<int> alternatives;
  std::vector<SceneAlternative> left_open;
  int edge_observations = 0;
  double rms_px = 0.0;
};

// How the edges of the parts fit one image.
struct ViewFit {
  int edge_points = 0;
  double rms_px = 0.0;
};

struct MetricScene {
  std::vector<std::optional<PosedCamera>> cameras;
  std::vector<PosedObject> objects;
  SceneCovariance covariance;  // joint, of cameras and objects; indices as above
  std::optional<SupportingPlane> plane;
  std::vector<ScaleSource> scales;  // objects, then focal lengths that were given
  std::vector<Finding> findings;
  // Of the cameras, by the data alone; empty without EuclideanOptions::camera_evidence.
  CameraEvidence evidence;
  std::vector<ViewFit> view_fits;  // per image
  double rms_px = 0.0;
  std::map<std::string, double> counts;
};

struct EuclideanOptions {
  double focal_start_widths = 1.5;      // middle of the prior on f, in image widths
  double focal_log_sigma = 0.35;        // weak prior on log f about its start
  double principal_point_sigma = 0.01;  // of the image width, prior on the offset from the centre
  double search_px = 4.0;               // edge points are looked for this far along the edge normal
  double edge_sigma_px = 0.15;          // of one edge point; the residual rescales it
  int rounds = 3;                       // re-association rounds
  // Edge samples of an object used per view; more: slower, hardly better (neighbours err in
  // common).
  int samples_per_view = 160;
  SceneBundleOptions bundle;  // of a round
  PlaneCellOptions plane;
  TexturePointOptions texture;
  // Plane and texture count as this many times less sure per round that is still to come: the
  // cameras recognition hands over are off by many of their deviations.
  double plane_slack = 4.0;
  SharedCameraOptions cameras;
  LensTermOptions lens;
  NoiseOptions noise;
  FindingOptions findings;
  MisfitAcceptance misfits;  // of AcceptanceOptions
  GraspOptions grasps;
  bool camera_evidence = false;  // MetricScene::evidence is wanted: as dear as the covariance
  int threads = 1;               // cores to use; the result does not depend on it
};

// Joint bundle adjustment of focal lengths, camera poses and object poses on the CAD edges seen in
// the images, the plane's matched points and, of a trusted reconstruction from texture
// (input.reconstruction), its points. Objects that do not fit the cameras of two or more
// others are left out and named in the findings. Views that come from one camera get one set of
// intrinsics (JudgeCameras; counts["views_of_one_camera"]). Lenses that edges and plane prove to
// have more than k1 get it (FitLensTerms; counts["lens_terms"], of views). Of the equivalent poses
// of a symmetric object the one of RepresentativePose is answered. The scene frame is that of the
// first object. Errors: INVALID_ARGUMENT, CANCELLED, FAILED_PRECONDITION (no object, no camera, too
// few edges).
absl::StatusOr<MetricScene> RefineMetricScene(const RecognitionInput& input,
                                              const RecognitionResult& recognition,
                                              const EuclideanOptions& options,
                                              const StopRequested& stop = {});

// The same where the cameras are known as a group (a calibrated station): its prior takes the place
// of the weak ones and of the request's hints, and no view is asked whose camera took it.
// Errors: also INVALID_ARGUMENT (the group has a view that recognition has not).
absl::StatusOr<MetricScene> RefineMetricScene(const RecognitionInput& input,
                                              const RecognitionResult& recognition,
                                              const CameraGroupPrior& group,
                                              const EuclideanOptions& options,
                                              const StopRequested& stop = {});

// What recognition would have said, had it known the adjusted scene: to adjust it again.
RecognitionResult AsRecognized(const MetricScene& metric, RecognitionResult recognition);

// Frames of a metric scene in a transformation graph.
struct SceneFrames {
  int scene = -1;
  std::vector<int> cameras;  // per view, -1: not recovered
  std::vector<int> objects;
};
// Adds the scene's frames with their joint covariance to the graph. Poses relative to a camera hold
// that camera's uncertainty too.
SceneFrames AddSceneFrames(const MetricScene& metric, TransformGraph* graph);

}  // namespace horopter
