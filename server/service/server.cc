#include "server/service/server.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/exception_status.h"
#include "server/service/catalog_service.h"
#include "server/service/convert.h"
#include "server/service/server_info_service.h"
#include "server/service/worker_pool.h"

namespace horopter {
namespace {

constexpr const char* kServiceNames[] = {
    "horopter.v1.RecognitionService", "horopter.v1.CatalogService", "horopter.v1.ServerService"};

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

constexpr int kMaxStreamsPerConnection = 100;
constexpr int kMaxMetadataBytes = 16 << 10;

v1::ServerLimits LimitsToProto(const ServerOptions& options, const RecognitionLimits& limits) {
  v1::ServerLimits proto;
  proto.set_max_images(kMaxImages);
  proto.set_min_image_side_px(limits.images.min_side_px);
  proto.set_max_image_pixels(limits.images.max_pixels);
  proto.set_max_total_pixels(limits.images.max_total_pixels);
  proto.set_max_candidate_objects(kMaxCandidates);
  proto.set_max_searched_objects(PipelineOptions().max_searched_objects);
  proto.set_max_recognize_bytes(limits.max_request_bytes);
  proto.set_max_object_bytes(int64_t{options.max_object_mb} << 20);
  proto.set_memory_bytes(int64_t{options.memory_mb} << 20);
  proto.set_work_bytes_per_pixel(limits.work_bytes_per_pixel);
  proto.set_workers(options.workers);
  proto.set_queue(options.queue);
  proto.set_tiff_and_pnm(limits.images.tiff_and_pnm);
  return proto;
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
  std::unique_ptr<Telemetry> telemetry;
  std::unique_ptr<MemoryBudget> memory;
  std::unique_ptr<RecognitionService> recognition;
  std::unique_ptr<CatalogService> catalog;
  std::unique_ptr<ServerInfoService> info;
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
  HOROPTER_RETURN_IF_ERROR(InRange("max_object_mb", options.max_object_mb, 1, 2047));
  HOROPTER_RETURN_IF_ERROR(InRange("memory_mb", options.memory_mb, 16, 1'000'000));
  if (options.memory_mb < 2 * std::max(options.max_message_mb, options.max_object_mb)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "memory_mb: ", options.memory_mb, " MiB hold no message of the largest size twice"));
  }
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
  const auto figures = [store = parts->store.get()] {
    const auto published = store->Published();
    return CatalogFigures{static_cast<int64_t>(published->ids.size()),
                          published->snapshot.generation};
  };
  HOROPTER_ASSIGN_OR_RETURN(parts->telemetry, Telemetry::Start(options.telemetry, figures));
  RequestSink* const sink = parts->telemetry.get();
  parts->scene_pool = std::make_unique<WorkerPool>(options.workers, options.queue);
  parts->catalog_pool =
      std::make_unique<WorkerPool>(options.catalog_workers, options.catalog_queue);
  parts->memory = std::make_unique<MemoryBudget>(int64_t{options.memory_mb} << 20);
  RecognitionLimits limits;
  limits.images = options.images;
  limits.max_request_bytes = int64_t{options.max_message_mb} << 20;
  limits.decode_threads = options.threads_per_request;
  parts->recognition = std::make_unique<RecognitionService>(
      *parts->store,
      CallGate{parts->scene_pool.get(), parts->memory.get(), sink},
      std::move(recognizer),
      limits);
  parts->catalog = std::make_unique<CatalogService>(
      *parts->store,
      CallGate{parts->catalog_pool.get(), parts->memory.get(), sink},
      int64_t{options.max_object_mb} << 20);
  parts->info = std::make_unique<ServerInfoService>(
      *parts->store, *parts->scene_pool, *parts->memory, LimitsToProto(options, limits));

  grpc::ServerBuilder builder;
  const int largest_mb = std::max(options.max_message_mb, options.max_object_mb);
  builder.SetMaxReceiveMessageSize(largest_mb << 20);
  // An object with its CAD file, or a backup's chunk: what was received can be sent.
  builder.SetMaxSendMessageSize(std::min(2047, 2 * largest_mb) << 20);
  // Bounds what gRPC itself holds of messages on their way.
  grpc::ResourceQuota quota("horopter");
  quota.Resize(size_t{2} * static_cast<size_t>(largest_mb) << 20);
  builder.SetResourceQuota(quota);
  builder.AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, kMaxStreamsPerConnection);
  builder.AddChannelArgument(GRPC_ARG_MAX_METADATA_SIZE, kMaxMetadataBytes);
  // Otherwise a second server on the same port would silently take a share of the calls.
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
  builder.RegisterService(parts->recognition.get());
  builder.RegisterService(parts->catalog.get());
  builder.RegisterService(parts->info.get());
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

int HoropterServer::metrics_port() const {
  return parts_->telemetry->metrics_port();
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
