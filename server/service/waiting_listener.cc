#include "server/service/waiting_listener.h"

#include <grpcpp/generic/async_generic_service.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>

#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/service/listener.h"

namespace horopter {
namespace {

// A refused call needs no body: what is larger is not read.
constexpr int kLargestMessageBytes = 1 << 16;

class RefusedCall final : public grpc::ServerGenericBidiReactor {
 public:
  explicit RefusedCall(const std::string& reason) {
    Finish(grpc::Status(grpc::StatusCode::UNAVAILABLE, reason));
  }
  void OnDone() override { delete this; }
};

}  // namespace

class WaitingListener::Refusal final : public grpc::CallbackGenericService {
 public:
  explicit Refusal(std::string reason) : reason_(std::move(reason)) {}
  grpc::ServerGenericBidiReactor* CreateReactor(grpc::GenericCallbackServerContext*) override {
    return new RefusedCall(reason_);
  }

 private:
  const std::string reason_;
};

WaitingListener::WaitingListener() = default;

absl::StatusOr<std::unique_ptr<WaitingListener>> WaitingListener::Start(
    const std::string& address,
    const TlsOptions& tls,
    const ConnectionLimits& limits,
    const std::string& reason) {
  EnableHealthAndReflection();
  HOROPTER_ASSIGN_OR_RETURN(const std::shared_ptr<grpc::ServerCredentials> credentials,
                            MakeServerCredentials(IsUnixAddress(address) ? TlsOptions() : tls));
  std::unique_ptr<WaitingListener> listener(new WaitingListener());
  HOROPTER_ASSIGN_OR_RETURN(listener->acceptor_, Acceptor::Create(address, limits));
  listener->refusal_ = std::make_unique<Refusal>(reason);
  grpc::ServerBuilder builder;
  builder.SetMaxReceiveMessageSize(kLargestMessageBytes);
  builder.RegisterCallbackGenericService(listener->refusal_.get());
  const auto connections = AddAcceptedConnections(credentials, &builder);
  listener->server_ = builder.BuildAndStart();
  if (listener->server_ == nullptr) {
    return absl::UnavailableError(absl::StrCat("cannot serve on ", address));
  }
  SetHealth(*listener->server_, false);
  listener->acceptor_->Start(connections);
  return listener;
}

WaitingListener::~WaitingListener() {
  if (acceptor_ != nullptr) acceptor_->Stop();
  if (server_ == nullptr) return;
  server_->Shutdown(std::chrono::system_clock::now());
  server_->Wait();
}

}  // namespace horopter
