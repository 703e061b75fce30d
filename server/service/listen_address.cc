#include "server/service/listen_address.h"

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <optional>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr char kUnix[] = "unix:";
constexpr char kAbstract[] = "unix-abstract:";
constexpr int kBacklog = 1024;
constexpr mode_t kOwnerAlone = 0077;
constexpr int kTriesOfAFreePort = 16;

using Resolved = std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)>;

absl::Status Unusable(const char* option, const std::string& text, const char* why) {
  return absl::InvalidArgumentError(absl::StrCat(option, ": '", text, "': ", why));
}

absl::Status CannotListen(const std::string& text, int error) {
  return absl::UnavailableError(absl::StrCat("cannot listen on ", text, ": ", ::strerror(error)));
}

bool IsWildcard(const std::string& host) {
  return host == "0.0.0.0" || host == "::";
}

absl::StatusOr<Resolved> Resolve(const std::string& host, int port) {
  addrinfo hints = {};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_NUMERICSERV;
  addrinfo* found = nullptr;
  const int error = ::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found);
  if (error == 0) return Resolved(found, &::freeaddrinfo);
  return absl::UnavailableError(absl::StrCat("'", host, "': ", ::gai_strerror(error)));
}

int PortOf(int socket) {
  sockaddr_storage bound = {};
  socklen_t size = sizeof bound;
  if (::getsockname(socket, reinterpret_cast<sockaddr*>(&bound), &size) != 0) return 0;
  return ntohs(bound.ss_family == AF_INET6 ? reinterpret_cast<sockaddr_in6*>(&bound)->sin6_port
                                           : reinterpret_cast<sockaddr_in*>(&bound)->sin_port);
}

void SetPort(int port, sockaddr* address) {
  const in_port_t wire = htons(static_cast<uint16_t>(port));
  if (address->sa_family == AF_INET6) reinterpret_cast<sockaddr_in6*>(address)->sin6_port = wire;
  if (address->sa_family == AF_INET) reinterpret_cast<sockaddr_in*>(address)->sin_port = wire;
}

