#include "client/answer_text.h"

#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace horopter {

std::string OutcomeText(const v1::RecognizeSceneResponse& response) {
  constexpr size_t kPrefix = sizeof("KIND_") - 1;
  std::string text = response.objects_size() > 0 ? "RECOGNIZED" : "";
  const auto add = [&](const std::string& word) {
    absl::StrAppend(&text, text.empty() ? "" : ",", word);
  };
  for (const v1::SceneReason& reason : response.reasons()) {
    const std::string& name = v1::SceneReason::Kind_Name(reason.kind());
    add(name.empty() ? "UNKNOWN" : name.substr(kPrefix));
  }
  if (response.completeness() == v1::COMPLETENESS_TIME_LIMITED) add("TIME_LIMITED");
  return text.empty() ? "UNKNOWN" : text;
}

std::string FindingName(const v1::SceneFinding& finding) {
  const auto* field = v1::SceneFinding::descriptor()->FindFieldByNumber(finding.finding_case());
  return field == nullptr ? "UNKNOWN" : absl::AsciiStrToUpper(field->name());
}

std::string CameraText(const v1::Camera& camera) {
  if (!camera.recovered()) {
    return absl::StrCat("camera not recovered",
                        camera.unrelated() ? "; shows nothing of what the other images show" : "");
  }
  constexpr size_t kPrefix = sizeof("SOURCE_") - 1;
  std::string text = absl::StrFormat(
      "focal length %.0f px (+- %.1f %%)", camera.focal_px(), camera.focal_log_sigma() * 100.0);
  const char* before = "; camera by ";
  for (const v1::CameraBasis& basis : camera.bases()) {
    const std::string& name = v1::CameraBasis::Source_Name(basis.source());
    absl::StrAppend(&text,
                    std::exchange(before, ", "),
                    name.empty() ? "unknown" : absl::AsciiStrToLower(name.substr(kPrefix)));
    if (basis.matches() > 0)
      absl::StrAppendFormat(&text, " %d (%.1f px)", basis.matches(), basis.rms_px());
  }
  return text;
}

std::string GripperText(const v1::RecognizedGrasp& grasp) {
  constexpr double kMm = 1e3;
  return grasp.has_suction()
             ? absl::StrFormat("cup of radius %.0f", grasp.suction().cup_radius_m() * kMm)
             : absl::StrFormat("opening %.0f", grasp.parallel_jaw().jaw_opening_m() * kMm);
}

}  // namespace horopter
