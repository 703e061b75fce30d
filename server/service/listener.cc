#include "server/service/listener.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/impl/server_builder_option.h>
#include <spdlog/spdlog.h>

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
                                         "horopter.v1.AnswerService",
                                         "horopter.v1.ServerService",
                                         "horopter.v1.RankingService"};
constexpr int kMaxStreamsPerConnection = 100;
constexpr int kMaxMetadataBytes = 16 << 10;
// Largest messages that gRPC itself may hold. Above it breaks calls off, those that are answered as
// well, and it needs more than the two that come in to hold two.
constexpr int kMessagesOnTheirWay = 4;

// Clients find out that a server is gone by pings, and so does the server. One that pings every 5 s
// is welcome, in calls and between them (proto/README.md); faster ones are not cut off either: a
// client that cannot choose would lose its calls, and what waits to be acknowledged is bounded.
constexpr int kPingsEveryMs = 5'000;
constexpr int kNeverTooManyPings = 0;
constexpr int kAskSilentClientsMs = 60'000;
constexpr int kAnswerWithinMs = 20'000;
// From the first byte to the settings that a client begins with.
constexpr int kHandshakeMs = 10'000;
// A connection without calls; clients of gRPC connect again by themselves. A backup may take the
// grace of an old one.
constexpr int kIdleMs = 3'600'000;
constexpr int kAgeGraceMs = 3'600'000;

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
}

void SetPatience(const ListenerOptions& options, grpc::ServerBuilder* builder) {
  for (const auto& [argument, value] :
       {std::pair(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, kPingsEveryMs),
        std::pair(GRPC_ARG_HTTP2_MAX_PING_STRIKES, kNeverTooManyPings),
        std::pair(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1),
        std::pair(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0),
        std::pair(GRPC_ARG_KEEPALIVE_TIME_MS, kAskSilentClientsMs),
        std::pair(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, kAnswerWithinMs),
        std::pair(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, kHandshakeMs),
        std::pair(GRPC_ARG_MAX_CONNECTION_IDLE_MS, kIdleMs),
        std::pair(GRPC_ARG_MAX_CONNECTION_AGE_MS, 1000 * options.max_age_seconds),
        std::pair(GRPC_ARG_MAX_CONNECTION_AGE_GRACE_MS, kAgeGraceMs)}) {
    builder->AddChannelArgument(argument, value);
  }
}

}  // namespace

void EnableHealthAndReflection() {
  static const bool enabled = [] {
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
    return true;
  }();
  (void)enabled;
}

void SetHealth(grpc::Server& server, bool serving) {
  grpc::HealthCheckServiceInterface* health = server.GetHealthCheckService();
  if (health == nullptr) return;
  health->SetServingStatus(serving);
  for (const char* name : kServiceNames) health->SetServingStatus(name, serving);
}

Acceptor::HandOver AddAcceptedConnections(
    const std::shared_ptr<grpc::ServerCredentials>& credentials, grpc::ServerBuilder* builder) {
  using grpc::experimental::ExternalConnectionAcceptor;
  using Experimental = grpc::ServerBuilder::experimental_type;
  const std::shared_ptr<ExternalConnectionAcceptor> connections =
      builder->experimental().AddExternalConnectionAcceptor(
          Experimental::ExternalConnectionType::FROM_FD, credentials);
  return [connections](int listening, int connection) {
    ExternalConnectionAcceptor::NewConnectionParameters parameters;
    parameters.listener_fd = listening;
    parameters.fd = connection;
    connections->HandleNewConnection(&parameters);
  };
}

Listener::Listener(std::unique_ptr<Access> access, TlsOptions tls, const ServedParts& served)
    : access_(std::move(access)),
      tls_(std::move(tls)),
      recognition_(served.store,
                   CallGate{&served.scenes, &served.memory, access_.get(), served.sink},
                   served.recognizer,
                   served.recognition),
      catalog_(served.store,
               served.shelf,
               served.cad_reader,
               CallGate{&served.catalog_calls, &served.memory, access_.get(), served.sink},
               served.max_object_bytes,
               served.recognition),
      stations_(served.store.catalog(),
                CallGate{&served.catalog_calls, &served.memory, access_.get(), served.sink}),
      answers_(served.board,
               served.recordings,
               CallGate{&served.catalog_calls, &served.memory, access_.get(), served.sink}),
      info_(served.store, served.scenes, served.memory, *access_, served.limits),
      ranking_(served.rank,
               CallGate{&served.scenes, &served.memory, access_.get(), served.sink},
               served.recognition.max_request_bytes) {}

Listener::~Listener() = default;

absl::StatusOr<std::unique_ptr<Listener>> Listener::Start(const ListenerOptions& options,
                                                          const ServedParts& served) {
  EnableHealthAndReflection();
  const TlsOptions tls = IsUnixAddress(options.address) ? TlsOptions() : options.tls;
  HOROPTER_ASSIGN_OR_RETURN(std::unique_ptr<Access> access, Access::Open(options.access));
  HOROPTER_ASSIGN_OR_RETURN(const std::shared_ptr<grpc::ServerCredentials> credentials,
                            MakeServerCredentials(tls));
  std::unique_ptr<Listener> listener(new Listener(std::move(access), tls, served));
  if (!options.address.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(listener->acceptor_,
                              Acceptor::Create(options.address, options.connections));
    listener->address_ = listener->acceptor_->address();
  }
  grpc::ServerBuilder builder;
  if (!options.reflection) builder.SetOption(std::make_unique<WithoutReflection>());
  SetLimits(options, &builder);
  SetPatience(options, &builder);
  builder.RegisterService(&listener->recognition_);
  builder.RegisterService(&listener->catalog_);
  builder.RegisterService(&listener->stations_);
  builder.RegisterService(&listener->answers_);
  builder.RegisterService(&listener->info_);
  builder.RegisterService(&listener->ranking_);
  const Acceptor::HandOver connections = AddAcceptedConnections(credentials, &builder);
  listener->server_ = builder.BuildAndStart();
  if (listener->server_ == nullptr) {
    return absl::UnavailableError(absl::StrCat("cannot serve on ", options.address));
  }
  if (listener->acceptor_ != nullptr) {
    listener->acceptor_->Start(connections);
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
  SetHealth(*server_, serving);
}

void Listener::Reload() {
  access_->Reload();
  const absl::StatusOr<absl::Time> until = CheckTlsFiles(tls_);
  if (!until.ok()) {
    spdlog::error("certificates: {}", std::string(until.status().message()));
  } else if (has_tls()) {
    spdlog::info("certificates are in force within {} s, until {}",
                 tls_.reload_seconds,
                 absl::FormatTime(*until, absl::UTCTimeZone()));
  }
}

void Listener::Shutdown(std::chrono::system_clock::time_point until) {
  if (acceptor_ != nullptr) acceptor_->Stop();
  server_->Shutdown(until);
  server_->Wait();
}

}  // namespace horopter
