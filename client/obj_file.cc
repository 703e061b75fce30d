#include "client/obj_file.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "client/mesh_text.h"
#include "client/polygon.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

std::string SmallLetters(std::string_view word) {
  return absl::AsciiStrToLower(absl::string_view(word.data(), word.size()));
}

std::string QuotedWord(std::string_view word) {
  constexpr size_t kLongest = 40;
  std::string text;
  for (const char c : word.substr(0, kLongest)) {
    text += absl::ascii_isprint(static_cast<unsigned char>(c)) ? c : '?';
  }
  return absl::StrCat("'", text, "'");
}

std::uint8_t ByteOfShare(double share) {
  return static_cast<std::uint8_t>(std::lround(255.0 * std::clamp(share, 0.0, 1.0)));
}

// Statements whose operands are numbers: a name may end with a backslash (a folder's), a number
// cannot.
bool TakesNumbers(const std::string& word) {
  static const std::set<std::string> kNames = {
      "o", "g", "s", "usemtl", "mtllib", "usemap", "maplib"};
  return !kNames.contains(word);
}

// Where a comment begins, or the end. "-1.#IND" is Microsoft's word for no number.
size_t CommentStart(const std::string& line) {
  size_t at = line.find('#');
  while (at != std::string::npos && at > 1 && line.compare(at - 2, 2, "1.") == 0 &&
         at + 1 < line.size() && absl::ascii_isalpha(static_cast<unsigned char>(line[at + 1]))) {
    at = line.find('#', at + 1);
  }
  return std::min(at, line.size());
}

// Diffuse colours of materials by name.
void ReadMaterials(std::string_view text, std::map<std::string, Rgba>* colors) {
  TextCursor cursor(WithoutByteOrderMark(text));
  Rgba* current = nullptr;
  while (const auto line = cursor.NextLine()) {
    const std::vector<std::string_view> words = WordsOf(*line);
    if (words.size() < 2) continue;
    const std::string word = SmallLetters(words[0]);
    if (word == "newmtl") {
      const size_t at = static_cast<size_t>(words[1].data() - line->data());
      const absl::string_view name(line->data() + at, line->size() - at);
      current =
          &colors->emplace(std::string(absl::StripAsciiWhitespace(name)), kNoColor).first->second;
    }
    const auto value = ParseNumber(words[1]);
    if (current == nullptr || !value || !std::isfinite(*value)) continue;
    if (word == "kd" && words.size() >= 4) {
      for (size_t k = 0; k < 3; ++k) {
        const auto share = ParseNumber(words[k + 1]);
        (*current)[k] = share && std::isfinite(*share) ? ByteOfShare(*share) : std::uint8_t{0};
      }
      // Opacity 0 stands for no colour; what the file makes invisible still has one.
      if ((*current)[3] == 0) (*current)[3] = 255;
    } else if (word == "d" || word == "tr") {
      (*current)[3] = std::max<std::uint8_t>(ByteOfShare(word == "d" ? *value : 1.0 - *value), 1);
    }
  }
}

struct Face {
  std::vector<std::int64_t> corners;  // vertex numbers from 0
  int line = 0;
  Rgba color = kNoColor;
};

class ObjReader {
 public:
  ObjReader(std::string_view text, const ReadMaterialFile& read_material)
      : cursor_(WithoutByteOrderMark(text)), read_material_(read_material) {}

  absl::StatusOr<MeshFile> Read() {
    while (auto statement = NextStatement()) {
      HOROPTER_RETURN_IF_ERROR(Take(*statement));
    }
    return Finish();
  }

 private:
  absl::Status Broken(const std::string& why) const {
    return absl::InvalidArgumentError(absl::StrCat("line ", line_, ": ", why));
  }

  // One statement with its continuation lines, without comments.
  std::optional<std::string> NextStatement() {
    auto line = cursor_.NextLine();
    if (!line) return std::nullopt;
    line_ = cursor_.Line();
    std::string statement(*line);
    const std::vector<std::string_view> words = WordsOf(*line);
    if (words.empty() || !TakesNumbers(SmallLetters(words[0]))) return statement;
    while (TakeOffContinuation(&statement)) {
      line = cursor_.NextLine();
      if (!line) break;
      absl::StrAppend(&statement, " ", absl::string_view(line->data(), line->size()));
    }
    return statement;
  }

