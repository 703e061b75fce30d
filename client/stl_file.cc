#include "client/stl_file.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <map>
#include <string>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "client/mesh_text.h"
#include "client/polygon.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr size_t kStlHeader = 80, kStlStart = 84, kStlRecord = 50;

bool IsWord(std::string_view word, const char* expected) {
  return absl::EqualsIgnoreCase(absl::string_view(word.data(), word.size()), expected);
}

// Little-endian, wherever this runs.
std::uint32_t StlWord(std::string_view bytes, size_t at) {
  std::uint32_t word = 0;
  for (size_t k = 4; k-- > 0;) word = word << 8 | static_cast<unsigned char>(bytes[at + k]);
  return word;
}

struct StlRecord {
  Eigen::Vector3f normal;
  std::array<Eigen::Vector3f, 3> corners;
  unsigned attribute = 0;
};

StlRecord RecordAt(std::string_view bytes, size_t number) {
  StlRecord record;
  const size_t at = kStlStart + number * kStlRecord;
  for (size_t k = 0; k < 12; ++k) {
    const float value = std::bit_cast<float>(StlWord(bytes, at + 4 * k));
    if (k < 3) {
      record.normal[static_cast<int>(k)] = value;
    } else {
      record.corners[k / 3 - 1][static_cast<int>(k % 3)] = value;
    }
  }
  record.attribute = static_cast<unsigned char>(bytes[at + 48]) |
                     static_cast<unsigned>(static_cast<unsigned char>(bytes[at + 49])) << 8;
  return record;
}

// Corners finite and in reach of those before: words and other bytes taken for numbers are not.
bool InReach(const StlRecord& record, const std::array<Eigen::Vector3f, 2>& box) {
  constexpr double kReach = 1e6;
  const double size = (box[1] - box[0]).cast<double>().norm() +
                      box[0].cast<double>().cwiseAbs().maxCoeff() +
                      box[1].cast<double>().cwiseAbs().maxCoeff() + 1e-3;
  return std::all_of(record.corners.begin(), record.corners.end(), [&](const Eigen::Vector3f& c) {
    return c.allFinite() && c.cast<double>().cwiseAbs().maxCoeff() <= kReach * size;
  });
}

// Whether bytes that no header counts are a facet: with an area, and a normal that is its own or
// left empty.
bool LooksLikeFacet(const StlRecord& record) {
  const Eigen::Vector3d a = record.corners[0].cast<double>();
  const Eigen::Vector3d cross =
      (record.corners[1].cast<double>() - a).cross(record.corners[2].cast<double>() - a);
  if (!(cross.norm() > 0.0)) return false;
  if (!record.normal.allFinite() || record.normal.isZero()) return true;
  return std::abs(record.normal.cast<double>().dot(cross) / cross.norm()) > 0.9;
}

// Whether every edge has its counterpart, by the corners' bytes: a file cut short is not closed.
bool IsClosed(const TriangleMesh& mesh) {
  using Corner = std::array<double, 3>;
  std::map<std::pair<Corner, Corner>, int> edges;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) {
      Corner ends[2];
      for (int e = 0; e < 2; ++e) {
        const Eigen::Vector3d& p = mesh.vertices[static_cast<size_t>(t[(k + e) % 3])];
        ends[e] = {p.x(), p.y(), p.z()};
      }
      if (ends[0] == ends[1]) continue;
      ++edges[std::minmax(ends[0], ends[1])];
    }
  }
  return std::all_of(edges.begin(), edges.end(), [](const auto& e) { return e.second % 2 == 0; });
}

void Append(const StlRecord& record, MeshFile* file) {
  const int first = static_cast<int>(file->mesh.vertices.size());
  for (const Eigen::Vector3f& c : record.corners) {
    file->mesh.vertices.push_back(c.cast<double>());
  }
  file->mesh.triangles.emplace_back(first, first + 1, first + 2);
}

