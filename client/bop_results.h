// Result files in BOP format: poses as CSV, recovered intrinsics as a JSON file beside it.
#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// One row: an instance of an object in one image.
struct BopEstimate {
  int scene_id = 0;
  int im_id = 0;
  int obj_id = 0;
  double score = 0.0;
  Rigid3 camera_from_object;  // metres; mm in the file
  double time_s = -1.0;       // for the whole image set of the scene; -1: not known
};

using BopCameras = std::map<int, std::map<int, Eigen::Matrix3d>>;  // scene -> image -> K
// scene -> image -> k1 k2 p1 p2 .., as cam_dist; any number of them.
using BopDistortions = std::map<int, std::map<int, std::vector<double>>>;

struct BopResults {
  std::vector<BopEstimate> estimates;
  BopCameras cameras;
  BopDistortions distortions;  // of images in `cameras`; absent: none
};

// "results.csv" -> "results.cameras.json".
std::string CamerasPathOf(const std::string& csv_path);

// Writes both files, each through a temporary file that is renamed at the end: a reader sees the
// old or the new content, never a part. Errors: PERMISSION_DENIED (cannot be written).
absl::Status WriteBopResults(const BopResults& results, const std::string& csv_path);

// Reads the CSV and, when it is there, the cameras file.
// Errors: NOT_FOUND, INVALID_ARGUMENT naming file and line.
absl::StatusOr<BopResults> ReadBopResults(const std::string& csv_path);

// Whether WriteFileAtomically could write there, before the work for it is done; nothing stays.
// Errors: NOT_FOUND (no such folder), PERMISSION_DENIED.
absl::Status CheckCanBeWritten(const std::string& path);

// Writes a file through a temporary sibling and a rename. Errors: PERMISSION_DENIED.
absl::Status WriteFileAtomically(const std::string& path, const std::string& content);

}  // namespace horopter
