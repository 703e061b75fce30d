// Whether the parts that should be in a scene are there: a kit, a tray, a fixture. Pure, on plain
// values; expected_stage.h calls it.
#pragma once

#include <Eigen/Core>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/pose_perturbation.h"

namespace horopter {

// A part, or several of a kind, that should be there; see ExpectedPart in recognition.proto.
struct ExpectedPart {
  std::string object_id;
  int count = 1;                            // more than one only without a place
  std::optional<Rigid3> frame_from_object;  // empty: anywhere
  std::string frame_object;                 // whose frame that is; empty: the robot's base
  double position_tolerance_m = 0.005;
  double rotation_tolerance_rad = 0.1;
  std::string label;
};

enum class ExpectedState { kPresent, kMissing, kDisplaced, kWrongPart, kCannotTell };

struct ExpectedOutcome {
  int expected = 0;                                  // index into the expected parts
  ExpectedState state = ExpectedState::kCannotTell;  // the most probable
  // Their sum is 1.
  double present = 0.0;
  double missing = 0.0;
  double displaced = 0.0;
  double wrong_part = 0.0;
  double cannot_tell = 0.0;
  int found = -1;  // index of the part that was taken for it, or is in its place; -1: none
  // How far that is from where it should be; empty: no part, or no place was said.
  std::optional<double> distance_m;
  std::optional<double> rotation_rad;
  std::string detail;  // for people
};

struct ExpectedReport {
  std::vector<ExpectedOutcome> outcomes;  // one per part, in the order of the expected ones
  double all_present = 1.0;
  std::vector<int> unexpected;  // parts that nobody expects: neither frames nor references
};

// What is known of a kind of part. center and radius_m: a ball about it, in its frame.
struct KnownShape {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  double radius_m = 0.0;
  std::vector<Rigid3> symmetries;  // without the identity
};

struct FoundPart {
  std::string object_id;
  double score = 0.0;  // probability that object and pose are right
  Rigid3 scene_from_object;
  std::vector<std::string> alternatives;  // what images do not tell it from
  bool is_reference = false;              // expected by the request in another way
};

struct SeeingCamera {
  PinholeCamera camera;
  Rigid3 camera_from_scene;
};

// A scene as it was answered.
struct ExpectedScene {
  std::vector<FoundPart> parts;
  // Of all parts, six rows each, in the scene's axes (perturbation of scene_from_object); empty:
  // the poses are exact.
  Eigen::MatrixXd joint_covariance;
  std::optional<Rigid3> base_from_scene;
  // Per part, of its pose in the base, in the scene's axes; empty: as in the scene.
  std::vector<Matrix6d> covariances_in_base;
  std::vector<SeeingCamera> cameras;         // those recovered
  bool searched = true;                      // false: time ran short, or the images show too little
  std::map<std::string, KnownShape> shapes;  // by id, of all parts and expected parts
};

// Every expected part is matched with at most one that was found, the nearest pairs first: those in
// their places, then those elsewhere, but for places that others' parts are in. What was found is
// present with its score times the probability, by its covariance, that it is within the
// tolerances. What was not found is missing as far as recognition finds what the images show of its
// place (kFoundShare).
ExpectedReport JudgeExpected(const std::vector<ExpectedPart>& expected, const ExpectedScene& scene);

// Share of the parts in sight that recognition finds: parts-dev and cad-dev, recall 0.94 and 0.92
// with three to six images (docs/benchmarks.md); of what one image alone shows less.
inline constexpr double kFoundShare = 0.9;
inline constexpr double kFoundShareInOneImage = 0.6;

}  // namespace horopter