// A descriptor, or -1 with errno. No SO_REUSEPORT: a second server on the same port would silently
// take a share of the calls.
int Bound(const sockaddr* address, socklen_t size, bool both_families) {
  const int fd = ::socket(address->sa_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (fd < 0) return -1;
  const int on = 1, v6_alone = both_families ? 0 : 1;
  ::setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (address->sa_family == AF_INET6) {
    ::setsockopt(fd, IPPROTO_IPV6, IPV6_V6ONLY, &v6_alone, sizeof v6_alone);
  }
  if (::bind(fd, address, size) == 0 && ::listen(fd, kBacklog) == 0) return fd;
  const int error = errno;
  ::close(fd);
  errno = error;
  return -1;
}

// All addresses of the name at one port. nullopt: a port that was free at the first is taken at
// another one, and a further try may have better luck.
absl::StatusOr<std::optional<std::vector<int>>> BindAll(const std::string& text,
                                                        const ListenAddress& address,
                                                        const addrinfo* resolved) {
  std::vector<int> sockets;
  int port = address.port, error = EADDRNOTAVAIL;
  for (const addrinfo* a = resolved; a != nullptr; a = a->ai_next) {
    SetPort(port, a->ai_addr);
    const int fd = Bound(a->ai_addr, a->ai_addrlen, IsWildcard(address.host));
    if (fd >= 0) {
      sockets.push_back(fd);
      if (port == 0) port = PortOf(fd);
      continue;
    }
    error = errno;
    // What the machine does not have (IPv6 switched off) is left out; a port that somebody else has
    // at one of the addresses would send some of the clients there.
    if (error == EADDRNOTAVAIL || error == EAFNOSUPPORT) continue;
    for (const int open : sockets) ::close(open);
    const bool unlucky = error == EADDRINUSE && address.port == 0 && !sockets.empty();
    if (unlucky) return std::optional<std::vector<int>>();
    return CannotListen(text, error);
  }
  if (sockets.empty()) return CannotListen(text, error);
  return std::make_optional(std::move(sockets));
}

absl::StatusOr<std::vector<int>> ListenOnTcp(const std::string& text,
                                             const ListenAddress& address) {
  for (int i = 0; i < kTriesOfAFreePort; ++i) {
    if (IsWildcard(address.host)) {
      HOROPTER_ASSIGN_OR_RETURN(const Resolved both, Resolve("::", address.port));
      const auto bound = BindAll(text, address, both.get());
      if (bound.ok() && bound->has_value()) return **bound;
    }
    const std::string host = address.host == "::" ? "0.0.0.0" : address.host;
    const auto resolved = Resolve(host, address.port);
    if (!resolved.ok()) {
      return absl::UnavailableError(
          absl::StrCat("cannot listen on ", text, ": ", std::string(resolved.status().message())));
    }
    HOROPTER_ASSIGN_OR_RETURN(const auto bound, BindAll(text, address, resolved->get()));
    if (bound) return *bound;
  }
  return CannotListen(text, EADDRINUSE);
}

absl::StatusOr<std::pair<sockaddr_un, socklen_t>> UnixName(const ListenAddress& address) {
  sockaddr_un name = {};
  name.sun_family = AF_UNIX;
  const bool abstract = address.kind == ListenAddress::Kind::kAbstract;
  if (address.path.size() + 1 > sizeof name.sun_path) {
    return absl::UnavailableError(
        absl::StrCat("cannot listen on ", address.path, ": the path has more than 107 bytes"));
  }
  std::copy(address.path.begin(), address.path.end(), name.sun_path + (abstract ? 1 : 0));
  const size_t size = offsetof(sockaddr_un, sun_path) + address.path.size() + 1;
  return std::make_pair(name, static_cast<socklen_t>(size));
}

absl::StatusOr<std::vector<int>> ListenOnUnix(const std::string& text,
                                              const ListenAddress& address) {
  HOROPTER_ASSIGN_OR_RETURN(const auto name, UnixName(address));
  struct stat info = {};
  if (address.kind == ListenAddress::Kind::kUnix && ::lstat(address.path.c_str(), &info) == 0) {
    if (!S_ISSOCK(info.st_mode)) return CannotListen(text, EEXIST);
    const auto other = ConnectToOwn(address, 1000);
    if (other.ok()) {
      ::close(*other);
      return CannotListen(text, EADDRINUSE);
    }
    ::unlink(address.path.c_str());
  }
  // The file is never open to others, not even between bind and chmod.
  const mode_t mask = ::umask(kOwnerAlone);
  const int fd = Bound(reinterpret_cast<const sockaddr*>(&name.first), name.second, false);
  const int error = errno;
  ::umask(mask);
  if (fd < 0) return CannotListen(text, error);
  return std::vector<int>{fd};
}

// 0, or the error.
int AwaitConnected(int fd, int timeout_ms) {
  pollfd ready = {fd, POLLOUT, 0};
  if (::poll(&ready, 1, timeout_ms) <= 0) return ETIMEDOUT;
  int error = 0;
  socklen_t size = sizeof error;
  ::getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &size);
  return error;
}

absl::StatusOr<int> Connected(const sockaddr* address, socklen_t size, int timeout_ms) {
  const int fd = ::socket(address->sa_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (fd < 0) {
    const std::string why = ::strerror(errno);
    return errno == EMFILE || errno == ENFILE ? absl::ResourceExhaustedError(why)
                                              : absl::UnknownError(why);
  }
  int error = ::connect(fd, address, size) == 0 ? 0 : errno;
  if (error == EINPROGRESS) error = AwaitConnected(fd, timeout_ms);
  if (error == 0) return fd;
  ::close(fd);
  const std::string why = ::strerror(error);
  const bool nobody = error == ECONNREFUSED || error == ETIMEDOUT || error == ENOENT ||
                      error == EAGAIN;  // a Unix socket's queue is full
  return nobody ? absl::UnavailableError(why) : absl::UnknownError(why);
}

}  // namespace

