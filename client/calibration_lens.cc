#include "client/calibration_lens.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>

#include "absl/strings/str_cat.h"
#include "client/calibration_values.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr size_t kRationalTerms = 8;  // coefficients

bool IsOneOf(const std::string& word, std::initializer_list<const char*> names) {
  // RealSense writes distortion.brown_conrady.
  const std::string plain = PlainWord(word.substr(word.rfind('.') + 1));
  return std::any_of(names.begin(), names.end(), [&](const char* name) { return plain == name; });
}

bool IsFisheyeName(const std::string& model) {
  return IsOneOf(
      model, {"equidistant", "fisheye", "opencvfisheye", "kannalabrandt", "kannalabrandt4", "kb4"});
}

bool IsBrown(const std::string& model) {
  return IsOneOf(model,
                 {"",
                  "plumbbob",
                  "rationalpolynomial",
                  "rational",
                  "radtan",
                  "brownconrady",
                  "opencv",
                  "fullopencv",
                  "none",
                  "null",
                  "pinhole",
                  "brown",
                  "radialtangential"});
}

bool IsModelName(const std::string& word) {
  return IsBrown(word) || IsFisheyeName(word);
}

// k1, k2, .. by their names, in OpenCV's order; nothing where none of them is there.
absl::StatusOr<std::vector<double>> NamedCoefficients(const CameraNode& camera, bool fisheye) {
  std::vector<double> d;
  const std::vector<std::string> names =
      fisheye ? std::vector<std::string>{"k1", "k2", "k3", "k4"}
              : std::vector<std::string>{"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"};
  bool any = false;
  for (const std::string& name : names) {
    // K1 of a stereo file is a matrix.
    const YAML::Node number = FindAround(camera, {name});
    d.push_back(0.0);
    if (!number.IsDefined() || !number.IsScalar()) continue;
    HOROPTER_ASSIGN_OR_RETURN(const auto value, NodeValue<double>(number, name));
    if (!value || !std::isfinite(*value)) return Bad(name, "is not finite");
    d.back() = *value;
    any = true;
  }
  if (!any) d.clear();
  return d;
}

// As MATLAB has it: radial numbers and tangential ones.
absl::StatusOr<std::vector<double>> RadialAndTangential(const CameraNode& camera) {
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<double> radial,
                            FiniteNumbers(FindAround(camera, RadialNames()), "radial_distortion"));
  HOROPTER_ASSIGN_OR_RETURN(
      const std::vector<double> tangential,
      FiniteNumbers(FindAround(camera, TangentialNames()), "tangential_distortion"));
  if (radial.empty() && tangential.empty()) return std::vector<double>();
  if (radial.size() > 6) return Bad("radial_distortion", "more than 6 numbers");
  if (tangential.size() > 2) return Bad("tangential_distortion", "more than 2 numbers");
  std::vector<double> d(kRationalTerms, 0.0);
  for (size_t i = 0; i < radial.size(); ++i) d[i < 2 ? i : i + 2] = radial[i];
  for (size_t i = 0; i < tangential.size(); ++i) d[i + 2] = tangential[i];
  return d;
}

// A lens under a name that is not known must not be left out without a word.
absl::Status CheckNothingIsLeft(const YAML::Node& map) {
  for (const auto& entry : map) {
    if (!entry.first.IsScalar() || entry.second.IsScalar() || entry.second.IsNull()) continue;
    const std::string key = PlainWord(entry.first.Scalar());
    const bool of_lens = (key.find("dist") != key.npos && key.find("distance") == key.npos) ||
                         key.find("radial") != key.npos || key.find("tangential") != key.npos;
    if (!of_lens || IsLensName(key)) continue;
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<double> numbers,
                              FiniteNumbers(entry.second, entry.first.Scalar()));
    const bool zero =
        std::all_of(numbers.begin(), numbers.end(), [](double n) { return n == 0.0; });
    if (zero && (entry.second.IsSequence() || !numbers.empty())) continue;
    return Bad(entry.first.Scalar(),
               "is not read; distortion_coefficients, dist, D, k1, k2, .., radial_distortion and "
               "tangential_distortion are");
  }
  return absl::OkStatus();
}

// The vector of OpenCV, or its numbers by name; a fisheye's k1 .. k4.
absl::StatusOr<std::vector<double>> ReadDistortion(const CameraNode& camera, bool fisheye) {
  constexpr char kField[] = "distortion_coefficients";
  HOROPTER_RETURN_IF_ERROR(CheckNothingIsLeft(camera.node));
  for (const YAML::Node& around : camera.around) {
    if (around.IsMap()) HOROPTER_RETURN_IF_ERROR(CheckNothingIsLeft(around));
  }
  const YAML::Node node = FindAround(camera, DistortionNames());
  std::vector<double> d;
  if (node.IsDefined() && node.IsSequence()) return FiniteNumbers(node, kField);
  if (node.IsDefined() && node.IsMap()) {
    if (node["data"]) return FiniteNumbers(node, kField);
    HOROPTER_ASSIGN_OR_RETURN(d, NamedCoefficients({"", node, "", {}}, fisheye));
    if (d.empty() && node.size() > 0) return Bad(kField, "holds neither a list nor k1, k2, ..");
    return d;
  }
  // The name of a model says nothing of its numbers.
  if (node.IsDefined() && node.IsScalar() && !IsModelName(node.Scalar()))
    return NumbersOfWord(node.Scalar(), kField);
  HOROPTER_ASSIGN_OR_RETURN(d, NamedCoefficients(camera, fisheye));
  if (d.empty() && !fisheye) return RadialAndTangential(camera);
  if (d.empty()) d.assign(4, 0.0);
  return d;
}

absl::StatusOr<bool> IsFisheye(const CameraNode& camera, const std::string& model) {
  const YAML::Node flag = FindAround(camera, {"fisheyemodel", "fisheye"});
  if (!flag.IsDefined() || !flag.IsScalar()) return IsFisheyeName(model);
  const std::string word = PlainWord(flag.Scalar());
  if (word == "1" || word == "true") return true;
  if (word == "0" || word == "false") return IsFisheyeName(model);
  return Bad("fisheye_model", "is neither 0 nor 1");
}

}  // namespace

absl::StatusOr<LensNumbers> LensNumbersOf(const CameraNode& camera) {
  const YAML::Node kind = FindAround(camera, {"cameramodel"});
  HOROPTER_ASSIGN_OR_RETURN(const auto projection, NodeValue<std::string>(kind, "camera_model"));
  if (projection && !IsModelName(*projection))
    return Bad("camera_model", absl::StrCat(*projection, " is not read; pinhole is"));
  const YAML::Node named = FindAround(camera, {"distortionmodel", "distortiontype", "model"});
  HOROPTER_ASSIGN_OR_RETURN(const auto told, NodeValue<std::string>(named, "distortion_model"));
  LensNumbers lens;
  lens.model = told.value_or(projection.value_or(""));
  if (const YAML::Node word = FindAround(camera, DistortionNames());
      lens.model.empty() && word.IsDefined() && word.IsScalar() && IsModelName(word.Scalar()))
    lens.model = word.Scalar();
  HOROPTER_ASSIGN_OR_RETURN(lens.fisheye, IsFisheye(camera, lens.model));
  lens.brown = IsBrown(lens.model);
  HOROPTER_ASSIGN_OR_RETURN(lens.d, ReadDistortion(camera, lens.fisheye));
  return lens;
}

}  // namespace horopter
