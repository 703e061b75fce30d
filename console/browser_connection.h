// One browser's connection: what it reads and writes (web_connection.cc), and the calls that it
// passes on (web_calls.cc).
#pragma once

#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "console/bridge_call.h"
#include "console/console_state.h"
#include "console/rpc_answer.h"
#include "console/web_connection.h"
#include "console/web_reply.h"
#include "console/web_stream.h"

namespace horopter {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = boost::beast::http;

constexpr size_t kMostHeadBytes = 16 << 10;

inline std::chrono::nanoseconds Seconds(double seconds) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
      std::chrono::duration<double>(seconds));
}

class BrowserConnection final : public WebConnection,
                                public std::enable_shared_from_this<BrowserConnection> {
 public:
  BrowserConnection(WebStream stream,
                    std::string peer,
                    ConsoleState& state,
                    std::function<void()> closed)
      : stream_(std::move(stream)),
        peer_(std::move(peer)),
        state_(state),
        closed_(std::move(closed)),
        idle_(stream_.get_executor()) {}
  ~BrowserConnection() override {
    Release();
    closed_();
  }

  void Start() override;
  void Close() override;

 private:
  std::string_view scheme() const { return stream_.is_tls() ? "https" : "http"; }
  const http::request<http::string_body>& request() const { return parser_->get(); }

  void ReadHead();
  void OnHead(beast::error_code error);
  void ReadBody(std::chrono::steady_clock::time_point now);
  void OnBody();
  void AnswerGet();
  void Refuse(http::status status, const std::string& text, const std::string& why);
  void Reply(WebReply reply, const std::string& kind);
  void Linger();
  void Drain();
  void Reserve(int64_t bytes);
  void Release();

  void SignIn();
  void OnSignedIn();
  bool TakeCall();
  void StartCall();
  void NextMessage();
  void Send(std::optional<grpc::ByteBuffer> message);
  void EndCall();
  void Watch();

  WebStream stream_;
  const std::string peer_;
  ConsoleState& state_;
  const std::function<void()> closed_;
  asio::steady_timer idle_;  // while a watching read takes the place of the next request's
  beast::flat_buffer buffer_;
  std::optional<http::request_parser<http::string_body>> parser_;
  std::optional<std::string> method_;
  std::string token_;
  int64_t reserved_ = 0;
  bool counted_call_ = false, counted_watch_ = false, watching_ = false, resume_ = false,
       closing_ = false, first_ = true;
  size_t drained_ = 0;
  std::shared_ptr<WebReply> reply_;
  std::optional<http::serializer<false, http::string_body>> reply_serializer_;
  std::shared_ptr<BridgeCall> call_;
  std::optional<RpcHead> head_;
  std::optional<http::serializer<false, http::empty_body>> serializer_;
  RpcPiece piece_;
};

}  // namespace horopter
