// Calibration files of other programs as one tree, whatever they are written in.
#pragma once

#include <yaml-cpp/yaml.h>

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

// The forms that are read, for messages.
inline constexpr char kCalibrationForms[] =
    "read are camera_info of ROS, calibrations of OpenCV (YAML, XML, JSON, lists of Python), "
    "camera.json of BOP, camchain of Kalibr and cameras.txt of COLMAP";

// YAML and JSON as they are; XML as OpenCV's FileStorage has it; lines of COLMAP's cameras.txt as a
// map of cameras by their ids, in pixels whose first centre is (0, 0).
// Errors: INVALID_ARGUMENT (in none of these forms), without the file's name.
absl::StatusOr<YAML::Node> ParseCalibration(const std::string& text);

// A camera of such a tree.
struct CameraNode {
  std::string name;    // that it is asked for by; empty: the only one of its kind
  YAML::Node node;     // a map
  std::string suffix;  // of its keys in that map, e.g. "1" of M1 and D1; or its prefix, "left"
  std::vector<YAML::Node> around;  // maps that it stands in, which may say the images' size
};

// All cameras of a tree, in its order; maps that hold others are looked into.
std::vector<CameraNode> CamerasIn(const YAML::Node& root);

// What a camera says under any of these names (lower-case, without _, - and spaces); not defined:
// nothing.
YAML::Node Find(const CameraNode& camera, const std::vector<std::string>& names);
// The same, of the maps that it stands in too.
YAML::Node FindAround(const CameraNode& camera, const std::vector<std::string>& names);

// All numbers of a list, of a list of lists, or of a map with `data`, in their order. Throws
// YAML::Exception where something is no number; empty where the node is of another kind.
std::vector<double> NumbersOf(const YAML::Node& node);

// Names of a camera matrix and of distortion coefficients.
const std::vector<std::string>& MatrixNames();
const std::vector<std::string>& DistortionNames();
const std::vector<std::string>& RadialNames();
const std::vector<std::string>& TangentialNames();
// Whether a key (PlainWord) is one of the last three, of whatever side.
bool IsLensName(const std::string& key);

// Lower-case, without _, - and spaces.
std::string PlainWord(const std::string& word);

}  // namespace horopter
