// TLS of a listener, and which addresses may do without.
#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"

namespace grpc {
class ServerCredentials;
}

namespace horopter {

// Files in PEM; read again when they have changed. To change certificate and key together, rename a
// folder or a symbolic link to it.
struct TlsOptions {
  std::string certificate;  // the server's chain; empty: no TLS
  std::string key;
  std::string client_ca;    // clients need a certificate of it (mutual TLS); empty: they need none
  int reload_seconds = 10;  // between two looks at the files; more: later change
};

// Credentials of a listener; without TLS insecure ones. Errors: INVALID_ARGUMENT (a certificate
// without a key or the reverse), FAILED_PRECONDITION (a file that cannot be read or is not PEM).
absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsOptions& options);

// HOST:PORT of the loopback interface, or unix:PATH: nobody else can read along.
bool IsLocalAddress(const std::string& address);
bool IsUnixAddress(const std::string& address);

}  // namespace horopter
