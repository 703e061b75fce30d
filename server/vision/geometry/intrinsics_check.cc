#include "server/vision/geometry/intrinsics_check.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"

namespace horopter {
namespace {

// Of a number that should be 0 or 1, in units of the focal length: files are rounded.
constexpr double kZero = 1e-6;
// Of a cut-out, how many times smaller it may be than its image.
constexpr double kCutOut = 10.0;

bool AreAlike(double fx, double fy) {
  return fx <= kMostPixelAspect * fy && fy <= kMostPixelAspect * fx;
}

}  // namespace

std::optional<std::string> FaultOfCameraMatrix(const std::array<double, 9>& K) {
  if (!std::all_of(K.begin(), K.end(), [](double k) { return std::isfinite(k); }))
    return "a number is not finite";
  if (std::all_of(K.begin(), K.end(), [](double k) { return k == 0.0; }))
    return "all numbers are 0: the camera is not calibrated";
  const double zero = kZero * std::max({1.0, std::abs(K[0]), std::abs(K[4])});
  const auto is_zero = [&](int i) { return std::abs(K[i]) <= zero; };
  const bool one = std::abs(K[8] - 1.0) <= kZero;
  if (one && is_zero(2) && is_zero(5) && (!is_zero(6) || !is_zero(7)))
    return "is transposed (or written column by column): the centre stands in the last row; rows "
           "are fx s cx, 0 fy cy, 0 0 1";
  if (!one || std::abs(K[6]) > kZero || std::abs(K[7]) > kZero || !is_zero(3))
    return "is not fx s cx, 0 fy cy, 0 0 1";
  if (!(K[0] > 0.0 && K[4] > 0.0)) return "focal lengths must be positive";
  if (!AreAlike(K[0], K[4])) {
    return absl::StrFormat("focal lengths %.6g and %.6g: one is more than %.0f times the other",
                           K[0],
                           K[4],
                           kMostPixelAspect);
  }
  return std::nullopt;
}

std::optional<LensFault> FaultOfLens(const LensModel& lens, int width, int height, bool cropped) {
  const double side = std::max(width, height);
  const double most = kMostFocalSides * (cropped ? kCutOut : 1.0);
  if (!(lens.fx >= kLeastFocalSides * side && lens.fx <= most * side)) {
    return LensFault{
        LensPart::kFocal,
        absl::StrFormat("a focal length of %.6g pixels is not that of an image of %d x "
                        "%d: %.6g to %.6g can be",
                        lens.fx,
                        width,
                        height,
                        kLeastFocalSides * side,
                        most * side)};
  }
  if (!AreAlike(lens.fx, lens.fy)) {
    return LensFault{LensPart::kAspect,
                     absl::StrFormat("%.6g does not go with %.6g: pixels are not more than %.0f "
                                     "times as long as wide",
                                     lens.fy,
                                     lens.fx,
                                     kMostPixelAspect)};
  }
  if (!std::isfinite(lens.cx) || !std::isfinite(lens.cy))
    return LensFault{LensPart::kCenter, "the principal point is not finite"};
  const bool inside =
      lens.cx >= -0.5 && lens.cx <= width - 0.5 && lens.cy >= -0.5 && lens.cy <= height - 0.5;
  if (!inside && !cropped) {
    return LensFault{LensPart::kCenter,
                     absl::StrFormat("the principal point %.6g, %.6g is outside of the image of %d "
                                     "x %d, which is not said to be cropped",
                                     lens.cx,
                                     lens.cy,
                                     width,
                                     height)};
  }
  if (FoldsImage(lens, width, height))
    return LensFault{LensPart::kCoefficients,
                     "the lens coefficients fold the image: towards its corners they take the same "
                     "pixels twice"};
  return std::nullopt;
}

}  // namespace horopter
