// Writes of CatalogService: safe to repeat, and never answered with an error once committed.
#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>
#include <google/protobuf/util/time_util.h>

#include <algorithm>
#include <cstring>
#include <optional>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/sha256.h"
#include "server/base/status_macros.h"
#include "server/service/catalog_convert.h"
#include "server/service/catalog_service.h"
#include "server/service/catalog_signing.h"
#include "server/service/convert.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

constexpr int kMaxBatch = 1000;
// Of an update that finds no object, and of the creation that follows and finds one.
constexpr int kUpsertTries = 3;

std::string Now() {
  return google::protobuf::util::TimeUtil::ToString(
      google::protobuf::util::TimeUtil::GetCurrentTime());
}

// What is wrong with an object is wrong with the request's field `object`; its id stands beside it.
absl::Status OfObject(const absl::Status& status) {
  return ErrorField(status) == "object_id" ? status : PrefixField("object.", status);
}

absl::StatusOr<CatalogRecord> NewRecord(const v1::CreateObjectRequest& request,
                                        const CallInfo& info) {
  if (!request.has_object()) return InvalidField("object", "missing");
  absl::StatusOr<CatalogRecord> record = RecordFromProto(request.object_id(), request.object());
  if (!record.ok()) return OfObject(record.status());
  Sign(info, &*record);
  record->create_time = record->update_time;
  return record;
}

// Equal messages have equal digests: maps are written in the order of their keys.
absl::StatusOr<RepeatableRequest> RepeatableFromProto(const std::string& id,
                                                      const google::protobuf::Message& request) {
  if (id.empty()) return RepeatableRequest{};
  const bool ascii = std::all_of(id.begin(), id.end(), [](char c) { return c > ' ' && c <= '~'; });
  if (!ascii || id.size() > kMaxRequestIdBytes) {
    return InvalidField("request_id",
                        absl::StrCat("not 1 to ", kMaxRequestIdBytes, " bytes of ASCII"));
  }
  std::string bytes;
  {
    google::protobuf::io::StringOutputStream stream(&bytes);
    google::protobuf::io::CodedOutputStream coded(&stream);
    coded.SetSerializationDeterministic(true);
    if (!request.SerializeToCodedStream(&coded)) return absl::InternalError("cannot serialize");
  }
  return RepeatableRequest{id, Sha256Hex(bytes)};
}

}  // namespace

void Sign(const CallInfo& info, CatalogRecord* record) {
  record->update_time = Now();
  record->changed_by = info.record->caller;
}

absl::Status CheckEtag(const std::string& if_match, const CatalogRecord& current) {
  if (if_match.empty() || if_match == EtagOf(current)) return absl::OkStatus();
  return FieldError(
      absl::StatusCode::kAborted,
      "if_match",
      absl::StrCat("object '", current.model.id, "' has changed: its etag is ", EtagOf(current)));
}

void ReadyToProto(const CatalogRecord& written, v1::Object* proto) {
  WrittenToProto(written, proto);
  proto->mutable_recognition_status()->set_state(v1::RecognitionStatus::STATE_READY);
}

