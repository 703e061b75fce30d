#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "horopter/v1/recognition.pb.h"
#include "horopter/v1/types.pb.h"
#include "server/service/convert.h"
#include "server/service/expected_convert.h"
#include "server/service/hint_convert.h"
#include "server/service/region_convert.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

v1::SceneReason::Kind ReasonToProto(ReasonKind kind) {
  switch (kind) {
    case ReasonKind::kNothingFound:
      return v1::SceneReason::KIND_NOTHING_FOUND;
    case ReasonKind::kAmbiguous:
      return v1::SceneReason::KIND_AMBIGUOUS;
    case ReasonKind::kScaleConflict:
      return v1::SceneReason::KIND_SCALE_CONFLICT;
    case ReasonKind::kTooFewFeatures:
      return v1::SceneReason::KIND_TOO_FEW_FEATURES;
    case ReasonKind::kNoParallax:
      return v1::SceneReason::KIND_NO_PARALLAX;
    case ReasonKind::kReferenceNotFound:
      return v1::SceneReason::KIND_REFERENCE_NOT_FOUND;
    case ReasonKind::kReferenceConflict:
      return v1::SceneReason::KIND_REFERENCE_CONFLICT;
    case ReasonKind::kEmptyCatalog:
      return v1::SceneReason::KIND_EMPTY_CATALOG;
    case ReasonKind::kUnrelatedImages:
      return v1::SceneReason::KIND_UNRELATED_IMAGES;
    case ReasonKind::kHintContradicted:
      return v1::SceneReason::KIND_HINT_CONTRADICTED;
    case ReasonKind::kReferenceAmbiguous:
      return v1::SceneReason::KIND_REFERENCE_AMBIGUOUS;
  }
  return v1::SceneReason::KIND_UNSPECIFIED;
}

v1::UnsearchedStep::Cause CauseToProto(UnsearchedCause cause) {
  switch (cause) {
    case UnsearchedCause::kTime:
      return v1::UnsearchedStep::CAUSE_TIME;
    case UnsearchedCause::kCatalogSize:
      return v1::UnsearchedStep::CAUSE_CATALOG_SIZE;
    case UnsearchedCause::kUnavailable:
      return v1::UnsearchedStep::CAUSE_UNAVAILABLE;
  }
  return v1::UnsearchedStep::CAUSE_UNSPECIFIED;
}

void ReasonsToProto(const SceneAnswer& answer, v1::RecognizeSceneResponse* proto) {
  proto->set_completeness(answer.time_limited ? v1::COMPLETENESS_TIME_LIMITED
                                              : v1::COMPLETENESS_COMPLETE);
  for (const AnswerReason& reason : answer.reasons) {
    v1::SceneReason* out = proto->add_reasons();
    out->set_kind(ReasonToProto(reason.kind));
    out->set_detail(reason.detail);
  }
  for (const UnsearchedStep& step : answer.unsearched) {
    v1::UnsearchedStep* out = proto->add_unsearched();
    out->set_cause(CauseToProto(step.cause));
    out->set_step(step.step);
  }
}

void CameraToProto(const PosedCamera& posed, v1::Camera* proto) {
  proto->set_recovered(true);
  proto->set_focal_px(posed.camera.focal_px);
  proto->set_principal_point_x_px(posed.camera.cx);
  proto->set_principal_point_y_px(posed.camera.cy);
  proto->set_k1(posed.camera.k1);
  proto->set_k2(posed.lens.k2);
  proto->set_p1(posed.lens.p1);
  proto->set_p2(posed.lens.p2);
  proto->set_focal_log_sigma(posed.focal_log_sigma);
  RigidToProto(posed.camera_from_scene, proto->mutable_camera_from_scene());
}

v1::CameraBasis::Source SourceToProto(BasisSource source) {
  switch (source) {
    case BasisSource::kTexture:
      return v1::CameraBasis::SOURCE_TEXTURE;
    case BasisSource::kFeatures:
      return v1::CameraBasis::SOURCE_FEATURES;
    case BasisSource::kParts:
      return v1::CameraBasis::SOURCE_PARTS;
    case BasisSource::kStation:
      return v1::CameraBasis::SOURCE_STATION;
    case BasisSource::kGiven:
      return v1::CameraBasis::SOURCE_GIVEN;
  }
  return v1::CameraBasis::SOURCE_UNSPECIFIED;
}

void BasesToProto(const SceneAnswer& answer, size_t image, v1::Camera* proto) {
  proto->set_unrelated(image < answer.unrelated_images.size() && answer.unrelated_images[image]);
  if (image >= answer.camera_bases.size()) return;
  for (const CameraBasis& basis : answer.camera_bases[image]) {
    v1::CameraBasis* out = proto->add_bases();
    out->set_source(SourceToProto(basis.source));
    out->set_matches(basis.matches);
    out->set_rms_px(basis.rms_px);
  }
}

