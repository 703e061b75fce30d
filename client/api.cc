#include "client/api.h"

#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <chrono>
#include <condition_variable>
#include <map>
#include <mutex>
#include <thread>

#include "absl/strings/cord.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "client/api_stubs.h"
#include "client/connection_fault.h"
#include "client/convert.h"
#include "horopter/v1/errors.pb.h"
#include "server/base/status_macros.h"
#include "server/base/utf8.h"

namespace horopter {
namespace {

constexpr char kVariantsKey[] = "horopter-variants";
constexpr char kMinGenerationKey[] = "horopter-min-generation";
constexpr char kFieldKey[] = "horopter-error-field";
constexpr char kRetryAfterKey[] = "retry-after-ms";
// As long as large messages are on their way.
constexpr char kRetryAfterBreakMs[] = "1000";
constexpr char kRequestIdKey[] = "horopter-request-id";
constexpr char kReasonKey[] = "horopter-error-reason";  // of this client only

std::string ValueOf(const std::multimap<grpc::string_ref, grpc::string_ref>& metadata,
                    const char* key) {
  const auto it = metadata.find(key);
  return it == metadata.end() ? "" : std::string(it->second.data(), it->second.size());
}

// The reason in the details of an error; empty: none.
std::string ReasonIn(const std::string& details) {
  v1::Status status;
  if (!status.ParseFromString(details)) return "";
  for (const google::protobuf::Any& detail : status.details()) {
    v1::ErrorInfo info;
    if (absl::EndsWith(detail.type_url(), "/google.rpc.ErrorInfo") &&
        info.ParseFromString(detail.value())) {
      return info.reason();
    }
  }
  return "";
}

}  // namespace

bool BrokenOffForMemory(const grpc::Status& status) {
  return status.error_code() == grpc::StatusCode::RESOURCE_EXHAUSTED &&
         absl::StrContains(status.error_message(), "RST_STREAM with error code 11");
}

absl::Status ToAbsl(const grpc::Status& status,
                    const grpc::ClientContext& context,
                    const std::string& address) {
  if (status.ok()) return absl::OkStatus();
  std::string message = status.error_message();
  const auto& trailers = context.GetServerTrailingMetadata();
  const std::string field = ValueOf(trailers, kFieldKey);
  std::string retry = ValueOf(trailers, kRetryAfterKey);
  if (BrokenOffForMemory(status)) retry = kRetryAfterBreakMs;
  const std::string request = ValueOf(context.GetServerInitialMetadata(), kRequestIdKey);
  if (!field.empty() && message.find(field) == std::string::npos) {
    absl::StrAppend(&message, " (field ", field, ")");
  }
  if (status.error_code() == grpc::StatusCode::UNAVAILABLE) {
    const std::string words = ConnectionFault(message);
    message = absl::StrCat("server ",
                           address,
                           " cannot be reached: ",
                           words.empty() ? message : absl::StrCat(words, " (", message, ")"));
  }
  if (status.error_code() == grpc::StatusCode::UNIMPLEMENTED) {
    absl::StrAppend(&message,
                    ": server ",
                    address,
                    " does not know this call; it is of another version, or no horopterd");
  }
  if (!request.empty()) absl::StrAppend(&message, " (request ", request, ")");
  // The codes of absl and gRPC have the same numbers.
  absl::Status out(static_cast<absl::StatusCode>(status.error_code()), message);
  if (!field.empty()) out.SetPayload(kFieldKey, absl::Cord(field));
  if (!retry.empty()) out.SetPayload(kRetryAfterKey, absl::Cord(retry));
  if (!request.empty()) out.SetPayload(kRequestIdKey, absl::Cord(request));
  if (const std::string reason = ReasonIn(status.error_details()); !reason.empty()) {
    out.SetPayload(kReasonKey, absl::Cord(reason));
  }
  return out;
}

namespace {

std::string PayloadOf(const absl::Status& status, const char* key) {
  const auto payload = status.GetPayload(key);
  return payload.has_value() ? std::string(*payload) : "";
}

// The one field of a health answer, `status`, is an enum; 1: SERVING.
bool IsServing(const grpc::ByteBuffer& response) {
  std::vector<grpc::Slice> slices;
  std::string bytes;
  if (response.Dump(&slices).ok()) {
    for (const grpc::Slice& s : slices) {
      bytes.append(reinterpret_cast<const char*>(s.begin()), s.size());
    }
  }
  return bytes == std::string("\x08\x01", 2);
}

v1::Object ObjectMessage(const ObjectModel& model, const CadFile& file) {
  v1::Object object = ToProto(model);
  object.set_name(ResourceName(model.id));
  if (!file.content.empty()) {
    v1::CadSource* source = object.mutable_source();
    source->set_file_name(ToUtf8(file.file_name));
    source->set_format(file.format);
    source->set_unit(file.unit);
    source->set_content(file.content);
  }
  return object;
}

}  // namespace

std::string RequestIdOf(const absl::Status& status) {
  return PayloadOf(status, kRequestIdKey);
}

std::string ErrorFieldOf(const absl::Status& status) {
  return PayloadOf(status, kFieldKey);
}

std::optional<int> RetryAfterMsOf(const absl::Status& status) {
  const std::string text = PayloadOf(status, kRetryAfterKey);
  int ms = 0;
  if (!absl::SimpleAtoi(text, &ms) || ms < 0) return std::nullopt;
  return ms;
}

std::string ErrorReasonOf(const absl::Status& status) {
  return PayloadOf(status, kReasonKey);
}

HoropterClient::HoropterClient(const std::string& address, double timeout_s)
    : HoropterClient(address, ClientOptions{timeout_s, 0, {}, {}, {}}) {}

HoropterClient::HoropterClient(const std::string& address, ClientOptions options)
    : stubs_(std::make_unique<Stubs>()), address_(address), options_(std::move(options)) {
  auto channel = MakeChannel(address, options_.security);
  stubs_->ready = channel.status();
  // The stubs need one, though no call is made on it.
  stubs_->channel = channel.ok() ? *std::move(channel)
                                 : grpc::CreateChannel(address, grpc::InsecureChannelCredentials());
  stubs_->catalog = v1::CatalogService::NewStub(stubs_->channel);
  stubs_->recognition = v1::RecognitionService::NewStub(stubs_->channel);
  stubs_->server = v1::ServerService::NewStub(stubs_->channel);
  stubs_->stations = v1::StationService::NewStub(stubs_->channel);
}

std::shared_ptr<grpc::Channel> HoropterClient::channel() const {
  return stubs_->channel;
}

absl::Status HoropterClient::Call(const std::function<void(grpc::ClientContext*, Done)>& start) {
  HOROPTER_RETURN_IF_ERROR(stubs_->ready);
  // Setting the machine's time neither ends nor prolongs the tries.
  using Clock = std::chrono::steady_clock;
  constexpr auto kSlice = std::chrono::milliseconds(50);
  const auto deadline =
      Clock::now() + std::chrono::milliseconds(static_cast<int64_t>(options_.timeout_s * 1e3));
  const auto interrupted = [&] { return options_.interrupted && options_.interrupted(); };
  for (int tries = 0;; ++tries) {
    grpc::ClientContext context;
    context.set_deadline(
        std::chrono::system_clock::now() +
        std::chrono::duration_cast<std::chrono::system_clock::duration>(deadline - Clock::now()));
    if (!options_.variants.empty()) context.AddMetadata(kVariantsKey, options_.variants);
    if (options_.min_generation > 0)
      context.AddMetadata(kMinGenerationKey, absl::StrCat(options_.min_generation));
    std::mutex mutex;
    std::condition_variable finished;
    std::optional<grpc::Status> result;
    start(&context, [&](grpc::Status status) {
      const std::lock_guard lock(mutex);
      result = std::move(status);
      finished.notify_all();  // under the lock: the waiting thread owns all of this
    });
    {
      std::unique_lock lock(mutex);
      bool cancelled = false;
      while (!result) {
        finished.wait_for(lock, kSlice);
        if (!result && !cancelled && interrupted()) context.TryCancel(), cancelled = true;
      }
    }
    const absl::Status status = ToAbsl(*result, context, address_);
    if (absl::IsCancelled(status) && interrupted()) return absl::CancelledError("interrupted");
    const std::optional<int> retry_ms = RetryAfterMsOf(status);
    if (!absl::IsResourceExhausted(status) || !retry_ms || tries >= options_.max_retries) {
      return status;
    }
    const auto again = Clock::now() + std::chrono::milliseconds(*retry_ms);
    if (again >= deadline) return status;
    if (options_.on_retry) options_.on_retry(*retry_ms);
    while (Clock::now() < again) {
      if (interrupted()) return absl::CancelledError("interrupted");
      std::this_thread::sleep_for(std::min<Clock::duration>(kSlice, again - Clock::now()));
    }
  }
}

HoropterClient::~HoropterClient() = default;

absl::StatusOr<v1::Object> HoropterClient::CreateObject(const ObjectModel& model,
                                                        const CadFile& file) {
  v1::CreateObjectRequest request;
  request.set_object_id(ToUtf8(model.id));
  *request.mutable_object() = ObjectMessage(model, file);
  v1::Object response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->CreateObject(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<v1::Object> HoropterClient::UpdateObject(const ObjectModel& model,
                                                        const CadFile& file,
                                                        const ObjectUpdate& what) {
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
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->UpdateObject(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::Status HoropterClient::PutObject(const v1::Object& object) {
  v1::UpdateObjectRequest request;
  *request.mutable_object() = object;
  request.mutable_update_mask()->add_paths(std::string("*"));
  request.set_allow_missing(true);
  v1::Object response;
  return Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->UpdateObject(context, &request, &response, std::move(done));
  });
}

absl::StatusOr<v1::Object> HoropterClient::GetObject(const std::string& id, v1::ObjectView view) {
  v1::GetObjectRequest request;
  request.set_name(ResourceName(id));
  request.set_view(view);
  v1::Object response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->GetObject(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<std::vector<v1::Object>> HoropterClient::ListObjects() {
  std::vector<v1::Object> objects;
  v1::ListObjectsRequest request;
  request.set_page_size(kPageSize);
  do {
    v1::ListObjectsResponse response;
    HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
      stubs_->catalog->async()->ListObjects(context, &request, &response, std::move(done));
    }));
    for (v1::Object& object : *response.mutable_objects()) objects.push_back(std::move(object));
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  return objects;
}

absl::Status HoropterClient::DeleteObject(const std::string& id) {
  v1::DeleteObjectRequest request;
  request.set_name(ResourceName(id));
  google::protobuf::Empty response;
  return Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->DeleteObject(context, &request, &response, std::move(done));
  });
}

absl::StatusOr<v1::ListObjectVersionsResponse> HoropterClient::ListObjectVersions(
    const std::string& id) {
  v1::ListObjectVersionsRequest request;
  request.set_name(ResourceName(id));
  v1::ListObjectVersionsResponse response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->ListObjectVersions(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<v1::Object> HoropterClient::RestoreObject(const std::string& id,
                                                         int64_t revision,
                                                         const std::string& if_match) {
  v1::RestoreObjectRequest request;
  request.set_name(ResourceName(id));
  request.set_revision(revision);
  request.set_if_match(if_match);
  v1::Object response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->RestoreObject(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<v1::Object> HoropterClient::LearnPrint(const v1::LearnPrintRequest& request) {
  v1::Object response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->LearnPrint(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<v1::Object> HoropterClient::RemovePrint(const std::string& id,
                                                       const std::string& if_match) {
  v1::UpdateObjectRequest request;
  request.mutable_object()->set_name(ResourceName(id));
  request.mutable_update_mask()->add_paths("print");
  request.set_if_match(if_match);
  v1::Object response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->UpdateObject(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<v1::ListLookAlikesResponse> HoropterClient::ListLookAlikes(const std::string& id) {
  v1::ListLookAlikesRequest request;
  request.set_name(ResourceName(id));
  v1::ListLookAlikesResponse response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->ListLookAlikes(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<bool> HoropterClient::RebuildObject(const std::string& id) {
  v1::RebuildObjectRequest request;
  request.set_name(ResourceName(id));
  v1::RebuildObjectResponse response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->catalog->async()->RebuildObject(context, &request, &response, std::move(done));
  }));
  return response.changed();
}

absl::StatusOr<v1::RecognizeSceneResponse> HoropterClient::RecognizeScene(
    const v1::RecognizeSceneRequest& request) {
  v1::RecognizeSceneResponse response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->recognition->async()->RecognizeScene(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<v1::ServerInfo> HoropterClient::GetServerInfo() {
  const v1::GetServerInfoRequest request;
  v1::ServerInfo response;
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stubs_->server->async()->GetServerInfo(context, &request, &response, std::move(done));
  }));
  return response;
}

absl::StatusOr<bool> HoropterClient::CheckHealth() {
  grpc::GenericStub stub(stubs_->channel);
  grpc::ByteBuffer response;
  const grpc::Slice nothing(std::string{});
  const grpc::ByteBuffer request(&nothing, 1);  // of no service: the server as a whole
  HOROPTER_RETURN_IF_ERROR(Call([&](grpc::ClientContext* context, Done done) {
    stub.UnaryCall(
        context, "/grpc.health.v1.Health/Check", {}, &request, &response, std::move(done));
  }));
  return IsServing(response);
}

}  // namespace horopter
