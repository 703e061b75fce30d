#include "server/service/transport_security.h"

#include <grpcpp/security/server_credentials.h>
#include <grpcpp/security/tls_credentials_options.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <spdlog/spdlog.h>

#include <ctime>
#include <fstream>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

template <typename T, void (*Free)(T*)>
struct Freed {
  void operator()(T* t) const { Free(t); }
};
using Bio = std::unique_ptr<BIO, Freed<BIO, ::BIO_free_all>>;
using Certificate = std::unique_ptr<X509, Freed<X509, ::X509_free>>;
using PrivateKey = std::unique_ptr<EVP_PKEY, Freed<EVP_PKEY, ::EVP_PKEY_free>>;

absl::Status BadFile(const std::string& path, const char* why) {
  ::ERR_clear_error();
  return absl::FailedPreconditionError(absl::StrCat(path, ": ", why));
}

absl::StatusOr<Bio> OpenFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  if (!file) return BadFile(path, "cannot be read");
  const std::string bytes = text.str();
  Bio bio(::BIO_new(::BIO_s_mem()));
  if (bio == nullptr || ::BIO_write(bio.get(), bytes.data(), static_cast<int>(bytes.size())) < 0) {
    return absl::ResourceExhaustedError("out of memory");
  }
  return bio;
}

// The first one of the file, which is the server's own.
absl::StatusOr<Certificate> ReadCertificate(const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const Bio bio, OpenFile(path));
  Certificate certificate(::PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr));
  if (certificate == nullptr) return BadFile(path, "holds no CERTIFICATE in PEM");
  return certificate;
}

// An encrypted key would wait for a word at a terminal.
int NoPassword(char*, int, int, void* asked) {
  *static_cast<bool*>(asked) = true;
  return -1;
}

absl::StatusOr<PrivateKey> ReadKey(const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const Bio bio, OpenFile(path));
  bool encrypted = false;
  PrivateKey key(::PEM_read_bio_PrivateKey(bio.get(), nullptr, &NoPassword, &encrypted));
  if (key != nullptr) return key;
  return BadFile(path,
                 encrypted ? "is encrypted; a server needs its key without a password"
                           : "holds no PRIVATE KEY in PEM");
}

absl::Time TimeOf(const ASN1_TIME* time) {
  std::tm utc = {};
  if (::ASN1_TIME_to_tm(time, &utc) != 1) return absl::InfiniteFuture();
  return absl::FromTM(utc, absl::UTCTimeZone());
}

}  // namespace

absl::StatusOr<absl::Time> CheckTlsFiles(const TlsOptions& options) {
  if (options.certificate.empty() != options.key.empty()) {
    return absl::InvalidArgumentError("tls-cert, tls-key: one is of no use without the other");
  }
  if (options.certificate.empty()) {
    if (options.client_ca.empty()) return absl::InfiniteFuture();
    return absl::InvalidArgumentError("tls-client-ca: needs tls-cert and tls-key");
  }
  HOROPTER_ASSIGN_OR_RETURN(const Certificate certificate, ReadCertificate(options.certificate));
  HOROPTER_ASSIGN_OR_RETURN(const PrivateKey key, ReadKey(options.key));
  if (::X509_check_private_key(certificate.get(), key.get()) != 1) {
    return BadFile(options.key,
                   absl::StrCat("is not the key of the certificate ", options.certificate).c_str());
  }
  if (!options.client_ca.empty()) {
    HOROPTER_RETURN_IF_ERROR(ReadCertificate(options.client_ca).status());
  }
  const absl::Time begins = TimeOf(::X509_get0_notBefore(certificate.get()));
  const absl::Time ends = TimeOf(::X509_get0_notAfter(certificate.get()));
  if (ends < absl::Now() || begins > absl::Now()) {
    spdlog::warn("{} is good from {} to {}: clients will not believe it now",
                 options.certificate,
                 absl::FormatTime(begins, absl::UTCTimeZone()),
                 absl::FormatTime(ends, absl::UTCTimeZone()));
  }
  return ends;
}

absl::StatusOr<absl::Time> CertificateEnd(const std::string& path) {
  HOROPTER_ASSIGN_OR_RETURN(const Certificate certificate, ReadCertificate(path));
  return TimeOf(::X509_get0_notAfter(certificate.get()));
}

absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsOptions& options) {
  HOROPTER_RETURN_IF_ERROR(CheckTlsFiles(options).status());
  if (options.certificate.empty()) return grpc::InsecureServerCredentials();
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

}  // namespace horopter
