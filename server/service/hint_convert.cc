#include "server/service/hint_convert.h"

#include <cmath>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "horopter/v1/recognition.pb.h"
#include "server/base/status_macros.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"
#include "server/vision/geometry/intrinsics_check.h"

namespace horopter {
namespace {

constexpr double kMaxFocalLogSigma = 2.0;
constexpr double kMaxDistortion = 10.0;
constexpr double kMaxRationalDistortion = 100.0;  // numerator and denominator compensate
constexpr double kMaxGripperM = 1.0;

bool IsRational(const v1::CameraHint& proto) {
  return proto.has_k4() || proto.has_k5() || proto.has_k6();
}

const char* FieldOf(LensPart part) {
  switch (part) {
    case LensPart::kFocal:
      return ".focal_px";
    case LensPart::kAspect:
      return ".focal_y_px";
    case LensPart::kCenter:
      return ".principal_point_x_px";
    case LensPart::kCoefficients:
      return ".k1";
  }
  return "";
}

absl::Status CheckLens(const LensModel& lens, const HintedImage& image, const std::string& field) {
  const std::optional<LensFault> fault =
      FaultOfLens(lens, image.width, image.height, image.cropped);
  if (!fault) return absl::OkStatus();
  const bool fisheye = lens.kind == LensModel::Kind::kEquidistant;
  const char* const at =
      fisheye && fault->part == LensPart::kCoefficients ? ".fisheye" : FieldOf(fault->part);
  return InvalidField(field + at, fault->detail);
}

}  // namespace

absl::StatusOr<CameraHint> HintFromProto(const v1::CameraHint& proto,
                                         const HintedImage& image,
                                         const std::string& field) {
  CameraHint hint;
  LensModel lens;  // as far as it is told
  lens.fx = lens.fy = kNominalFocalShare * std::max(image.width, image.height);
  lens.cx = 0.5 * (image.width - 1);
  lens.cy = 0.5 * (image.height - 1);
  if (proto.has_focal_px()) {
    if (!(proto.focal_px() > 0.0 && std::isfinite(proto.focal_px()))) {
      return InvalidField(field + ".focal_px",
                          absl::StrCat(proto.focal_px(), " is not a focal length in pixels"));
    }
    hint.focal_px = lens.fx = lens.fy = proto.focal_px();
  }
  if (proto.has_focal_y_px() && !proto.has_focal_px()) {
    return InvalidField(field + ".focal_y_px", "set without focal_px");
  }
  if (proto.has_focal_log_sigma()) {
    if (!hint.focal_px) return InvalidField(field + ".focal_log_sigma", "set without focal_px");
    if (!(proto.focal_log_sigma() > 0.0 && proto.focal_log_sigma() <= kMaxFocalLogSigma)) {
      return InvalidField(
          field + ".focal_log_sigma",
          absl::StrCat(proto.focal_log_sigma(), " is outside 0..", kMaxFocalLogSigma));
    }
    hint.focal_log_sigma = proto.focal_log_sigma();
  }
  if (proto.has_principal_point_x_px() != proto.has_principal_point_y_px()) {
    return InvalidField(field + ".principal_point_x_px", "x and y must be set together");
  }
  if (proto.has_principal_point_x_px()) {
    const Eigen::Vector2d point(proto.principal_point_x_px(), proto.principal_point_y_px());
    if (!point.allFinite()) return InvalidField(field + ".principal_point_x_px", "not finite");
    hint.principal_point = point;
    lens.cx = point.x();
    lens.cy = point.y();
  }
  if (proto.has_k1()) {
    const double most = IsRational(proto) ? kMaxRationalDistortion : kMaxDistortion;
    if (!(std::abs(proto.k1()) <= most)) {
      return InvalidField(field + ".k1", absl::StrCat(proto.k1(), " is out of range"));
    }
    hint.k1 = proto.k1();
    lens.coefficients[0] = proto.k1();
  }
  // Of a whole lens LensFromProto looks at all of it.
  if (!HasLens(proto)) HOROPTER_RETURN_IF_ERROR(CheckLens(lens, image, field));
  return hint;
}

bool HasLens(const v1::CameraHint& proto) {
  return proto.has_focal_y_px() || proto.has_k2() || proto.has_p1() || proto.has_p2() ||
         proto.has_k3() || IsRational(proto) || proto.has_fisheye();
}

absl::StatusOr<std::optional<LensModel>> LensFromProto(const v1::CameraHint& proto,
                                                       const HintedImage& image,
                                                       const std::string& field) {
  if (!HasLens(proto)) return std::nullopt;
  for (const auto& [set, name] :
       {std::pair{proto.has_focal_px(), ".focal_px"},
        std::pair{proto.has_principal_point_x_px(), ".principal_point_x_px"}}) {
    if (!set) return InvalidField(field + name, "missing; the lens needs it");
  }
  LensModel lens;
  lens.fx = proto.focal_px();
  lens.fy = proto.has_focal_y_px() ? proto.focal_y_px() : lens.fx;
  lens.cx = proto.principal_point_x_px();
  lens.cy = proto.principal_point_y_px();
  std::vector<std::pair<const char*, double>> named;
  if (proto.has_fisheye()) {
    lens.kind = LensModel::Kind::kEquidistant;
    if (proto.has_k1() || proto.has_k2() || proto.has_p1() || proto.has_p2() || proto.has_k3() ||
        IsRational(proto)) {
      return InvalidField(field + ".fisheye", "set together with k1, k2, p1, p2, k3 .. k6");
    }
    const v1::FisheyeLens& f = proto.fisheye();
    named = {{".fisheye.k1", f.k1()},
             {".fisheye.k2", f.k2()},
             {".fisheye.k3", f.k3()},
             {".fisheye.k4", f.k4()}};
  } else {
    named = {{".k1", proto.k1()},
             {".k2", proto.k2()},
             {".p1", proto.p1()},
             {".p2", proto.p2()},
             {".k3", proto.k3()},
             {".k4", proto.k4()},
             {".k5", proto.k5()},
             {".k6", proto.k6()}};
  }
  for (size_t i = 0; i < named.size(); ++i) {
    const bool radial = named[i].first[1] == 'k';
    const double most = radial && IsRational(proto) ? kMaxRationalDistortion : kMaxDistortion;
    if (!(std::abs(named[i].second) <= most)) {
      return InvalidField(field + named[i].first,
                          absl::StrCat(named[i].second, " is out of range"));
    }
    (i < 5 ? lens.coefficients[i] : lens.denominator[i - 5]) = named[i].second;
  }
  HOROPTER_RETURN_IF_ERROR(CheckLens(lens, image, field));
  return lens;
}

absl::StatusOr<std::optional<CameraPoseHint>> PoseHintFromProto(const v1::CameraHint& proto,
                                                                const std::string& field) {
  const auto sigma = [&](bool set, double value, double highest, const char* name) -> absl::Status {
    if (!set) return absl::OkStatus();
    if (!proto.has_camera_from_base()) {
      return InvalidField(absl::StrCat(field, ".", name), "set without camera_from_base");
    }
    if (value > 0.0 && value <= highest) return absl::OkStatus();
    return InvalidField(absl::StrCat(field, ".", name),
                        absl::StrCat(value, " is outside 0..", highest));
  };
  HOROPTER_RETURN_IF_ERROR(sigma(proto.has_rotation_sigma_rad(),
                                 proto.rotation_sigma_rad(),
                                 kMaxRotationSigmaRad,
                                 "rotation_sigma_rad"));
  HOROPTER_RETURN_IF_ERROR(sigma(proto.has_position_sigma_m(),
                                 proto.position_sigma_m(),
                                 kMaxPositionSigmaM,
                                 "position_sigma_m"));
  if (!proto.has_camera_from_base()) return std::nullopt;
  CameraPoseHint hint;
  HOROPTER_ASSIGN_OR_RETURN(hint.camera_from_base,
                            RigidFromProto(proto.camera_from_base(), field + ".camera_from_base"));
  if (proto.has_rotation_sigma_rad()) hint.rotation_sigma_rad = proto.rotation_sigma_rad();
  if (proto.has_position_sigma_m()) hint.position_sigma_m = proto.position_sigma_m();
  return hint;
}

absl::StatusOr<std::optional<GripperTools>> GripperFromProto(
    const v1::RecognizeSceneRequest& proto) {
  if (!proto.has_gripper()) return std::nullopt;
  const v1::Gripper& in = proto.gripper();
  const auto check = [](double value, const char* name) -> absl::Status {
    if (value > 0.0 && value <= kMaxGripperM) return absl::OkStatus();
    return InvalidField(absl::StrCat("gripper.", name),
                        absl::StrCat(value, " is outside 0..", kMaxGripperM, " m"));
  };
  if (!in.has_parallel_jaw() && !in.has_suction()) {
    return InvalidField("gripper", "neither parallel_jaw nor suction is set");
  }
  GripperTools tools;
  if (in.has_parallel_jaw()) {
    const auto& jaw = in.parallel_jaw();
    HOROPTER_RETURN_IF_ERROR(check(jaw.finger_length_m(), "parallel_jaw.finger_length_m"));
    HOROPTER_RETURN_IF_ERROR(check(jaw.finger_width_m(), "parallel_jaw.finger_width_m"));
    HOROPTER_RETURN_IF_ERROR(check(jaw.finger_thickness_m(), "parallel_jaw.finger_thickness_m"));
    tools.parallel_jaw = {jaw.finger_length_m(), jaw.finger_width_m(), jaw.finger_thickness_m()};
    if (jaw.has_max_opening_m()) {
      if (!(jaw.max_opening_m() > 0.0)) {
        return InvalidField("gripper.parallel_jaw.max_opening_m", "not positive");
      }
      tools.parallel_jaw->max_opening_m = jaw.max_opening_m();
    }
  }
  if (in.has_suction()) {
    HOROPTER_RETURN_IF_ERROR(check(in.suction().length_m(), "suction.length_m"));
    tools.suction = {in.suction().length_m(), 0.0};
    if (in.suction().has_holder_radius_m()) {
      HOROPTER_RETURN_IF_ERROR(check(in.suction().holder_radius_m(), "suction.holder_radius_m"));
      tools.suction->holder_radius_m = in.suction().holder_radius_m();
    }
  }
  if (in.has_approach_m()) {
    HOROPTER_RETURN_IF_ERROR(check(in.approach_m(), "approach_m"));
    tools.approach_m = in.approach_m();
  }
  return tools;
}

}  // namespace horopter
