#include "server/service/catalog_service.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/service/catalog_convert.h"
#include "server/service/convert.h"
#include "server/service/page_sizes.h"
#include "server/service/rpc_status.h"
#include "server/service/unary_call.h"

namespace horopter {
namespace {

// A token is this prefix and the last id of its page.
constexpr std::string_view kObjectTokenPrefix = "v1.";

absl::StatusOr<std::string> LastObjectOf(const std::string& page_token) {
  if (page_token.empty()) return std::string();
  const std::string id = page_token.substr(std::min(kObjectTokenPrefix.size(), page_token.size()));
  if (page_token.substr(0, kObjectTokenPrefix.size()) != kObjectTokenPrefix || !IsObjectId(id)) {
    return InvalidField("page_token", "not a token of this method");
  }
  return id;
}

// Whether recognition looks for the object.
void StatusToProto(const PublishedCatalog& published, const std::string& id, v1::Object* proto) {
  v1::RecognitionStatus* status = proto->mutable_recognition_status();
  if (published.Contains(id)) {
    status->set_state(v1::RecognitionStatus::STATE_READY);
  } else if (const auto found = published.unusable.find(id); found != published.unusable.end()) {
    status->set_state(v1::RecognitionStatus::STATE_FAILED);
    status->set_reason(found->second);
  } else if (published.pending.count(id) > 0) {
    status->set_state(v1::RecognitionStatus::STATE_PENDING);
  }
}

// Fields of Object, as a mask names them.
std::vector<const char*> PathsOf(const UpdateParts& parts) {
  std::vector<const char*> paths;
  if (parts.display_name) paths.push_back("display_name");
  if (parts.geometry) paths.insert(paths.end(), {"diameter_m", "vertices_m", "edges", "mesh"});
  if (parts.symmetries) paths.push_back("object_from_symmetric_object");
  if (parts.grasps) paths.push_back("grasps");
  if (parts.source) paths.push_back("source");
  if (parts.labels) paths.push_back("labels");
  if (parts.print) paths.push_back("print");
  return paths;
}

}  // namespace

absl::Status CatalogService::Read(const std::string& id,
                                  v1::ObjectView view,
                                  v1::Object* response) {
  Catalog& catalog = store_.catalog();
  if (view == v1::OBJECT_VIEW_BASIC) {
    HOROPTER_ASSIGN_OR_RETURN(const ObjectSummary summary, catalog.GetSummary(id));
    SummaryToProto(summary, response);
    StatusToProto(*store_.Published(), id, response);
    return absl::OkStatus();
  }
  HOROPTER_ASSIGN_OR_RETURN(const CatalogRecord record, catalog.GetObject(id));
  RecordToProto(record, response);
  StatusToProto(*store_.Published(), id, response);
  if (view == v1::OBJECT_VIEW_FULL && record.source.size_bytes > 0) {
    HOROPTER_ASSIGN_OR_RETURN(*response->mutable_source()->mutable_content(),
                              catalog.GetCadFile(id));
  }
  return absl::OkStatus();
}

absl::Status CatalogService::ReadFormer(const std::string& id,
                                        int64_t revision,
                                        v1::ObjectView view,
                                        v1::Object* response) {
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord record, store_.catalog().GetVersion(id, revision));
  if (view == v1::OBJECT_VIEW_BASIC) {
    WrittenToProto(record, response);
  } else {
    RecordToProto(record, response);
  }
  response->clear_etag();
  if (view == v1::OBJECT_VIEW_FULL && !record.source.content.empty()) {
    *response->mutable_source()->mutable_content() = std::move(record.source.content);
  }
  return absl::OkStatus();
}

