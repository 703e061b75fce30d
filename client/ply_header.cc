#include "client/ply_header.h"

#include <map>
#include <optional>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "client/mesh_text.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

std::string LowerWord(std::string_view word) {
  return absl::AsciiStrToLower(absl::string_view(word.data(), word.size()));
}

std::optional<PlyType> TypeOf(std::string_view word) {
  static const std::map<std::string, PlyType> kTypes = {
      {"char", PlyType::kInt8},     {"int8", PlyType::kInt8},     {"uchar", PlyType::kUint8},
      {"uint8", PlyType::kUint8},   {"short", PlyType::kInt16},   {"int16", PlyType::kInt16},
      {"ushort", PlyType::kUint16}, {"uint16", PlyType::kUint16}, {"int", PlyType::kInt32},
      {"int32", PlyType::kInt32},   {"uint", PlyType::kUint32},   {"uint32", PlyType::kUint32},
      {"int64", PlyType::kInt64},   {"long", PlyType::kInt64},    {"uint64", PlyType::kUint64},
      {"ulong", PlyType::kUint64},  {"float", PlyType::kFloat},   {"float32", PlyType::kFloat},
      {"double", PlyType::kDouble}, {"float64", PlyType::kDouble}};
  const auto known = kTypes.find(LowerWord(word));
  return known == kTypes.end() ? std::nullopt : std::make_optional(known->second);
}

absl::Status BadHeader(const std::string& why) {
  return absl::InvalidArgumentError(absl::StrCat("header: ", why));
}

absl::Status TakeFormat(const std::string& format, PlyHeader* header) {
  header->text = format == "ascii";
  header->big_endian = format == "binary_big_endian";
  if (!header->text && !header->big_endian && format != "binary_little_endian") {
    return BadHeader("unknown format");
  }
  return absl::OkStatus();
}

absl::Status TakeElement(const std::vector<std::string_view>& words, PlyHeader* header) {
  PlyElement element;
  if (words.size() < 3) return BadHeader("an element without name or count");
  element.name = LowerWord(words[1]);
  if (!absl::SimpleAtoi(absl::string_view(words[2].data(), words[2].size()), &element.count)) {
    return BadHeader(
        absl::StrCat("the count of element ", header->elements.size() + 1, " is none"));
  }
  header->elements.push_back(std::move(element));
  return absl::OkStatus();
}

absl::Status TakeProperty(const std::vector<std::string_view>& words, PlyHeader* header) {
  if (header->elements.empty()) return BadHeader("a property before any element");
  PlyProperty property;
  property.list = words.size() >= 2 && LowerWord(words[1]) == "list";
  const size_t at = property.list ? 3 : 1;  // of the type
  if (words.size() < at + 2) return BadHeader("a property without type or name");
  const auto type = TypeOf(words[at]);
  const auto count_type = property.list ? TypeOf(words[2]) : PlyType::kUint8;
  if (!type || !count_type) return BadHeader("unknown property type");
  property.type = *type;
  property.count_type = *count_type;
  property.name = LowerWord(words[at + 1]);
  header->elements.back().properties.push_back(std::move(property));
  return absl::OkStatus();
}

}  // namespace

size_t SizeOf(PlyType type) {
  switch (type) {
    case PlyType::kInt8:
    case PlyType::kUint8:
      return 1;
    case PlyType::kInt16:
    case PlyType::kUint16:
      return 2;
    case PlyType::kInt32:
    case PlyType::kUint32:
    case PlyType::kFloat:
      return 4;
    default:
      return 8;
  }
}

int PlyElement::Find(const std::string& property) const {
  for (size_t k = 0; k < properties.size(); ++k) {
    if (properties[k].name == property) return static_cast<int>(k);
  }
  return -1;
}

absl::StatusOr<PlyHeader> ParsePlyHeader(std::string_view bytes) {
  PlyHeader header;
  const std::string_view marked = WithoutByteOrderMark(bytes);
  const size_t skipped = bytes.size() - marked.size();
  TextCursor cursor(marked);
  auto line = cursor.NextLine();
  if (!line || LowerWord(line->substr(0, 3)) != "ply" || WordsOf(*line).size() != 1) {
    return absl::InvalidArgumentError("not a PLY file (no line ply at the start)");
  }
  // A CR alone ends the header's lines where the first one ends so: bytes begin right behind it,
  // and the first of them may be an LF.
  const bool cr = marked.size() > line->size() + 1 && marked[line->size()] == '\r' &&
                  marked[line->size() + 1] != '\n';
  bool has_format = false;
  while ((line = cursor.NextLine())) {
    const std::vector<std::string_view> words = WordsOf(*line);
    const std::string word = words.empty() ? "" : LowerWord(words[0]);
    if (word == "end_header") {
      if (!has_format) return BadHeader("no format");
      header.size = skipped + cursor.Offset();
      if (cr)
        header.size =
            skipped + static_cast<size_t>(line->data() - marked.data()) + line->size() + 1;
      header.size = std::min(header.size, bytes.size());
      header.lines = cursor.Line();
      return header;
    }
    if (word == "format" && words.size() >= 2) {
      HOROPTER_RETURN_IF_ERROR(TakeFormat(LowerWord(words[1]), &header));
      has_format = true;
    } else if (word == "element") {
      HOROPTER_RETURN_IF_ERROR(TakeElement(words, &header));
    } else if (word == "property") {
      HOROPTER_RETURN_IF_ERROR(TakeProperty(words, &header));
    } else if (!word.empty() && word != "comment" && word != "obj_info") {
      return BadHeader(absl::StrCat("line ", cursor.Line(), " is none of PLY's"));
    }
  }
  return BadHeader("it has no end (end_header)");
}

}  // namespace horopter
