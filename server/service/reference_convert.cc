#include "server/service/reference_convert.h"

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "horopter/v1/recognition.pb.h"
#include "server/base/status_macros.h"
#include "server/service/convert.h"
#include "server/service/hint_convert.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

constexpr int kMostFurtherReferences = 15;

absl::StatusOr<double> SigmaOf(bool set, double value, double most, const std::string& field) {
  if (!set) return 0.0;
  if (value > 0.0 && value <= most) return value;
  return InvalidField(field, absl::StrCat(value, " is outside 0..", most));
}

absl::StatusOr<ReferenceObject> ReferenceFromProto(const v1::ReferenceObject& proto,
                                                   const std::string& field) {
  ReferenceObject out;
  HOROPTER_ASSIGN_OR_RETURN(out.object_id, ObjectIdFromName(proto.object(), field + ".object"));
  HOROPTER_ASSIGN_OR_RETURN(out.base_from_object,
                            RigidFromProto(proto.base_from_object(), field + ".base_from_object"));
  HOROPTER_ASSIGN_OR_RETURN(out.rotation_sigma_rad,
                            SigmaOf(proto.has_rotation_sigma_rad(),
                                    proto.rotation_sigma_rad(),
                                    kMaxRotationSigmaRad,
                                    field + ".rotation_sigma_rad"));
  HOROPTER_ASSIGN_OR_RETURN(out.position_sigma_m,
                            SigmaOf(proto.has_position_sigma_m(),
                                    proto.position_sigma_m(),
                                    kMaxPositionSigmaM,
                                    field + ".position_sigma_m"));
  return out;
}

}  // namespace

absl::Status AddReferences(const v1::RecognizeSceneRequest& proto, SceneRequest* request) {
  if (proto.further_references_size() > kMostFurtherReferences)
    return InvalidField("further_references", absl::StrCat("more than ", kMostFurtherReferences));
  if (!proto.has_reference()) {
    if (proto.further_references_size() == 0) return absl::OkStatus();
    return InvalidField("further_references", "set without reference");
  }
  HOROPTER_ASSIGN_OR_RETURN(request->reference, ReferenceFromProto(proto.reference(), "reference"));
  for (int i = 0; i < proto.further_references_size(); ++i) {
    HOROPTER_ASSIGN_OR_RETURN(request->further_references.emplace_back(),
                              ReferenceFromProto(proto.further_references(i),
                                                 absl::StrCat("further_references[", i, "]")));
  }
  return absl::OkStatus();
}

}  // namespace horopter
