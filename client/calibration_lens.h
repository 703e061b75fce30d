// The lens of one camera of a calibration file, as the file has it.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/calibration_document.h"

namespace horopter {

struct LensNumbers {
  std::string model;  // "": the file names none
  bool fisheye = false;
  bool brown = false;     // a model whose numbers are those of OpenCV, or none is named
  std::vector<double> d;  // in OpenCV's order; of a fisheye k1 .. k4
};

// From a vector, a map or a word of numbers, from k1, k2, .. or as MATLAB has it. Errors:
// INVALID_ARGUMENT naming the field: no numbers, a projection that is no pinhole's, numbers of a
// lens under a name that is not known.
absl::StatusOr<LensNumbers> LensNumbersOf(const CameraNode& camera);

}  // namespace horopter
