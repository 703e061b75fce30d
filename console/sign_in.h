// Signing in with the server's own tokens, and what the page may know of it.
#pragma once

#include <grpcpp/support/status.h>

#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "console/bridge_call.h"
#include "console/console_state.h"
#include "console/web_reply.h"

namespace horopter {

constexpr char kSessionCookie[] = "horopter_session";

// {"token": ".."}; empty where the server asks for none. Errors: INVALID_ARGUMENT (no such JSON, a
// token that cannot be one, none where the console has a certificate of its own: who comes without
// would have that one's rights).
absl::StatusOr<std::string> TokenOfBody(const std::string& body, const ConsoleOptions& options);

// The cheapest call of the server: it says whether the token is good.
BridgeRequest TokenTest(const std::string& token);

// What the browser is told of that call's end.
WebReply SignInReply(const grpc::Status& status);

// Set-Cookie; seconds 0: the browser forgets it.
std::string SessionCookie(std::string_view id, std::string_view scheme, double seconds);

// Whether the session is signed in, and the console's own bounds.
WebReply SessionReply(ConsoleState& state, std::string_view id);

// 200 while the process serves; the state of the connection to the server is in its text.
WebReply HealthReply(ConsoleState& state);

}  // namespace horopter
