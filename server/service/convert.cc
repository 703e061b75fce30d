#include "server/service/convert.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "db/catalog_record.h"
#include "horopter/v1/recognition.pb.h"
#include "horopter/v1/types.pb.h"
#include "server/base/status_macros.h"
#include "server/service/exif_camera.h"
#include "server/service/expected_convert.h"
#include "server/service/hint_convert.h"
#include "server/service/rectify.h"
#include "server/service/reference_convert.h"
#include "server/service/region_convert.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

constexpr char kObjectPrefix[] = "objects/";
constexpr double kQuaternionNormTolerance = 0.01;
}  // namespace

std::string ObjectName(std::string_view id) {
  return absl::StrCat(kObjectPrefix, std::string(id));
}

absl::StatusOr<std::string> ObjectIdFromName(std::string_view name, std::string_view field) {
  constexpr size_t kPrefixSize = sizeof(kObjectPrefix) - 1;
  const std::string id(name.substr(std::min(kPrefixSize, name.size())));
  if (name.substr(0, kPrefixSize) != kObjectPrefix || !IsObjectId(id)) {
    return InvalidField(
        field,
        absl::StrCat("'",
                     std::string(name.substr(0, 80)),
                     "' is not objects/{object} with {object} of [a-z0-9_-]{1,63}"));
  }
  return id;
}

absl::StatusOr<Rigid3> RigidFromProto(const v1::RigidTransform& proto, std::string_view field) {
  if (!proto.has_rotation())
    return InvalidField(absl::StrCat(std::string(field), ".rotation"), "missing");
  const v1::Quaternion& q = proto.rotation();
  const Eigen::Quaterniond quaternion(q.w(), q.x(), q.y(), q.z());
  const double norm = quaternion.norm();
  if (!(std::abs(norm - 1.0) <= kQuaternionNormTolerance)) {
    return InvalidField(absl::StrCat(std::string(field), ".rotation"),
                        absl::StrCat("quaternion has norm ", norm, ", not 1"));
  }
  const v1::Vector3& t = proto.translation_m();
  const Rigid3 transform{quaternion.normalized().toRotationMatrix(), {t.x(), t.y(), t.z()}};
  if (!transform.t.allFinite())
    return InvalidField(absl::StrCat(std::string(field), ".translation_m"), "not finite");
  return transform;
}

void VectorToProto(const Eigen::Vector3d& v, v1::Vector3* proto) {
  proto->set_x(v.x());
  proto->set_y(v.y());
  proto->set_z(v.z());
}

void RigidToProto(const Rigid3& a_from_b, v1::RigidTransform* proto) {
  Eigen::Quaterniond q(a_from_b.R);
  q.normalize();
  if (q.w() < 0.0) q.coeffs() *= -1.0;
  v1::Quaternion* rotation = proto->mutable_rotation();
  rotation->set_w(q.w());
  rotation->set_x(q.x());
  rotation->set_y(q.y());
  rotation->set_z(q.z());
  VectorToProto(a_from_b.t, proto->mutable_translation_m());
}

