#include "client/channel.h"

#include <grpcpp/grpcpp.h>
#include <grpcpp/support/client_interceptor.h>

#include <fstream>
#include <sstream>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "client/address.h"
#include "client/token.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

namespace experimental = grpc::experimental;

// Credentials of a call would do the same, but not without TLS.
class TokenInterceptor final : public experimental::Interceptor {
 public:
  explicit TokenInterceptor(const std::string& value) : value_(value) {}
  void Intercept(experimental::InterceptorBatchMethods* methods) override {
    if (methods->QueryInterceptionHookPoint(
            experimental::InterceptionHookPoints::PRE_SEND_INITIAL_METADATA)) {
      methods->GetSendInitialMetadata()->emplace("authorization", value_);
    }
    methods->Proceed();
  }

 private:
  const std::string& value_;
};

class TokenInterceptorFactory final : public experimental::ClientInterceptorFactoryInterface {
 public:
  explicit TokenInterceptorFactory(const std::string& token) : value_("Bearer " + token) {}
  experimental::Interceptor* CreateClientInterceptor(experimental::ClientRpcInfo*) override {
    return new TokenInterceptor(value_);
  }

 private:
  const std::string value_;
};

absl::StatusOr<std::string> ReadPem(const std::string& path) {
  if (path.empty()) return std::string();
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  if (!file) return absl::FailedPreconditionError(absl::StrCat(path, ": cannot be read"));
  return text.str();
}

bool IsOnThisMachine(const std::string& address) {
  if (absl::StartsWith(address, "unix:")) return true;
  const std::string host = address.substr(0, address.rfind(':'));
  return host == "localhost" || host == "[::1]" ||
         (absl::StartsWith(host, "127.") && host.find_first_not_of("0123456789.") == host.npos);
}

}  // namespace

absl::StatusOr<std::shared_ptr<grpc::Channel>> MakeChannel(const std::string& address,
                                                           const ChannelSecurity& security) {
  HOROPTER_RETURN_IF_ERROR(CheckAddress(address));
  const bool tls = security.tls || !security.ca_file.empty() || !security.cert_file.empty();
  if (security.cert_file.empty() != security.key_file.empty()) {
    return absl::InvalidArgumentError("a client certificate needs its key and the reverse");
  }
  // Other bytes would end the process: gRPC asserts that metadata has none.
  HOROPTER_ASSIGN_OR_RETURN(const std::string token, CleanToken(security.token, "token"));
  if (!tls && !token.empty() && !IsOnThisMachine(address)) {
    return absl::FailedPreconditionError(
        absl::StrCat("a token is not sent to ", address, " without TLS"));
  }
  std::shared_ptr<grpc::ChannelCredentials> credentials = grpc::InsecureChannelCredentials();
  grpc::ChannelArguments arguments;
  if (tls) {
    grpc::SslCredentialsOptions options;
    HOROPTER_ASSIGN_OR_RETURN(options.pem_root_certs, ReadPem(security.ca_file));
    HOROPTER_ASSIGN_OR_RETURN(options.pem_cert_chain, ReadPem(security.cert_file));
    HOROPTER_ASSIGN_OR_RETURN(options.pem_private_key, ReadPem(security.key_file));
    credentials = grpc::SslCredentials(options);
    if (!security.server_name.empty()) arguments.SetSslTargetNameOverride(security.server_name);
  }
  if (!security.proxy || !MayUseProxy(address)) arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
  arguments.SetMaxReceiveMessageSize(-1);  // CAD files; the server bounds what it takes
  arguments.SetMaxSendMessageSize(-1);
  std::vector<std::unique_ptr<experimental::ClientInterceptorFactoryInterface>> interceptors;
  if (!token.empty()) {
    interceptors.push_back(std::make_unique<TokenInterceptorFactory>(token));
  }
  return experimental::CreateCustomChannelWithInterceptors(
      address, credentials, arguments, std::move(interceptors));
}

}  // namespace horopter
