#include "console/web_connection.h"

#include <boost/asio/ssl/stream.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/ssl.hpp>
#include <optional>
#include <type_traits>
#include <utility>

#include "console/request_rules.h"
#include "console/rpc_answer.h"
#include "console/sign_in.h"
#include "console/web_frames.h"
#include "console/web_reply.h"

namespace horopter {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = boost::beast::http;
using Plain = beast::tcp_stream;
using Tls = beast::ssl_stream<beast::tcp_stream>;

constexpr size_t kMostHeadBytes = 16 << 10;
constexpr size_t kMostSignInBytes = 128 << 10;
constexpr size_t kMostMessages = 1024;

std::chrono::nanoseconds Seconds(double seconds) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
      std::chrono::duration<double>(seconds));
}

template <class Stream>
class Connection final : public WebConnection,
                         public std::enable_shared_from_this<Connection<Stream>> {
 public:
  Connection(Stream stream,
             std::string peer,
             std::shared_ptr<asio::ssl::context> tls,
             ConsoleState& state,
             std::function<void()> closed)
      : tls_(std::move(tls)),
        stream_(std::move(stream)),
        peer_(std::move(peer)),
        state_(state),
        closed_(std::move(closed)),
        idle_(stream_.get_executor()) {}
  ~Connection() override {
    Release();
    closed_();
  }

  void Start() override {
    if constexpr (std::is_same_v<Stream, Tls>) {
      Lowest().expires_after(Seconds(state_.options.head_seconds));
      stream_.async_handshake(asio::ssl::stream_base::server,
                              [self = this->shared_from_this()](beast::error_code error) {
                                if (!error) self->ReadHead();
                              });
    } else {
      ReadHead();
    }
  }

  void Close() override {
    if (call_) std::exchange(call_, nullptr)->Abandon();
    idle_.cancel();
    beast::error_code ignored;
    Lowest().socket().close(ignored);
  }

 private:
  beast::tcp_stream& Lowest() { return beast::get_lowest_layer(stream_); }
  std::string_view scheme() const { return std::is_same_v<Stream, Tls> ? "https" : "http"; }
  const http::request<http::string_body>& request() const { return parser_->get(); }

  void ReadHead() {
    if (watching_) {
      // The read that watches for the browser's end is still there, and may bring the next request.
      resume_ = true;
      idle_.expires_after(Seconds(state_.options.idle_seconds));
      idle_.async_wait([self = this->shared_from_this()](beast::error_code error) {
        if (!error && self->resume_) self->Close();
      });
      return;
    }
    parser_.emplace();
    parser_->header_limit(kMostHeadBytes);
    parser_->body_limit(boost::none);  // set when the head is known
    Lowest().expires_after(
        Seconds(first_ ? state_.options.head_seconds : state_.options.idle_seconds));
    first_ = false;
    http::async_read_header(stream_,
                            buffer_,
                            *parser_,
                            [self = this->shared_from_this()](beast::error_code error, size_t) {
                              self->OnHead(error);
                            });
  }

  void OnHead(beast::error_code error) {
    if (error == http::error::header_limit) {
      return Refuse(http::status::request_header_fields_too_large, "the head is too long", "head");
    }
    if (error.category() == http::make_error_code(http::error::bad_method).category() &&
        error != http::error::end_of_stream && error != http::error::partial_message) {
      return Refuse(http::status::bad_request, "this is not HTTP", "malformed");
    }
    if (error) return Close();
    const auto now = std::chrono::steady_clock::now();
    const WebRequestHead& head = request();
    if (!state_.rates.Take(peer_, now)) {
      return Refuse(http::status::too_many_requests, "too many requests", "rate");
    }
    if (!IsOwnHost(FieldOf(head, "Host"), state_.options.names)) {
      return Refuse(
          http::status::misdirected_request, "this host name is not one of ours (--name)", "host");
    }
    if (head.method() == http::verb::get || head.method() == http::verb::head) return AnswerGet();
    if (head.method() != http::verb::post) {
      return Refuse(http::status::method_not_allowed, "only GET, HEAD and POST", "method");
    }
    const BrowserHead browser{FieldOf(head, "Host"),
                              FieldOf(head, "Origin"),
                              FieldOf(head, "Sec-Fetch-Site"),
                              FieldOf(head, kConsoleHeader)};
    if (const std::string why = WhyForeign(browser, scheme()); !why.empty()) {
      return Refuse(http::status::forbidden, why, "foreign");
    }
    ReadBody(now);
  }

  // Who is not signed in sends no body beyond his token's.
  void ReadBody(std::chrono::steady_clock::time_point now) {
    const WebRequestHead& head = request();
    const std::string_view target(head.target().data(), head.target().size());
    uint64_t most = kMostSignInBytes;
    if (target != "/sign-in" && target != "/sign-out") {
      method_ = RpcMethodOf(target);
      if (!method_) return Refuse(http::status::not_found, "no such call", "path");
      const std::string_view type = FieldOf(head, "Content-Type");
      if (type != "application/grpc-web+proto" && type != "application/grpc-web") {
        return Refuse(
            http::status::unsupported_media_type, "calls are application/grpc-web+proto", "type");
      }
      const std::string* token =
          state_.sessions.Use(CookieOf(FieldOf(head, "Cookie"), kSessionCookie), now);
      if (token == nullptr) {
        return Refuse(http::status::unauthorized, "sign in first", "session");
      }
      token_ = *token;
      most = static_cast<uint64_t>(state_.options.max_body_mb) << 20;
    }
    const auto length = parser_->content_length();
    if (!length) return Refuse(http::status::length_required, "say the length", "length");
    if (*length > most) {
      return Refuse(http::status::payload_too_large,
                    "at most " + std::to_string(most) + " bytes are taken",
                    "size");
    }
    const auto bytes = static_cast<int64_t>(*length);
    if (state_.body_bytes + bytes > static_cast<int64_t>(state_.options.memory_mb) << 20) {
      return Refuse(http::status::service_unavailable, "too much is on its way", "memory");
    }
    Reserve(bytes);
    parser_->body_limit(most);
    Lowest().expires_after(Seconds(state_.options.body_seconds));
    http::async_read(stream_,
                     buffer_,
                     *parser_,
                     [self = this->shared_from_this()](beast::error_code error, size_t) {
                       if (error) return self->Close();
                       self->OnBody();
                     });
  }

  void OnBody() {
    Lowest().expires_never();
    const std::string_view target(request().target().data(), request().target().size());
    if (target == "/sign-in") return SignIn();
    if (target == "/sign-out") {
      state_.sessions.Close(CookieOf(FieldOf(request(), "Cookie"), kSessionCookie));
      WebReply reply = TextReply(http::status::ok, "{}", "application/json");
      reply.set(http::field::set_cookie, SessionCookie("", scheme(), 0.0));
      return Reply(std::move(reply), "session");
    }
    StartCall();
  }

  void AnswerGet() {
    const WebRequestHead& head = request();
    if (parser_->content_length() && *parser_->content_length() > 0) {
      return Refuse(http::status::bad_request, "a question has no body", "malformed");
    }
    std::string_view path(head.target().data(), head.target().size());
    path = path.substr(0, path.find('?'));
    if (path == "/healthz") return Reply(HealthReply(state_), "health");
    if (path == "/metrics") {
      state_.metrics.sessions().Set(static_cast<double>(state_.sessions.size()));
      return Reply(TextReply(http::status::ok, state_.metrics.Text(), "text/plain; version=0.0.4"),
                   "metrics");
    }
    if (path == "/session") {
      const std::string_view id = CookieOf(FieldOf(head, "Cookie"), kSessionCookie);
      return Reply(SessionReply(state_, id), "session");
    }
    const PageFile* const file = state_.page.Find(path);
    if (file == nullptr) return Reply(TextReply(http::status::not_found, "not found"), "page");
    Reply(FileReply(*file, head), "page");
  }

  void SignIn() {
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
    call_->Next([self = this->shared_from_this()](std::optional<grpc::ByteBuffer> message) {
      if (message) {
        self->call_->Next([self](std::optional<grpc::ByteBuffer>) { self->OnSignedIn(); });
      } else {
        self->OnSignedIn();
      }
    });
  }

  void OnSignedIn() {
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

  bool TakeCall() {
    if (state_.calls >= state_.options.max_calls) {
      Refuse(http::status::service_unavailable, "too many calls at once", "calls");
      return false;
    }
    ++state_.calls;
    counted_call_ = true;
    state_.metrics.calls().Set(state_.calls);
    return true;
  }

  void StartCall() {
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

  void NextMessage() {
    call_->Next([self = this->shared_from_this()](std::optional<grpc::ByteBuffer> message) {
      self->Send(std::move(message));
    });
  }

  // A message, or the trailers when there is none; before the first the head.
  void Send(std::optional<grpc::ByteBuffer> message) {
    if (head_) {
      BeginAnswer(call_->initial(), request().keep_alive(), &*head_);
      serializer_.emplace(*head_);
      Lowest().expires_after(Seconds(state_.options.write_seconds));
      return http::async_write_header(
          stream_,
          *serializer_,
          [self = this->shared_from_this(), message = std::move(message)](beast::error_code error,
                                                                          size_t) mutable {
            if (error) return self->Close();
            self->serializer_.reset();
            self->head_.reset();
            if (self->call_) self->Send(std::move(message));
          });
    }
    piece_ = message ? MessagePiece(*message) : EndPiece(call_->status(), call_->trailing());
    const bool last = !message;
    Lowest().expires_after(Seconds(state_.options.write_seconds));
    asio::async_write(stream_,
                      BuffersOf(piece_),
                      [self = this->shared_from_this(), last](beast::error_code error, size_t) {
                        if (error) return self->Close();
                        self->Lowest().expires_never();
                        if (!self->call_) return;
                        if (!last) return self->NextMessage();
                        self->EndCall();
                      });
  }

  void EndCall() {
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
  void Watch() {
    if (watching_) return;
    if (buffer_.size() > kMostHeadBytes) return;  // somebody sends ahead: he waits
    watching_ = true;
    stream_.async_read_some(
        buffer_.prepare(4096),
        [self = this->shared_from_this()](beast::error_code error, size_t bytes) {
          self->watching_ = false;
          if (error) return self->Close();
          self->buffer_.commit(bytes);
          if (!std::exchange(self->resume_, false)) return;
          self->idle_.cancel();
          self->ReadHead();
        });
  }

  void Refuse(http::status status, const std::string& text, const std::string& why) {
    state_.metrics.CountRefusal(why);
    WebReply reply = TextReply(status, text + "\n");
    reply.keep_alive(false);
    closing_ = true;
    Reply(std::move(reply), "refused");
  }

  void Reply(WebReply reply, const std::string& kind) {
    state_.metrics.CountRequest(kind, reply.result_int());
    const bool close = closing_ || !request().keep_alive();
    reply.keep_alive(!close);
    reply_ = std::make_shared<WebReply>(std::move(reply));
    Lowest().expires_after(Seconds(state_.options.write_seconds));
    // The length of what HEAD asks for is that of what it would get.
    const bool head_only = parser_ && request().method() == http::verb::head;
    reply_serializer_.emplace(*reply_);
    reply_serializer_->split(head_only);
    const auto done = [self = this->shared_from_this(), close](beast::error_code error, size_t) {
      if (error) return self->Close();
      self->reply_serializer_.reset();
      self->Release();
      if (!close) return self->ReadHead();
      self->Linger();
    };
    if (head_only) {
      http::async_write_header(stream_, *reply_serializer_, done);
    } else {
      http::async_write(stream_, *reply_serializer_, done);
    }
  }

  // A refusal is read by who still sends only when his bytes are taken for a while.
  void Linger() {
    if (watching_) return Close();
    beast::error_code ignored;
    Lowest().socket().shutdown(asio::ip::tcp::socket::shutdown_send, ignored);
    Lowest().expires_after(std::chrono::seconds(2));
    Drain();
  }

  void Drain() {
    buffer_.clear();
    Lowest().async_read_some(
        buffer_.prepare(65536),
        [self = this->shared_from_this()](beast::error_code error, size_t bytes) {
          self->drained_ += bytes;
          if (error || self->drained_ > size_t{64} << 20) return self->Close();
          self->Drain();
        });
  }

  void Reserve(int64_t bytes) {
    reserved_ += bytes;
    state_.body_bytes += bytes;
    state_.metrics.body_bytes().Set(static_cast<double>(state_.body_bytes));
  }

  // What the request held.
  void Release() {
    Reserve(-reserved_);
    if (std::exchange(counted_call_, false)) {
      --state_.calls;
      state_.metrics.calls().Set(state_.calls);
    }
    token_.clear();
    method_.reset();
  }

  const std::shared_ptr<asio::ssl::context> tls_;
  Stream stream_;
  const std::string peer_;
  ConsoleState& state_;
  const std::function<void()> closed_;
  asio::steady_timer idle_;  // while a watching read takes the place of the next request's
  beast::flat_buffer buffer_;
  std::optional<http::request_parser<http::string_body>> parser_;
  std::optional<std::string> method_;
  std::string token_;
  int64_t reserved_ = 0;
  bool counted_call_ = false, watching_ = false, resume_ = false, closing_ = false, first_ = true;
  size_t drained_ = 0;
  std::shared_ptr<WebReply> reply_;
  std::optional<http::serializer<false, http::string_body>> reply_serializer_;
  std::shared_ptr<BridgeCall> call_;
  std::optional<RpcHead> head_;
  std::optional<http::serializer<false, http::empty_body>> serializer_;
  RpcPiece piece_;
};

}  // namespace

std::shared_ptr<WebConnection> MakeWebConnection(asio::ip::tcp::socket socket,
                                                 const std::string& peer,
                                                 std::shared_ptr<asio::ssl::context> tls,
                                                 ConsoleState& state,
                                                 std::function<void()> closed) {
  if (tls == nullptr) {
    return std::make_shared<Connection<Plain>>(
        Plain(std::move(socket)), peer, nullptr, state, std::move(closed));
  }
  return std::make_shared<Connection<Tls>>(
      Tls(std::move(socket), *tls), peer, tls, state, std::move(closed));
}

}  // namespace horopter
