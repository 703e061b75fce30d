// The whole server behind one object: catalog store, services, worker pools, health and reflection.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/service/acceptor.h"
#include "server/service/access.h"
#include "server/service/answer_board.h"
#include "server/service/cad_reader.h"
#include "server/service/catalog_store.h"
#include "server/service/image_decode.h"
#include "server/service/port_watch.h"
#include "server/service/rankers.h"
#include "server/service/ranking_shard.h"
#include "server/service/recognition_service.h"
#include "server/service/telemetry.h"
#include "server/service/transport_security.h"

namespace grpc {
class Channel;
}

namespace horopter {

struct ServerOptions {
  // HOST:PORT, port 0: any free one, or unix:PATH; empty: in-process only (tests).
  std::string listen;
  TlsOptions tls;            // of all listeners but Unix sockets
  bool insecure = false;     // listen where others can read along without TLS
  std::string access_file;   // tokens and certificates with roles (access.h); empty: all may do all
  bool open_access = false;  // without an access file where others can call, though with TLS
  // A second listener, HOST:PORT or unix:PATH, for calls that need an admin and for reflection,
  // which the first one then refuses. Who can open a Unix socket, made for its owner alone, is an
  // admin without a token. Empty: none.
  std::string admin_listen;
  bool admin_calls = true;  // false: the first listener refuses them
  bool reflection = true;
  ConnectionLimits connections;  // of each listener
  // Connections are asked to end after so long, and clients connect anew: where several servers
  // share a name, each gets its share of them again after a restart. Lower: sooner.
  int max_connection_age_seconds = 86'400;
  int workers = 1;  // scenes at once; more: more throughput, slower single answers
  int queue = 8;    // scenes that may wait; more: longer waits before a refusal
  // How long a scene may have to wait by the mean time of a scene, as a share of it; raising it
  // refuses less under load and makes answers later. 0: as long as the queue is.
  double max_wait = 0.0;
  int catalog_workers = 2;  // catalog calls at once
  int catalog_queue = 64;
  int max_message_mb = 256;  // of a request for recognition
  int max_object_mb = 192;   // of a request that holds an object
  // Requests, decoded images and the stages' share by pixels of all calls together; beside it the
  // receiving side of gRPC holds at most four of the largest messages, and the stages what
  // ServerLimits.stage_bytes says. Raising it lets more large calls wait.
  int memory_mb = 4096;
  int threads_per_request = 2;  // decode its images
  int load_threads = 2;         // prepare the catalog at start
  // Objects of a catalog of another version are prepared before anything is served; else beside it
  // (StoreOptions).
  bool prepare_first = false;
  int max_resident = 5000;  // objects held in memory (StoreOptions)
  // Folder for what was derived of objects, and its size (StoreOptions); empty: none.
  std::string derived_cache;
  int derived_cache_mb = 20'000;
  // A full catalog refuses further objects. Above max_searched_objects of the pipeline requests
  // have to name candidates.
  int max_objects = 5000;
  ImageLimits images;
  bool allow_variants = false;  // a request may choose variants of the methods (RecognitionLimits)
  AnswerBoardOptions watch;     // who may see what was answered, and how much of it is held
  CadReaderOptions cad;         // of ImportObject
  // "ranker": holds the keys of a share of the catalog, `shard` (NUMBER/COUNT), ranks parts by them
  // for other servers and recognises nothing; "server": all else.
  std::string role = "server";
  std::string shard = "1/1";
  RankerOptions rankers;       // of a server whose catalog is ranked by others
  TelemetryOptions telemetry;  // metrics, request log, traces, recordings; none by default
};

// Errors: INVALID_ARGUMENT naming the option.
absl::Status Validate(const ServerOptions& options);

// Serves from Start until Stop or destruction.
class HoropterServer {
 public:
  // Errors: INVALID_ARGUMENT (options), UNAVAILABLE (the address cannot be bound), those of
  // CatalogStore::Load (CANCELLED when `stop` says so while the catalog is loaded),
  // RESOURCE_EXHAUSTED (out of memory).
  static absl::StatusOr<std::unique_ptr<HoropterServer>> Start(std::unique_ptr<Catalog> catalog,
                                                               ObjectPreparer preparer,
                                                               Recognizer recognizer,
                                                               const ServerOptions& options,
                                                               const StopRequested& stop = {});
  ~HoropterServer();

  // host:port with the port that was bound; empty without a listener.
  const std::string& address() const;
  const std::string& admin_address() const;
  const CatalogStore& store() const;
  int metrics_port() const;  // 0: no metrics are served

  // A client connected without the network.
  std::shared_ptr<grpc::Channel> InProcessChannel();

  // The files of the logs are opened anew, access file and certificates looked at. What fails is
  // logged and stays as it was.
  void Reload();

  // Looks at the listeners' ports from now until Stop; PortWatch says when it calls what.
  void WatchPorts(const PortWatchOptions& options,
                  std::function<void()> reached,
                  std::function<void(const std::string& why)> lost);

  // Health becomes NOT_SERVING, new calls are refused with UNAVAILABLE, accepted ones may finish
  // for `drain_seconds`; then they are cancelled. Returns when the last one is done.
  void Stop(double drain_seconds);

 private:
  struct Parts;
  explicit HoropterServer(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace horopter
