// The address of a server that does not serve yet: whoever watches learns that it lives.
#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/service/acceptor.h"
#include "server/service/transport_security.h"

namespace grpc {
class Server;
}

namespace horopter {

// From Start until it is destroyed grpc.health.v1 says NOT_SERVING, of the server and of each of
// its services, and all other calls are UNAVAILABLE with the reason. Knows no callers, so tells
// all of them the same: the reason holds nothing that only some may know.
class WaitingListener {
 public:
  // address: HOST:PORT or unix:PATH. Errors: INVALID_ARGUMENT (no address, a certificate without a
  // key), UNAVAILABLE (it cannot be bound), those of MakeServerCredentials.
  static absl::StatusOr<std::unique_ptr<WaitingListener>> Start(const std::string& address,
                                                                const TlsOptions& tls,
                                                                const ConnectionLimits& limits,
                                                                const std::string& reason);
  // The address is free again for the server.
  ~WaitingListener();

  // With the port that was bound.
  const std::string& address() const { return acceptor_->address(); }

 private:
  class Refusal;
  WaitingListener();

  std::unique_ptr<Refusal> refusal_;
  std::unique_ptr<Acceptor> acceptor_;
  std::unique_ptr<grpc::Server> server_;
};

}  // namespace horopter
