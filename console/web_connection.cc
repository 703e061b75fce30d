#include "console/web_connection.h"

#include "console/browser_connection.h"
#include "console/request_rules.h"
#include "console/sign_in.h"

namespace horopter {
namespace {

constexpr size_t kMostSignInBytes = 128 << 10;

}  // namespace

void BrowserConnection::Start() {
  if (!stream_.is_tls()) return ReadHead();
  stream_.lowest().expires_after(Seconds(state_.options.head_seconds));
  stream_.async_handshake([self = shared_from_this()](beast::error_code error) {
    if (!error) self->ReadHead();
  });
}

void BrowserConnection::Close() {
  if (call_) std::exchange(call_, nullptr)->Abandon();
  idle_.cancel();
  beast::error_code ignored;
  stream_.lowest().socket().close(ignored);
}

void BrowserConnection::ReadHead() {
  if (watching_) {
    // The read that watches for the browser's end is still there, and may bring the next request.
    resume_ = true;
    idle_.expires_after(Seconds(state_.options.idle_seconds));
    idle_.async_wait([self = shared_from_this()](beast::error_code error) {
      if (!error && self->resume_) self->Close();
    });
    return;
  }
  parser_.emplace();
  parser_->header_limit(kMostHeadBytes);
  parser_->body_limit(boost::none);  // set when the head is known
  stream_.lowest().expires_after(
      Seconds(first_ ? state_.options.head_seconds : state_.options.idle_seconds));
  first_ = false;
  http::async_read_header(
      stream_, buffer_, *parser_, [self = shared_from_this()](beast::error_code error, size_t) {
        self->OnHead(error);
      });
}

void BrowserConnection::OnHead(beast::error_code error) {
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
void BrowserConnection::ReadBody(std::chrono::steady_clock::time_point now) {
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
  stream_.lowest().expires_after(Seconds(state_.options.body_seconds));
  http::async_read(
      stream_, buffer_, *parser_, [self = shared_from_this()](beast::error_code error, size_t) {
        if (error) return self->Close();
        self->OnBody();
      });
}

void BrowserConnection::OnBody() {
  stream_.lowest().expires_never();
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

void BrowserConnection::AnswerGet() {
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

void BrowserConnection::Refuse(http::status status,
                               const std::string& text,
                               const std::string& why) {
  state_.metrics.CountRefusal(why);
  WebReply reply = TextReply(status, text + "\n");
  reply.keep_alive(false);
  closing_ = true;
  Reply(std::move(reply), "refused");
}

void BrowserConnection::Reply(WebReply reply, const std::string& kind) {
  state_.metrics.CountRequest(kind, reply.result_int());
  const bool close = closing_ || !request().keep_alive();
  reply.keep_alive(!close);
  reply_ = std::make_shared<WebReply>(std::move(reply));
  stream_.lowest().expires_after(Seconds(state_.options.write_seconds));
  // The length of what HEAD asks for is that of what it would get.
  const bool head_only = parser_ && request().method() == http::verb::head;
  reply_serializer_.emplace(*reply_);
  reply_serializer_->split(head_only);
  const auto done = [self = shared_from_this(), close](beast::error_code error, size_t) {
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
void BrowserConnection::Linger() {
  if (watching_) return Close();
  beast::error_code ignored;
  stream_.lowest().socket().shutdown(asio::ip::tcp::socket::shutdown_send, ignored);
  stream_.lowest().expires_after(std::chrono::seconds(2));
  Drain();
}

void BrowserConnection::Drain() {
  buffer_.clear();
  stream_.lowest().async_read_some(
      buffer_.prepare(65536), [self = shared_from_this()](beast::error_code error, size_t bytes) {
        self->drained_ += bytes;
        if (error || self->drained_ > size_t{64} << 20) return self->Close();
        self->Drain();
      });
}

void BrowserConnection::Reserve(int64_t bytes) {
  reserved_ += bytes;
  state_.body_bytes += bytes;
  state_.metrics.body_bytes().Set(static_cast<double>(state_.body_bytes));
}

// What the request held.
void BrowserConnection::Release() {
  Reserve(-reserved_);
  if (std::exchange(counted_call_, false)) {
    --state_.calls;
    state_.metrics.calls().Set(state_.calls);
  }
  if (std::exchange(counted_watch_, false)) --state_.watches;
  token_.clear();
  method_.reset();
}

std::shared_ptr<WebConnection> MakeWebConnection(asio::ip::tcp::socket socket,
                                                 const std::string& peer,
                                                 std::shared_ptr<asio::ssl::context> tls,
                                                 ConsoleState& state,
                                                 std::function<void()> closed) {
  return std::make_shared<BrowserConnection>(
      WebStream(std::move(socket), std::move(tls)), peer, state, std::move(closed));
}

}  // namespace horopter
