#include "client/api.h"

#include <grpcpp/grpcpp.h>

#include <chrono>

#include "absl/strings/str_cat.h"
#include "client/convert.h"
#include "horopter/v1/catalog.grpc.pb.h"
#include "horopter/v1/recognition.grpc.pb.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr char kFieldKey[] = "horopter-error-field";
constexpr int kPageSize = 200;

void SetDeadline(grpc::ClientContext& context, double timeout_s) {
  context.set_deadline(std::chrono::system_clock::now() +
                       std::chrono::milliseconds(static_cast<long>(timeout_s * 1e3)));
}

absl::Status ToAbsl(const grpc::Status& status,
                    const grpc::ClientContext& context,
                    const std::string& address) {
  if (status.ok()) return absl::OkStatus();
  std::string message = status.error_message();
  const auto& trailers = context.GetServerTrailingMetadata();
  if (const auto it = trailers.find(kFieldKey); it != trailers.end()) {
    const std::string field(it->second.data(), it->second.size());
    if (message.find(field) == std::string::npos) absl::StrAppend(&message, " (field ", field, ")");
  }
  if (status.error_code() == grpc::StatusCode::UNAVAILABLE) {
    message = absl::StrCat("server ", address, " cannot be reached: ", message);
  }
  // The codes of absl and gRPC have the same numbers.
  return absl::Status(static_cast<absl::StatusCode>(status.error_code()), message);
}

v1::Object ObjectMessage(const ObjectModel& model, const CadFile& file) {
  v1::Object object = ToProto(model);
  object.set_name(ResourceName(model.id));
  if (!file.content.empty()) {
    v1::CadSource* source = object.mutable_source();
    source->set_file_name(file.file_name);
    source->set_format(file.format);
    source->set_unit(file.unit);
    source->set_content(file.content);
  }
  return object;
}

}  // namespace

struct HoropterClient::Stubs {
  std::unique_ptr<v1::CatalogService::Stub> catalog;
  std::unique_ptr<v1::RecognitionService::Stub> recognition;
};

HoropterClient::HoropterClient(const std::string& address, double timeout_s)
    : stubs_(std::make_unique<Stubs>()), address_(address), timeout_s_(timeout_s) {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(-1);  // CAD files; the server bounds what it takes
  arguments.SetMaxSendMessageSize(-1);
  const auto channel =
      grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
  stubs_->catalog = v1::CatalogService::NewStub(channel);
  stubs_->recognition = v1::RecognitionService::NewStub(channel);
}

HoropterClient::~HoropterClient() = default;

absl::StatusOr<v1::Object> HoropterClient::CreateObject(const ObjectModel& model,
                                                        const CadFile& file) {
  grpc::ClientContext context;
  SetDeadline(context, timeout_s_);
  v1::CreateObjectRequest request;
  request.set_object_id(model.id);
  *request.mutable_object() = ObjectMessage(model, file);
  v1::Object response;
  HOROPTER_RETURN_IF_ERROR(
      ToAbsl(stubs_->catalog->CreateObject(&context, request, &response), context, address_));
  return response;
}

absl::StatusOr<v1::Object> HoropterClient::UpdateObject(const ObjectModel& model,
                                                        const CadFile& file,
                                                        const ObjectUpdate& what) {
  grpc::ClientContext context;
  SetDeadline(context, timeout_s_);
  v1::UpdateObjectRequest request;
  *request.mutable_object() = ObjectMessage(model, file);
  auto* mask = request.mutable_update_mask();
  if (what.geometry) {
    for (const char* path :
         {"diameter_m", "vertices_m", "edges", "mesh", "object_from_symmetric_object", "source"}) {
      mask->add_paths(path);
    }
  }
  if (what.grasps) mask->add_paths("grasps");
  if (what.display_name) mask->add_paths("display_name");
  v1::Object response;
  HOROPTER_RETURN_IF_ERROR(
      ToAbsl(stubs_->catalog->UpdateObject(&context, request, &response), context, address_));
  return response;
}

absl::Status HoropterClient::PutObject(const v1::Object& object) {
  v1::Object response;
  absl::Status created;
  {
    grpc::ClientContext context;
    SetDeadline(context, timeout_s_);
    v1::CreateObjectRequest request;
    request.set_object_id(IdOfResource(object.name()));
    *request.mutable_object() = object;
    created =
        ToAbsl(stubs_->catalog->CreateObject(&context, request, &response), context, address_);
  }
  if (!absl::IsAlreadyExists(created)) return created;
  grpc::ClientContext context;
  SetDeadline(context, timeout_s_);
  v1::UpdateObjectRequest request;
  *request.mutable_object() = object;
  return ToAbsl(stubs_->catalog->UpdateObject(&context, request, &response), context, address_);
}

