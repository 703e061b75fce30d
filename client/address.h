// Addresses of servers, and whether a proxy stands before them. As
// client/python/horopter/address.py.
#pragma once

#include <string>

#include "absl/status/status.h"

namespace horopter {

// Errors: INVALID_ARGUMENT: not HOST:PORT, [IPv6]:PORT, unix:PATH nor another name that gRPC
// resolves; of a URL the message says what it would be as an address.
absl::Status CheckAddress(const std::string& address);

// By its name or one of its interfaces. Asks no name server.
bool IsThisMachine(const std::string& address);

// entries: separated by commas: * (all), a domain with what is below it, an address, a network
// (10.0.0.0/8), each with a port if need be.
bool MatchesNoProxy(const std::string& address, const std::string& entries);

// False for this machine and what no_proxy, NO_PROXY or no_grpc_proxy of the environment names:
// gRPC asks a proxy for this machine as well, and knows one spelling.
bool MayUseProxy(const std::string& address);

}  // namespace horopter
