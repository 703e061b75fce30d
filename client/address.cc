#include "client/address.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <string_view>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"

namespace horopter {
namespace {

// What gRPC resolves by itself.
constexpr std::array<std::string_view, 7> kSchemes = {
    "dns", "ipv4", "ipv6", "unix", "unix-abstract", "vsock", "xds"};

struct HostPort {
  std::string host;    // without brackets
  std::string port;    // as written; empty: none
  bool named = false;  // a port was written
};

HostPort Split(std::string address) {
  for (const char* scheme : {"dns:", "ipv4:", "ipv6:"}) {
    if (!absl::StartsWith(address, scheme)) continue;
    address = address.substr(std::strlen(scheme));
    if (absl::StartsWith(address, "//")) {
      const size_t slash = address.find('/', 2);
      address = slash == address.npos ? "" : address.substr(slash + 1);
    }
    break;
  }
  const size_t colon = address.rfind(':');
  const auto unbracketed = [](const std::string& host) {
    const bool bracketed = host.size() >= 2 && host.front() == '[' && host.back() == ']';
    return bracketed ? host.substr(1, host.size() - 2) : host;
  };
  const std::string host = address.substr(0, colon);
  const bool six = absl::StrContains(host, ":") && (host.front() != '[' || host.back() != ']');
  if (colon == address.npos || six) return {unbracketed(address), "", false};
  return {unbracketed(host), address.substr(colon + 1), true};
}

// An address of IP as the 16 bytes of version 6; those of version 4 are mapped.
using Bytes = std::array<unsigned char, 16>;

std::optional<Bytes> NumericOf(std::string host) {
  host = host.substr(0, host.find('%'));
  Bytes bytes{};
  if (inet_pton(AF_INET6, host.c_str(), bytes.data()) == 1) return bytes;
  bytes = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff};
  if (inet_pton(AF_INET, host.c_str(), bytes.data() + 12) == 1) return bytes;
  return std::nullopt;
}

bool IsVersion4(const Bytes& bytes) {
  constexpr Bytes kMapped = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff};
  return std::equal(bytes.begin(), bytes.begin() + 12, kMapped.begin());
}

// A socket can be bound to addresses of this machine alone.
bool CanBind(const Bytes& bytes) {
  sockaddr_storage where{};
  socklen_t size = 0;
  if (IsVersion4(bytes)) {
    auto* four = reinterpret_cast<sockaddr_in*>(&where);
    four->sin_family = AF_INET;
    std::memcpy(&four->sin_addr, bytes.data() + 12, 4);
    size = sizeof(*four);
  } else {
    auto* six = reinterpret_cast<sockaddr_in6*>(&where);
    six->sin6_family = AF_INET6;
    std::memcpy(&six->sin6_addr, bytes.data(), 16);
    size = sizeof(*six);
  }
  const int probe = ::socket(where.ss_family, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (probe < 0) return false;
  const bool bound = ::bind(probe, reinterpret_cast<const sockaddr*>(&where), size) == 0;
  ::close(probe);
  return bound;
}

bool IsInNetwork(const Bytes& bytes, const std::string& network) {
  const std::vector<std::string> parts = absl::StrSplit(network, absl::MaxSplits('/', 1));
  int length = 0;
  if (parts.size() != 2 || !absl::SimpleAtoi(parts[1], &length)) return false;
  const std::optional<Bytes> of = NumericOf(parts[0]);
  if (!of || IsVersion4(*of) != IsVersion4(bytes)) return false;
  if (IsVersion4(*of)) length += 96;
  if (length < 0 || length > 128) return false;
  for (int bit = 0; bit < length; ++bit) {
    const int mask = 0x80 >> bit % 8;
    if ((bytes[bit / 8] & mask) != ((*of)[bit / 8] & mask)) return false;
  }
  return true;
}

std::string LowerHost(const std::string& host) {
  return absl::AsciiStrToLower(absl::StripSuffix(host, "."));
}

bool MatchesEntry(const HostPort& where, const std::optional<Bytes>& numeric, std::string entry) {
  entry = absl::AsciiStrToLower(absl::StripAsciiWhitespace(entry));
  if (entry == "*") return true;
  if (numeric && absl::StrContains(entry, "/")) return IsInNetwork(*numeric, entry);
  const HostPort named = Split(entry);
  if (named.host.empty() || (named.named && named.port != where.port)) return false;
  if (numeric) return NumericOf(named.host) == numeric;
  std::string_view domain = named.host;
  while (!domain.empty() && (domain.front() == '*' || domain.front() == '.'))
    domain.remove_prefix(1);
  while (!domain.empty() && domain.back() == '.') domain.remove_suffix(1);
  const std::string host = LowerHost(where.host);
  return !domain.empty() && (host == domain || host.ends_with("." + std::string(domain)));
}

}  // namespace

absl::Status CheckAddress(const std::string& address) {
  const auto is_scheme = [](std::string_view word) {
    return std::find(kSchemes.begin(), kSchemes.end(), word) != kSchemes.end();
  };
  const std::string scheme = address.substr(0, address.find(':'));
  if (const size_t at = address.find("://"); at != address.npos && !is_scheme(scheme)) {
    const std::string rest = address.substr(at + 3);
    const bool tls = scheme == "https" || scheme == "grpcs";
    return absl::InvalidArgumentError(absl::StrCat("'",
                                                   address,
                                                   "' is a URL; an address is HOST:PORT, here '",
                                                   rest.substr(0, rest.find('/')),
                                                   tls ? "', with TLS (--tls)" : "'"));
  }
  if (scheme != "dns" && is_scheme(scheme)) return absl::OkStatus();
  const HostPort parts = Split(address);
  int port = 0;
  if (parts.host.empty() || parts.host.find_first_of("/?# ") != parts.host.npos ||
      parts.port.find_first_not_of("0123456789") != parts.port.npos ||
      !absl::SimpleAtoi(parts.port, &port) || port < 1 || port > 65535) {
    return absl::InvalidArgumentError(
        absl::StrCat("'", address, "' is no address: HOST:PORT, [IPv6]:PORT or unix:PATH"));
  }
  return absl::OkStatus();
}

bool IsThisMachine(const std::string& address) {
  for (const char* scheme : {"unix:", "unix-abstract:", "vsock:"}) {
    if (absl::StartsWith(address, scheme)) return true;
  }
  const std::string host = LowerHost(Split(address).host);
  char name[256] = "";
  if (gethostname(name, sizeof(name) - 1) == 0 && host == LowerHost(name)) return true;
  if (host == "localhost" || absl::EndsWith(host, ".localhost")) return true;
  const std::optional<Bytes> numeric = NumericOf(host);
  if (!numeric) return false;
  return (IsVersion4(*numeric) && (*numeric)[12] == 127) || CanBind(*numeric);
}

bool MatchesNoProxy(const std::string& address, const std::string& entries) {
  const HostPort where = Split(address);
  const std::optional<Bytes> numeric = NumericOf(where.host);
  const std::vector<std::string> list = absl::StrSplit(entries, ',');
  return std::any_of(list.begin(), list.end(), [&](const std::string& entry) {
    return MatchesEntry(where, numeric, entry);
  });
}

bool MayUseProxy(const std::string& address) {
  if (IsThisMachine(address)) return false;
  for (const char* name : {"no_grpc_proxy", "no_proxy", "NO_PROXY"}) {
    const char* const entries = std::getenv(name);
    if (entries != nullptr && MatchesNoProxy(address, entries)) return false;
  }
  return true;
}

}  // namespace horopter
