#include "client/ply_file.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/mesh_text.h"
#include "client/ply_header.h"
#include "client/polygon.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

bool IsFloating(PlyType type) {
  return type == PlyType::kFloat || type == PlyType::kDouble;
}

// Values one after the other, as words or as bytes.
class Values {
 public:
  Values(const PlyHeader& header, std::string_view data)
      : text_(header.text), big_endian_(header.big_endian), data_(data), cursor_(data) {}

  // Nothing at the end of the data, or where a word is no number.
  std::optional<double> Next(PlyType type) {
    if (!text_) return NextBytes(type);
    while (const auto word = cursor_.NextWord()) {
      const auto value = ParseNumber(*word);
      if (value) return value;
      if (*word != "comment" && *word != "obj_info") return std::nullopt;
      cursor_.SkipLine();
    }
    return std::nullopt;
  }

  // What is left, as bytes; of text those from the next word on.
  size_t Left() {
    if (!text_) return data_.size() - at_;
    TextCursor ahead = cursor_;
    const auto word = ahead.NextWord();
    return word ? data_.size() - ahead.Offset() + word->size() : 0;
  }

  // Least bytes that so many values take.
  size_t Least(PlyType type) const { return text_ ? 2 : SizeOf(type); }

 private:
  std::optional<double> NextBytes(PlyType type) {
    const size_t n = SizeOf(type);
    if (data_.size() - at_ < n) return std::nullopt;
    std::uint64_t u = 0;
    for (size_t i = 0; i < n; ++i) {
      const size_t from = big_endian_ ? i : n - 1 - i;
      u = u << 8 | static_cast<unsigned char>(data_[at_ + from]);
    }
    at_ += n;
    switch (type) {
      case PlyType::kInt8:
        return static_cast<std::int8_t>(u);
      case PlyType::kInt16:
        return static_cast<std::int16_t>(u);
      case PlyType::kInt32:
        return static_cast<std::int32_t>(u);
      case PlyType::kInt64:
        return static_cast<double>(static_cast<std::int64_t>(u));
      case PlyType::kFloat:
        return std::bit_cast<float>(static_cast<std::uint32_t>(u));
      case PlyType::kDouble:
        return std::bit_cast<double>(u);
      default:
        return static_cast<double>(u);
    }
  }

  bool text_, big_endian_;
  std::string_view data_;
  size_t at_ = 0;
  TextCursor cursor_;
};

// Where red, green, blue and opacity of an element stand, if it has them.
struct ColorColumns {
  int column[4] = {-1, -1, -1, -1};
  double full[4] = {255, 255, 255, 255};

  explicit ColorColumns(const PlyElement& element) {
    const char* kNames[4][2] = {{"red", "diffuse_red"},
                                {"green", "diffuse_green"},
                                {"blue", "diffuse_blue"},
                                {"alpha", "diffuse_alpha"}};
    for (int k = 0; k < 4; ++k) {
      for (const char* name : kNames[k]) {
        const int found = element.Find(name);
        if (column[k] < 0 && found >= 0 && !element.properties[static_cast<size_t>(found)].list) {
          column[k] = found;
        }
      }
      if (column[k] < 0) continue;
      const PlyType type = element.properties[static_cast<size_t>(column[k])].type;
      full[k] = IsFloating(type) ? 1.0 : type == PlyType::kUint16 ? 65535.0 : 255.0;
    }
  }
  bool used() const { return column[0] >= 0 && column[1] >= 0 && column[2] >= 0; }
  // Shares of full; opacity 1 where there is none.
  Eigen::Vector4d Of(const std::vector<double>& values) const {
    Eigen::Vector4d out(0, 0, 0, 1);
    for (int k = 0; k < 4; ++k) {
      if (column[k] < 0) continue;
      const double share = values[static_cast<size_t>(column[k])] / full[k];
      out[k] = std::isfinite(share) ? std::clamp(share, 0.0, 1.0) : 0.0;
    }
    return out;
  }
};

Rgba ToRgba(const Eigen::Vector4d& color) {
  Rgba out;
  for (int k = 0; k < 4; ++k) out[k] = static_cast<std::uint8_t>(std::lround(255.0 * color[k]));
  // Opacity 0 stands for no colour; a file that makes a face invisible still colours it.
  out[3] = std::max<std::uint8_t>(out[3], 1);
  return out;
}

// The list of vertex numbers of a face: by its name, else the only list of whole numbers.
int IndexList(const PlyElement& element) {
  for (const char* name : {"vertex_indices", "vertex_index"}) {
    const int found = element.Find(name);
    if (found >= 0 && element.properties[static_cast<size_t>(found)].list) return found;
  }
  int only = -1;
  for (size_t k = 0; k < element.properties.size(); ++k) {
    const PlyProperty& p = element.properties[k];
    if (!p.list || IsFloating(p.type)) continue;
    if (only >= 0) return -1;
    only = static_cast<int>(k);
  }
  return only;
}