namespace {

constexpr size_t kMaxLabelBytes = 255;

// Deviation of a cut-out's principal point, of its larger side: those of visp-cube (photographs of
// a cube, cut out by hand) lie 0.03 - 0.3 from the middle.
constexpr double kCroppedCenterSigma = 0.2;

// What the images' files and `cropped` say of the cameras, where their hints do not. The images'
// sizes were checked. Returns whether they say anything.
bool AddFileHints(const v1::RecognizeSceneRequest& proto,
                  const std::vector<ImageShape>& shapes,
                  std::vector<CameraHint>* hints) {
  bool any = false;
  const bool read = !proto.ignore_exif() && proto.station().empty();
  for (int i = 0; i < proto.images_size(); ++i) {
    const v1::SceneImage& image = proto.images(i);
    CameraHint& hint = (*hints)[i];
    const int width = static_cast<int>(shapes[i].width),
              height = static_cast<int>(shapes[i].height);
    ExifCamera file;
    if (read && !image.has_raw())
      file = CameraFromExif(ReadExif(image.content()), width, height, image.cropped());
    if (file.focal_px && !hint.focal_px) {
      hint.focal_px = file.focal_px;
      hint.focal_log_sigma = file.focal_log_sigma;
      hint.presumed = any = true;
    }
    if (hint.principal_point) continue;
    hint.principal_point_sigma_px = file.center_sigma_px;
    if (image.cropped() && !file.center_sigma_px)
      hint.principal_point_sigma_px = kCroppedCenterSigma * std::max(width, height);
    any = any || hint.principal_point_sigma_px;
  }
  return any;
}

// What is only given back.
absl::Status CheckLabels(const v1::RecognizeSceneRequest& proto) {
  for (int i = 0; i < proto.images_size(); ++i) {
    const v1::SceneImage& image = proto.images(i);
    for (const auto& [name, text] :
         {std::pair{"camera_id", &image.camera_id()}, std::pair{"frame_id", &image.frame_id()}}) {
      if (text->size() > kMaxLabelBytes) {
        return InvalidField(absl::StrCat("images[", i, "].", name),
                            absl::StrCat("longer than ", kMaxLabelBytes, " bytes"));
      }
    }
  }
  return absl::OkStatus();
}

// Ids, each once. Errors: INVALID_ARGUMENT naming the field.
absl::StatusOr<std::vector<std::string>> CandidatesFromProto(
    const v1::RecognizeSceneRequest& proto) {
  if (proto.candidate_objects_size() > kMaxCandidates) {
    return InvalidField("candidate_objects", absl::StrCat("more than ", kMaxCandidates));
  }
  std::vector<std::string> candidates;
  for (int i = 0; i < proto.candidate_objects_size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(
        std::string id,
        ObjectIdFromName(proto.candidate_objects(i), absl::StrCat("candidate_objects[", i, "]")));
    // A name given twice means the same as once.
    if (std::find(candidates.begin(), candidates.end(), id) == candidates.end()) {
      candidates.push_back(std::move(id));
    }
  }
  return candidates;
}

// Where parts are looked for, in the images as they were sent or are rectified.
absl::Status AddRegions(const v1::RecognizeSceneRequest& proto,
                        const std::vector<ImageShape>& shapes,
                        const std::vector<std::optional<LensModel>>& lenses,
                        SceneRequest* request) {
  HOROPTER_ASSIGN_OR_RETURN(request->space_boxes, SpaceRegionsFromProto(proto));
  std::vector<std::optional<SearchedPart>> searched(proto.images_size());
  bool any = false;
  for (int i = 0; i < proto.images_size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(searched[i],
                              RegionsFromProto(proto.images(i),
                                               static_cast<int>(shapes[i].width),
                                               static_cast<int>(shapes[i].height),
                                               lenses[i],
                                               absl::StrCat("images[", i, "]")));
    any = any || searched[i];
  }
  if (any) request->searched = std::move(searched);
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<SceneRequest> SceneRequestFromProto(const v1::RecognizeSceneRequest& proto,
                                                   const ImageLimits& limits,
                                                   int threads,
                                                   const StopRequested& stop) {
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<ImageShape> shapes, ShapesOf(proto, limits));
  SceneRequest request;
  HOROPTER_ASSIGN_OR_RETURN(request.candidates, CandidatesFromProto(proto));
  HOROPTER_RETURN_IF_ERROR(AddReferences(proto, &request));
  HOROPTER_ASSIGN_OR_RETURN(request.expected_parts, ExpectedPartsFromProto(proto));
  HOROPTER_RETURN_IF_ERROR(CheckLabels(proto));
  HOROPTER_ASSIGN_OR_RETURN(request.gripper, GripperFromProto(proto));
  if (proto.has_unknown_share()) {
    if (!(proto.unknown_share() > 0.0 && proto.unknown_share() < 1.0))
      return InvalidField("unknown_share",
                          absl::StrCat(proto.unknown_share(), ": need > 0 and < 1"));
    request.unknown_share = proto.unknown_share();
  }
  bool any_hint = false, any_pose = false;
  std::vector<CameraHint> hints(proto.images_size());
  std::vector<std::optional<CameraPoseHint>> poses(proto.images_size());
  std::vector<std::optional<LensModel>> lenses(proto.images_size());
  for (int i = 0; i < proto.images_size(); ++i) {
    if (!proto.images(i).has_camera_hint()) continue;
    any_hint = true;
    const v1::CameraHint& hint = proto.images(i).camera_hint();
    const std::string field = absl::StrCat("images[", i, "].camera_hint");
    const HintedImage image{static_cast<int>(shapes[i].width),
                            static_cast<int>(shapes[i].height),
                            proto.images(i).cropped()};
    HOROPTER_ASSIGN_OR_RETURN(hints[i], HintFromProto(hint, image, field));
    HOROPTER_ASSIGN_OR_RETURN(lenses[i], LensFromProto(hint, image, field));
    HOROPTER_ASSIGN_OR_RETURN(poses[i], PoseHintFromProto(hint, field));
    any_pose = any_pose || poses[i].has_value();
  }
  any_hint = AddFileHints(proto, shapes, &hints) || any_hint;
  if (any_hint) request.hints = std::move(hints);
  if (any_pose) request.camera_poses = std::move(poses);

  HOROPTER_RETURN_IF_ERROR(AddRegions(proto, shapes, lenses, &request));
  if (!proto.explain_object().empty()) {
    HOROPTER_ASSIGN_OR_RETURN(request.explained,
                              ObjectIdFromName(proto.explain_object(), "explain_object"));
  }
  if (!v1::OverlayOptions::Format_IsValid(proto.overlay().format()))
    return InvalidField("overlay.format", "unknown value");
  request.unexplained_edges = proto.overlay().unexplained_edges();
  HOROPTER_ASSIGN_OR_RETURN(request.images, DecodeImages(proto, limits, threads, stop));
  for (int i = 0; i < proto.images_size(); ++i) {
    if (!lenses[i]) continue;
    if (IsStopRequested(stop)) return absl::CancelledError("stopped");
    HOROPTER_ASSIGN_OR_RETURN(request.images[i], Rectified(request.images[i], *lenses[i]));
    request.hints[i].k1 = 0.0;
  }
  return request;
}

}  // namespace horopter