absl::Status CatalogService::Versions(const std::string& id,
                                      v1::ListObjectVersionsResponse* response) {
  HOROPTER_ASSIGN_OR_RETURN(const std::vector<ObjectVersion> versions,
                            store_.catalog().ListVersions(id));
  for (const ObjectVersion& version : versions) {
    v1::ObjectVersion* out = response->add_versions();
    SummaryToProto(version.summary, out->mutable_object());
    if (&version == &versions.front()) {
      StatusToProto(*store_.Published(), id, out->mutable_object());
    } else {
      out->mutable_object()->clear_etag();
    }
    out->set_changed_by(version.summary.record.changed_by);
    if (version.changed) {
      for (const char* path : PathsOf(*version.changed)) {
        out->mutable_changed_fields()->add_paths(path);
      }
    }
  }
  return absl::OkStatus();
}

grpc::ServerUnaryReactor* CatalogService::ListObjectVersions(grpc::CallbackServerContext* context,
                                                             const grpc::ByteBuffer* bytes,
                                                             grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::ListObjectVersionsRequest, v1::ListObjectVersionsResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "ListObjectVersions", .needs = Role::kObserver},
       [this](const v1::ListObjectVersionsRequest& request,
              const CallInfo&,
              v1::ListObjectVersionsResponse* response) -> absl::Status {
         HOROPTER_ASSIGN_OR_RETURN(const std::string id, ObjectIdFromName(request.name(), "name"));
         return Versions(id, response);
       }});
}

grpc::ServerUnaryReactor* CatalogService::GetObject(grpc::CallbackServerContext* context,
                                                    const grpc::ByteBuffer* bytes,
                                                    grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::GetObjectRequest, v1::Object>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "GetObject", .needs = Role::kRobot},
       [this](const v1::GetObjectRequest& request, const CallInfo&, v1::Object* response)
           -> absl::Status {
         HOROPTER_ASSIGN_OR_RETURN(const std::string id, ObjectIdFromName(request.name(), "name"));
         if (!v1::ObjectView_IsValid(request.view())) return InvalidField("view", "unknown value");
         if (request.revision() == 0) return Read(id, request.view(), response);
         HOROPTER_ASSIGN_OR_RETURN(const ObjectSummary now, store_.catalog().GetSummary(id));
         if (now.record.revision == request.revision()) return Read(id, request.view(), response);
         return ReadFormer(id, request.revision(), request.view(), response);
       }});
}

grpc::ServerUnaryReactor* CatalogService::ListObjects(grpc::CallbackServerContext* context,
                                                      const grpc::ByteBuffer* bytes,
                                                      grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::ListObjectsRequest, v1::ListObjectsResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{.name = "ListObjects", .needs = Role::kRobot},
       [this](const v1::ListObjectsRequest& request,
              const CallInfo&,
              v1::ListObjectsResponse* response) -> absl::Status {
         if (request.page_size() < 0) return InvalidField("page_size", "negative");
         if (request.view() != v1::OBJECT_VIEW_UNSPECIFIED &&
             request.view() != v1::OBJECT_VIEW_BASIC) {
           return InvalidField("view", "only OBJECT_VIEW_BASIC can be listed");
         }
         HOROPTER_ASSIGN_OR_RETURN(const std::string after, LastObjectOf(request.page_token()));
         const int page = request.page_size() == 0 ? kDefaultPageSize
                                                   : std::min(request.page_size(), kMaxPageSize);
         // One more than asked for tells whether a page follows.
         HOROPTER_ASSIGN_OR_RETURN(std::vector<ObjectSummary> found,
                                   store_.catalog().ListObjects(after, page + 1));
         const bool more = static_cast<int>(found.size()) > page;
         if (more) found.pop_back();
         const auto published = store_.Published();
         for (const ObjectSummary& summary : found) {
           SummaryToProto(summary, response->add_objects());
           StatusToProto(*published,
                         summary.record.model.id,
                         response->mutable_objects(response->objects_size() - 1));
         }
         if (more)
           response->set_next_page_token(
               absl::StrCat(std::string(kObjectTokenPrefix), found.back().record.model.id));
         HOROPTER_ASSIGN_OR_RETURN(const int total, store_.catalog().CountObjects());
         response->set_total_size(total);
         return absl::OkStatus();
       }});
}

}  // namespace horopter