template <typename Matrix>
void MatrixToProto(const Matrix& m, google::protobuf::RepeatedField<double>* out) {
  for (Eigen::Index row = 0; row < m.rows(); ++row) {
    for (Eigen::Index col = 0; col < m.cols(); ++col) out->Add(m(row, col));
  }
}

// What is particular to its kind.
void FindingValueToProto(const AnswerFinding& finding, v1::SceneFinding* proto) {
  switch (finding.kind) {
    case FindingKind::kSingleObject:
      proto->mutable_single_object();
      return;
    case FindingKind::kFrameBySymmetry:
      proto->mutable_frame_by_symmetry()->set_equivalent_frames(
          static_cast<int>(std::lround(finding.value)));
      return;
    case FindingKind::kTurnUndetermined:
      VectorToProto(finding.direction,
                    proto->mutable_turn_undetermined()->mutable_axis_in_object());
      proto->mutable_turn_undetermined()->set_sigma_rad(finding.value);
      return;
    case FindingKind::kShiftUndetermined:
      VectorToProto(finding.direction,
                    proto->mutable_shift_undetermined()->mutable_direction_in_object());
      proto->mutable_shift_undetermined()->set_sigma_m(finding.value);
      return;
    case FindingKind::kFocalAndDepth:
      proto->mutable_focal_and_depth()->set_focal_log_sigma(finding.value);
      return;
    case FindingKind::kScaleConflict:
      proto->mutable_scale_conflict()->set_size_ratio(std::exp(finding.value));
      return;
    case FindingKind::kObjectRejected:
      proto->mutable_object_rejected();
      return;
    case FindingKind::kReferenceConflict:
      proto->mutable_reference_conflict();
      if (finding.value > 0.0) {
        proto->mutable_reference_conflict()->set_distance_m(finding.value);
      }
      return;
    case FindingKind::kExifContradicted:
      proto->mutable_exif_contradicted()->set_focal_px(finding.value);
      return;
    case FindingKind::kReferenceSymmetric:
      proto->mutable_reference_symmetric()->set_equivalent_poses(
          static_cast<int>(std::lround(finding.value)));
      return;
    case FindingKind::kBaseUncertain:
      proto->mutable_base_uncertain()->set_position_sigma_m(finding.value);
      proto->mutable_base_uncertain()->set_rotation_sigma_rad(finding.turn_rad);
      return;
  }
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
    FindingValueToProto(finding, out);
    if (!finding.object_id.empty()) out->set_object(ObjectName(finding.object_id));
    out->set_instance(finding.instance);
    if (finding.image >= 0) out->set_image(finding.image);
    out->set_detail(finding.detail);
  }
  for (const ContradictedHint& hint : answer.contradicted_hints) {
    v1::SceneFinding* out = proto->add_findings();
    out->mutable_hint_contradicted()->set_focal_px(hint.focal_px);
    out->mutable_hint_contradicted()->set_principal_point_x_px(hint.principal_point.x());
    out->mutable_hint_contradicted()->set_principal_point_y_px(hint.principal_point.y());
    out->set_image(hint.image);
    out->set_detail(hint.detail);
  }
}

