// The whole server behind one object: catalog store, services, worker pools, health and reflection.
#pragma once

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/service/catalog_store.h"
#include "server/service/image_decode.h"
#include "server/service/recognition_service.h"
#include "server/service/telemetry.h"

namespace grpc {
class Channel;
}

namespace horopter {

struct ServerOptions {
  std::string listen;       // host:port, port 0: any free one; empty: in-process only (tests)
  int workers = 1;          // scenes at once; more: more throughput, slower single answers
  int queue = 8;            // scenes that may wait; more: longer waits before a refusal
  int catalog_workers = 2;  // catalog calls at once
  int catalog_queue = 64;
  int max_message_mb = 256;  // of a request for recognition
  int max_object_mb = 192;   // of a request that holds an object
  // Requests, decoded images and the stages' share of all calls together; the receiving side of
  // gRPC holds at most two of the largest messages beside it. Raising it lets more large calls
  // wait.
  int memory_mb = 4096;
  int threads_per_request = 2;  // decode its images
  int load_threads = 2;         // prepare the catalog at start
  int max_resident = 5000;      // objects held in memory (StoreOptions)
  ImageLimits images;
  TelemetryOptions telemetry;  // metrics, request log, traces, recordings; none by default
};

// Errors: INVALID_ARGUMENT naming the option.
absl::Status Validate(const ServerOptions& options);

// Serves from Start until Stop or destruction.
class HoropterServer {
 public:
  // Errors: INVALID_ARGUMENT (options), UNAVAILABLE (the address cannot be bound), those of
  // CatalogStore::Load, RESOURCE_EXHAUSTED (out of memory).
  static absl::StatusOr<std::unique_ptr<HoropterServer>> Start(std::unique_ptr<Catalog> catalog,
                                                               ObjectPreparer preparer,
                                                               Recognizer recognizer,
                                                               const ServerOptions& options);
  ~HoropterServer();

  // host:port with the port that was bound; empty without a listener.
  const std::string& address() const;
  const CatalogStore& store() const;
  int metrics_port() const;  // 0: no metrics are served

  // A client connected without the network.
  std::shared_ptr<grpc::Channel> InProcessChannel();

  // Health becomes NOT_SERVING, new calls are refused with UNAVAILABLE, accepted ones may finish
  // for `drain_seconds`; then they are cancelled. Returns when the last one is done.
  void Stop(double drain_seconds);

 private:
  struct Parts;
  explicit HoropterServer(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace horopter
