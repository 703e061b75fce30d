#include "console/sign_in.h"

#include <chrono>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "client/token.h"

namespace horopter {
namespace {

namespace http = boost::beast::http;
using nlohmann::json;

constexpr auto kTestWithin = std::chrono::seconds(10);

WebReply JsonReply(http::status status, const json& value) {
  return TextReply(
      status, value.dump(-1, ' ', true, json::error_handler_t::replace), "application/json");
}

}  // namespace

absl::StatusOr<std::string> TokenOfBody(const std::string& body, const ConsoleOptions& options) {
  const json parsed = json::parse(body, nullptr, false);
  if (!parsed.is_object() || !parsed.contains("token") || !parsed["token"].is_string()) {
    return absl::InvalidArgumentError("expected {\"token\": \"..\"}");
  }
  absl::StatusOr<std::string> token = CleanToken(parsed["token"].get<std::string>(), "token");
  if (token.ok() && token->empty() && !options.security.cert_file.empty()) {
    return absl::InvalidArgumentError("a token is needed");
  }
  return token;
}

BridgeRequest TokenTest(const std::string& token) {
  BridgeRequest request;
  request.method = "/horopter.v1.ServerService/GetServerInfo";
  request.token = token;
  request.messages.emplace_back();  // GetServerInfoRequest has no field
  const grpc::Slice nothing("");
  request.messages[0] = grpc::ByteBuffer(&nothing, 1);
  request.timeout = kTestWithin;
  return request;
}

WebReply SignInReply(const grpc::Status& status) {
  switch (status.error_code()) {
    case grpc::StatusCode::OK:
      return JsonReply(http::status::ok, {{"signed_in", true}});
    case grpc::StatusCode::UNAUTHENTICATED:
    case grpc::StatusCode::PERMISSION_DENIED:
      return JsonReply(http::status::unauthorized, {{"error", status.error_message()}});
    default:
      return JsonReply(http::status::bad_gateway, {{"error", status.error_message()}});
  }
}

std::string SessionCookie(std::string_view id, std::string_view scheme, double seconds) {
  return absl::StrCat(kSessionCookie,
                      "=",
                      std::string(id),
                      "; Path=/; HttpOnly; SameSite=Strict; Max-Age=",
                      static_cast<int64_t>(seconds),
                      scheme == "https" ? "; Secure" : "");
}

WebReply SessionReply(ConsoleState& state, std::string_view id) {
  const std::string* const token = state.sessions.Use(id, std::chrono::steady_clock::now());
  return JsonReply(http::status::ok,
                   {{"signed_in", token != nullptr},
                    {"with_token", token != nullptr && !token->empty()},
                    {"version", HOROPTER_VERSION},
                    {"max_body_bytes", int64_t{state.options.max_body_mb} << 20}});
}

WebReply HealthReply(ConsoleState& state) {
  static constexpr const char* kStates[] = {
      "idle", "connecting", "ready", "unreachable", "shut down"};
  const int connection = state.channel->GetState(false);
  return JsonReply(http::status::ok,
                   {{"serving", true},
                    {"page", state.page.complete()},
                    {"server", connection >= 0 && connection < 5 ? kStates[connection] : "?"}});
}

}  // namespace horopter
