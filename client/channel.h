// A channel to a server: TLS, client certificate and bearer token.
#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"

namespace grpc {
class Channel;
}

namespace horopter {

// How a client proves who he is and whom it believes. Files in PEM.
struct ChannelSecurity {
  bool tls = false;       // with the system's authorities where ca_file is empty
  std::string ca_file;    // authorities that may vouch for the server; implies tls
  std::string cert_file;  // the client's certificate (mutual TLS) and its key; imply tls
  std::string key_file;
  std::string server_name;  // in the server's certificate; empty: the host of the address
  std::string token;        // sent with every call; without TLS only to this machine
  // Other machines are reached through the proxy that the environment names (http_proxy,
  // https_proxy, grpc_proxy), but for those of no_proxy or NO_PROXY; this machine never is.
  bool proxy = true;
};

// Connects when the first call is made. Errors: FAILED_PRECONDITION (a file cannot be read, a token
// would travel in the clear), INVALID_ARGUMENT (no address, a certificate without its key, a token
// of other than printable ASCII characters; blanks around it are dropped).
absl::StatusOr<std::shared_ptr<grpc::Channel>> MakeChannel(const std::string& address,
                                                           const ChannelSecurity& security);

}  // namespace horopter
