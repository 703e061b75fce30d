// One call of the server, passed on byte by byte.
#pragma once

#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <boost/asio/any_io_executor.hpp>
#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace horopter {

struct BridgeRequest {
  std::string method;  // /PACKAGE.SERVICE/METHOD
  std::string token;   // empty: none
  std::vector<grpc::ByteBuffer> messages;
  std::chrono::nanoseconds timeout{0};
};

// Unary calls and those whose answers stream; the next message is read when it is asked for, so
// that a slow reader holds one. Its methods are called, and the handler runs, on the executor's one
// thread.
class BridgeCall final : public grpc::ClientBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>,
                         public std::enable_shared_from_this<BridgeCall> {
 public:
  using Handler = std::function<void(std::optional<grpc::ByteBuffer>)>;

  static std::shared_ptr<BridgeCall> Start(grpc::GenericStub& stub,
                                           BridgeRequest request,
                                           boost::asio::any_io_executor executor);

  // The next message, or none when the call has ended. One at a time.
  void Next(Handler handler);

  // Nobody waits any more: the call is cancelled and no handler runs.
  void Abandon();

  // Once the call has ended.
  const grpc::Status& status() const { return status_; }
  std::multimap<std::string, std::string> trailing() const;
  // Once there is a message or the end.
  std::multimap<std::string, std::string> initial() const;

  void OnReadDone(bool ok) override;
  void OnWriteDone(bool ok) override;
  void OnDone(const grpc::Status& status) override;

 private:
  BridgeCall(BridgeRequest request, boost::asio::any_io_executor executor)
      : request_(std::move(request)), executor_(std::move(executor)) {}
  void Deliver(std::optional<grpc::ByteBuffer> message);

  BridgeRequest request_;
  boost::asio::any_io_executor executor_;
  grpc::ClientContext context_;
  grpc::ByteBuffer read_;
  size_t written_ = 0;
  grpc::Status status_;
  // Of the executor's thread.
  Handler handler_;
  bool reading_ = false, ended_ = false, abandoned_ = false;
  std::shared_ptr<BridgeCall> self_;  // until gRPC is done with it
};

}  // namespace horopter