  // Cuts a comment and the backslash at the end; whether there was one. A backslash in a comment
  // continues nothing.
  static bool TakeOffContinuation(std::string* statement) {
    statement->resize(CommentStart(*statement));
    while (!statement->empty() &&
           absl::ascii_isspace(static_cast<unsigned char>(statement->back()))) {
      statement->pop_back();
    }
    if (statement->empty() || statement->back() != '\\') return false;
    statement->pop_back();
    return true;
  }

  absl::Status Take(const std::string& statement) {
    const std::vector<std::string_view> words = WordsOf(statement);
    if (words.empty() || words[0][0] == '#') return absl::OkStatus();
    const std::string word = SmallLetters(words[0]);
    const std::vector<std::string_view> operands(words.begin() + 1, words.end());
    if (word == "v") return TakeVertex(operands);
    if (word == "f" || word == "fo") return TakeFace(operands);
    if (word == "surf" || word == "bsp" || word == "bzp" || word == "cdc" || word == "res") {
      return Broken(absl::StrCat(
          "a free-form surface (", word, "), which is not read: export the part as triangles"));
    }
    if (word == "usemtl" || word == "mtllib") {
      if (!operands.empty()) TakeMaterial(word == "mtllib", statement, operands);
      return absl::OkStatus();
    }
    static const std::set<std::string> kKnown = {
        "vt",       "vn",     "vp",         "g",         "o",     "s",    "mg",    "usemap",
        "maplib",   "cstype", "deg",        "bmat",      "step",  "curv", "curv2", "parm",
        "trim",     "hole",   "scrv",       "sp",        "end",   "con",  "bevel", "c_interp",
        "d_interp", "lod",    "shadow_obj", "trace_obj", "ctech", "stech"};
    if (word == "l" || word == "p") {
      ++left_out_[word == "l" ? "lines" : "points"];
    } else if (!kKnown.contains(word)) {
      ++left_out_[absl::StrCat("statements ", QuotedWord(words[0]))];
    }
    return absl::OkStatus();
  }

  absl::Status TakeVertex(const std::vector<std::string_view>& operands) {
    if (operands.size() < 3) return Broken("a vertex of fewer than three numbers");
    std::vector<double> numbers;
    for (const std::string_view word : operands) {
      const auto number = ParseNumber(word);
      if (!number) return Broken(absl::StrCat(QuotedWord(word), " is no number"));
      numbers.push_back(*number);
    }
    out_.mesh.vertices.emplace_back(numbers[0], numbers[1], numbers[2]);
    weights_ += numbers.size() == 4 && numbers[3] != 1.0;
    Eigen::Vector3d color = Eigen::Vector3d::Constant(-1.0);
    if (numbers.size() >= 6) color = {numbers[3], numbers[4], numbers[5]};
    if (numbers.size() >= 6 && color.allFinite()) {
      has_colors_ = true;
      largest_color_ = std::max(largest_color_, color.maxCoeff());
    }
    colors_.push_back(color);
    return absl::OkStatus();
  }

  absl::Status TakeFace(const std::vector<std::string_view>& operands) {
    Face face;
    face.line = line_;
    face.color = material_;
    for (const std::string_view word : operands) {
      const std::string_view number = word.substr(0, word.find('/'));
      std::int64_t index = 0;
      if (!absl::SimpleAtoi(absl::string_view(number.data(), number.size()), &index) ||
          index == 0) {
        return Broken(absl::StrCat("the corner ", QuotedWord(word), " names no vertex"));
      }
      const auto known = static_cast<std::int64_t>(out_.mesh.vertices.size());
      if (index < -known) {
        return Broken(absl::StrCat("a face names vertex ", index, " of ", known, " so far"));
      }
      face.corners.push_back(index > 0 ? index - 1 : known + index);
    }
    faces_.push_back(std::move(face));
    return absl::OkStatus();
  }

