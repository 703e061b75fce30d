// TLS of a listener, and which addresses may do without.
#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/time/time.h"

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
// without a key or the reverse), those of CheckTlsFiles.
absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsOptions& options);

// What the files say now: until when the server's certificate is good; infinite without TLS. Warns
// in the log of one that is over or not yet begun, which clients will not believe. Errors: as
// above, and FAILED_PRECONDITION when key and certificate do not belong together or the key is
// encrypted.
absl::StatusOr<absl::Time> CheckTlsFiles(const TlsOptions& options);

// Until when the first certificate of the file is good. Errors: FAILED_PRECONDITION.
absl::StatusOr<absl::Time> CertificateEnd(const std::string& path);

}  // namespace horopter
