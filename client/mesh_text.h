// Words and numbers of mesh files written as text.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace horopter {

// A number however it is written: signs, exponents, NaN and infinities, Microsoft's "-1.#IND" too.
// Nothing for what is no number.
std::optional<double> ParseNumber(std::string_view word);

// Without a mark of byte order. UTF-16 is told from UTF-8 by its own mark: see IsUtf16.
std::string_view WithoutByteOrderMark(std::string_view text);
bool IsUtf16(std::string_view text);

// Words of a line: what stands between spaces and tabs.
std::vector<std::string_view> WordsOf(std::string_view line);

// A text one line or one word at a time; lines end with LF, CR or both.
class TextCursor {
 public:
  explicit TextCursor(std::string_view text) : text_(text) {}

  bool AtEnd() const { return at_ >= text_.size(); }
  // The next line without its end, or nothing at the end of the text.
  std::optional<std::string_view> NextLine();
  // The next word, over line ends; nothing at the end.
  std::optional<std::string_view> NextWord();
  // Up to the end of the line that the last word stands in.
  void SkipLine();
  // Of what was read last, from 1.
  int Line() const { return line_; }
  size_t Offset() const { return at_; }

 private:
  void PassLineEnd();

  std::string_view text_;
  size_t at_ = 0;
  int line_ = 1;
  bool started_ = false;
};

}  // namespace horopter