// Materialise's colours: "COLOR=" and four bytes in the header, five bits of red, green and blue a
// facet from the lowest bit on, unless the highest bit says that the header's colour stands.
class FacetColors {
 public:
  explicit FacetColors(std::string_view header) {
    const size_t at = header.find("COLOR=");
    used_ = at != std::string_view::npos && at + 10 <= header.size();
    for (size_t k = 0; used_ && k < 4; ++k) {
      default_[k] = static_cast<std::uint8_t>(header[at + 6 + k]);
    }
    default_[3] = std::max<std::uint8_t>(default_[3], 1);
  }
  bool used() const { return used_; }
  Rgba Of(unsigned attribute) const {
    if ((attribute & 0x8000u) != 0) return default_;
    const auto byte = [&](unsigned shift) {
      return static_cast<std::uint8_t>(((attribute >> shift) & 31u) * 255u / 31u);
    };
    return {byte(0), byte(5), byte(10), 255};
  }

 private:
  bool used_ = false;
  Rgba default_ = kNoColor;
};

absl::StatusOr<MeshFile> ParseBinary(std::string_view bytes) {
  const std::uint32_t counted = StlWord(bytes, kStlHeader);
  const size_t held = (bytes.size() - kStlStart) / kStlRecord;
  const bool unknown = counted == 0 || counted == 0xFFFFFFFFu;
  const FacetColors colors(bytes.substr(0, kStlHeader));
  MeshFile file;
  std::array<Eigen::Vector3f, 2> box = {Eigen::Vector3f::Zero(), Eigen::Vector3f::Zero()};
  const auto add = [&](const StlRecord& record) {
    if (file.mesh.triangles.empty()) box = {record.corners[0], record.corners[0]};
    for (const Eigen::Vector3f& c : record.corners) {
      if (!c.allFinite()) continue;
      box = {box[0].cwiseMin(c), box[1].cwiseMax(c)};
    }
    Append(record, &file);
    if (colors.used()) file.mesh.colors.push_back(colors.Of(record.attribute));
  };
  size_t read = 0;
  const size_t sure = unknown ? 0 : std::min<size_t>(counted, held);
  for (; read < sure; ++read) add(RecordAt(bytes, read));
  for (; read < held; ++read) {  // what the header does not count
    const StlRecord record = RecordAt(bytes, read);
    const bool exact = unknown && (bytes.size() - kStlStart) % kStlRecord == 0;
    if (read > 0 && !InReach(record, box)) break;
    if (!exact && !LooksLikeFacet(record)) break;
    add(record);
  }
  file.faces = static_cast<std::int64_t>(read);
  if (read == 0) return absl::InvalidArgumentError("holds no facets");
  if (!unknown && counted > held) {
    // A wrong count, or the end is missing.
    if ((bytes.size() - kStlStart) % kStlRecord != 0 || !IsClosed(file.mesh)) {
      return absl::InvalidArgumentError(
          absl::StrCat("cut short: ", held, " of ", counted, " facets"));
    }
  }
  if (read != counted) {
    file.notes.push_back(
        absl::StrCat("the header counts ", counted, " facets; ", read, " are there"));
  }
  const size_t behind = bytes.size() - kStlStart - read * kStlRecord;
  if (behind > 0 && unknown && behind >= kStlRecord) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the header counts ", counted, " facets, and what follows facet ", read, " is none"));
  }
  if (behind > 0) {
    file.notes.push_back(absl::StrCat(behind, " bytes behind the last facet read over"));
  }
  return file;
}

class TextReader {
 public:
  explicit TextReader(std::string_view text) : cursor_(text) {}