class PlyReader {
 public:
  PlyReader(const PlyHeader& header, std::string_view data)
      : header_(header), values_(header, data) {}

  absl::StatusOr<MeshFile> Read() {
    for (const PlyElement& element : header_.elements) {
      HOROPTER_RETURN_IF_ERROR(ReadElement(element));
    }
    if (const size_t left = values_.Left(); left > 0) {
      if (header_.text && values_.Next(PlyType::kDouble)) {
        return absl::InvalidArgumentError("holds more numbers than its header declares");
      }
      out_.notes.push_back(absl::StrCat(left, " bytes behind the last element read over"));
    }
    if (!has_vertices_) return absl::InvalidArgumentError("no vertices with x, y, z");
    if (polygons_.empty() && strips_.empty()) return AsCloud();
    HOROPTER_RETURN_IF_ERROR(MakeTriangles());
    return std::move(out_);
  }

 private:
  absl::Status CheckRoom(const PlyElement& element) {
    // Each record takes some bytes: a count that has no room is refused before anything is made.
    size_t least = 0;
    for (const PlyProperty& p : element.properties) {
      least += values_.Least(p.list ? p.count_type : p.type);
    }
    const std::uint64_t room = (values_.Left() + 1) / std::max<size_t>(least, 1);
    if (least == 0 || element.count <= room) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrCat(
        "cut short: no room for the ", element.count, " ", What(element), " that it declares"));
  }

  static std::string What(const PlyElement& element) {
    return element.name == "vertex" ? "vertices" : element.name == "face" ? "faces" : "elements";
  }

  absl::Status ReadElement(const PlyElement& element) {
    if (element.count == 0 || element.properties.empty()) return absl::OkStatus();
    HOROPTER_RETURN_IF_ERROR(CheckRoom(element));
    const bool vertices = element.name == "vertex" && !has_vertices_;
    const bool faces = element.name == "face", strips = element.name == "tristrips";
    int xyz[3] = {-1, -1, -1};
    if (vertices) {
      const char* kNames[3] = {"x", "y", "z"};
      for (int k = 0; k < 3; ++k) {
        xyz[k] = element.Find(kNames[k]);
        if (xyz[k] < 0 || element.properties[static_cast<size_t>(xyz[k])].list) {
          return absl::InvalidArgumentError("vertices without x, y, z");
        }
      }
      has_vertices_ = true;
    }
    const int indices = faces || strips ? IndexList(element) : -1;
    if ((faces || strips) && indices < 0) {
      return absl::InvalidArgumentError("faces without a list of vertices");
    }
    const ColorColumns colors(element);
    std::vector<double> record(element.properties.size());
    for (std::uint64_t i = 0; i < element.count; ++i) {
      std::vector<std::int64_t> list;
      HOROPTER_RETURN_IF_ERROR(ReadRecord(element, i, indices, &record, &list));
      if (vertices) {
        out_.mesh.vertices.emplace_back(record[static_cast<size_t>(xyz[0])],
                                        record[static_cast<size_t>(xyz[1])],
                                        record[static_cast<size_t>(xyz[2])]);
        if (colors.used()) vertex_colors_.push_back(colors.Of(record));
      } else if (faces) {
        polygons_.push_back(std::move(list));
        has_face_colors_ = has_face_colors_ || colors.used();
        face_colors_.push_back(colors.used() ? ToRgba(colors.Of(record)) : kNoColor);
      } else if (strips) {
        strips_.push_back(std::move(list));
      }
    }
    return absl::OkStatus();
  }

  // Single values into `record`, the list at `indices` into `list`, other lists passed by.
  absl::Status ReadRecord(const PlyElement& element,
                          std::uint64_t number,
                          int indices,
                          std::vector<double>* record,
                          std::vector<std::int64_t>* list) {
    const auto broken = [&] {
      return absl::InvalidArgumentError(absl::StrCat("cut short or not as its header declares: ",
                                                     number,
                                                     " of ",
                                                     element.count,
                                                     " ",
                                                     What(element)));
    };
    for (size_t k = 0; k < element.properties.size(); ++k) {
      const PlyProperty& p = element.properties[k];
      const auto value = values_.Next(p.list ? p.count_type : p.type);
      if (!value) return broken();
      (*record)[k] = *value;
      if (!p.list) continue;
      if (!(*value >= 0.0) || *value != std::floor(*value) ||
          *value > static_cast<double>((values_.Left() + 1) / values_.Least(p.type))) {
        return broken();
      }
      for (auto n = static_cast<std::uint64_t>(*value); n > 0; --n) {
        const auto index = values_.Next(p.type);
        if (!index) return broken();
        if (static_cast<int>(k) != indices) continue;
        constexpr double kLargest = std::numeric_limits<int>::max();
        if (!(std::abs(*index) <= kLargest) || *index != std::floor(*index)) {
          return absl::InvalidArgumentError(
              absl::StrCat("face ", number, " has a corner that is no vertex number"));
        }
        list->push_back(static_cast<std::int64_t>(*index));
      }
    }
    return absl::OkStatus();
  }

  absl::StatusOr<std::vector<int>> Corners(const std::vector<std::int64_t>& list, size_t number) {
    std::vector<int> corners;
    for (const std::int64_t index : list) {
      if (index < 0 || index >= static_cast<std::int64_t>(out_.mesh.vertices.size())) {
        return absl::InvalidArgumentError(absl::StrCat(
            "face ", number, " names vertex ", index, " of ", out_.mesh.vertices.size()));
      }
      corners.push_back(static_cast<int>(index));
    }
    return corners;
  }

  void Add(const Eigen::Vector3i& triangle, const Rgba* color) {
    out_.mesh.triangles.push_back(triangle);
    if (color != nullptr) {
      out_.mesh.colors.push_back(*color);
    } else if (!vertex_colors_.empty()) {
      Eigen::Vector4d sum = Eigen::Vector4d::Zero();
      for (const int c : triangle) sum += vertex_colors_[static_cast<size_t>(c)] / 3.0;
      out_.mesh.colors.push_back(ToRgba(sum));
    } else {
      out_.mesh.colors.push_back(kNoColor);
    }
  }

  absl::Status MakeTriangles() {
    int flat = 0;
    for (size_t i = 0; i < polygons_.size(); ++i) {
      HOROPTER_ASSIGN_OR_RETURN(const std::vector<int> corners, Corners(polygons_[i], i));
      const auto triangles = TriangulatePolygon(out_.mesh.vertices, corners);
      if (triangles.empty() && corners.size() >= 3) {
        return absl::InvalidArgumentError(
            absl::StrCat("face ", i, " has ", corners.size(), " corners and is not convex"));
      }
      flat += triangles.empty();
      for (const Eigen::Vector3i& t : triangles) {
        Add(t, has_face_colors_ ? &face_colors_[i] : nullptr);
      }
    }
    out_.faces = static_cast<std::int64_t>(polygons_.size());
    for (size_t i = 0; i < strips_.size(); ++i) HOROPTER_RETURN_IF_ERROR(Unroll(i));
    if (flat > 0) {
      out_.notes.push_back(absl::StrCat(flat, " faces of fewer than three corners left out"));
    }
    if (out_.mesh.triangles.empty()) return absl::InvalidArgumentError("holds no faces");
    return CheckCorners(out_.mesh);
  }

  // Strips are parted by -1; every second triangle runs the other way.
  absl::Status Unroll(size_t number) {
    std::vector<std::int64_t> run;
    std::vector<std::int64_t> strip = strips_[number];
    strip.push_back(-1);
    for (const std::int64_t index : strip) {
      if (index != -1) {
        run.push_back(index);
        continue;
      }
      HOROPTER_ASSIGN_OR_RETURN(const std::vector<int> corners, Corners(run, number));
      for (size_t k = 0; k + 2 < corners.size(); ++k) {
        const bool even = k % 2 == 0;
        Add({corners[k], corners[even ? k + 1 : k + 2], corners[even ? k + 2 : k + 1]}, nullptr);
        ++out_.faces;
      }
      run.clear();
    }
    return absl::OkStatus();
  }

  absl::StatusOr<MeshFile> AsCloud() {
    std::vector<Eigen::Vector3d>& points = out_.mesh.vertices;
    const size_t all = points.size();
    std::erase_if(points, [](const Eigen::Vector3d& p) { return !p.allFinite(); });
    if (points.empty()) return absl::InvalidArgumentError("no vertex with finite coordinates");
    if (points.size() < all) {
      out_.notes.push_back(absl::StrCat(
          all - points.size(), " of ", all, " points have no finite coordinates; left out"));
    }
    return std::move(out_);
  }

  const PlyHeader& header_;
  Values values_;
  MeshFile out_;
  bool has_vertices_ = false;
  std::vector<Eigen::Vector4d> vertex_colors_;
  std::vector<std::vector<std::int64_t>> polygons_, strips_;
  std::vector<Rgba> face_colors_;
  bool has_face_colors_ = false;
};

}  // namespace

absl::StatusOr<MeshFile> ParsePly(std::string_view bytes) {
  if (IsUtf16(bytes)) return absl::InvalidArgumentError("written in UTF-16: save it as plain text");
  HOROPTER_ASSIGN_OR_RETURN(const PlyHeader header, ParsePlyHeader(bytes));
  return PlyReader(header, bytes.substr(header.size)).Read();
}

}  // namespace horopter
