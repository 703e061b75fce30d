// The calls that a browser's connection passes on: signing in, and those of the server.
#include "console/browser_connection.h"
#include "console/request_rules.h"
#include "console/sign_in.h"
#include "console/web_frames.h"

namespace horopter {
namespace {

constexpr size_t kMostMessages = 1024;
// It lasts as long as somebody looks, and is counted apart.
constexpr std::string_view kWatchMethod = "/horopter.v1.AnswerService/WatchAnswers";

}  // namespace

void BrowserConnection::SignIn() {
  if (!state_.sign_ins.Take(peer_, std::chrono::steady_clock::now())) {
    return Refuse(http::status::too_many_requests, "too many sign-ins: wait a minute", "sign_in");
  }
  absl::StatusOr<std::string> token = TokenOfBody(request().body(), state_.options);
  if (!token.ok()) {
    return Reply(TextReply(http::status::bad_request, std::string(token.status().message())),
                 "session");
  }
  if (!TakeCall()) return;
  token_ = *std::move(token);
  call_ = BridgeCall::Start(state_.stub, TokenTest(token_), stream_.get_executor());
  Watch();
  call_->Next([self = shared_from_this()](std::optional<grpc::ByteBuffer> message) {
    if (message) {
      self->call_->Next([self](std::optional<grpc::ByteBuffer>) { self->OnSignedIn(); });
    } else {
      self->OnSignedIn();
    }
  });
}

void BrowserConnection::OnSignedIn() {
  const grpc::Status status = std::exchange(call_, nullptr)->status();
  WebReply reply = SignInReply(status);
  if (status.ok()) {
    const std::string id =
        state_.sessions.Open(std::move(token_), std::chrono::steady_clock::now());
    if (id.empty()) {
      reply = TextReply(http::status::internal_server_error, "no random bytes");
    } else {
      reply.set(http::field::set_cookie,
                SessionCookie(id, scheme(), 3600.0 * state_.options.session.lifetime_hours));
    }
  }
  Reply(std::move(reply), "session");
}

bool BrowserConnection::TakeCall() {
  if (method_ && *method_ == kWatchMethod) {
    if (state_.watches >= state_.options.max_watches) {
      Refuse(http::status::service_unavailable, "too many watch already", "watches");
      return false;
    }
    ++state_.watches;
    counted_watch_ = true;
    return true;
  }
  if (state_.calls >= state_.options.max_calls) {
    Refuse(http::status::service_unavailable, "too many calls at once", "calls");
    return false;
  }
  ++state_.calls;
  counted_call_ = true;
  state_.metrics.calls().Set(state_.calls);
  return true;
}

void BrowserConnection::StartCall() {
  auto body = std::make_shared<std::string>(std::move(parser_->get().body()));
  absl::StatusOr<std::vector<std::string_view>> messages = ReadWebMessages(*body, kMostMessages);
  if (!messages.ok()) {
    return Reply(TextReply(http::status::bad_request, std::string(messages.status().message())),
                 "call");
  }
  if (!TakeCall()) return;
  BridgeRequest bridged;
  bridged.method = *method_;
  bridged.token = token_;
  bridged.timeout = Seconds(state_.options.call_seconds);
  if (const auto asked = ParseGrpcTimeout(FieldOf(request(), "grpc-timeout"))) {
    bridged.timeout = std::min(*asked, bridged.timeout);
  }
  bridged.messages = SharedMessages(body, *messages);
  head_.emplace(http::status::ok, 11);
  call_ = BridgeCall::Start(state_.stub, std::move(bridged), stream_.get_executor());
  Watch();
  NextMessage();
}

void BrowserConnection::NextMessage() {
  call_->Next([self = shared_from_this()](std::optional<grpc::ByteBuffer> message) {
    self->Send(std::move(message));
  });
}

// A message, or the trailers when there is none; before the first the head.
void BrowserConnection::Send(std::optional<grpc::ByteBuffer> message) {
  if (head_) {
    BeginAnswer(call_->initial(), request().keep_alive(), &*head_);
    serializer_.emplace(*head_);
    stream_.lowest().expires_after(Seconds(state_.options.write_seconds));
    return http::async_write_header(stream_,
                                    *serializer_,
                                    [self = shared_from_this(), message = std::move(message)](
                                        beast::error_code error, size_t) mutable {
                                      if (error) return self->Close();
                                      self->serializer_.reset();
                                      self->head_.reset();
                                      if (self->call_) self->Send(std::move(message));
                                    });
  }
  piece_ = message ? MessagePiece(*message) : EndPiece(call_->status(), call_->trailing());
  const bool last = !message;
  stream_.lowest().expires_after(Seconds(state_.options.write_seconds));
  asio::async_write(stream_,
                    BuffersOf(piece_),
                    [self = shared_from_this(), last](beast::error_code error, size_t) {
                      if (error) return self->Close();
                      self->stream_.lowest().expires_never();
                      if (!self->call_) return;
                      if (!last) return self->NextMessage();
                      self->EndCall();
                    });
}

void BrowserConnection::EndCall() {
  const int code = call_->status().error_code();
  state_.metrics.CountCall(code);
  state_.metrics.CountRequest("call", 200);
  // A token that is over ends the session that was opened with it.
  if (code == grpc::StatusCode::UNAUTHENTICATED) {
    state_.sessions.Close(CookieOf(FieldOf(request(), "Cookie"), kSessionCookie));
  }
  call_ = nullptr;
  piece_ = {};
  const bool more = request().keep_alive();
  Release();
  if (more) return ReadHead();
  Close();
}

// Notices that the browser has gone while the server works; what comes is kept for the next
// request.
void BrowserConnection::Watch() {
  if (watching_) return;
  if (buffer_.size() > kMostHeadBytes) return;  // somebody sends ahead: he waits
  watching_ = true;
  stream_.async_read_some(buffer_.prepare(4096),
                          [self = shared_from_this()](beast::error_code error, size_t bytes) {
                            self->watching_ = false;
                            if (error) return self->Close();
                            self->buffer_.commit(bytes);
                            if (!std::exchange(self->resume_, false)) return;
                            self->idle_.cancel();
                            self->ReadHead();
                          });
}

}  // namespace horopter
