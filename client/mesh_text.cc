#include "client/mesh_text.h"

#include <limits>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/string_view.h"

namespace horopter {
namespace {

bool IsBlank(char c) {
  return c == ' ' || c == '\t' || c == '\v' || c == '\f' || c == '\0';
}

bool IsLineEnd(char c) {
  return c == '\n' || c == '\r';
}

}  // namespace

std::optional<double> ParseNumber(std::string_view word) {
  const absl::string_view text(word.data(), word.size());
  double value = 0.0;
  if (absl::SimpleAtod(text, &value)) return value;
  for (const char* odd : {"#IND", "#QNAN", "#SNAN", "#INF"}) {  // Microsoft's, before 2015
    if (absl::StrContains(absl::AsciiStrToUpper(text), odd)) {
      return std::numeric_limits<double>::quiet_NaN();
    }
  }
  return std::nullopt;
}

std::string_view WithoutByteOrderMark(std::string_view text) {
  if (text.substr(0, 3) == "\xEF\xBB\xBF") text.remove_prefix(3);
  return text;
}

bool IsUtf16(std::string_view text) {
  return text.substr(0, 2) == "\xFF\xFE" || text.substr(0, 2) == "\xFE\xFF";
}

std::vector<std::string_view> WordsOf(std::string_view line) {
  std::vector<std::string_view> words;
  size_t at = 0;
  while (at < line.size()) {
    while (at < line.size() && IsBlank(line[at])) ++at;
    const size_t start = at;
    while (at < line.size() && !IsBlank(line[at])) ++at;
    if (at > start) words.push_back(line.substr(start, at - start));
  }
  return words;
}

void TextCursor::PassLineEnd() {
  if (text_[at_] == '\r' && at_ + 1 < text_.size() && text_[at_ + 1] == '\n') ++at_;
  ++at_;
}

std::optional<std::string_view> TextCursor::NextLine() {
  if (AtEnd()) return std::nullopt;
  if (started_) ++line_;
  started_ = true;
  const size_t start = at_;
  while (at_ < text_.size() && !IsLineEnd(text_[at_])) ++at_;
  const std::string_view line = text_.substr(start, at_ - start);
  if (!AtEnd()) PassLineEnd();
  return line;
}

std::optional<std::string_view> TextCursor::NextWord() {
  while (at_ < text_.size() && (IsBlank(text_[at_]) || IsLineEnd(text_[at_]))) {
    if (IsLineEnd(text_[at_])) {
      PassLineEnd();
      ++line_;
    } else {
      ++at_;
    }
  }
  if (AtEnd()) return std::nullopt;
  const size_t start = at_;
  while (at_ < text_.size() && !IsBlank(text_[at_]) && !IsLineEnd(text_[at_])) ++at_;
  return text_.substr(start, at_ - start);
}

void TextCursor::SkipLine() {
  while (at_ < text_.size() && !IsLineEnd(text_[at_])) ++at_;
}

}  // namespace horopter
