#include "client/calibration_camera.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/calibration_lens.h"
#include "client/calibration_values.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/intrinsics_check.h"

namespace horopter {
namespace {

constexpr double kSquare = 0.005;   // |log(fx / fy)| below which pixels count as square
constexpr double kLeftOutPx = 1.0;  // what may be left out of a lens, or of a skew
constexpr double kMostSide = 1e6;   // of an image, pixels
// Of a distortion vector of OpenCV: the rational model, then thin prism and tilt.
constexpr size_t kRational = 8, kThinPrism = 12, kTilted = 14;

// A camera as its file has it.
struct Calibration {
  int width = 0, height = 0;
  std::array<double, 9> K{};
  LensModel lens;
  std::optional<ImageRegion> region;
  std::vector<std::string> warnings;
};

// Of an image's side: 640, or 640.0 as Python writes it. 0: the node is not there.
absl::StatusOr<int> SideOf(const YAML::Node& node, const std::string& field) {
  HOROPTER_ASSIGN_OR_RETURN(const auto value, NodeValue<double>(node, field));
  if (!value) return 0;
  if (!(*value >= 0.0 && *value <= kMostSide) || *value != std::floor(*value))
    return Bad(field, "is no number of pixels");
  return static_cast<int>(*value);
}

// Width and height in one: two numbers, a map, or a word as 640x480.
absl::Status ReadBothSides(const YAML::Node& both, Calibration* out) {
  if (!both.IsDefined() || both.IsNull()) return absl::OkStatus();
  if (both.IsMap()) {
    const CameraNode map{"", both, "", {}};
    HOROPTER_ASSIGN_OR_RETURN(out->width, SideOf(Find(map, {"width", "w"}), "image_size.width"));
    HOROPTER_ASSIGN_OR_RETURN(out->height, SideOf(Find(map, {"height", "h"}), "image_size.height"));
    return absl::OkStatus();
  }
  std::vector<double> numbers;
  if (both.IsScalar()) {
    HOROPTER_ASSIGN_OR_RETURN(numbers, NumbersOfWord(both.Scalar(), "image_size"));
  } else {
    HOROPTER_ASSIGN_OR_RETURN(numbers, FiniteNumbers(both, "image_size"));
  }
  if (numbers.size() != 2 ||
      !(numbers[0] >= 1 && numbers[0] <= kMostSide && numbers[1] >= 1 && numbers[1] <= kMostSide))
    return Bad("image_size", "is not width and height");
  out->width = static_cast<int>(numbers[0]);
  out->height = static_cast<int>(numbers[1]);
  return absl::OkStatus();
}

absl::Status ReadSize(const CameraNode& camera, Calibration* out) {
  HOROPTER_ASSIGN_OR_RETURN(
      out->width, SideOf(FindAround(camera, {"imagewidth", "width", "imgwidth"}), "image_width"));
  HOROPTER_ASSIGN_OR_RETURN(
      out->height,
      SideOf(FindAround(camera, {"imageheight", "height", "imgheight"}), "image_height"));
  if (out->width > 0 && out->height > 0) return absl::OkStatus();
  if (const YAML::Node w = Find(camera, {"w"}), h = Find(camera, {"h"});
      w.IsDefined() && h.IsDefined() && w.IsScalar() && h.IsScalar()) {
    HOROPTER_ASSIGN_OR_RETURN(out->width, SideOf(w, "w"));
    HOROPTER_ASSIGN_OR_RETURN(out->height, SideOf(h, "h"));
    return absl::OkStatus();
  }
  return ReadBothSides(
      FindAround(camera, {"imagesize", "resolution", "imgsize", "imageresolution", "size"}), out);
}

absl::Status ReadMatrix(const CameraNode& camera, Calibration* out) {
  std::vector<std::string> names = MatrixNames();
  names.push_back("m");  // M1 and M2 of OpenCV's stereo sample
  std::vector<double> K;
  if (const YAML::Node node = Find(camera, names); node.IsSequence() || node.IsMap()) {
    HOROPTER_ASSIGN_OR_RETURN(K, FiniteNumbers(node, "camera_matrix"));
  } else {
    for (const std::vector<std::string>& name : std::vector<std::vector<std::string>>{
             {"fx", "f"}, {"fy", "fx", "f"}, {"cx", "ppx"}, {"cy", "ppy"}}) {
      HOROPTER_ASSIGN_OR_RETURN(const auto value,
                                NodeValue<double>(Find(camera, name), name.front()));
      if (!value) return Bad(name.front(), "is missing");
      K.push_back(*value);
    }
  }
  // fx, fy, cx, cy, as Kalibr and BOP have them.
  if (K.size() == 4) K = {K[0], 0.0, K[2], 0.0, K[1], K[3], 0.0, 0.0, 1.0};
  if (K.size() != 9)
    return Bad("camera_matrix (or K)", absl::StrCat("needs 9 numbers, not ", K.size()));
  std::copy(K.begin(), K.end(), out->K.begin());
  if (const auto fault = FaultOfCameraMatrix(out->K)) return Bad("camera_matrix (or K)", *fault);
  out->lens.fx = K[0];
  out->lens.fy = K[4];
  out->lens.cx = K[2];
  out->lens.cy = K[5];
  return absl::OkStatus();
}

// What of OpenCV's thin prism and tilt moves pixels by so little that it can be left out.
absl::Status LeaveOut(const std::vector<double>& d,
                      const Calibration& of,
                      LensModel* lens,
                      std::vector<std::string>* warnings) {
  const auto at = [&](size_t i) { return i < d.size() ? std::abs(d[i]) : 0.0; };
  const double width = of.width > 0 ? of.width : 2.0 * lens->cx;
  const double height = of.height > 0 ? of.height : 2.0 * lens->cy;
  const double r2 = std::pow(std::max(lens->cx, width - lens->cx) / lens->fx, 2) +
                    std::pow(std::max(lens->cy, height - lens->cy) / lens->fy, 2);
  double normalized = r2 * std::hypot(at(8) + r2 * at(9), at(10) + r2 * at(11));
  for (size_t i = kThinPrism; i < kTilted; ++i) normalized += r2 * at(i);
  const double px = normalized * std::max(lens->fx, lens->fy);
  if (px == 0.0) return absl::OkStatus();
  const std::string what =
      absl::StrFormat("thin prism and tilt (coefficients 9 to 14) move pixels by up to %.2g", px);
  if (px > kLeftOutPx) {
    return Bad("distortion_coefficients",
               absl::StrCat(what,
                            " and are not read; calibrate once more with up to eight coefficients "
                            "(CALIB_RATIONAL_MODEL) or the fisheye model"));
  }
  warnings->push_back(absl::StrCat(what, " and are not used"));
  return absl::OkStatus();
}

absl::Status ReadLens(const CameraNode& camera, Calibration* out) {
  HOROPTER_ASSIGN_OR_RETURN(const LensNumbers numbers, LensNumbersOf(camera));
  const std::vector<double>& d = numbers.d;
  const bool zero = std::all_of(d.begin(), d.end(), [](double c) { return c == 0.0; });
  LensModel& lens = out->lens;
  if (numbers.fisheye) {
    lens.kind = LensModel::Kind::kEquidistant;
    if (d.size() < 4 || std::any_of(d.begin() + 4, d.end(), [](double c) { return c != 0.0; })) {
      return Bad(
          "distortion_coefficients",
          absl::StrCat("an equidistant (fisheye) lens needs 4 coefficients, not ", d.size()));
    }
    std::copy_n(d.begin(), 4, lens.coefficients.begin());
    return absl::OkStatus();
  }
  if (zero) return absl::OkStatus();
  if (!numbers.brown) {
    return Bad("distortion_model",
               absl::StrCat(numbers.model,
                            " is not read; plumb_bob, rational_polynomial and equidistant are, and "
                            "any where all coefficients are 0"));
  }
  if (d.size() > kTilted)
    return Bad("distortion_coefficients", absl::StrCat(d.size(), " numbers, more than 14"));
  std::copy_n(d.begin(), std::min<size_t>(d.size(), 5), lens.coefficients.begin());
  for (size_t i = 5; i < std::min(d.size(), kRational); ++i) lens.denominator[i - 5] = d[i];
  return LeaveOut(d, *out, &lens, &out->warnings);
}

absl::Status ReadRegion(const CameraNode& camera, Calibration* out) {
  ImageRegion region;
  const auto number =
      [](const YAML::Node& node, const std::string& field, int* to) -> absl::Status {
    HOROPTER_ASSIGN_OR_RETURN(const auto value, NodeValue<int>(node, field));
    if (value && *value < 0) return Bad(field, "is negative");
    *to = value.value_or(0);
    return absl::OkStatus();
  };
  HOROPTER_RETURN_IF_ERROR(number(Find(camera, {"binningx"}), "binning_x", &region.binning_x));
  HOROPTER_RETURN_IF_ERROR(number(Find(camera, {"binningy"}), "binning_y", &region.binning_y));
  region.binning_x = std::max(1, region.binning_x);
  region.binning_y = std::max(1, region.binning_y);
  const YAML::Node roi = Find(camera, {"roi"});
  if (roi.IsDefined() && roi.IsSequence() && roi.size() > 0)
    return Bad("roi", "is a list; x_offset, y_offset, width and height are read");
  if (roi.IsDefined() && roi.IsMap()) {
    HOROPTER_RETURN_IF_ERROR(number(roi["x_offset"], "roi.x_offset", &region.x));
    HOROPTER_RETURN_IF_ERROR(number(roi["y_offset"], "roi.y_offset", &region.y));
    HOROPTER_RETURN_IF_ERROR(number(roi["width"], "roi.width", &region.width));
    HOROPTER_RETURN_IF_ERROR(number(roi["height"], "roi.height", &region.height));
  }
  const auto beyond = [](int offset, int size, int all) {
    return all > 0 && (offset >= all || size > all - offset);
  };
  if (beyond(region.x, region.width, out->width) || beyond(region.y, region.height, out->height))
    return Bad("roi", absl::StrFormat("is not within %d x %d", out->width, out->height));
  const bool all = region.x == 0 && region.y == 0 &&
                   (region.width == 0 || region.width == out->width) &&
                   (region.height == 0 || region.height == out->height);
  if (!all || region.binning_x > 1 || region.binning_y > 1) out->region = region;
  return absl::OkStatus();
}

// Largest shift, over the image, by what k1 alone leaves out of the lens; pixels.
double LeftOutPx(const Calibration& c) {
  constexpr int kSteps = 8;
  const double width = c.width > 0 ? c.width : 2.0 * c.lens.cx + 1.0;
  const double height = c.height > 0 ? c.height : 2.0 * c.lens.cy + 1.0;
  LensModel whole = c.lens;
  whole.fx = whole.fy = std::sqrt(c.lens.fx * c.lens.fy);
  LensModel simple = whole;
  simple.coefficients = {whole.coefficients[0], 0.0, 0.0, 0.0, 0.0};
  simple.denominator = {};
  double worst = 0.0;
  for (int i = 0; i <= kSteps; ++i) {
    for (int k = 0; k <= kSteps; ++k) {
      const Eigen::Vector2d ray((i * (width - 1.0) / kSteps - whole.cx) / whole.fx,
                                (k * (height - 1.0) / kSteps - whole.cy) / whole.fx);
      worst = std::max(worst, (DistortedPixel(whole, ray) - DistortedPixel(simple, ray)).norm());
    }
  }
  return worst;
}

absl::StatusOr<CameraFile> FileOf(Calibration c) {
  CameraFile camera;
  camera.width = c.width;
  camera.height = c.height;
  camera.focal_px = std::sqrt(c.lens.fx * c.lens.fy);
  camera.cx = c.lens.cx;
  camera.cy = c.lens.cy;
  camera.region = c.region;
  camera.warnings = std::move(c.warnings);
  const bool fisheye = c.lens.kind == LensModel::Kind::kEquidistant;
  camera.k1 = fisheye ? 0.0 : c.lens.coefficients[0];
  if (fisheye || std::abs(std::log(c.lens.fx / c.lens.fy)) > kSquare ||
      !(LeftOutPx(c) <= kLeftOutPx)) {
    camera.lens = LensFile{c.lens.fx, c.lens.fy, fisheye, c.lens.coefficients, c.lens.denominator};
  }
  const double height = c.height > 0 ? c.height : 2.0 * c.lens.cy + 1.0;
  const double skew_px = std::abs(c.K[1]) * std::max(c.lens.cy, height - c.lens.cy) / c.lens.fy;
  if (skew_px > kLeftOutPx) {
    return Bad("camera_matrix (or K)",
               absl::StrFormat("the skew %.6g moves pixels by up to %.2g and is not taken: "
                               "calibrate without it",
                               c.K[1],
                               skew_px));
  }
  if (c.K[1] != 0.0) camera.warnings.push_back("the skew is not used");
  return camera;
}

}  // namespace

absl::StatusOr<CameraFile> CameraOf(const CameraNode& node) {
  Calibration c;
  HOROPTER_RETURN_IF_ERROR(ReadSize(node, &c));
  HOROPTER_RETURN_IF_ERROR(ReadMatrix(node, &c));
  HOROPTER_RETURN_IF_ERROR(ReadLens(node, &c));
  HOROPTER_RETURN_IF_ERROR(ReadRegion(node, &c));
  return FileOf(std::move(c));
}

}  // namespace horopter
