// Addresses that a server listens on.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

struct ListenAddress {
  enum class Kind { kTcp, kUnix, kAbstract };
  Kind kind = Kind::kTcp;
  std::string host;  // without brackets; of kTcp
  int port = 0;      // 0: any free one
  std::string path;  // of the socket's file, or its abstract name
};

// HOST:PORT (an IPv6 address in brackets), unix:PATH or unix-abstract:NAME. Errors:
// INVALID_ARGUMENT that begins with the name of the option.
absl::StatusOr<ListenAddress> ParseListenAddress(const char* option, const std::string& text);

// Of the loopback interface, or a Unix socket: nobody else can read along.
bool IsLocalAddress(const std::string& address);
bool IsUnixAddress(const std::string& address);

// Sockets that listen, non-blocking and closed on exec; more than one where a name has several
// addresses. 0.0.0.0 and [::] are both all addresses of both families where there are both.
struct ListeningSockets {
  std::vector<int> descriptors;
  std::string address;  // with the port that was bound
};

// A socket's file that nobody listens on any more is replaced; a new one is its owner's alone.
// Errors: UNAVAILABLE with the reason (in use, no such address, no right).
absl::StatusOr<ListeningSockets> Listen(const std::string& text, const ListenAddress& address);

// A connection to an address that this process listens on; wildcards: over loopback. Non-blocking.
// Errors: UNAVAILABLE (nothing listens there, or nothing in time), RESOURCE_EXHAUSTED (no
// descriptor), UNKNOWN (the address is not this machine's now: says nothing of the server).
absl::StatusOr<int> ConnectToOwn(const ListenAddress& address, int timeout_ms);

}  // namespace horopter