absl::Status CatalogService::CreateOnce(std::vector<CatalogRecord> records,
                                        const RepeatableRequest& request,
                                        const CallInfo& info,
                                        const AnswerOf& answer_of) {
  // OK: answered with what the request made before; NOT_FOUND: it is new.
  const auto answer_again = [&]() -> absl::StatusOr<bool> {
    if (request.id.empty()) return false;
    const absl::StatusOr<MadeObjects> made = store_.catalog().FindRequest(request.id);
    if (absl::IsNotFound(made.status())) return false;
    HOROPTER_RETURN_IF_ERROR(made.status());
    if (made->digest != request.digest) {
      return InvalidField("request_id", "was used for a request with another content");
    }
    int next = 0;
    for (const std::string& id : made->object_ids) {
      HOROPTER_RETURN_IF_ERROR(Read(id, v1::OBJECT_VIEW_BASIC, answer_of(next++)));
    }
    return true;
  };
  HOROPTER_ASSIGN_OR_RETURN(const bool known, answer_again());
  if (known) return absl::OkStatus();
  // Told anew from the first one on when another server's write came first.
  const int count = static_cast<int>(records.size());
  int next = 0;
  const absl::Status created = store_.Create(
      std::move(records),
      request,
      [&](const CatalogRecord& written) {
        ReadyToProto(written, answer_of(next++ % count));
        return absl::OkStatus();
      },
      info.limits.stop);
  if (!absl::IsAlreadyExists(created)) return created;
  // The same request may have come in twice at a time.
  HOROPTER_ASSIGN_OR_RETURN(const bool meanwhile, answer_again());
  return meanwhile ? absl::OkStatus() : created;
}

absl::Status CatalogService::Create(const v1::CreateObjectRequest& request,
                                    const CallInfo& info,
                                    v1::Object* response) {
  HOROPTER_ASSIGN_OR_RETURN(CatalogRecord record, NewRecord(request, info));
  HOROPTER_ASSIGN_OR_RETURN(const RepeatableRequest repeatable,
                            RepeatableFromProto(request.request_id(), request));
  std::vector<CatalogRecord> records;
  records.push_back(std::move(record));
  const absl::Status status = CreateOnce(std::move(records), repeatable, info, [&](int) {
    response->Clear();
    return response;
  });
  return CatalogStore::ObjectOf(status) ? OfObject(status) : status;
}

// Of fields that the request has itself the field is named, of all else the file is to blame.
absl::Status OfFile(const absl::Status& status) {
  const std::string field = ErrorField(status);
  for (const char* own : {"object_id", "grasps", "labels", "display_name"}) {
    if (field.compare(0, std::strlen(own), own) == 0) return status;
  }
  if (!absl::IsInvalidArgument(status)) return status;
  return InvalidField("content", std::string(status.message()));
}

absl::Status CatalogService::Import(const v1::ImportObjectRequest& request,
                                    const CallInfo& info,
                                    v1::ImportObjectResponse* response) {
  HOROPTER_ASSIGN_OR_RETURN(const RepeatableRequest repeatable,
                            RepeatableFromProto(request.request_id(), request));
  const std::string& id = request.object_id();
  if (!IsObjectId(id)) return InvalidField("object_id", "is not [a-z0-9_-]{1,63}");
  if (repeatable.id.empty() && store_.catalog().GetSummary(id).ok()) {
    return absl::AlreadyExistsError(absl::StrCat("object '", id, "' is already in the catalog"));
  }
  HOROPTER_ASSIGN_OR_RETURN(
      v1::ImportObjectResponse read,
      cad_reader_.Read(request, BesideCatalog(store_.catalog(), "import"), info.limits.stop));
  v1::Object& object = *read.mutable_object();
  if (!request.display_name().empty()) object.set_display_name(request.display_name());
  *object.mutable_grasps() = request.grasps();
  *object.mutable_labels() = request.labels();
  object.mutable_source()->set_file_name(request.file_name());
  object.mutable_source()->set_content(request.content());
  absl::StatusOr<CatalogRecord> record = RecordFromProto(id, object);
  if (!record.ok()) return OfFile(record.status());
  Sign(info, &*record);
  record->create_time = record->update_time;
  std::vector<CatalogRecord> records;
  records.push_back(*std::move(record));
  const absl::Status status = CreateOnce(std::move(records), repeatable, info, [&](int) {
    response->mutable_object()->Clear();
    return response->mutable_object();
  });
  if (!status.ok()) return CatalogStore::ObjectOf(status) ? OfFile(status) : status;
  *response->mutable_warnings() = std::move(*read.mutable_warnings());
  return absl::OkStatus();
}

