#include "server/service/expected_convert.h"

#include <numbers>
#include <utility>

#include "absl/strings/str_cat.h"
#include "horopter/v1/recognition.pb.h"
#include "server/base/status_macros.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

constexpr int kMostExpected = 200;
constexpr size_t kMaxExpectedLabelBytes = 255;
constexpr double kMaxPositionToleranceM = 10.0;

absl::Status SetTolerance(
    bool set, double value, double most, bool has_place, const std::string& field, double* out) {
  if (!set) return absl::OkStatus();
  if (!has_place) return InvalidField(field, "set without frame_from_object");
  if (!(value > 0.0 && value <= most))
    return InvalidField(field, absl::StrCat(value, " is outside 0..", most));
  *out = value;
  return absl::OkStatus();
}

absl::StatusOr<ExpectedPart> PartFromProto(const v1::ExpectedPart& proto,
                                           const std::string& field) {
  ExpectedPart part;
  HOROPTER_ASSIGN_OR_RETURN(part.object_id, ObjectIdFromName(proto.object(), field + ".object"));
  if (proto.count() < 0 || proto.count() > kMostExpected)
    return InvalidField(field + ".count",
                        absl::StrCat(proto.count(), " is outside 1..", kMostExpected));
  part.count = proto.count() == 0 ? 1 : proto.count();
  const bool has_place = proto.has_frame_from_object();
  if (has_place) {
    if (part.count > 1) return InvalidField(field + ".count", "several cannot be in one place");
    HOROPTER_ASSIGN_OR_RETURN(
        part.frame_from_object,
        RigidFromProto(proto.frame_from_object(), field + ".frame_from_object"));
  }
  if (!proto.frame_object().empty()) {
    if (!has_place) return InvalidField(field + ".frame_object", "set without frame_from_object");
    HOROPTER_ASSIGN_OR_RETURN(part.frame_object,
                              ObjectIdFromName(proto.frame_object(), field + ".frame_object"));
    if (part.frame_object == part.object_id)
      return InvalidField(field + ".frame_object", "the object itself");
  }
  HOROPTER_RETURN_IF_ERROR(SetTolerance(proto.has_position_tolerance_m(),
                                        proto.position_tolerance_m(),
                                        kMaxPositionToleranceM,
                                        has_place,
                                        field + ".position_tolerance_m",
                                        &part.position_tolerance_m));
  HOROPTER_RETURN_IF_ERROR(SetTolerance(proto.has_rotation_tolerance_rad(),
                                        proto.rotation_tolerance_rad(),
                                        std::numbers::pi,
                                        has_place,
                                        field + ".rotation_tolerance_rad",
                                        &part.rotation_tolerance_rad));
  if (proto.label().size() > kMaxExpectedLabelBytes)
    return InvalidField(field + ".label",
                        absl::StrCat("longer than ", kMaxExpectedLabelBytes, " bytes"));
  part.label = proto.label();
  return part;
}

v1::ExpectedOutcome::State StateToProto(ExpectedState state) {
  switch (state) {
    case ExpectedState::kPresent:
      return v1::ExpectedOutcome::STATE_PRESENT;
    case ExpectedState::kMissing:
      return v1::ExpectedOutcome::STATE_MISSING;
    case ExpectedState::kDisplaced:
      return v1::ExpectedOutcome::STATE_DISPLACED;
    case ExpectedState::kWrongPart:
      return v1::ExpectedOutcome::STATE_WRONG_PART;
    case ExpectedState::kCannotTell:
      return v1::ExpectedOutcome::STATE_CANNOT_TELL;
  }
  return v1::ExpectedOutcome::STATE_UNSPECIFIED;
}

}  // namespace

absl::StatusOr<std::vector<ExpectedPart>> ExpectedPartsFromProto(
    const v1::RecognizeSceneRequest& proto) {
  std::vector<ExpectedPart> out;
  int count = 0;
  for (int i = 0; i < proto.expected_parts_size(); ++i) {
    const std::string field = absl::StrCat("expected_parts[", i, "]");
    HOROPTER_ASSIGN_OR_RETURN(ExpectedPart part, PartFromProto(proto.expected_parts(i), field));
    count += part.count;
    if (count > kMostExpected)
      return InvalidField("expected_parts", absl::StrCat("more than ", kMostExpected, " parts"));
    out.push_back(std::move(part));
  }
  return out;
}

void ExpectedToProto(const SceneAnswer& answer,
                     const std::vector<ExpectedPart>& expected,
                     v1::ExpectedReport* proto) {
  const ExpectedReport& report = *answer.expected;
  proto->set_all_present_probability(report.all_present);
  for (const ExpectedOutcome& outcome : report.outcomes) {
    v1::ExpectedOutcome* out = proto->add_outcomes();
    out->set_expected_index(outcome.expected);
    out->set_label(expected[outcome.expected].label);
    out->set_state(StateToProto(outcome.state));
    out->set_present_probability(outcome.present);
    out->set_missing_probability(outcome.missing);
    out->set_displaced_probability(outcome.displaced);
    out->set_wrong_part_probability(outcome.wrong_part);
    out->set_cannot_tell_probability(outcome.cannot_tell);
    if (outcome.found >= 0) {
      const AnswerObject& found = answer.objects[outcome.found];
      out->set_object(ObjectName(found.object_id));
      out->set_instance(found.instance);
    }
    if (outcome.distance_m) out->set_distance_m(*outcome.distance_m);
    if (outcome.rotation_rad) out->set_rotation_rad(*outcome.rotation_rad);
    out->set_detail(outcome.detail);
  }
  for (const int k : report.unexpected) {
    v1::UnexpectedObject* out = proto->add_unexpected();
    out->set_object(ObjectName(answer.objects[k].object_id));
    out->set_instance(answer.objects[k].instance);
  }
}

}  // namespace horopter
