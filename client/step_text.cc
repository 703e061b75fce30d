#include "client/step_text.h"

#include <algorithm>
#include <charconv>
#include <cstdint>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"

namespace horopter {
namespace {

bool IsKeyword(char c) {
  return absl::ascii_isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '-';
}

size_t PassBlanks(std::string_view text, size_t at) {
  while (at < text.size()) {
    if (absl::ascii_isspace(static_cast<unsigned char>(text[at])) || text[at] == '\0') {
      ++at;
    } else if (text.substr(at, 2) == "/*") {
      const size_t end = text.find("*/", at + 2);
      at = end == std::string_view::npos ? text.size() : end + 2;
    } else {
      break;
    }
  }
  return at;
}

// Behind the string that begins here.
size_t PassString(std::string_view text, size_t at) {
  for (++at; at < text.size(); ++at) {
    if (text[at] != '\'') continue;
    if (at + 1 < text.size() && text[at + 1] == '\'') {
      ++at;
    } else {
      return at + 1;
    }
  }
  return text.size();
}

// Behind a character of no meaning, a string or a comment.
size_t Pass(std::string_view text, size_t at) {
  if (text[at] == '\'') return PassString(text, at);
  if (text.substr(at, 2) == "/*") return PassBlanks(text, at);
  return at + 1;
}

// Behind the bracket that closes the one here.
size_t PassBrackets(std::string_view text, size_t at) {
  int depth = 0;
  while (at < text.size()) {
    if (text[at] == '(') ++depth;
    if (text[at] == ')' && --depth == 0) return at + 1;
    at = Pass(text, at);
  }
  return text.size();
}

std::string_view Trimmed(std::string_view text) {
  size_t from = PassBlanks(text, 0), to = text.size();
  while (to > from && absl::ascii_isspace(static_cast<unsigned char>(text[to - 1]))) --to;
  return text.substr(from, to - from);
}

int Number(std::string_view digits) {
  int value = 0;
  const auto read = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  return read.ec == std::errc() ? value : 0;
}

// Calls use(type, parameters) for the types of an entity until it returns true.
template <typename Use>
void ForEachType(std::string_view body, const Use& use) {
  body = Trimmed(body);
  const bool complex = !body.empty() && body[0] == '(';
  size_t at = complex ? 1 : 0;
  while (at < body.size()) {
    at = PassBlanks(body, at);
    const size_t start = at;
    while (at < body.size() && IsKeyword(body[at])) ++at;
    const std::string_view type = body.substr(start, at - start);
    at = PassBlanks(body, at);
    if (type.empty() || at >= body.size() || body[at] != '(') return;
    const size_t end = PassBrackets(body, at);
    if (use(type, body.substr(at, end - at)) || !complex) return;
    at = end;
  }
}

void AppendUtf8(std::uint32_t code, std::string* out) {
  const auto put = [&](std::uint32_t byte) { out->push_back(static_cast<char>(byte)); };
  if (code < 0x80) {
    put(code);
  } else if (code < 0x800) {
    put(0xC0 | code >> 6);
    put(0x80 | (code & 0x3F));
  } else if (code < 0x10000) {
    put(0xE0 | code >> 12);
    put(0x80 | (code >> 6 & 0x3F));
    put(0x80 | (code & 0x3F));
  } else if (code < 0x110000) {
    put(0xF0 | code >> 18);
    put(0x80 | (code >> 12 & 0x3F));
    put(0x80 | (code >> 6 & 0x3F));
    put(0x80 | (code & 0x3F));
  }
}

// The next character of UTF-8; its size 0: it is none.
std::uint32_t NextUtf8(std::string_view text, size_t at, size_t* size) {
  const auto byte = [&](size_t k) { return static_cast<unsigned char>(text[at + k]); };
  *size = 0;
  const unsigned first = byte(0);
  const size_t length = first < 0x80       ? 1
                        : first >> 5 == 6  ? 2
                        : first >> 4 == 14 ? 3
                        : first >> 3 == 30 ? 4
                                           : 0;
  if (length == 0 || at + length > text.size()) return 0;
  std::uint32_t code = length == 1 ? first : first & (0x7Fu >> length);
  for (size_t k = 1; k < length; ++k) {
    if (byte(k) >> 6 != 2) return 0;
    code = code << 6 | (byte(k) & 0x3Fu);
  }
  constexpr std::uint32_t kLeast[] = {0, 0, 0x80, 0x800, 0x10000};
  if (code < kLeast[length] || code > 0x10FFFF || (code >= 0xD800 && code < 0xE000)) return 0;
  *size = length;
  return code;
}

bool IsUtf8(std::string_view text) {
  for (size_t at = 0, size = 0; at < text.size(); at += size) {
    NextUtf8(text, at, &size);
    if (size == 0) return false;
  }
  return true;
}

std::string FromLatin1(std::string_view text) {
  std::string out;
  for (const char c : text) AppendUtf8(static_cast<unsigned char>(c), &out);
  return out;
}

// UTF-8 that was taken for Latin-1 and written as UTF-8 once more, or the text itself.
std::string EncodedOnce(const std::string& text) {
  std::string bytes;
  bool beyond_ascii = false;
  for (size_t at = 0, size = 0; at < text.size(); at += size) {
    const std::uint32_t code = NextUtf8(text, at, &size);
    if (size == 0 || code > 0xFF) return text;
    beyond_ascii = beyond_ascii || code > 0x7F;
    bytes.push_back(static_cast<char>(code));
  }
  return beyond_ascii && IsUtf8(bytes) ? bytes : text;
}

// \X2\00F60042\X0\ and \X4\...: `digits` of each character. Returns where it ends.
size_t DecodeHex(std::string_view text, size_t at, size_t digits, std::string* out) {
  std::uint32_t high = 0;
  while (at + digits <= text.size() && text[at] != '\\') {
    std::uint32_t code = 0;
    const std::string_view word = text.substr(at, digits);
    const auto read = std::from_chars(word.data(), word.data() + digits, code, 16);
    if (read.ec != std::errc() || read.ptr != word.data() + digits) break;
    at += digits;
    if (code >= 0xD800 && code < 0xDC00) {  // UTF-16, as some write
      high = code;
    } else if (code >= 0xDC00 && code < 0xE000) {
      if (high != 0) AppendUtf8(0x10000 + ((high - 0xD800) << 10) + (code - 0xDC00), out);
      high = 0;
    } else {
      AppendUtf8(code, out);
    }
  }
  return text.substr(at, 4) == "\\X0\\" ? at + 4 : at;
}

}  // namespace

absl::StatusOr<StepText> StepText::Parse(std::string_view text) {
  if (text.substr(0, 4096).find("ISO-10303-21") == std::string_view::npos) {
    return absl::InvalidArgumentError("not a STEP file (no ISO-10303-21 header)");
  }
  if (text.find("END-ISO-10303-21") == std::string_view::npos) {
    return absl::InvalidArgumentError("cut short (no END-ISO-10303-21 at the end)");
  }
  StepText out;
  for (size_t at = 0; at < text.size();) {
    at = PassBlanks(text, at);
    const size_t start = at;
    while (at < text.size() && text[at] != ';') at = Pass(text, at);
    const std::string_view statement = text.substr(start, at - start);
    ++at;
    if (statement.empty() || statement[0] != '#') continue;
    const size_t equals = statement.find('=');
    const int id = StepReference(Trimmed(statement.substr(0, std::min(equals, statement.size()))));
    if (id <= 0 || equals == std::string_view::npos) continue;
    const std::string_view body = Trimmed(statement.substr(equals + 1));
    if (!out.bodies_.emplace(id, body).second) continue;
    out.ids_.push_back(id);
    ForEachType(body, [&](std::string_view type, std::string_view) {
      out.by_type_[type].push_back(id);
      return false;
    });
    for (const int named : out.ReferencesOf(id)) out.users_.emplace_back(named, id);
  }
  std::sort(out.users_.begin(), out.users_.end());
  out.users_.erase(std::unique(out.users_.begin(), out.users_.end()), out.users_.end());
  return out;
}

std::string StepText::TypeOf(int id) const {
  std::string found;
  const auto body = bodies_.find(id);
  if (body == bodies_.end()) return found;
  ForEachType(body->second, [&](std::string_view type, std::string_view) {
    found = std::string(type);
    return true;
  });
  return found;
}

bool StepText::Is(int id, std::string_view type) const {
  bool is = false;
  const auto body = bodies_.find(id);
  if (body == bodies_.end()) return false;
  ForEachType(body->second, [&](std::string_view t, std::string_view) { return is = t == type; });
  return is;
}

const std::vector<int>& StepText::OfType(std::string_view type) const {
  static const std::vector<int> kNone;
  const auto found = by_type_.find(type);
  return found == by_type_.end() ? kNone : found->second;
}

std::vector<int> StepText::OfTypesLike(std::string_view part) const {
  std::vector<int> ids;
  for (const auto& [type, of_type] : by_type_) {
    if (type.find(part) != std::string_view::npos) {
      ids.insert(ids.end(), of_type.begin(), of_type.end());
    }
  }
  std::sort(ids.begin(), ids.end());
  ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
  return ids;
}

std::vector<std::string_view> StepText::Parameters(int id, std::string_view type) const {
  std::vector<std::string_view> parameters;
  const auto body = bodies_.find(id);
  if (body == bodies_.end()) return parameters;
  ForEachType(body->second, [&](std::string_view t, std::string_view list) {
    if (!type.empty() && t != type) return false;
    parameters = StepList(list);
    return true;
  });
  return parameters;
}

std::string_view StepText::Parameter(int id, size_t number, std::string_view type) const {
  const std::vector<std::string_view> parameters = Parameters(id, type);
  return number < parameters.size() ? parameters[number] : std::string_view();
}

int StepText::Named(int id, size_t number, std::string_view type) const {
  return StepReference(Parameter(id, number, type));
}

std::vector<int> StepText::ReferencesOf(int id) const {
  std::vector<int> references;
  const auto found = bodies_.find(id);
  if (found == bodies_.end()) return references;
  const std::string_view body = found->second;
  for (size_t at = 0; at < body.size();) {
    if (body[at] != '#') {
      at = Pass(body, at);
      continue;
    }
    size_t end = at + 1;
    while (end < body.size() && absl::ascii_isdigit(static_cast<unsigned char>(body[end]))) ++end;
    if (const int named = Number(body.substr(at + 1, end - at - 1)); named > 0) {
      references.push_back(named);
    }
    at = end;
  }
  return references;
}

std::vector<int> StepText::UsersOf(int id) const {
  std::vector<int> users;
  for (auto it = std::lower_bound(users_.begin(), users_.end(), std::make_pair(id, 0));
       it != users_.end() && it->first == id;
       ++it) {
    users.push_back(it->second);
  }
  return users;
}

bool IsShapeRepresentation(const StepText& step, int id) {
  const std::string type = step.TypeOf(id);
  return absl::EndsWith(type, "SHAPE_REPRESENTATION") &&
         type != "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION";
}

std::vector<std::string_view> StepList(std::string_view parameter) {
  parameter = Trimmed(parameter);
  if (parameter.size() < 2 || parameter.front() != '(' || parameter.back() != ')') {
    return {parameter};
  }
  std::vector<std::string_view> items;
  size_t start = 1, at = 1;
  while (at + 1 < parameter.size()) {
    if (parameter[at] == ',') {
      items.push_back(Trimmed(parameter.substr(start, at - start)));
      start = ++at;
    } else {
      at = parameter[at] == '(' ? PassBrackets(parameter, at) : Pass(parameter, at);
    }
  }
  if (start >= parameter.size()) return items;
  const std::string_view last = Trimmed(parameter.substr(start, parameter.size() - 1 - start));
  if (!last.empty() || !items.empty()) items.push_back(last);
  return items;
}

int StepReference(std::string_view parameter) {
  parameter = Trimmed(parameter);
  return parameter.size() < 2 || parameter[0] != '#' ? 0 : Number(parameter.substr(1));
}

std::string StepString(std::string_view parameter) {
  parameter = Trimmed(parameter);
  if (parameter.size() < 2 || parameter.front() != '\'' || parameter.back() != '\'') return "";
  const std::string_view text = parameter.substr(1, parameter.size() - 2);
  std::string raw, out;
  const auto flush = [&] {  // bytes between the escapes
    out += IsUtf8(raw) ? EncodedOnce(raw) : FromLatin1(raw);
    raw.clear();
  };
  for (size_t at = 0; at < text.size();) {
    const std::string_view rest = text.substr(at);
    if (rest.substr(0, 2) == "''" || rest.substr(0, 2) == "\\\\") {
      raw.push_back(text[at]);
      at += 2;
    } else if (rest.substr(0, 4) == "\\X2\\" || rest.substr(0, 4) == "\\X4\\") {
      flush();
      at = DecodeHex(text, at + 4, rest[2] == '2' ? 4 : 8, &out);
    } else if (rest.substr(0, 3) == "\\X\\" && rest.size() >= 5) {
      flush();
      at = DecodeHex(text.substr(0, at + 5), at + 3, 2, &out);
    } else if (rest.substr(0, 3) == "\\S\\" && rest.size() >= 4) {
      flush();
      AppendUtf8(static_cast<unsigned char>(rest[3]) + 128u, &out);
      at += 4;
    } else if (rest.size() >= 4 && rest.substr(0, 2) == "\\P" && rest[3] == '\\') {
      at += 4;  // names the page of \S\; Latin-1 is taken
    } else if (text[at] == '\n' || text[at] == '\r') {
      ++at;  // broken for the line's length
    } else {
      raw.push_back(text[at++]);
    }
  }
  flush();
  return out;
}

bool IsCleanUtf8(std::string_view text) {
  for (size_t at = 0, size = 0; at < text.size(); at += size) {
    const std::uint32_t code = NextUtf8(text, at, &size);
    if (size == 0 || code < 0x20 || (code >= 0x7F && code < 0xA0)) return false;
  }
  return true;
}

}  // namespace horopter