absl::Status CatalogService::CreateBatch(const v1::BatchCreateObjectsRequest& request,
                                         const CallInfo& info,
                                         v1::BatchCreateObjectsResponse* response) {
  if (request.requests_size() == 0) return InvalidField("requests", "empty");
  if (request.requests_size() > kMaxBatch) {
    return InvalidField("requests",
                        absl::StrCat(request.requests_size(), " objects, at most ", kMaxBatch));
  }
  const auto in_request = [](int i, const absl::Status& status) {
    return PrefixField(absl::StrCat("requests[", i, "]."), status);
  };
  std::vector<CatalogRecord> records;
  std::set<std::string> ids;
  for (int i = 0; i < request.requests_size(); ++i) {
    const v1::CreateObjectRequest& one = request.requests(i);
    if (!one.request_id().empty()) {
      return in_request(i, InvalidField("request_id", "must be unset in a batch"));
    }
    if (!ids.insert(one.object_id()).second) {
      return in_request(i, InvalidField("object_id", "is there twice"));
    }
    absl::StatusOr<CatalogRecord> record = NewRecord(one, info);
    if (!record.ok()) return in_request(i, record.status());
    records.push_back(*std::move(record));
  }
  HOROPTER_ASSIGN_OR_RETURN(const RepeatableRequest repeatable,
                            RepeatableFromProto(request.request_id(), request));
  const absl::Status status = CreateOnce(std::move(records), repeatable, info, [&](int i) {
    if (i == response->objects_size()) return response->add_objects();
    v1::Object* begun = response->mutable_objects(i);
    begun->Clear();
    return begun;
  });
  const std::optional<int> of = CatalogStore::ObjectOf(status);
  return of ? in_request(*of, OfObject(status)) : status;
}

absl::Status CatalogService::Update(const v1::UpdateObjectRequest& request,
                                    const CallInfo& info,
                                    v1::Object* response) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string id,
                            ObjectIdFromName(request.object().name(), "object.name"));
  HOROPTER_ASSIGN_OR_RETURN(const ObjectMask mask,
                            MaskFromProto(request.update_mask(), request.object()));
  if (request.allow_missing() && !request.if_match().empty()) {
    return InvalidField("if_match", "set together with allow_missing");
  }
  const auto merge = [&](CatalogRecord current) -> absl::StatusOr<CatalogRecord> {
    HOROPTER_RETURN_IF_ERROR(CheckEtag(request.if_match(), current));
    absl::StatusOr<CatalogRecord> merged = MergeRecord(std::move(current), request.object(), mask);
    if (!merged.ok()) return merged.status();
    Sign(info, &*merged);
    return merged;
  };
  const auto answer = [&](const CatalogRecord& written) {
    response->Clear();
    ReadyToProto(written, response);
    return absl::OkStatus();
  };
  absl::Status status;
  for (int attempt = 0; attempt < kUpsertTries; ++attempt) {
    status = store_.Update(id, mask.Parts(), merge, answer);
    if (!absl::IsNotFound(status) || !request.allow_missing()) break;
    absl::StatusOr<CatalogRecord> record = RecordFromProto(id, request.object());
    if (!record.ok()) return OfObject(record.status());
    Sign(info, &*record);
    record->create_time = record->update_time;
    std::vector<CatalogRecord> records;
    records.push_back(*std::move(record));
    status = store_.Create(std::move(records), {}, answer, info.limits.stop);
    if (!absl::IsAlreadyExists(status)) break;
  }
  return ErrorField(status) == "if_match" ? status : OfObject(status);
}

absl::Status CatalogService::Restore(const v1::RestoreObjectRequest& request,
                                     const CallInfo& info,
                                     v1::Object* response) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string id, ObjectIdFromName(request.name(), "name"));
  if (request.revision() == 0) return InvalidField("revision", "missing");
  const auto sign = [&](CatalogRecord current) -> absl::StatusOr<CatalogRecord> {
    HOROPTER_RETURN_IF_ERROR(CheckEtag(request.if_match(), current));
    Sign(info, &current);
    return current;
  };
  return store_.RestoreVersion(id, request.revision(), sign, [&](const CatalogRecord& written) {
    response->Clear();  // begun when another server's write came first
    ReadyToProto(written, response);
    return absl::OkStatus();
  });
}

