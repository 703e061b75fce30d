#include "client/token.h"

#include <sys/prctl.h>

#include <algorithm>
#include <fstream>
#include <string_view>

#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

constexpr size_t kMostTokenBytes = 64 << 10;
constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
constexpr std::string_view kBlank = " \t\r\n\v\f";

bool IsTokenBlank(char c) {
  return kBlank.find(c) != std::string_view::npos;
}

}  // namespace

absl::StatusOr<std::string> CleanToken(const std::string& text, const std::string& where) {
  std::string_view rest = text;
  const auto is_mark = [&](bool at_end) {
    return at_end ? rest.size() >= 3 && rest.substr(rest.size() - 3) == kByteOrderMark
                  : rest.substr(0, 3) == kByteOrderMark;
  };
  for (bool dropped = true; dropped && !rest.empty();) {
    dropped = true;
    if (is_mark(false)) {
      rest.remove_prefix(3);
    } else if (is_mark(true)) {
      rest.remove_suffix(3);
    } else if (IsTokenBlank(rest.front())) {
      rest.remove_prefix(1);
    } else if (IsTokenBlank(rest.back())) {
      rest.remove_suffix(1);
    } else {
      dropped = false;
    }
  }
  const auto printable = [](char c) { return c >= 0x20 && c < 0x7f; };
  const auto bad = std::find_if_not(rest.begin(), rest.end(), printable);
  if (bad == rest.end()) return std::string(rest);
  const std::string_view before(text.data(), static_cast<size_t>(&*bad - text.data()));
  const auto line = std::count(before.begin(), before.end(), '\n');
  const size_t column = before.size() - (line > 0 ? before.rfind('\n') + 1 : 0);
  return absl::InvalidArgumentError(absl::StrCat(where,
                                                 ": line ",
                                                 line + 1,
                                                 ", column ",
                                                 column + 1,
                                                 ": a token is of printable ASCII characters"));
}

absl::StatusOr<std::string> ReadTokenFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::string text(kMostTokenBytes, '\0');
  if (file) file.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (!file && file.gcount() == 0 && !file.eof())
    return absl::FailedPreconditionError(absl::StrCat(path, ": cannot be read"));
  text.resize(static_cast<size_t>(file.gcount()));
  // What follows the token's line is not looked at.
  const size_t first = text.find_first_not_of(std::string(kBlank) + std::string(kByteOrderMark));
  if (first != std::string::npos) text.resize(std::min(text.size(), text.find('\n', first)));
  absl::StatusOr<std::string> token = CleanToken(text, path);
  if (token.ok() && token->empty())
    return absl::FailedPreconditionError(absl::StrCat(path, ": holds no token"));
  return token;
}

void KeepTokensOutOfCoreDumps() {
  prctl(PR_SET_DUMPABLE, 0);
}

}  // namespace horopter