  absl::StatusOr<MeshFile> Read() {
    while (auto word = cursor_.NextWord()) {
      if (IsWord(*word, "solid")) {
        open_ = true;
        cursor_.SkipLine();  // a name of any words
      } else if (IsWord(*word, "endsolid")) {
        open_ = false;
        cursor_.SkipLine();
      } else if (IsWord(*word, "end")) {
        word = cursor_.NextWord();
        open_ = open_ && !(word && IsWord(*word, "solid"));
        cursor_.SkipLine();
      } else if (IsWord(*word, "facet")) {
        HOROPTER_RETURN_IF_ERROR(ReadFacet());
      } else {
        ++unknown_;
        cursor_.SkipLine();
      }
    }
    if (file_.faces == 0) return absl::InvalidArgumentError("holds no facets");
    if (open_) file_.notes.push_back("no endsolid at the end: the file may be cut short");
    if (unknown_ > 0) {
      file_.notes.push_back(absl::StrCat(unknown_, " lines that are none of STL's read over"));
    }
    return std::move(file_);
  }

 private:
  absl::Status Broken(const std::string& why) const {
    return absl::InvalidArgumentError(absl::StrCat("line ", cursor_.Line(), ": ", why));
  }

  // From behind "facet" to its end. The normal, however it is written, is passed by.
  absl::Status ReadFacet() {
    std::vector<int> polygon;
    while (true) {
      const auto word = cursor_.NextWord();
      if (!word) return Broken("cut short within a facet");
      if (IsWord(*word, "endfacet")) break;
      if (IsWord(*word, "end")) {
        const auto what = cursor_.NextWord();
        if (!what || IsWord(*what, "facet")) break;
        continue;
      }
      if (IsWord(*word, "facet") || IsWord(*word, "endsolid") || IsWord(*word, "solid")) {
        return Broken(absl::StrCat("facet ", file_.faces + 1, " has no end"));
      }
      if (!IsWord(*word, "vertex")) continue;
      Eigen::Vector3d point;
      for (int k = 0; k < 3; ++k) {
        const auto number = cursor_.NextWord();
        const auto value = number ? ParseNumber(*number) : std::nullopt;
        if (!value) return Broken("a vertex without three numbers");
        point[k] = *value;
      }
      polygon.push_back(static_cast<int>(file_.mesh.vertices.size()));
      file_.mesh.vertices.push_back(point);
    }
    ++file_.faces;
    const auto triangles = TriangulatePolygon(file_.mesh.vertices, polygon);
    if (triangles.empty()) {
      return Broken(absl::StrCat("facet ", file_.faces, " has ", polygon.size(), " corners"));
    }
    file_.mesh.triangles.insert(file_.mesh.triangles.end(), triangles.begin(), triangles.end());
    return absl::OkStatus();
  }

  TextCursor cursor_;
  MeshFile file_;
  bool open_ = false;
  int unknown_ = 0;
};

// Facets in words, and no byte that text does not have before the first of them.
bool IsText(std::string_view bytes) {
  const std::string_view start = bytes.substr(0, 4096);
  if (start.find('\0') != std::string_view::npos) return false;
  const auto first = TextCursor(start).NextWord();
  return (first && IsWord(*first, "solid")) ||
         absl::StrContains(absl::AsciiStrToLower(absl::string_view(start.data(), start.size())),
                           "facet");
}

}  // namespace

absl::StatusOr<MeshFile> ParseStl(std::string_view bytes) {
  if (IsUtf16(bytes)) return absl::InvalidArgumentError("written in UTF-16: save it as plain text");
  const bool counted =
      bytes.size() > kStlStart &&
      bytes.size() == kStlStart + kStlRecord * std::uint64_t{StlWord(bytes, kStlHeader)};
  const std::string_view text = WithoutByteOrderMark(bytes);
  MeshFile file;
  if (!counted && IsText(text)) {
    HOROPTER_ASSIGN_OR_RETURN(file, TextReader(text).Read());
  } else if (bytes.size() >= kStlStart + kStlRecord) {
    HOROPTER_ASSIGN_OR_RETURN(file, ParseBinary(bytes));
  } else {
    return absl::InvalidArgumentError("neither STL text (solid ...) nor of a facet's size");
  }
  HOROPTER_RETURN_IF_ERROR(CheckCorners(file.mesh));
  return file;
}

}  // namespace horopter