absl::Status CatalogService::Delete(const v1::DeleteObjectRequest& request) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string id, ObjectIdFromName(request.name(), "name"));
  const absl::Status status = store_.Delete(
      id, [&](const CatalogRecord& current) { return CheckEtag(request.if_match(), current); });
  return absl::IsNotFound(status) && request.allow_missing() ? absl::OkStatus() : status;
}

grpc::ServerUnaryReactor* CatalogService::CreateObject(grpc::CallbackServerContext* context,
                                                       const grpc::ByteBuffer* bytes,
                                                       grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::CreateObjectRequest, v1::Object>(
      gate_,
      context,
      bytes,
      answer,
      {{"CreateObject", max_object_bytes_},
       [this](const auto& request, const CallInfo& info, v1::Object* response) {
         return Create(request, info, response);
       }});
}

grpc::ServerUnaryReactor* CatalogService::ImportObject(grpc::CallbackServerContext* context,
                                                       const grpc::ByteBuffer* bytes,
                                                       grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::ImportObjectRequest, v1::ImportObjectResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{"ImportObject", max_object_bytes_},
       [this](const auto& request, const CallInfo& info, v1::ImportObjectResponse* response) {
         return Import(request, info, response);
       },
       // The file is stored beside the geometry that comes of it, of which nothing is known yet but
       // how large it may be.
       [this](const auto& request) -> absl::StatusOr<CallDemand> {
         return CallDemand{.bytes =
                               max_object_bytes_ + static_cast<int64_t>(request.content().size())};
       }});
}

grpc::ServerUnaryReactor* CatalogService::BatchCreateObjects(grpc::CallbackServerContext* context,
                                                             const grpc::ByteBuffer* bytes,
                                                             grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::BatchCreateObjectsRequest, v1::BatchCreateObjectsResponse>(
      gate_,
      context,
      bytes,
      answer,
      {{"BatchCreateObjects", max_object_bytes_},
       [this](const auto& request, const CallInfo& info, v1::BatchCreateObjectsResponse* response) {
         return CreateBatch(request, info, response);
       }});
}

grpc::ServerUnaryReactor* CatalogService::UpdateObject(grpc::CallbackServerContext* context,
                                                       const grpc::ByteBuffer* bytes,
                                                       grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::UpdateObjectRequest, v1::Object>(
      gate_,
      context,
      bytes,
      answer,
      {{"UpdateObject", max_object_bytes_},
       [this](const auto& request, const CallInfo& info, v1::Object* response) {
         return Update(request, info, response);
       }});
}

grpc::ServerUnaryReactor* CatalogService::RestoreObject(grpc::CallbackServerContext* context,
                                                        const grpc::ByteBuffer* bytes,
                                                        grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::RestoreObjectRequest, v1::Object>(
      gate_,
      context,
      bytes,
      answer,
      {{"RestoreObject"}, [this](const auto& request, const CallInfo& info, v1::Object* response) {
         return Restore(request, info, response);
       }});
}

grpc::ServerUnaryReactor* CatalogService::DeleteObject(grpc::CallbackServerContext* context,
                                                       const grpc::ByteBuffer* bytes,
                                                       grpc::ByteBuffer* answer) {
  return RunUnaryCall<v1::DeleteObjectRequest, google::protobuf::Empty>(
      gate_,
      context,
      bytes,
      answer,
      {{"DeleteObject"}, [this](const auto& request, const CallInfo&, google::protobuf::Empty*) {
         return Delete(request);
       }});
}

}  // namespace horopter