  void TakeMaterial(bool library,
                    const std::string& statement,
                    const std::vector<std::string_view>& operands) {
    // A name may hold spaces; a line may hold several names.
    const size_t at = static_cast<size_t>(operands[0].data() - statement.data());
    const std::string name(absl::StripAsciiWhitespace(absl::string_view(statement).substr(at)));
    if (!library) {
      const auto known = materials_.find(name);
      material_ = known == materials_.end() ? kNoColor : known->second;
      return;
    }
    std::string text = read_material_ ? read_material_(name) : "";
    ReadMaterials(text, &materials_);
    if (!text.empty() || operands.size() < 2 || !read_material_) return;
    for (const std::string_view word : operands) {
      ReadMaterials(read_material_(std::string(word)), &materials_);
    }
  }

  // Mean over the corners where they are coloured, else the material's.
  Rgba ColorOf(const Face& face) const {
    if (!has_colors_ || face.corners.empty()) return face.color;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const std::int64_t c : face.corners) {
      const Eigen::Vector3d& color = colors_[static_cast<size_t>(c)];
      if (!color.allFinite() || color.minCoeff() < 0.0) return face.color;
      sum += color;
    }
    sum /= static_cast<double>(face.corners.size()) * (largest_color_ > 1.0 ? 255.0 : 1.0);
    return {ByteOfShare(sum.x()), ByteOfShare(sum.y()), ByteOfShare(sum.z()), 255};
  }

  absl::StatusOr<MeshFile> Finish() {
    const auto vertices = static_cast<std::int64_t>(out_.mesh.vertices.size());
    if (vertices > std::numeric_limits<int>::max()) {
      return absl::InvalidArgumentError("too many vertices");
    }
    int flat = 0;
    for (const Face& face : faces_) {
      line_ = face.line;
      std::vector<int> polygon;
      for (const std::int64_t c : face.corners) {
        if (c >= vertices) {
          return Broken(absl::StrCat("a face names vertex ", c + 1, " of ", vertices));
        }
        polygon.push_back(static_cast<int>(c));
      }
      const auto triangles = TriangulatePolygon(out_.mesh.vertices, polygon);
      if (triangles.empty() && polygon.size() >= 3) {
        return Broken(absl::StrCat("a polygon of ", polygon.size(), " corners that is not convex"));
      }
      flat += triangles.empty();
      out_.mesh.triangles.insert(out_.mesh.triangles.end(), triangles.begin(), triangles.end());
      out_.mesh.colors.resize(out_.mesh.triangles.size(), ColorOf(face));
    }
    out_.faces = static_cast<std::int64_t>(faces_.size());
    if (flat > 0) {
      out_.notes.push_back(absl::StrCat(flat, " faces of fewer than three corners left out"));
    }
    if (weights_ > 0) {
      out_.notes.push_back(absl::StrCat(
          weights_, " vertices carry a weight (a fourth number), which does not move them"));
    }
    constexpr size_t kMost = 4;  // kinds of statements that are named
    for (const auto& [what, count] : left_out_) {
      if (out_.notes.size() > kMost) break;
      out_.notes.push_back(absl::StrCat(count, " ", what, " left out"));
    }
    return std::move(out_);
  }

  TextCursor cursor_;
  const ReadMaterialFile& read_material_;
  int line_ = 0;
  MeshFile out_;
  std::vector<Eigen::Vector3d> colors_;  // of the vertices; negative: none
  bool has_colors_ = false;
  double largest_color_ = 0.0;
  int weights_ = 0;
  std::vector<Face> faces_;
  std::map<std::string, Rgba> materials_;
  Rgba material_ = kNoColor;
  std::map<std::string, int> left_out_;
};

}  // namespace

absl::StatusOr<MeshFile> ParseObj(std::string_view text, const ReadMaterialFile& read_material) {
  if (IsUtf16(text)) return absl::InvalidArgumentError("written in UTF-16: save it as plain text");
  HOROPTER_ASSIGN_OR_RETURN(MeshFile file, ObjReader(text, read_material).Read());
  if (file.mesh.triangles.empty()) return absl::InvalidArgumentError("holds no faces");
  HOROPTER_RETURN_IF_ERROR(CheckCorners(file.mesh));
  return file;
}

}  // namespace horopter
