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
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

constexpr char kObjectPrefix[] = "objects/";
constexpr double kQuaternionNormTolerance = 0.01;
constexpr double kMaxFocalPx = 1e7;
constexpr double kMaxFocalLogSigma = 2.0;
constexpr double kMaxDistortion = 10.0;
constexpr double kMaxRotationSigmaRad = 1.0;
constexpr double kMaxPositionSigmaM = 10.0;

absl::StatusOr<CameraHint> HintFromProto(const v1::CameraHint& proto, const std::string& field) {
  CameraHint hint;
  if (proto.has_focal_px()) {
    if (!(proto.focal_px() > 0.0 && proto.focal_px() <= kMaxFocalPx)) {
      return InvalidField(field + ".focal_px",
                          absl::StrCat(proto.focal_px(), " is not a focal length in pixels"));
    }
    hint.focal_px = proto.focal_px();
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
  }
  if (proto.has_k1()) {
    if (!(std::abs(proto.k1()) <= kMaxDistortion)) {
      return InvalidField(field + ".k1", absl::StrCat(proto.k1(), " is out of range"));
    }
    hint.k1 = proto.k1();
  }
  return hint;
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

v1::SceneState StateToProto(SceneState state) {
  switch (state) {
    case SceneState::kRecognized:
      return v1::SCENE_STATE_RECOGNIZED;
    case SceneState::kNothingFound:
      return v1::SCENE_STATE_NOTHING_FOUND;
    case SceneState::kAmbiguous:
      return v1::SCENE_STATE_AMBIGUOUS;
    case SceneState::kTooFewFeatures:
      return v1::SCENE_STATE_TOO_FEW_FEATURES;
    case SceneState::kNoParallax:
      return v1::SCENE_STATE_NO_PARALLAX;
    case SceneState::kReferenceNotFound:
      return v1::SCENE_STATE_REFERENCE_NOT_FOUND;
    case SceneState::kEmptyCatalog:
      return v1::SCENE_STATE_EMPTY_CATALOG;
  }
  return v1::SCENE_STATE_UNSPECIFIED;
}

void CameraToProto(const PosedCamera& posed, v1::Camera* proto) {
  proto->set_recovered(true);
  proto->set_focal_px(posed.camera.focal_px);
  proto->set_principal_point_x_px(posed.camera.cx);
  proto->set_principal_point_y_px(posed.camera.cy);
  proto->set_k1(posed.camera.k1);
  proto->set_focal_log_sigma(posed.focal_log_sigma);
  RigidToProto(posed.camera_from_scene, proto->mutable_camera_from_scene());
}

template <typename Matrix>
void MatrixToProto(const Matrix& m, google::protobuf::RepeatedField<double>* out) {
  for (Eigen::Index row = 0; row < m.rows(); ++row) {
    for (Eigen::Index col = 0; col < m.cols(); ++col) out->Add(m(row, col));
  }
}

v1::SceneFinding::Kind FindingToProto(FindingKind kind) {
  switch (kind) {
    case FindingKind::kSingleObject:
      return v1::SceneFinding::KIND_SINGLE_OBJECT;
    case FindingKind::kFrameBySymmetry:
      return v1::SceneFinding::KIND_FRAME_BY_SYMMETRY;
    case FindingKind::kTurnUndetermined:
      return v1::SceneFinding::KIND_TURN_UNDETERMINED;
    case FindingKind::kShiftUndetermined:
      return v1::SceneFinding::KIND_SHIFT_UNDETERMINED;
    case FindingKind::kFocalAndDepth:
      return v1::SceneFinding::KIND_FOCAL_AND_DEPTH;
    case FindingKind::kScaleConflict:
      return v1::SceneFinding::KIND_SCALE_CONFLICT;
    case FindingKind::kObjectRejected:
      return v1::SceneFinding::KIND_OBJECT_REJECTED;
    case FindingKind::kReferenceConflict:
      return v1::SceneFinding::KIND_REFERENCE_CONFLICT;
  }
  return v1::SceneFinding::KIND_UNSPECIFIED;
}

v1::ScaleSource::Kind ScaleToProto(ScaleSourceKind kind) {
  switch (kind) {
    case ScaleSourceKind::kObject:
      return v1::ScaleSource::KIND_OBJECT;
    case ScaleSourceKind::kReferenceCameras:
      return v1::ScaleSource::KIND_REFERENCE_CAMERAS;
    case ScaleSourceKind::kKnownFocalLength:
      return v1::ScaleSource::KIND_KNOWN_FOCAL_LENGTH;
  }
  return v1::ScaleSource::KIND_UNSPECIFIED;
}

void FindingsToProto(const SceneAnswer& answer, v1::RecognizeSceneResponse* proto) {
  for (const AnswerFinding& finding : answer.findings) {
    v1::SceneFinding* out = proto->add_findings();
    out->set_kind(FindingToProto(finding.kind));
    if (!finding.object_id.empty()) out->set_object(ObjectName(finding.object_id));
    out->set_instance(finding.instance);
    if (finding.image >= 0) out->set_image(finding.image);
    if (!finding.direction.isZero()) {
      out->mutable_direction()->set_x(finding.direction.x());
      out->mutable_direction()->set_y(finding.direction.y());
      out->mutable_direction()->set_z(finding.direction.z());
    }
    out->set_value(finding.value);
    out->set_detail(finding.detail);
  }
  for (const AnswerScale& scale : answer.scales) {
    v1::ScaleSource* out = proto->add_scale_sources();
    out->set_kind(ScaleToProto(scale.kind));
    if (!scale.object_id.empty()) out->set_object(ObjectName(scale.object_id));
    out->set_instance(scale.instance);
    if (scale.image >= 0) out->set_image(scale.image);
    out->set_log_ratio(scale.log_ratio);
    out->set_log_sigma(scale.log_sigma);
    out->set_agrees(scale.agrees);
  }
}

void ObjectToProto(const AnswerObject& object,
                   const SceneAnswer& answer,
                   v1::RecognizedObject* proto) {
  proto->set_object(ObjectName(object.object_id));
  proto->set_instance(object.instance);
  proto->set_score(object.score);
  RigidToProto(object.scene_from_object, proto->mutable_scene_from_object());
  MatrixToProto(object.covariance, proto->mutable_pose_covariance());
  for (size_t view = 0; view < answer.cameras.size(); ++view) {
    v1::ObjectInImage* image = proto->add_images();
    if (view < object.view_scores.size() && object.view_scores[view] >= 0.0) {
      image->set_score(object.view_scores[view]);
    }
    if (answer.cameras[view]) {
      RigidToProto(answer.cameras[view]->camera_from_scene * object.scene_from_object,
                   image->mutable_camera_from_object());
    }
    if (view < object.camera_covariances.size() && object.camera_covariances[view]) {
      MatrixToProto(*object.camera_covariances[view], image->mutable_pose_covariance());
    }
  }
  for (const std::string& id : object.alternatives) proto->add_alternative_objects(ObjectName(id));
  for (const SceneGrasp& grasp : object.grasps) {
    v1::RecognizedGrasp* out = proto->add_grasps();
    out->set_name(grasp.name);
    out->set_symmetry_index(grasp.symmetry);
    RigidToProto(grasp.scene_from_gripper, out->mutable_scene_from_gripper());
    if (answer.base_from_scene) {
      RigidToProto(*answer.base_from_scene * grasp.scene_from_gripper,
                   out->mutable_base_from_gripper());
      RigidToProto(*answer.base_from_scene * grasp.scene_from_pregrasp,
                   out->mutable_base_from_pregrasp());
    }
    RigidToProto(grasp.scene_from_pregrasp, out->mutable_scene_from_pregrasp());
    out->set_success(grasp.success);
    out->set_jaw_opening_m(grasp.jaw_opening_m);
    out->set_grip_width_m(grasp.grip_width_m);
    out->set_quality(grasp.quality);
  }
  v1::GraspCounts* counts = proto->mutable_grasp_counts();
  counts->set_considered(object.grasp_counts.considered);
  counts->set_too_narrow(object.grasp_counts.too_narrow);
  counts->set_below_plane(object.grasp_counts.below_plane);
  counts->set_blocked(object.grasp_counts.blocked);
  counts->set_unsure(object.grasp_counts.unsure);
  if (answer.base_from_scene) {
    RigidToProto(*answer.base_from_scene * object.scene_from_object,
                 proto->mutable_base_from_object());
  }
  if (object.base_from_object) {
    MatrixToProto(object.base_from_object->covariance, proto->mutable_base_pose_covariance());
  }
}

void StageToProto(const StageReport& stage, v1::StageReport* proto) {
  proto->set_stage(stage.stage);
  const double whole = std::floor(stage.seconds);
  proto->mutable_elapsed()->set_seconds(static_cast<int64_t>(whole));
  proto->mutable_elapsed()->set_nanos(static_cast<int32_t>((stage.seconds - whole) * 1e9));
  for (const auto& [name, count] : stage.counts) (*proto->mutable_counts())[name] = count;
}

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

void RigidToProto(const Rigid3& a_from_b, v1::RigidTransform* proto) {
  Eigen::Quaterniond q(a_from_b.R);
  q.normalize();
  if (q.w() < 0.0) q.coeffs() *= -1.0;
  v1::Quaternion* rotation = proto->mutable_rotation();
  rotation->set_w(q.w());
  rotation->set_x(q.x());
  rotation->set_y(q.y());
  rotation->set_z(q.z());
  v1::Vector3* translation = proto->mutable_translation_m();
  translation->set_x(a_from_b.t.x());
  translation->set_y(a_from_b.t.y());
  translation->set_z(a_from_b.t.z());
}

absl::StatusOr<SceneRequest> SceneRequestFromProto(const v1::RecognizeSceneRequest& proto,
                                                   const ImageLimits& limits,
                                                   int threads,
                                                   const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(ShapesOf(proto, limits).status());
  if (proto.candidate_objects_size() > kMaxCandidates) {
    return InvalidField("candidate_objects", absl::StrCat("more than ", kMaxCandidates));
  }
  SceneRequest request;
  for (int i = 0; i < proto.candidate_objects_size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(
        std::string id,
        ObjectIdFromName(proto.candidate_objects(i), absl::StrCat("candidate_objects[", i, "]")));
    // A name given twice means the same as once.
    if (std::find(request.candidates.begin(), request.candidates.end(), id) ==
        request.candidates.end()) {
      request.candidates.push_back(std::move(id));
    }
  }
  if (proto.has_reference()) {
    ReferenceObject reference;
    HOROPTER_ASSIGN_OR_RETURN(reference.object_id,
                              ObjectIdFromName(proto.reference().object(), "reference.object"));
    HOROPTER_ASSIGN_OR_RETURN(
        reference.base_from_object,
        RigidFromProto(proto.reference().base_from_object(), "reference.base_from_object"));
    request.reference = std::move(reference);
  }
  bool any_hint = false, any_pose = false;
  std::vector<CameraHint> hints(proto.images_size());
  std::vector<std::optional<CameraPoseHint>> poses(proto.images_size());
  for (int i = 0; i < proto.images_size(); ++i) {
    if (!proto.images(i).has_camera_hint()) continue;
    any_hint = true;
    const std::string field = absl::StrCat("images[", i, "].camera_hint");
    HOROPTER_ASSIGN_OR_RETURN(hints[i], HintFromProto(proto.images(i).camera_hint(), field));
    HOROPTER_ASSIGN_OR_RETURN(poses[i], PoseHintFromProto(proto.images(i).camera_hint(), field));
    any_pose = any_pose || poses[i].has_value();
  }
  if (any_hint) request.hints = std::move(hints);
  if (any_pose) request.camera_poses = std::move(poses);

  if (!proto.explain_object().empty()) {
    HOROPTER_ASSIGN_OR_RETURN(request.explained,
                              ObjectIdFromName(proto.explain_object(), "explain_object"));
  }
  if (!v1::OverlayOptions::Format_IsValid(proto.overlay().format()))
    return InvalidField("overlay.format", "unknown value");
  request.unexplained_edges = proto.overlay().unexplained_edges();
  HOROPTER_ASSIGN_OR_RETURN(request.images, DecodeImages(proto, limits, threads, stop));
  return request;
}

void SceneAnswerToProto(const SceneAnswer& answer,
                        const SceneRequest& request,
                        v1::RecognizeSceneResponse* proto) {
  proto->set_state(StateToProto(answer.state));
  proto->set_detail(answer.detail);
  for (size_t i = 0; i < request.images.size(); ++i) {
    v1::Camera* camera = proto->add_cameras();
    camera->set_image_width_px(request.images[i].cols);
    camera->set_image_height_px(request.images[i].rows);
    if (i < answer.cameras.size() && answer.cameras[i]) CameraToProto(*answer.cameras[i], camera);
  }
  std::vector<const AnswerObject*> objects;
  for (const AnswerObject& object : answer.objects) objects.push_back(&object);
  std::sort(objects.begin(), objects.end(), [](const AnswerObject* a, const AnswerObject* b) {
    return std::tie(a->object_id, a->instance) < std::tie(b->object_id, b->instance);
  });
  for (const AnswerObject* object : objects) ObjectToProto(*object, answer, proto->add_objects());
  // Blocks of the joint covariance in the same order.
  if (answer.joint_covariance.rows() == 6 * static_cast<Eigen::Index>(objects.size())) {
    std::vector<Eigen::Index> rows;
    for (const AnswerObject* object : objects) {
      for (int i = 0; i < 6; ++i) rows.push_back(6 * (object - answer.objects.data()) + i);
    }
    MatrixToProto(answer.joint_covariance(rows, rows), proto->mutable_joint_pose_covariance());
  }
  FindingsToProto(answer, proto);
  if (answer.base_from_scene)
    RigidToProto(*answer.base_from_scene, proto->mutable_base_from_scene());
  if (answer.explanation) ExplanationToProto(*answer.explanation, proto->mutable_explanation());
  for (const StageReport& stage : answer.stages) StageToProto(stage, proto->add_stages());
}

}  // namespace horopter
