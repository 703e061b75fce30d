#include "console/bridge_call.h"

#include <boost/asio/post.hpp>
#include <utility>

namespace horopter {
namespace {

std::multimap<std::string, std::string> Copied(
    const std::multimap<grpc::string_ref, grpc::string_ref>& metadata) {
  std::multimap<std::string, std::string> copied;
  for (const auto& [key, value] : metadata) {
    copied.emplace(std::string(key.data(), key.size()), std::string(value.data(), value.size()));
  }
  return copied;
}

}  // namespace

std::shared_ptr<BridgeCall> BridgeCall::Start(grpc::GenericStub& stub,
                                              BridgeRequest request,
                                              boost::asio::any_io_executor executor) {
  std::shared_ptr<BridgeCall> call(new BridgeCall(std::move(request), std::move(executor)));
  call->self_ = call;
  grpc::ClientContext& context = call->context_;
  if (!call->request_.token.empty()) {
    context.AddMetadata("authorization", "Bearer " + call->request_.token);
  }
  context.set_deadline(
      std::chrono::system_clock::now() +
      std::chrono::duration_cast<std::chrono::system_clock::duration>(call->request_.timeout));
  stub.PrepareBidiStreamingCall(&context, call->request_.method, {}, call.get());
  call->AddHold();  // reads are begun outside of reactions
  if (call->request_.messages.empty()) {
    call->StartWritesDone();
  } else {
    call->StartWrite(&call->request_.messages[0]);
  }
  call->StartCall();
  return call;
}

void BridgeCall::Next(Handler handler) {
  handler_ = std::move(handler);
  if (ended_) {
    boost::asio::post(executor_, [self = shared_from_this()] { self->Deliver(std::nullopt); });
    return;
  }
  reading_ = true;
  StartRead(&read_);
}

void BridgeCall::Abandon() {
  if (abandoned_ || ended_) return;
  abandoned_ = true;
  handler_ = nullptr;
  context_.TryCancel();
  if (!reading_) RemoveHold();
}

void BridgeCall::Deliver(std::optional<grpc::ByteBuffer> message) {
  const Handler handler = std::exchange(handler_, nullptr);
  if (handler) handler(std::move(message));
}

void BridgeCall::OnReadDone(bool ok) {
  if (!ok) {
    RemoveHold();  // the end follows
    return;
  }
  grpc::ByteBuffer message;
  message.Swap(&read_);
  boost::asio::post(executor_, [self = shared_from_this(), message = std::move(message)]() mutable {
    self->reading_ = false;
    if (self->abandoned_) {
      self->RemoveHold();
    } else {
      self->Deliver(std::move(message));
    }
  });
}

void BridgeCall::OnWriteDone(bool ok) {
  if (!ok) return;
  request_.messages[written_]
      .Clear();  // a file of a hundred megabytes is not held until the answer
  if (++written_ < request_.messages.size()) {
    StartWrite(&request_.messages[written_]);
  } else {
    StartWritesDone();
  }
}

void BridgeCall::OnDone(const grpc::Status& status) {
  status_ = status;
  boost::asio::post(executor_, [self = std::exchange(self_, nullptr)] {
    self->ended_ = true;
    if (!self->abandoned_) self->Deliver(std::nullopt);
  });
}

std::multimap<std::string, std::string> BridgeCall::trailing() const {
  return Copied(context_.GetServerTrailingMetadata());
}

std::multimap<std::string, std::string> BridgeCall::initial() const {
  return Copied(context_.GetServerInitialMetadata());
}

}  // namespace horopter
