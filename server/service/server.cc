#include "server/service/server.h"

#include <grpcpp/grpcpp.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/exception_status.h"
#include "server/service/convert.h"
#include "server/service/listener.h"
#include "server/service/worker_pool.h"

namespace horopter {
namespace {

// Scale spaces of SIFT (up to 100 MB for a tile), hypotheses and solvers of one thread.
constexpr int64_t kStageBytesPerThread = int64_t{128} << 20;

// As many threads work on scenes as there are workers and threads of the pool, whose size the
// threads that load the catalog have, too.
int64_t StageBytes(const ServerOptions& options) {
  const int64_t allowed = int64_t{options.workers} * options.threads_per_request;
  const int64_t there = int64_t{options.workers} + options.load_threads - 1;
  return kStageBytesPerThread * std::min(allowed, there);
}

v1::ServerLimits LimitsToProto(const ServerOptions& options, const RecognitionLimits& limits) {
  v1::ServerLimits proto;
  proto.set_max_images(kMaxImages);
  proto.set_min_image_side_px(limits.images.min_side_px);
  proto.set_max_image_pixels(limits.images.max_pixels);
  proto.set_max_total_pixels(limits.images.max_total_pixels);
  proto.set_max_candidate_objects(kMaxCandidates);
  proto.set_max_searched_objects(PipelineOptions().max_searched_objects);
  proto.set_max_objects(options.max_objects);
  proto.set_max_recognize_bytes(limits.max_request_bytes);
  proto.set_max_object_bytes(int64_t{options.max_object_mb} << 20);
  proto.set_memory_bytes(int64_t{options.memory_mb} << 20);
  proto.set_work_bytes_per_pixel(limits.work_bytes_per_pixel);
  proto.set_stage_bytes(StageBytes(options));
  proto.set_workers(options.workers);
  proto.set_queue(options.queue);
  const FeatureOptions features = PipelineOptions().features;
  proto.set_max_segments_per_image(features.max_segments);
  proto.set_max_arcs_per_image(features.arcs.max_arcs);
  proto.set_tiff_and_pnm(limits.images.tiff_and_pnm);
  return proto;
}

// Images, parts and tokens do not travel in the clear unless that is said.
absl::Status CheckPrivate(const std::string& address, const ServerOptions& options) {
  if (address.empty() || IsLocalAddress(address)) return absl::OkStatus();
  if (options.insecure) return absl::OkStatus();
  if (!options.tls.certificate.empty()) {
    if (!options.access_file.empty() || options.open_access) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat("listen: ",
                     address,
                     " can be reached from other machines, and whoever connects may do everything: "
                     "give access-file, or say open-access"));
  }
  return absl::InvalidArgumentError(
      absl::StrCat("listen: ",
                   address,
                   " can be reached from other machines: give tls-cert and tls-key, or say "
                   "insecure where the network is private"));
}

ListenerOptions MainListener(const ServerOptions& options) {
  ListenerOptions listener;
  listener.address = options.listen;
  listener.tls = options.tls;
  listener.access.file = options.access_file;
  listener.access.admin_calls = options.admin_calls && options.admin_listen.empty();
  listener.reflection = options.reflection && options.admin_listen.empty();
  listener.connections = options.connections;
  listener.max_age_seconds = options.max_connection_age_seconds;
  listener.largest_message_mb = std::max(options.max_message_mb, options.max_object_mb);
  return listener;
}

ListenerOptions AdminListener(const ServerOptions& options) {
  ListenerOptions listener = MainListener(options);
  listener.address = options.admin_listen;
  listener.access.admin_calls = true;
  if (IsUnixAddress(options.admin_listen)) listener.access.file.clear();
  listener.reflection = options.reflection;
  return listener;
}

// What is asked of rankers are the edges of images: they do not travel in the clear, either.
absl::Status ValidateRanking(const ServerOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options.rankers));
  const bool ranker = options.role == "ranker";
  if (!ranker && options.role != "server")
    return absl::InvalidArgumentError(
        absl::StrCat("role: '", options.role, "' is neither server nor ranker"));
  const absl::StatusOr<ShardNumber> shard = ParseShard(options.shard);
  if (!shard.ok()) return shard.status();
  if (!ranker && shard->count > 1)
    return absl::InvalidArgumentError("shard: of a ranker alone (--role ranker)");
  if (ranker && !options.rankers.addresses.empty())
    return absl::InvalidArgumentError("rankers: of a server alone, not of a ranker");
  for (const std::string& address : options.rankers.addresses) {
    if (options.insecure || !options.rankers.ca.empty() || IsLocalAddress(address)) continue;
    return absl::InvalidArgumentError(
        absl::StrCat("rankers: ",
                     address,
                     " is another machine: give ranker-ca, or say insecure where the network is "
                     "private"));
  }
  return absl::OkStatus();
}

