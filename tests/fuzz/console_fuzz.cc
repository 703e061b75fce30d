#include <boost/asio/buffer.hpp>
#include <boost/beast/http.hpp>
#include <string>

#include "console/request_rules.h"
#include "console/rpc_answer.h"
#include "console/sign_in.h"
#include "console/web_frames.h"
#include "tests/fuzz/check.h"

namespace horopter {
namespace {

namespace http = boost::beast::http;

// The frames of a body are in it, one after the other, and make the same body again.
void CheckFrames(const std::string& body) {
  constexpr size_t kMost = 1024;
  const auto messages = ReadWebMessages(body, kMost);
  if (!messages.ok()) {
    Require(messages.status().code() == absl::StatusCode::kInvalidArgument);
    Require(!messages.status().message().empty());
    return;
  }
  Require(!messages->empty() && messages->size() <= kMost);
  std::string again;
  for (const std::string_view message : *messages) {
    again += WebMessageHead(static_cast<uint32_t>(message.size()));
    again += message;
  }
  Require(again == body);
}

// What a server says becomes lines of a frame, none of which ends early.
void CheckTrailers(const std::string& text) {
  const size_t half = text.size() / 2;
  const std::multimap<std::string, std::string> metadata = {
      {text.substr(0, half), text.substr(half)}, {"details-bin", text}, {"key", text}};
  const std::string frame = WebTrailerFrame(3, text, metadata);
  Require(frame.size() >= kWebFrameHead && static_cast<unsigned char>(frame[0]) == 0x80);
  size_t begin = kWebFrameHead;
  while (begin < frame.size()) {
    const size_t end = frame.find("\r\n", begin);
    Require(end != frame.npos);
    const std::string line = frame.substr(begin, end - begin);
    Require(line.find(": ") != line.npos && line.find_first_of("\r\n") == line.npos);
    begin = end + 2;
  }
  (void)WebHeaderValue(text.substr(0, half), text.substr(half));
}

std::string Field(const http::request<http::string_body>& request, std::string_view name) {
  const auto value = request[boost::beast::string_view(name.data(), name.size())];
  return {value.data(), value.size()};
}

// A request that is HTTP, as a connection judges it.
void CheckRequest(const http::request<http::string_body>& request) {
  const std::string target(request.target().data(), request.target().size());
  const std::string host = Field(request, "Host"), origin = Field(request, "Origin");
  const std::string site = Field(request, "Sec-Fetch-Site"),
                    marker = Field(request, kConsoleHeader);
  const std::string cookies = Field(request, "Cookie");
  (void)IsOwnHost(host, {"cell-pc"});
  if (WhyForeign({host, origin, site, marker}, "http").empty()) {
    Require(marker == "1" && (origin.empty() || origin == "http://" + host));
  }
  const std::string_view cookie = CookieOf(cookies, kSessionCookie);
  Require(cookie.empty() || cookies.find(cookie) != cookies.npos);
  if (const auto method = RpcMethodOf(target)) {
    Require(*method == target && target.find("..") == target.npos);
  }
  if (const auto timeout = ParseGrpcTimeout(Field(request, "grpc-timeout"))) {
    Require(timeout->count() >= 0);
  }
  const auto token = TokenOfBody(request.body(), {});
  if (token.ok()) Require(token->find_first_of("\r\n") == token->npos);
  CheckFrames(request.body());
}

}  // namespace
}  // namespace horopter

// Whatever a browser sends: HTTP, the rules of it, and frames of gRPC-Web.
extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, size_t size) {
  using namespace horopter;
  const std::string bytes(reinterpret_cast<const char*>(data), size);
  CheckFrames(bytes);
  CheckTrailers(bytes.substr(0, 512));
  http::request_parser<http::string_body> parser;
  parser.header_limit(16 << 10);
  parser.body_limit(1 << 20);
  parser.eager(true);
  boost::system::error_code error;
  size_t begin = 0;
  while (begin < bytes.size() && !error && !parser.is_done()) {
    const size_t taken =
        parser.put(boost::asio::buffer(bytes.data() + begin, bytes.size() - begin), error);
    if (taken == 0) break;
    begin += taken;
  }
  if (!error && parser.is_header_done()) CheckRequest(parser.get());
  return 0;
}