absl::StatusOr<ListenAddress> ParseListenAddress(const char* option, const std::string& text) {
  ListenAddress address;
  for (const auto& [prefix, kind] : {std::pair(kUnix, ListenAddress::Kind::kUnix),
                                     std::pair(kAbstract, ListenAddress::Kind::kAbstract)}) {
    if (!absl::StartsWith(text, prefix)) continue;
    address.kind = kind;
    address.path = text.substr(std::strlen(prefix));
    if (kind == ListenAddress::Kind::kUnix && absl::StartsWith(address.path, "//")) {
      address.path.erase(0, 2);  // unix:///absolute
    }
    if (address.path.empty()) return Unusable(option, text, "names no socket");
    return address;
  }
  const size_t colon = text.rfind(':');
  if (colon == text.npos || colon == 0) {
    return Unusable(option, text, "expected HOST:PORT or unix:PATH");
  }
  address.host = text.substr(0, colon);
  const std::string port = text.substr(colon + 1);
  if (port.empty() || port.find_first_not_of("0123456789") != port.npos ||
      !absl::SimpleAtoi(port, &address.port) || address.port > 65535) {
    return Unusable(option, text, "the port is a number from 0 to 65535");
  }
  if (address.host.front() == '[' && address.host.back() == ']') {
    address.host = address.host.substr(1, address.host.size() - 2);
  } else if (address.host.find(':') != address.host.npos) {
    return Unusable(option, text, "an IPv6 address stands in brackets, e.g. [::1]:50051");
  }
  if (address.host.empty()) return Unusable(option, text, "expected HOST:PORT or unix:PATH");
  return address;
}

bool IsUnixAddress(const std::string& address) {
  return absl::StartsWith(address, kUnix) || absl::StartsWith(address, kAbstract);
}

bool IsLocalAddress(const std::string& address) {
  if (IsUnixAddress(address)) return true;
  const std::string host = address.substr(0, address.rfind(':'));
  if (host == "localhost" || host == "[::1]") return true;
  return absl::StartsWith(host, "127.") && host.find_first_not_of("0123456789.") == host.npos;
}

absl::StatusOr<ListeningSockets> Listen(const std::string& text, const ListenAddress& address) {
  ListeningSockets listening;
  listening.address = text;
  if (address.kind != ListenAddress::Kind::kTcp) {
    HOROPTER_ASSIGN_OR_RETURN(listening.descriptors, ListenOnUnix(text, address));
    return listening;
  }
  HOROPTER_ASSIGN_OR_RETURN(listening.descriptors, ListenOnTcp(text, address));
  listening.address =
      absl::StrCat(text.substr(0, text.rfind(':')), ":", PortOf(listening.descriptors[0]));
  return listening;
}

absl::StatusOr<int> ConnectToOwn(const ListenAddress& address, int timeout_ms) {
  if (address.kind != ListenAddress::Kind::kTcp) {
    HOROPTER_ASSIGN_OR_RETURN(const auto name, UnixName(address));
    return Connected(reinterpret_cast<const sockaddr*>(&name.first), name.second, timeout_ms);
  }
  const auto resolved =
      Resolve(IsWildcard(address.host) ? "127.0.0.1" : address.host, address.port);
  if (!resolved.ok()) return absl::UnknownError(std::string(resolved.status().message()));
  absl::Status last = absl::UnknownError("no address");
  for (const addrinfo* a = resolved->get(); a != nullptr; a = a->ai_next) {
    absl::StatusOr<int> fd = Connected(a->ai_addr, a->ai_addrlen, timeout_ms);
    if (fd.ok()) return fd;
    // A family that the machine does not have says nothing beside one that refused.
    if (!absl::IsUnavailable(last)) last = fd.status();
  }
  return last;
}

}  // namespace horopter
