// What is known about the cameras of a request, from the command line or a dataset.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/bop_dataset.h"
#include "horopter/v1/recognition.pb.h"

namespace horopter {

// Each list is empty, has one entry for all images, or one per image.
struct CameraArguments {
  std::vector<double> focal_px;
  double focal_sigma = 0.0;         // of the log of the focal length; 0: the server's default
  std::vector<std::string> camera;  // FILE or FILE#NAME for ReadCameraFile
  // Seven numbers per camera: x y z (metres) qw qx qy qz of base_from_camera.
  std::vector<double> camera_pose;
  std::vector<double> camera_pose_sigma;  // of all: radians, metres; empty: the server's default
};

// Sets the hints of request->images(), whose contents must be there: a calibration of another size
// is scaled, one with a region or binning is cut and binned. `warnings`: what of the files is not
// used, and what is supposed.
// Errors: INVALID_ARGUMENT (counts that do not fit, both a focal length and a file, a quaternion
// whose norm is not 1, an image that cannot be read), those of ReadCameraFile and ForImages.
absl::Status AddCameraHints(const CameraArguments& arguments,
                            v1::RecognizeSceneRequest* request,
                            std::vector<std::string>* warnings);

// Which of a dataset's true intrinsics a request may tell.
enum class DatasetHints { kNone, kFocal, kTruth };
inline const std::map<std::string, DatasetHints> kHints = {{"none", DatasetHints::kNone},
                                                           {"focal", DatasetHints::kFocal},
                                                           {"truth", DatasetHints::kTruth}};

// kFocal: the focal length; kTruth: principal point and k1 as well. Nothing without a camera.
void AddDatasetHints(DatasetHints hints, const BopImage& image, v1::SceneImage* out);

}  // namespace horopter
