#include "server/service/listener.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/impl/server_builder_option.h>
#include <sys/stat.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr const char* kServiceNames[] = {"horopter.v1.RecognitionService",
                                         "horopter.v1.CatalogService",
                                         "horopter.v1.StationService",
                                         "horopter.v1.ServerService"};
constexpr int kMaxStreamsPerConnection = 100;
constexpr int kMaxMetadataBytes = 16 << 10;
// Largest messages that gRPC itself may hold. Above it breaks calls off, those that are answered as
// well, and it needs more than the two that come in to hold two.
constexpr int kMessagesOnTheirWay = 4;
constexpr mode_t kOwnerAlone = 0077;

// The library with reflection adds it to every server that is built.
class WithoutReflection final : public grpc::ServerBuilderOption {
 public:
  void UpdateArguments(grpc::ChannelArguments*) override {}
  void UpdatePlugins(std::vector<std::unique_ptr<grpc::ServerBuilderPlugin>>* plugins) override {
    std::erase_if(*plugins, [](const auto& plugin) {
      return plugin->name().find("reflection") != std::string::npos;
    });
  }
};

void EnableHealthAndReflection() {
  static const bool enabled = [] {
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
    return true;
  }();
  (void)enabled;
}

void SetLimits(const ListenerOptions& options, grpc::ServerBuilder* builder) {
  const int largest_mb = options.largest_message_mb;
  builder->SetMaxReceiveMessageSize(largest_mb << 20);
  // An object with its CAD file, or a backup's chunk: what was received can be sent.
  builder->SetMaxSendMessageSize(std::min(2047, 2 * largest_mb) << 20);
  // Bounds what gRPC itself holds of messages on their way.
  grpc::ResourceQuota quota("horopter");
  quota.Resize(size_t{kMessagesOnTheirWay} * static_cast<size_t>(largest_mb) << 20);
  builder->SetResourceQuota(quota);
  builder->AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, kMaxStreamsPerConnection);
  builder->AddChannelArgument(GRPC_ARG_MAX_METADATA_SIZE, kMaxMetadataBytes);
  // Otherwise a second server on the same port would silently take a share of the calls.
  builder->AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
}

}  // namespace

Listener::Listener(std::unique_ptr<Access> access, const ServedParts& served)
    : access_(std::move(access)),
      recognition_(served.store,
                   CallGate{&served.scenes, &served.memory, access_.get(), served.sink},
                   served.recognizer,
                   served.recognition),
      catalog_(served.store,
               served.shelf,
               CallGate{&served.catalog_calls, &served.memory, access_.get(), served.sink},
               served.max_object_bytes),
      stations_(served.store.catalog(),
                CallGate{&served.catalog_calls, &served.memory, access_.get(), served.sink}),
      info_(served.store, served.scenes, served.memory, *access_, served.limits) {}

Listener::~Listener() = default;

absl::StatusOr<std::unique_ptr<Listener>> Listener::Start(const ListenerOptions& options,
                                                          const ServedParts& served) {
  EnableHealthAndReflection();
  const bool is_unix = IsUnixAddress(options.address);
  HOROPTER_ASSIGN_OR_RETURN(std::unique_ptr<Access> access, Access::Open(options.access));
  HOROPTER_ASSIGN_OR_RETURN(const std::shared_ptr<grpc::ServerCredentials> credentials,
                            MakeServerCredentials(is_unix ? TlsOptions() : options.tls));
  std::unique_ptr<Listener> listener(new Listener(std::move(access), served));
  grpc::ServerBuilder builder;
  if (!options.reflection) builder.SetOption(std::make_unique<WithoutReflection>());
  SetLimits(options, &builder);
  builder.RegisterService(&listener->recognition_);
  builder.RegisterService(&listener->catalog_);
  builder.RegisterService(&listener->stations_);
  builder.RegisterService(&listener->info_);
  int port = 0;
  if (!options.address.empty()) builder.AddListeningPort(options.address, credentials, &port);
  // The socket's file is never open to others, not even between bind and chmod.
  const mode_t mask = is_unix ? ::umask(kOwnerAlone) : 0;
  listener->server_ = builder.BuildAndStart();
  if (is_unix) ::umask(mask);
  if (listener->server_ == nullptr || (!options.address.empty() && port == 0)) {
    return absl::UnavailableError(absl::StrCat("cannot listen on ", options.address));
  }
  listener->address_ = options.address;
  if (!options.address.empty() && !is_unix) {
    const std::string host = options.address.substr(0, options.address.rfind(':'));
    listener->address_ = absl::StrCat(host, ":", port);
  }
  listener->SetServing(true);
  return listener;
}

std::shared_ptr<grpc::Channel> Listener::InProcessChannel() {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(-1);
  return server_->InProcessChannel(arguments);
}

void Listener::SetServing(bool serving) {
  grpc::HealthCheckServiceInterface* health = server_->GetHealthCheckService();
  if (health == nullptr) return;
  health->SetServingStatus(serving);
  for (const char* name : kServiceNames) health->SetServingStatus(name, serving);
}

void Listener::Shutdown(std::chrono::system_clock::time_point until) {
  server_->Shutdown(until);
  server_->Wait();
}

}  // namespace horopter
