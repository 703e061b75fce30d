// The catalog's maintenance calls that do not stream: look-alikes, rebuilding.
#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/catalog_decoys.h"
#include "server/service/catalog_service.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"
#include "server/service/unary_call.h"
#include "server/vision/invariants/look_alike.h"

namespace horopter {
namespace {

// Objects that a look-alike is looked for among when the catalog is not in memory.
constexpr int kMostCompared = 500;

v1::LookAlike::Kind ToProto(LookAlikeKind kind) {
  switch (kind) {
    case LookAlikeKind::kCongruent:
      return v1::LookAlike::KIND_CONGRUENT;
    case LookAlikeKind::kSimilar:
      return v1::LookAlike::KIND_SIMILAR;
    case LookAlikeKind::kMirror:
      return v1::LookAlike::KIND_MIRROR;
    case LookAlikeKind::kAffine:
      return v1::LookAlike::KIND_AFFINE;
    case LookAlikeKind::kProjective:
      return v1::LookAlike::KIND_PROJECTIVE;
  }
  return v1::LookAlike::KIND_UNSPECIFIED;
}

void AddVertices(const ObjectModel& model,
                 const std::vector<int>& indices,
                 google::protobuf::RepeatedField<double>* out) {
  for (const int i : indices) {
    for (const double x : model.vertices[i]) out->Add(x);
  }
}

}  // namespace

namespace {

void AddUntoldDecoys(const std::vector<UntoldDecoy>& decoys, v1::ListLookAlikesResponse* response) {
  for (const UntoldDecoy& decoy : decoys) {
    v1::UntoldDecoy* proto = response->add_untold_decoys();
    const bool is_feature = decoy.kind == UntoldDecoy::Kind::kFeature;
    proto->set_kind(is_feature ? v1::UntoldDecoy::KIND_FEATURE
                               : v1::UntoldDecoy::KIND_MIRROR_IMAGE);
    proto->set_differing_px(decoy.differing_px);
    if (!is_feature) continue;
    VectorToProto(decoy.feature_place, proto->mutable_feature_place());
    proto->set_feature_size_m(decoy.feature_size_m);
  }
}

}  // namespace

grpc::ServerUnaryReactor* CatalogService::ListLookAlikes(grpc::CallbackServerContext* context,
                                                         const grpc::ByteBuffer* bytes,
                                                         grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::ListLookAlikesRequest, v1::ListLookAlikesResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "ListLookAlikes", .needs = Role::kRobot},
       [this](const v1::ListLookAlikesRequest& request,
              const CallInfo& info,
              v1::ListLookAlikesResponse* response) -> absl::Status {
         HOROPTER_ASSIGN_OR_RETURN(const std::string id, ObjectIdFromName(request.name(), "name"));
         HOROPTER_ASSIGN_OR_RETURN(const CatalogRecord named, store_.catalog().GetObject(id));
         const auto published = store_.Published();
         HOROPTER_ASSIGN_OR_RETURN(
             const std::vector<int> candidates,
             store_.LookAlikeCandidates(*published, id, kMostCompared, info.limits.stop));
         for (const int i : candidates) {
           if (IsStopRequested(info.limits.stop)) return absl::CancelledError("stopped");
           response->set_compared(response->compared() + 1);
           HOROPTER_ASSIGN_OR_RETURN(const auto object, ObjectAt(published->snapshot, i));
           const ObjectModel& other = store_.ModelOf(*object);
           const auto found = FindLookAlike(named.model, other);
           if (!found) continue;
           v1::LookAlike* look_alike = response->add_look_alikes();
           look_alike->set_name(absl::StrCat("objects/", published->ids[i]));
           look_alike->set_kind(ToProto(found->kind));
           for (const double s : found->stretch) look_alike->add_stretch(s);
           look_alike->set_matched_vertices(found->matched);
           AddVertices(named.model, found->only_in_a, look_alike->mutable_only_in_named_m());
           AddVertices(other, found->only_in_b, look_alike->mutable_only_in_other_m());
         }
         std::stable_sort(
             response->mutable_look_alikes()->begin(),
             response->mutable_look_alikes()->end(),
             [](const v1::LookAlike& a, const v1::LookAlike& b) { return a.kind() < b.kind(); });
         if (IsStopRequested(info.limits.stop)) return absl::CancelledError("stopped");
         AddUntoldDecoys(UntoldDecoysOf(named.model), response);
         return absl::OkStatus();
       }});
}

grpc::ServerUnaryReactor* CatalogService::RebuildObject(grpc::CallbackServerContext* context,
                                                        const grpc::ByteBuffer* bytes,
                                                        grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::RebuildObjectRequest, v1::RebuildObjectResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{"RebuildObject"},
       [this](const v1::RebuildObjectRequest& request,
              const CallInfo&,
              v1::RebuildObjectResponse* response) -> absl::Status {
         HOROPTER_ASSIGN_OR_RETURN(const std::string id, ObjectIdFromName(request.name(), "name"));
         HOROPTER_ASSIGN_OR_RETURN(const bool changed, store_.Rebuild(id));
         response->set_changed(changed);
         return absl::OkStatus();
       }});
}

}  // namespace horopter
