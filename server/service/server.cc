#include "server/service/server.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/exception_status.h"
#include "server/service/catalog_service.h"
#include "server/service/worker_pool.h"

namespace horopter {
namespace {

constexpr const char* kServiceNames[] = {"horopter.v1.RecognitionService",
                                         "horopter.v1.CatalogService"};

void EnableHealthAndReflection() {
  static const bool enabled = [] {
    grpc::EnableDefaultHealthCheckService(true);
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
    return true;
  }();
  (void)enabled;
}

void SetServing(grpc::Server& server, bool serving) {
  grpc::HealthCheckServiceInterface* health = server.GetHealthCheckService();
  if (health == nullptr) return;
  health->SetServingStatus(serving);
  for (const char* name : kServiceNames) health->SetServingStatus(name, serving);
}

absl::Status InRange(const char* name, int value, int low, int high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(name, ": ", value, " is outside ", low, "..", high));
}

}  // namespace

// In order of construction; the pools go before the services and the store they work on.
struct HoropterServer::Parts {
  std::unique_ptr<CatalogStore> store;
  std::unique_ptr<RecognitionService> recognition;
  std::unique_ptr<CatalogService> catalog;
  std::unique_ptr<WorkerPool> scene_pool;
  std::unique_ptr<WorkerPool> catalog_pool;
  std::unique_ptr<grpc::Server> server;
  std::string address;
};

absl::Status Validate(const ServerOptions& options) {
  HOROPTER_RETURN_IF_ERROR(InRange("workers", options.workers, 1, 256));
  HOROPTER_RETURN_IF_ERROR(InRange("queue", options.queue, 0, 10000));
  HOROPTER_RETURN_IF_ERROR(InRange("catalog_workers", options.catalog_workers, 1, 256));
  HOROPTER_RETURN_IF_ERROR(InRange("catalog_queue", options.catalog_queue, 0, 10000));
  HOROPTER_RETURN_IF_ERROR(InRange("max_message_mb", options.max_message_mb, 1, 2047));
  HOROPTER_RETURN_IF_ERROR(InRange("max_resident", options.max_resident, 1, 10'000'000));
  HOROPTER_RETURN_IF_ERROR(InRange("threads_per_request", options.threads_per_request, 1, 256));
  return InRange("load_threads", options.load_threads, 1, 256);
}

HoropterServer::HoropterServer(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}

HoropterServer::~HoropterServer() {
  Stop(0.0);
}

absl::StatusOr<std::unique_ptr<HoropterServer>> HoropterServer::Start(
    std::unique_ptr<Catalog> catalog,
    ObjectPreparer preparer,
    Recognizer recognizer,
    const ServerOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  EnableHealthAndReflection();
  auto parts = std::make_unique<Parts>();
  const auto load = [&] {
    return CatalogStore::Load(
        std::move(catalog),
        std::move(preparer),
        {.threads = options.load_threads, .max_resident = options.max_resident});
  };
  HOROPTER_ASSIGN_OR_RETURN(parts->store, CatchExceptions(load));
  const LoadReport& loaded = parts->store->load_report();
  for (const std::string& failure : loaded.failures) {
    spdlog::error("left out of recognition: {}", failure);
  }
  if (loaded.prepared > 0) {
    spdlog::info("{} objects prepared anew: their derived data were missing or out of date",
                 loaded.prepared);
  }
  if (!loaded.stored.ok()) {
    spdlog::warn("derived data cannot be stored, the next start is slow again: {}",
                 std::string(loaded.stored.message()));
  }
  parts->scene_pool = std::make_unique<WorkerPool>(options.workers, options.queue);
  parts->catalog_pool =
      std::make_unique<WorkerPool>(options.catalog_workers, options.catalog_queue);
  parts->recognition = std::make_unique<RecognitionService>(*parts->store,
                                                            *parts->scene_pool,
                                                            std::move(recognizer),
                                                            options.images,
                                                            options.threads_per_request);
  parts->catalog = std::make_unique<CatalogService>(*parts->store, *parts->catalog_pool);

  grpc::ServerBuilder builder;
  builder.SetMaxReceiveMessageSize(options.max_message_mb << 20);
  builder.SetMaxSendMessageSize(options.max_message_mb << 20);
  // Otherwise a second server on the same port would silently take a share of the calls.
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
  builder.RegisterService(parts->recognition.get());
  builder.RegisterService(parts->catalog.get());
  int port = 0;
  if (!options.listen.empty()) {
    builder.AddListeningPort(options.listen, grpc::InsecureServerCredentials(), &port);
  }
  parts->server = builder.BuildAndStart();
  if (parts->server == nullptr || (!options.listen.empty() && port == 0)) {
    return absl::UnavailableError(absl::StrCat("cannot listen on ", options.listen));
  }
  if (!options.listen.empty()) {
    parts->address = absl::StrCat(options.listen.substr(0, options.listen.rfind(':')), ":", port);
  }
  SetServing(*parts->server, true);
  return std::unique_ptr<HoropterServer>(new HoropterServer(std::move(parts)));
}

const std::string& HoropterServer::address() const {
  return parts_->address;
}

const CatalogStore& HoropterServer::store() const {
  return *parts_->store;
}

std::shared_ptr<grpc::Channel> HoropterServer::InProcessChannel() {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(-1);
  return parts_->server->InProcessChannel(arguments);
}

void HoropterServer::Stop(double drain_seconds) {
  if (parts_ == nullptr || parts_->server == nullptr) return;
  SetServing(*parts_->server, false);
  parts_->scene_pool->Close();
  parts_->catalog_pool->Close();
  const auto drain = std::chrono::duration_cast<std::chrono::system_clock::duration>(
      std::chrono::duration<double>(drain_seconds));
  parts_->server->Shutdown(std::chrono::system_clock::now() + drain);
  parts_->server->Wait();
  parts_->scene_pool.reset();
  parts_->catalog_pool.reset();
  parts_->server.reset();
}

}  // namespace horopter