// Of a ranker.
absl::StatusOr<PipelineResult> RefuseScenes(const SceneRequest&,
                                            const CatalogSnapshot&,
                                            const CallLimits&) {
  return absl::FailedPreconditionError("this server is a ranker (--role ranker)");
}

absl::StatusOr<std::unique_ptr<RankingShard>> StartShard(const CatalogStore& store,
                                                         const ServerOptions& options,
                                                         const StopRequested& stop) {
  if (options.role != "ranker") return std::unique_ptr<RankingShard>();
  RankingShardOptions of_shard;
  HOROPTER_ASSIGN_OR_RETURN(of_shard.shard, ParseShard(options.shard));
  of_shard.threads = options.threads_per_request;
  if (!options.derived_cache.empty()) of_shard.cache = options.derived_cache + "/ranking";
  of_shard.cache_bytes = int64_t{options.derived_cache_mb} << 20;
  HOROPTER_ASSIGN_OR_RETURN(auto shard, RankingShard::Start(store, of_shard, stop));
  const RankingShard::Figures figures = shard->figures();
  spdlog::info("ranks {} parts, shard {}: {:.1f} MB of keys",
               figures.parts,
               options.shard,
               1e-6 * static_cast<double>(figures.bytes));
  return shard;
}

absl::Status ValidateAddresses(const ServerOptions& options) {
  for (const auto& [option, address] :
       {std::pair("listen", options.listen),
        std::pair("admin-listen", options.admin_listen),
        std::pair("metrics-listen", options.telemetry.metrics_listen)}) {
    if (address.empty()) continue;
    HOROPTER_RETURN_IF_ERROR(ParseListenAddress(option, address).status());
  }
  if (IsUnixAddress(options.telemetry.metrics_listen)) {
    return absl::InvalidArgumentError("metrics-listen: Prometheus needs HOST:PORT");
  }
  for (const std::string& address : {options.listen, options.admin_listen}) {
    HOROPTER_RETURN_IF_ERROR(CheckPrivate(address, options));
  }
  return absl::OkStatus();
}

absl::Status InRange(const char* name, int value, int low, int high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(name, ": ", value, " is outside ", low, "..", high));
}

void TellLoad(const LoadReport& loaded) {
  for (const std::string& failure : loaded.failures) {
    spdlog::error("left out of recognition: {}", failure);
  }
  if (loaded.prepared > 0) {
    spdlog::info("{} objects prepared again: their derived data were missing or out of date",
                 loaded.prepared);
  }
  if (loaded.pending > 0) {
    spdlog::warn(
        "{} objects are prepared again beside what is served, and recognition does without them "
        "until "
        "then: their derived data are missing or of another version",
        loaded.pending);
  }
  if (!loaded.stored.ok()) {
    spdlog::warn("derived data cannot be stored, the next start is slow again: {}",
                 std::string(loaded.stored.message()));
  }
}

}  // namespace

// In order of construction; the pools go before the listeners, whose services their jobs use.
struct HoropterServer::Parts {
  std::unique_ptr<CatalogStore> store;
  std::unique_ptr<RankingShard> shard;  // null: no ranker
  std::unique_ptr<Telemetry> telemetry;
  std::unique_ptr<AnswerBoard> board;
  std::unique_ptr<PostingSink> sink;
  std::unique_ptr<MemoryBudget> memory;
  BackupShelf shelf;
  std::unique_ptr<CadReader> cad_reader;
  std::unique_ptr<WorkerPool> scene_pool;
  std::unique_ptr<WorkerPool> catalog_pool;
  std::unique_ptr<Listener> listener;
  std::unique_ptr<Listener> admin_listener;  // null: none
  std::unique_ptr<PortWatch> watch;          // null: nobody looks

  std::vector<Listener*> listeners() const {
    if (admin_listener == nullptr) return {listener.get()};
    return {listener.get(), admin_listener.get()};
  }
};

