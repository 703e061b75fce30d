// What gRPC and OpenSSL say of connections, in our words.
#pragma once

#include <string>
#include <string_view>

namespace horopter {

// Why a server cannot be reached, and what to do, by the message of a call that ended with
// UNAVAILABLE; empty: the message is none that is known.
std::string ConnectionFault(std::string_view message);

}  // namespace horopter
