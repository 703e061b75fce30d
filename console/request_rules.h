// Which requests of browsers are ours to answer: pure functions of what their heads say.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace horopter {

// Header that the page's own scripts add. A form or an image of another page cannot, and its
// scripts would have to ask first (CORS), which is never allowed.
constexpr char kConsoleHeader[] = "x-horopter-console";

// The heads that matter; empty: not there.
struct BrowserHead {
  std::string_view host;
  std::string_view origin;
  std::string_view fetch_site;  // Sec-Fetch-Site
  std::string_view marker;      // kConsoleHeader
};

// The host without port is an address, localhost or one of `names`. Else a page of somebody else
// may have its name point here (DNS rebinding).
bool IsOwnHost(std::string_view host, const std::vector<std::string>& names);

// Why a request that does something is not the page's own; empty: it is.
std::string WhyForeign(const BrowserHead& head, std::string_view scheme);

// Value of the cookie of that name; empty: there is none, or more than one.
std::string_view CookieOf(std::string_view cookies, std::string_view name);

// `/horopter.v1.SERVICE/METHOD` as it is; unset: another path.
std::optional<std::string> RpcMethodOf(std::string_view target);

}  // namespace horopter