absl::Status Validate(const ServerOptions& options) {
  HOROPTER_RETURN_IF_ERROR(ValidateAddresses(options));
  HOROPTER_RETURN_IF_ERROR(ValidateRanking(options));
  HOROPTER_RETURN_IF_ERROR(
      InRange("max-connections", options.connections.max_connections, 1, 1'000'000));
  HOROPTER_RETURN_IF_ERROR(
      InRange("max-connections-per-peer", options.connections.max_per_peer, 1, 1'000'000));
  HOROPTER_RETURN_IF_ERROR(
      InRange("max-connection-age-seconds", options.max_connection_age_seconds, 1, 1'000'000));
  if (options.telemetry.audit_required && options.telemetry.audit_log.empty()) {
    return absl::InvalidArgumentError("audit-required: needs audit-log");
  }
  HOROPTER_RETURN_IF_ERROR(InRange("tls-reload-seconds", options.tls.reload_seconds, 1, 86400));
  HOROPTER_RETURN_IF_ERROR(InRange("workers", options.workers, 1, 256));
  HOROPTER_RETURN_IF_ERROR(InRange("queue", options.queue, 0, 10000));
  if (!(options.max_wait >= 0.0 && options.max_wait <= 1e4)) {
    return absl::InvalidArgumentError(
        absl::StrCat("max-wait: ", options.max_wait, " is not between 0 and 10000"));
  }
  HOROPTER_RETURN_IF_ERROR(InRange("catalog-workers", options.catalog_workers, 1, 256));
  HOROPTER_RETURN_IF_ERROR(InRange("catalog-queue", options.catalog_queue, 0, 10000));
  HOROPTER_RETURN_IF_ERROR(InRange("max-message-mb", options.max_message_mb, 1, 2047));
  HOROPTER_RETURN_IF_ERROR(InRange("max-object-mb", options.max_object_mb, 1, 2047));
  HOROPTER_RETURN_IF_ERROR(InRange("memory-mb", options.memory_mb, 16, 1'000'000));
  if (options.memory_mb < 2 * std::max(options.max_message_mb, options.max_object_mb)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "memory-mb: ", options.memory_mb, " MiB hold no message of the largest size twice"));
  }
  HOROPTER_RETURN_IF_ERROR(InRange("max_watchers", options.watch.max_watchers, 0, 10'000));
  HOROPTER_RETURN_IF_ERROR(InRange("watch_memory_mb", options.watch.memory_mb, 1, 100'000));
  HOROPTER_RETURN_IF_ERROR(Validate(options.cad));
  HOROPTER_RETURN_IF_ERROR(InRange("max-resident", options.max_resident, 1, 10'000'000));
  HOROPTER_RETURN_IF_ERROR(InRange("derived-cache-mb", options.derived_cache_mb, 1, 100'000'000));
  HOROPTER_RETURN_IF_ERROR(InRange("max-objects", options.max_objects, 1, 10'000'000));
  HOROPTER_RETURN_IF_ERROR(InRange("threads-per-request", options.threads_per_request, 1, 256));
  return InRange("load-threads", options.load_threads, 1, 256);
}

HoropterServer::HoropterServer(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}

HoropterServer::~HoropterServer() {
  Stop(0.0);
}

absl::StatusOr<std::unique_ptr<HoropterServer>> HoropterServer::Start(
    std::unique_ptr<Catalog> catalog,
    ObjectPreparer preparer,
    Recognizer recognizer,
    const ServerOptions& options,
    const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  auto parts = std::make_unique<Parts>();
  const auto load = [&] {
    return CatalogStore::Load(std::move(catalog),
                              std::move(preparer),
                              {.threads = options.load_threads,
                               .stop = stop,
                               .max_resident = options.max_resident,
                               .max_objects = options.max_objects,
                               .prepare_beside = !options.prepare_first,
                               .derived_cache = options.derived_cache,
                               .derived_cache_bytes = int64_t{options.derived_cache_mb} << 20});
  };
  HOROPTER_ASSIGN_OR_RETURN(parts->store, CatchExceptions(load));
  TellLoad(parts->store->load_report());
  RemoveLeftovers(parts->store->catalog());
  const auto figures = [store = parts->store.get()] {
    const auto published = store->Published();
    return CatalogFigures{static_cast<int64_t>(published->ids.size()),
                          static_cast<int64_t>(published->unusable.size()),
                          static_cast<int64_t>(published->pending.size()),
                          published->snapshot.generation,
                          store->SecondsBehind()};
  };
  TelemetryOptions telemetry = options.telemetry;
  telemetry.certificate = options.tls.certificate;
  HOROPTER_ASSIGN_OR_RETURN(parts->telemetry, Telemetry::Start(telemetry, figures));
  AnswerBoardOptions watch = options.watch;
  watch.images = options.images;
  parts->board = std::make_unique<AnswerBoard>(watch);
  parts->sink = std::make_unique<PostingSink>(*parts->telemetry, *parts->board);
  parts->scene_pool =
      std::make_unique<WorkerPool>(options.workers, options.queue, options.max_wait);
  parts->catalog_pool =
      std::make_unique<WorkerPool>(options.catalog_workers, options.catalog_queue);
  parts->memory = std::make_unique<MemoryBudget>(int64_t{options.memory_mb} << 20);
  parts->cad_reader =
      std::make_unique<CadReader>(options.cad, int64_t{options.max_object_mb} << 20);
  RecognitionLimits limits;
  limits.images = options.images;
  limits.max_request_bytes = int64_t{options.max_message_mb} << 20;
  limits.decode_threads = options.threads_per_request;
  limits.allow_variants = options.allow_variants;
  HOROPTER_ASSIGN_OR_RETURN(parts->shard, StartShard(*parts->store, options, stop));
  PartRanker rank;
  if (parts->shard != nullptr) {
    recognizer = RefuseScenes;
    rank = [shard = parts->shard.get()](const auto& images, const StopRequested& stopped) {
      return shard->Rank(images, stopped);
    };
  }
  if (!options.rankers.addresses.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(auto rankers, Rankers::Create(options.rankers));
    recognizer = RankedRecognizer(std::move(recognizer), std::move(rankers));
  }
  const ServedParts served{
      .store = *parts->store,
      .rank = std::move(rank),
      .shelf = parts->shelf,
      .cad_reader = *parts->cad_reader,
      .board = *parts->board,
      .recordings = options.telemetry.recorder.folder,
      .scenes = *parts->scene_pool,
      .catalog_calls = *parts->catalog_pool,
      .memory = *parts->memory,
      .sink = parts->sink.get(),
      .recognizer = std::move(recognizer),
      .recognition = limits,
      .max_object_bytes = int64_t{options.max_object_mb} << 20,
      .limits = LimitsToProto(options, limits),
  };
  HOROPTER_ASSIGN_OR_RETURN(parts->listener, Listener::Start(MainListener(options), served));
  if (!options.admin_listen.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(parts->admin_listener,
                              Listener::Start(AdminListener(options), served));
  }
  parts->telemetry->AskForLoad([scenes = parts->scene_pool.get(), memory = parts->memory.get()] {
    const WorkerPool::Load now = scenes->load();
    return LoadFigures{now.running, now.waiting, memory->used(), memory->bytes()};
  });
  return std::unique_ptr<HoropterServer>(new HoropterServer(std::move(parts)));
}

const std::string& HoropterServer::address() const {
  return parts_->listener->address();
}

const std::string& HoropterServer::admin_address() const {
  static const std::string none;
  return parts_->admin_listener == nullptr ? none : parts_->admin_listener->address();
}

int HoropterServer::metrics_port() const {
  return parts_->telemetry->metrics_port();
}

const CatalogStore& HoropterServer::store() const {
  return *parts_->store;
}

std::shared_ptr<grpc::Channel> HoropterServer::InProcessChannel() {
  return parts_->listener->InProcessChannel();
}

void HoropterServer::Reload() {
  const absl::Status reopened = parts_->telemetry->Reopen();
  if (!reopened.ok()) spdlog::error("{}", std::string(reopened.message()));
  for (Listener* listener : parts_->listeners()) listener->Reload();
}

void HoropterServer::WatchPorts(const PortWatchOptions& options,
                                std::function<void()> reached,
                                std::function<void(const std::string& why)> lost) {
  std::vector<WatchedPort> ports;
  for (Listener* listener : parts_->listeners()) {
    if (!listener->address().empty()) ports.push_back({listener->address(), listener->has_tls()});
  }
  parts_->watch =
      std::make_unique<PortWatch>(std::move(ports), options, std::move(reached), std::move(lost));
}

void HoropterServer::Stop(double drain_seconds) {
  if (parts_ == nullptr || parts_->listener == nullptr) return;
  parts_->watch.reset();
  for (Listener* listener : parts_->listeners()) listener->SetServing(false);
  parts_->board->Close();  // who watches would hold the end up
  parts_->scene_pool->Close();
  parts_->catalog_pool->Close();
  const auto drain = std::chrono::duration_cast<std::chrono::system_clock::duration>(
      std::chrono::duration<double>(drain_seconds));
  const auto until = std::chrono::system_clock::now() + drain;
  for (Listener* listener : parts_->listeners()) listener->Shutdown(until);
  parts_->telemetry->AskForLoad({});
  parts_->scene_pool.reset();
  parts_->catalog_pool.reset();
  parts_->admin_listener.reset();
  parts_->listener.reset();
}

}  // namespace horopter
