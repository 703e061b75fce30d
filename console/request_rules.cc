#include "console/request_rules.h"

#include <algorithm>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

constexpr std::string_view kPackage = "/horopter.v1.";

bool IsIdentifier(std::string_view text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](char c) {
    return absl::ascii_isalnum(static_cast<unsigned char>(c));
  });
}

std::string_view WithoutPort(std::string_view host) {
  if (!host.empty() && host.front() == '[') return host.substr(0, host.find(']') + 1);
  return host.substr(0, host.find(':'));
}

bool IsAddress(std::string_view host) {
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') return true;
  return !host.empty() && host.find_first_not_of("0123456789.") == host.npos;
}

std::string_view Trimmed(std::string_view text) {
  while (!text.empty() && text.front() == ' ') text.remove_prefix(1);
  while (!text.empty() && text.back() == ' ') text.remove_suffix(1);
  return text;
}

}  // namespace

bool IsOwnHost(std::string_view host, const std::vector<std::string>& names) {
  const std::string name = absl::AsciiStrToLower(std::string(WithoutPort(host)));
  if (IsAddress(name) || name == "localhost") return true;
  return std::any_of(names.begin(), names.end(), [&](const std::string& own) {
    return absl::AsciiStrToLower(own) == name && !name.empty();
  });
}

std::string WhyForeign(const BrowserHead& head, std::string_view scheme) {
  if (head.marker != "1") return absl::StrCat("the header ", kConsoleHeader, ": 1 is missing");
  if (!head.fetch_site.empty() && head.fetch_site != "same-origin") {
    return "the request comes from another site";
  }
  const std::string own = absl::StrCat(std::string(scheme), "://", std::string(head.host));
  if (!head.origin.empty() && head.origin != own) return "the request comes from another origin";
  return "";
}

std::string_view CookieOf(std::string_view cookies, std::string_view name) {
  std::string_view found;
  while (!cookies.empty()) {
    const size_t end = std::min(cookies.find(';'), cookies.size());
    const std::string_view one = Trimmed(cookies.substr(0, end));
    cookies.remove_prefix(std::min(end + 1, cookies.size()));
    const size_t equals = one.find('=');
    if (equals == one.npos || one.substr(0, equals) != name) continue;
    if (!found.empty()) return {};
    found = one.substr(equals + 1);
  }
  return found;
}

std::optional<std::string> RpcMethodOf(std::string_view target) {
  if (target.substr(0, kPackage.size()) != kPackage || target.size() > 128) return std::nullopt;
  const std::string_view rest = target.substr(kPackage.size());
  const size_t slash = rest.find('/');
  if (slash == rest.npos || !IsIdentifier(rest.substr(0, slash)) ||
      !IsIdentifier(rest.substr(slash + 1))) {
    return std::nullopt;
  }
  return std::string(target);
}

}  // namespace horopter
