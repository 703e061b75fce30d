#include "client/answer_text.h"

#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/convert.h"

namespace horopter {
namespace {

std::string PlaceText(const Eigen::Vector3d& place_m) {
  const Eigen::Vector3d mm = place_m * 1e3;
  return absl::StrFormat("(%.1f, %.1f, %.1f)", mm.x(), mm.y(), mm.z());
}

std::string NameOfAlternative(const v1::ObjectAlternative& a) {
  const std::string id = IdOfResource(a.object());
  switch (a.kind()) {
    case v1::ObjectAlternative::KIND_POSE:
      return absl::StrCat(id, " in another pose");
    case v1::ObjectAlternative::KIND_MIRROR_IMAGE:
      return absl::StrCat("the mirror image of ", id, ", which is not enrolled");
    case v1::ObjectAlternative::KIND_STRETCHED:
      return absl::StrCat("something like ", id, ", but stretched");
    case v1::ObjectAlternative::KIND_FEATURE:
      return absl::StrFormat("something that differs from %s by a feature %.1f mm large at %s",
                             id,
                             a.feature_size_m() * 1e3,
                             PlaceText(FromProto(a.feature_place())));
    case v1::ObjectAlternative::KIND_SIZE:
      return absl::StrCat(id, ", which is the same in another size");
    default:
      return id;
  }
}

}  // namespace

std::string AlternativeText(const v1::ObjectAlternative& alternative,
                            const Rigid3& frame_from_scene) {
  std::string text = NameOfAlternative(alternative);
  if (alternative.probability() > 0)
    absl::StrAppendFormat(&text, " (%.2f)", alternative.probability());
  if (alternative.has_scene_from_camera()) {
    const Rigid3 camera = frame_from_scene * FromProto(alternative.scene_from_camera());
    absl::StrAppend(&text, ": an image from ", PlaceText(camera.t), " would tell");
  }
  return text;
}

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

std::string OpenCamerasText(const v1::RecognizeSceneResponse& response) {
  for (const v1::StageReport& stage : response.stages()) {
    const auto solutions = stage.counts().find("texture_solutions");
    if (solutions == stage.counts().end() || !(solutions->second > 1.0)) continue;
    return absl::StrFormat(
        "cameras: texture alone leaves %.0f solutions open; the one whose parts more images show "
        "was taken",
        solutions->second);
  }
  return "";
}

std::string GripperText(const v1::RecognizedGrasp& grasp) {
  constexpr double kMm = 1e3;
  return grasp.has_suction()
             ? absl::StrFormat("cup of radius %.0f", grasp.suction().cup_radius_m() * kMm)
             : absl::StrFormat("opening %.0f", grasp.parallel_jaw().jaw_opening_m() * kMm);
}

}  // namespace horopter