void ScalesToProto(const SceneAnswer& answer, v1::RecognizeSceneResponse* proto) {
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

void GraspToProto(const SceneGrasp& grasp, const SceneAnswer& answer, v1::RecognizedGrasp* proto) {
  proto->set_name(grasp.name);
  proto->set_symmetry_index(grasp.symmetry);
  RigidToProto(grasp.scene_from_gripper, proto->mutable_scene_from_gripper());
  RigidToProto(grasp.scene_from_pregrasp, proto->mutable_scene_from_pregrasp());
  if (answer.base_from_scene) {
    RigidToProto(*answer.base_from_scene * grasp.scene_from_gripper,
                 proto->mutable_base_from_gripper());
    RigidToProto(*answer.base_from_scene * grasp.scene_from_pregrasp,
                 proto->mutable_base_from_pregrasp());
  }
  proto->set_success(grasp.success);
  proto->set_scene_success(grasp.scene_success);
  proto->set_quality(grasp.quality);
  if (grasp.suction) {
    proto->mutable_suction()->set_cup_radius_m(grasp.cup_radius_m);
  } else {
    proto->mutable_parallel_jaw()->set_jaw_opening_m(grasp.jaw_opening_m);
    proto->mutable_parallel_jaw()->set_grip_width_m(grasp.grip_width_m);
  }
}

void ObjectInImagesToProto(const AnswerObject& object,
                           const SceneAnswer& answer,
                           v1::RecognizedObject* proto) {
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
}

v1::ObjectAlternative::Kind AlternativeKindToProto(AlternativeKind kind) {
  switch (kind) {
    case AlternativeKind::kPose:
      return v1::ObjectAlternative::KIND_POSE;
    case AlternativeKind::kObject:
      return v1::ObjectAlternative::KIND_OBJECT;
    case AlternativeKind::kMirrorImage:
      return v1::ObjectAlternative::KIND_MIRROR_IMAGE;
    case AlternativeKind::kStretched:
      return v1::ObjectAlternative::KIND_STRETCHED;
    case AlternativeKind::kFeature:
      return v1::ObjectAlternative::KIND_FEATURE;
    case AlternativeKind::kSize:
      return v1::ObjectAlternative::KIND_SIZE;
  }
  return v1::ObjectAlternative::KIND_UNSPECIFIED;
}

void AlternativeToProto(const AnswerAlternative& alternative,
                        const SceneAnswer& answer,
                        v1::ObjectAlternative* proto) {
  proto->set_kind(AlternativeKindToProto(alternative.kind));
  proto->set_object(ObjectName(alternative.object_id));
  proto->set_probability(alternative.probability);
  if (alternative.scene_from_object)
    RigidToProto(*alternative.scene_from_object, proto->mutable_scene_from_object());
  if (alternative.kind == AlternativeKind::kFeature) {
    VectorToProto(alternative.feature_place, proto->mutable_feature_place());
    proto->set_feature_size_m(alternative.feature_size_m);
  }
  if (!alternative.scene_from_camera) return;
  RigidToProto(*alternative.scene_from_camera, proto->mutable_scene_from_camera());
  if (answer.base_from_scene) {
    RigidToProto(*answer.base_from_scene * *alternative.scene_from_camera,
                 proto->mutable_base_from_camera());
  }
  proto->set_differing_px(alternative.differing_px);
}

void ObjectToProto(const AnswerObject& object,
                   const SceneAnswer& answer,
                   bool full,
                   v1::RecognizedObject* proto) {
  proto->set_object(ObjectName(object.object_id));
  proto->set_instance(object.instance);
  proto->set_score(object.score);
  RigidToProto(object.scene_from_object, proto->mutable_scene_from_object());
  for (const std::string& id : object.alternatives) proto->add_alternative_objects(ObjectName(id));
  for (const AnswerAlternative& a : object.left_open)
    AlternativeToProto(a, answer, proto->add_alternatives());
  for (const SceneGrasp& grasp : object.grasps) GraspToProto(grasp, answer, proto->add_grasps());
  v1::GraspCounts* counts = proto->mutable_grasp_counts();
  counts->set_considered(object.grasp_counts.considered);
  counts->set_too_narrow(object.grasp_counts.too_narrow);
  counts->set_below_plane(object.grasp_counts.below_plane);
  counts->set_blocked(object.grasp_counts.blocked);
  counts->set_unsure(object.grasp_counts.unsure);
  counts->set_other_gripper(object.grasp_counts.other_gripper);
  if (answer.base_from_scene) {
    RigidToProto(*answer.base_from_scene * object.scene_from_object,
                 proto->mutable_base_from_object());
  }
  if (!full) return;
  MatrixToProto(object.covariance, proto->mutable_pose_covariance());
  ObjectInImagesToProto(object, answer, proto);
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

void PlanesToProto(const SceneAnswer& answer, v1::RecognizeSceneResponse* proto) {
  if (!answer.plane) return;
  const SupportingPlane& plane = *answer.plane;
  VectorToProto(plane.normal, proto->mutable_supporting_plane_in_scene()->mutable_normal());
  proto->mutable_supporting_plane_in_scene()->set_offset_m(plane.offset_m);
  if (!answer.base_from_scene) return;
  const Eigen::Vector3d normal = answer.base_from_scene->R * plane.normal;
  VectorToProto(normal, proto->mutable_supporting_plane_in_base()->mutable_normal());
  proto->mutable_supporting_plane_in_base()->set_offset_m(plane.offset_m +
                                                          normal.dot(answer.base_from_scene->t));
}

// Those that are told, by id and instance.
std::vector<const AnswerObject*> ToldObjects(const SceneAnswer& answer, double min_score) {
  std::vector<const AnswerObject*> objects;
  for (const AnswerObject& object : answer.objects) {
    if (object.score >= min_score) objects.push_back(&object);
  }
  std::sort(objects.begin(), objects.end(), [](const AnswerObject* a, const AnswerObject* b) {
    return std::tie(a->object_id, a->instance) < std::tie(b->object_id, b->instance);
  });
  return objects;
}

// Blocks of the joint covariance in the order of the objects that are told.
void JointCovarianceToProto(const SceneAnswer& answer,
                            const std::vector<const AnswerObject*>& objects,
                            v1::RecognizeSceneResponse* proto) {
  if (answer.joint_covariance.rows() != 6 * static_cast<Eigen::Index>(answer.objects.size())) {
    return;
  }
  std::vector<Eigen::Index> rows;
  for (const AnswerObject* object : objects) {
    for (int i = 0; i < 6; ++i) rows.push_back(6 * (object - answer.objects.data()) + i);
  }
  MatrixToProto(answer.joint_covariance(rows, rows), proto->mutable_joint_pose_covariance());
}

}  // namespace

absl::StatusOr<AnswerFormat> AnswerFormatFromProto(const v1::RecognizeSceneRequest& proto) {
  if (!v1::AnswerView_IsValid(proto.view())) return InvalidField("view", "unknown value");
  if (!(proto.min_score() >= 0.0 && proto.min_score() <= 1.0)) {
    return InvalidField("min_score", absl::StrCat(proto.min_score(), " is outside 0..1"));
  }
  return AnswerFormat{proto.view() != v1::ANSWER_VIEW_BASIC, proto.min_score()};
}

void SceneAnswerToProto(const SceneAnswer& answer,
                        const SceneRequest& request,
                        const AnswerFormat& format,
                        v1::RecognizeSceneResponse* proto) {
  for (size_t i = 0; i < request.images.size(); ++i) {
    v1::Camera* camera = proto->add_cameras();
    camera->set_image_width_px(request.images[i].cols);
    camera->set_image_height_px(request.images[i].rows);
    if (i < answer.cameras.size() && answer.cameras[i]) CameraToProto(*answer.cameras[i], camera);
    BasesToProto(answer, i, camera);
    RegionsToProto(request, static_cast<int>(i), camera);
    camera->set_focal_from_exif(i < answer.presumed_focal.size() && answer.presumed_focal[i]);
  }
  const std::vector<const AnswerObject*> objects = ToldObjects(answer, format.min_score);
  for (const AnswerObject* object : objects) {
    ObjectToProto(*object, answer, format.full, proto->add_objects());
  }
  ReasonsToProto(answer, proto);
  if (const size_t hidden = answer.objects.size() - objects.size(); hidden > 0) {
    proto->set_objects_below_min_score(static_cast<int32_t>(hidden));
    if (objects.empty()) {
      v1::SceneReason* reason = proto->add_reasons();
      reason->set_kind(v1::SceneReason::KIND_BELOW_MIN_SCORE);
      reason->set_detail(absl::StrCat(hidden, " objects score less than ", format.min_score));
      std::sort(proto->mutable_reasons()->pointer_begin(),
                proto->mutable_reasons()->pointer_end(),
                [](const auto* a, const auto* b) { return a->kind() < b->kind(); });
    }
  }
  if (answer.base_from_scene)
    RigidToProto(*answer.base_from_scene, proto->mutable_base_from_scene());
  for (const AnswerBase& base : answer.base_alternatives) {
    v1::BaseAlternative* out = proto->add_base_alternatives();
    RigidToProto(base.base_from_scene, out->mutable_base_from_scene());
    out->set_object(ObjectName(base.object_id));
    out->set_instance(base.instance);
    out->set_symmetry_index(base.symmetry);
  }
  PlanesToProto(answer, proto);
  FindingsToProto(answer, proto);
  if (answer.expected) ExpectedToProto(answer, request.expected_parts, proto->mutable_expected());
  if (answer.explanation) ExplanationToProto(*answer.explanation, proto->mutable_explanation());
  if (!format.full) return;
  JointCovarianceToProto(answer, objects, proto);
  ScalesToProto(answer, proto);
  for (const StageReport& stage : answer.stages) StageToProto(stage, proto->add_stages());
}

void EchoImages(const v1::RecognizeSceneRequest& request, v1::RecognizeSceneResponse* proto) {
  for (int i = 0; i < request.images_size(); ++i) {
    const v1::SceneImage& image = request.images(i);
    v1::Camera* camera = proto->mutable_cameras(i);
    camera->set_camera_id(image.camera_id());
    camera->set_frame_id(image.frame_id());
    if (image.has_capture_time()) *camera->mutable_capture_time() = image.capture_time();
    camera->set_rectified(HasLens(image.camera_hint()));
  }
}

}  // namespace horopter
