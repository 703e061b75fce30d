#include "server/service/transport_security.h"

#include <grpcpp/security/server_credentials.h>
#include <grpcpp/security/tls_credentials_options.h>

#include <fstream>
#include <sstream>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

absl::Status CheckPem(const std::string& path, const char* kind) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  if (!file) return absl::FailedPreconditionError(absl::StrCat(path, ": cannot be read"));
  if (absl::StrContains(text.str(), "-----BEGIN ") && absl::StrContains(text.str(), kind)) {
    return absl::OkStatus();
  }
  return absl::FailedPreconditionError(absl::StrCat(path, ": holds no ", kind, " in PEM"));
}

}  // namespace

absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsOptions& options) {
  if (options.certificate.empty() != options.key.empty()) {
    return absl::InvalidArgumentError("tls_cert, tls_key: one is of no use without the other");
  }
  if (options.certificate.empty()) {
    if (options.client_ca.empty()) return grpc::InsecureServerCredentials();
    return absl::InvalidArgumentError("tls_client_ca: needs tls_cert and tls_key");
  }
  HOROPTER_RETURN_IF_ERROR(CheckPem(options.certificate, "CERTIFICATE"));
  HOROPTER_RETURN_IF_ERROR(CheckPem(options.key, "PRIVATE KEY"));
  if (!options.client_ca.empty()) {
    HOROPTER_RETURN_IF_ERROR(CheckPem(options.client_ca, "CERTIFICATE"));
  }
  using grpc::experimental::FileWatcherCertificateProvider;
  const auto provider = std::make_shared<FileWatcherCertificateProvider>(
      options.key,
      options.certificate,
      options.client_ca,
      static_cast<unsigned>(options.reload_seconds));
  grpc::experimental::TlsServerCredentialsOptions tls(provider);
  tls.watch_identity_key_cert_pairs();
  if (!options.client_ca.empty()) {
    tls.watch_root_certs();
    tls.set_cert_request_type(GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
  }
  return grpc::experimental::TlsServerCredentials(tls);
}

bool IsUnixAddress(const std::string& address) {
  return absl::StartsWith(address, "unix:") || absl::StartsWith(address, "unix-abstract:");
}

bool IsLocalAddress(const std::string& address) {
  if (IsUnixAddress(address)) return true;
  const std::string host = address.substr(0, address.rfind(':'));
  if (host == "localhost" || host == "[::1]") return true;
  return absl::StartsWith(host, "127.") && host.find_first_not_of("0123456789.") == host.npos;
}

}  // namespace horopter
