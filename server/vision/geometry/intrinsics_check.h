// Whether the numbers of a calibration can be those of a camera: what no real set-up would give is
// refused before anything is computed with it. The program, `station import` and the server ask the
// same questions.
#pragma once

#include <array>
#include <optional>
#include <string>

#include "server/vision/geometry/lens_model.h"

namespace horopter {

// Of fx and fy, one by the other.
inline constexpr double kMostPixelAspect = 2.0;
// Focal lengths in units of the image's longer side: nobody's lens is outside.
inline constexpr double kLeastFocalSides = 0.2, kMostFocalSides = 40.0;

// Row-major, pixels. Empty: it is fx s cx 0 fy cy 0 0 1, its numbers finite and fx, fy positive and
// alike. Else what is wrong with it; a transposed one, one that is 0 throughout and one that is
// scaled are told as such.
std::optional<std::string> FaultOfCameraMatrix(const std::array<double, 9>& K);

enum class LensPart { kFocal, kAspect, kCenter, kCoefficients };
struct LensFault {
  LensPart part = LensPart::kFocal;
  std::string detail;
};

// Empty: an image of this size may have been taken through it. cropped: its centre may be outside.
std::optional<LensFault> FaultOfLens(const LensModel& lens, int width, int height, bool cropped);

}  // namespace horopter