absl::StatusOr<v1::Object> HoropterClient::GetObject(const std::string& id, v1::ObjectView view) {
  grpc::ClientContext context;
  SetDeadline(context, timeout_s_);
  v1::GetObjectRequest request;
  request.set_name(ResourceName(id));
  request.set_view(view);
  v1::Object response;
  HOROPTER_RETURN_IF_ERROR(
      ToAbsl(stubs_->catalog->GetObject(&context, request, &response), context, address_));
  return response;
}

absl::StatusOr<std::vector<v1::Object>> HoropterClient::ListObjects() {
  std::vector<v1::Object> objects;
  v1::ListObjectsRequest request;
  request.set_page_size(kPageSize);
  do {
    grpc::ClientContext context;
    SetDeadline(context, timeout_s_);
    v1::ListObjectsResponse response;
    HOROPTER_RETURN_IF_ERROR(
        ToAbsl(stubs_->catalog->ListObjects(&context, request, &response), context, address_));
    for (v1::Object& object : *response.mutable_objects()) objects.push_back(std::move(object));
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  return objects;
}

absl::Status HoropterClient::DeleteObject(const std::string& id) {
  grpc::ClientContext context;
  SetDeadline(context, timeout_s_);
  v1::DeleteObjectRequest request;
  request.set_name(ResourceName(id));
  google::protobuf::Empty response;
  return ToAbsl(stubs_->catalog->DeleteObject(&context, request, &response), context, address_);
}

absl::StatusOr<v1::ListLookAlikesResponse> HoropterClient::ListLookAlikes(const std::string& id) {
  grpc::ClientContext context;
  SetDeadline(context, timeout_s_);
  v1::ListLookAlikesRequest request;
  request.set_name(ResourceName(id));
  v1::ListLookAlikesResponse response;
  HOROPTER_RETURN_IF_ERROR(
      ToAbsl(stubs_->catalog->ListLookAlikes(&context, request, &response), context, address_));
  return response;
}

absl::StatusOr<v1::VerifyCatalogResponse> HoropterClient::VerifyCatalog(bool recompute) {
  grpc::ClientContext context;
  SetDeadline(context, timeout_s_);
  v1::VerifyCatalogRequest request;
  request.set_recompute(recompute);
  v1::VerifyCatalogResponse response;
  HOROPTER_RETURN_IF_ERROR(
      ToAbsl(stubs_->catalog->VerifyCatalog(&context, request, &response), context, address_));
  return response;
}

absl::StatusOr<bool> HoropterClient::RebuildObject(const std::string& id) {
  grpc::ClientContext context;
  SetDeadline(context, timeout_s_);
  v1::RebuildObjectRequest request;
  request.set_name(ResourceName(id));
  v1::RebuildObjectResponse response;
  HOROPTER_RETURN_IF_ERROR(
      ToAbsl(stubs_->catalog->RebuildObject(&context, request, &response), context, address_));
  return response.changed();
}

absl::Status HoropterClient::BackupCatalog(
    const std::function<absl::Status(const std::string& chunk)>& write) {
  grpc::ClientContext context;
  SetDeadline(context, timeout_s_);
  const auto reader = stubs_->catalog->BackupCatalog(&context, {});
  v1::BackupCatalogResponse response;
  int64_t received = 0, total = 0;
  while (reader->Read(&response)) {
    received += static_cast<int64_t>(response.chunk().size());
    total = response.total_bytes();
    if (const absl::Status status = write(response.chunk()); !status.ok()) {
      context.TryCancel();
      reader->Finish();
      return status;
    }
  }
  HOROPTER_RETURN_IF_ERROR(ToAbsl(reader->Finish(), context, address_));
  if (received != total || total == 0) {
    return absl::DataLossError(absl::StrCat("received ", received, " of ", total, " bytes"));
  }
  return absl::OkStatus();
}

absl::StatusOr<v1::RecognizeSceneResponse> HoropterClient::RecognizeScene(
    const v1::RecognizeSceneRequest& request) {
  grpc::ClientContext context;
  SetDeadline(context, timeout_s_);
  v1::RecognizeSceneResponse response;
  HOROPTER_RETURN_IF_ERROR(
      ToAbsl(stubs_->recognition->RecognizeScene(&context, request, &response), context, address_));
  return response;
}

}  // namespace horopter
