#include "client/glb_file.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

using nlohmann::json;

constexpr size_t kMostGlbTriangles = 20'000'000;

absl::Status BadGlb(const std::string& why) {
  return absl::InvalidArgumentError(why);
}

std::uint32_t GlbWord(std::string_view bytes, size_t at) {
  std::uint32_t word = 0;
  for (size_t k = 4; k-- > 0;) word = word << 8 | static_cast<unsigned char>(bytes[at + k]);
  return word;
}

// The member of an object, or null.
const json& Member(const json& object, const char* name) {
  static const json kNull;
  if (!object.is_object()) return kNull;
  const auto found = object.find(name);
  return found == object.end() ? kNull : *found;
}

// Element of the array `name` by an index that is itself a JSON value; null where there is none.
const json& Element(const json& root, const char* name, const json& index) {
  static const json kNull;
  const json& list = Member(root, name);
  if (!list.is_array() || !index.is_number_unsigned()) return kNull;
  const auto i = index.get<std::uint64_t>();
  return i < list.size() ? list[i] : kNull;
}

// A whole number, or the fallback where the member is not there; none: it is something else.
std::optional<std::uint64_t> Whole(const json& object, const char* name, std::uint64_t fallback) {
  const json& value = Member(object, name);
  if (value.is_null()) return fallback;
  if (!value.is_number_unsigned()) return std::nullopt;
  const auto number = value.get<std::uint64_t>();
  constexpr std::uint64_t kLargest = std::uint64_t{1} << 40;  // sums of them do not overflow
  return number <= kLargest ? std::make_optional(number) : std::nullopt;
}

size_t ComponentSize(std::uint64_t type) {
  switch (type) {
    case 5120:
    case 5121:
      return 1;
    case 5122:
    case 5123:
      return 2;
    case 5125:
    case 5126:
      return 4;
    default:
      return 0;
  }
}

double Component(std::string_view bytes, size_t at, std::uint64_t type, bool normalized) {
  std::uint32_t raw = 0;
  for (size_t k = ComponentSize(type); k-- > 0;) {
    raw = raw << 8 | static_cast<unsigned char>(bytes[at + k]);
  }
  const auto share = [&](double value, double full) {
    return normalized ? std::max(value / full, -1.0) : value;
  };
  switch (type) {
    case 5120:
      return share(static_cast<std::int8_t>(raw), 127.0);
    case 5121:
      return share(raw, 255.0);
    case 5122:
      return share(static_cast<std::int16_t>(raw), 32767.0);
    case 5123:
      return share(raw, 65535.0);
    case 5125:
      return raw;
    default:
      return std::bit_cast<float>(raw);
  }
}

// Light as colours are displayed.
std::uint8_t DisplayByte(double linear) {
  const double c = std::clamp(linear, 0.0, 1.0);
  const double s = c <= 0.0031308 ? 12.92 * c : 1.055 * std::pow(c, 1.0 / 2.4) - 0.055;
  return static_cast<std::uint8_t>(std::lround(255.0 * s));
}

class GlbReader {
 public:
  GlbReader(const json& root, std::string_view data) : root_(root), data_(data) {}

  absl::StatusOr<MeshFile> Read() {
    HOROPTER_RETURN_IF_ERROR(CheckExtensions());
    const json& scenes = Member(root_, "scenes");
    const json& chosen = Member(root_, "scene");
    const json& scene = Element(root_, "scenes", chosen.is_null() ? json(0u) : chosen);
    if (scenes.is_array() && !scenes.empty()) {
      for (const json& node : Children(scene, "nodes")) {
        HOROPTER_RETURN_IF_ERROR(Visit(node, Eigen::Affine3d::Identity(), 0));
      }
    } else {
      for (const json& mesh : Children(root_, "meshes")) {
        HOROPTER_RETURN_IF_ERROR(AddMesh(mesh, Eigen::Affine3d::Identity()));
      }
    }
    if (out_.mesh.triangles.empty()) return BadGlb("holds no triangles");
    if (left_out_ > 0) {
      out_.notes.push_back(absl::StrCat(left_out_, " sets of lines or points left out"));
    }
    out_.faces = static_cast<std::int64_t>(out_.mesh.triangles.size());
    out_.usual_unit = "m";
    HOROPTER_RETURN_IF_ERROR(CheckCorners(out_.mesh));
    return std::move(out_);
  }

 private:
  static const json& Children(const json& object, const char* name) {
    static const json kNone = json::array();
    const json& list = Member(object, name);
    return list.is_array() ? list : kNone;
  }

  absl::Status CheckExtensions() const {
    for (const json& name : Children(root_, "extensionsRequired")) {
      const std::string word = name.is_string() ? name.get<std::string>() : "";
      bool harmless = word == "KHR_mesh_quantization";
      for (const char* prefix : {"KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_"}) {
        harmless = harmless || absl::StartsWith(word, prefix);
      }
      if (!harmless)
        return BadGlb(
            absl::StrCat("needs '", word, "', which is not read: export it without compression"));
    }
    return absl::OkStatus();
  }

  absl::Status Visit(const json& index, const Eigen::Affine3d& parent, int depth) {
    constexpr int kDeepest = 200;
    const json& node = Element(root_, "nodes", index);
    if (node.is_null()) return BadGlb("a node that is not there");
    if (depth > kDeepest || !visited_.insert(index.get<std::uint64_t>()).second) {
      return BadGlb("a node that hangs from two others or from itself");
    }
    const std::optional<Eigen::Affine3d> own = TransformOf(node);
    if (!own) return BadGlb("a node whose transform is none");
    const Eigen::Affine3d here = parent * *own;
    if (!Member(node, "mesh").is_null()) {
      HOROPTER_RETURN_IF_ERROR(AddMesh(Element(root_, "meshes", Member(node, "mesh")), here));
    }
    for (const json& child : Children(node, "children")) {
      HOROPTER_RETURN_IF_ERROR(Visit(child, here, depth + 1));
    }
    return absl::OkStatus();
  }

  // Numbers of an array of that size; the fallback where there is none.
  static std::optional<std::vector<double>> Numbers(const json& object,
                                                    const char* name,
                                                    std::vector<double> fallback) {
    const json& list = Member(object, name);
    if (list.is_null()) return fallback;
    if (!list.is_array() || list.size() != fallback.size()) return std::nullopt;
    for (size_t k = 0; k < fallback.size(); ++k) {
      if (!list[k].is_number()) return std::nullopt;
      fallback[k] = list[k].get<double>();
    }
    return fallback;
  }

  static std::optional<Eigen::Affine3d> TransformOf(const json& node) {
    const auto matrix = Numbers(node, "matrix", {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1});
    const auto t = Numbers(node, "translation", {0, 0, 0});
    const auto q = Numbers(node, "rotation", {0, 0, 0, 1});
    const auto s = Numbers(node, "scale", {1, 1, 1});
    if (!matrix || !t || !q || !s) return std::nullopt;
    Eigen::Affine3d out = Eigen::Affine3d::Identity();
    if (node.contains("matrix")) {
      // Rows in the place of columns would lose the translation.
      const auto& m = *matrix;
      if (m[3] != 0.0 || m[7] != 0.0 || m[11] != 0.0 || m[15] != 1.0) return std::nullopt;
      out.matrix() = Eigen::Map<const Eigen::Matrix4d>(matrix->data());  // columns
      return out;
    }
    const Eigen::Quaterniond turn((*q)[3], (*q)[0], (*q)[1], (*q)[2]);
    if (!(turn.norm() > 0.0)) return std::nullopt;
    out.translate(Eigen::Vector3d((*t)[0], (*t)[1], (*t)[2]));
    out.rotate(turn.normalized());
    out.scale(Eigen::Vector3d((*s)[0], (*s)[1], (*s)[2]));
    return out;
  }

  absl::Status AddMesh(const json& mesh, const Eigen::Affine3d& place) {
    if (!mesh.is_object()) return BadGlb("a mesh that is not there");
    for (const json& primitive : Children(mesh, "primitives")) {
      HOROPTER_RETURN_IF_ERROR(AddPrimitive(primitive, place));
    }
    return absl::OkStatus();
  }

  // Values of an accessor, `width` a row.
  absl::StatusOr<std::vector<double>> Values(const json& index, const char* type, size_t width) {
    const json& accessor = Element(root_, "accessors", index);
    if (Member(accessor, "type") != type) return BadGlb(absl::StrCat("no accessor of type ", type));
    if (accessor.contains("sparse")) return BadGlb("sparse geometry, which is not read");
    const json& view = Element(root_, "bufferViews", Member(accessor, "bufferView"));
    if (!view.is_object()) return BadGlb("an accessor without data (compressed?)");
    const auto buffer = Whole(view, "buffer", 1);
    const json& file = Element(root_, "buffers", json(0u));
    if (buffer != 0u || file.contains("uri")) return BadGlb("its data is in another file");
    const auto component = Whole(accessor, "componentType", 0), count = Whole(accessor, "count", 0);
    const auto offset = Whole(accessor, "byteOffset", 0), start = Whole(view, "byteOffset", 0);
    const auto length = Whole(view, "byteLength", 0);
    const size_t size = component ? ComponentSize(*component) : 0, row = size * width;
    const auto stride = Whole(view, "byteStride", row);
    if (size == 0 || !count || !offset || !start || !length || !stride || *stride < row) {
      return BadGlb("an accessor that cannot be read");
    }
    if (*start + *length > data_.size() ||
        (*count > 0 &&
         (*count - 1 > *length / *stride || *offset + *stride * (*count - 1) + row > *length))) {
      return BadGlb("cut short: an accessor beyond its data");
    }
    const bool normalized = Member(accessor, "normalized") == true;
    std::vector<double> values;
    values.reserve(*count * width);
    for (std::uint64_t i = 0; i < *count; ++i) {
      for (size_t k = 0; k < width; ++k) {
        values.push_back(
            Component(data_, *start + *offset + *stride * i + size * k, *component, normalized));
      }
    }
    return values;
  }

  Rgba ColorOf(const json& primitive) const {
    const json& material = Element(root_, "materials", Member(primitive, "material"));
    const auto c =
        Numbers(Member(material, "pbrMetallicRoughness"), "baseColorFactor", {1, 1, 1, 1});
    if (!material.is_object() || !c ||
        !Member(material, "pbrMetallicRoughness").contains("baseColorFactor")) {
      return kNoColor;
    }
    const double opacity = std::clamp((*c)[3], 0.0, 1.0);
    return {DisplayByte((*c)[0]),
            DisplayByte((*c)[1]),
            DisplayByte((*c)[2]),
            static_cast<std::uint8_t>(std::max(1L, std::lround(255.0 * opacity)))};
  }

  absl::Status AddPrimitive(const json& primitive, const Eigen::Affine3d& place) {
    constexpr std::uint64_t kTriangles = 4, kStrip = 5, kFan = 6;
    const auto mode = Whole(primitive, "mode", kTriangles);
    if (!mode || *mode > kFan) return BadGlb("a primitive of no known mode");
    if (*mode < kTriangles) {
      ++left_out_;
      return absl::OkStatus();
    }
    HOROPTER_ASSIGN_OR_RETURN(
        const std::vector<double> xyz,
        Values(Member(Member(primitive, "attributes"), "POSITION"), "VEC3", 3));
    const size_t points = xyz.size() / 3;
    std::vector<double> indices;
    if (Member(primitive, "indices").is_null()) {
      for (size_t i = 0; i < points; ++i) indices.push_back(static_cast<double>(i));
    } else {
      HOROPTER_ASSIGN_OR_RETURN(indices, Values(Member(primitive, "indices"), "SCALAR", 1));
    }
    if (*mode == kTriangles && indices.size() % 3 != 0) return BadGlb("triangles of two corners");
    for (const double i : indices) {
      if (!(i >= 0.0 && i < static_cast<double>(points))) {
        return BadGlb(absl::StrCat("a triangle names vertex ", i, " of ", points));
      }
    }
    const size_t triangles =
        *mode == kTriangles ? indices.size() / 3 : std::max<size_t>(indices.size(), 2) - 2;
    if (out_.mesh.triangles.size() + triangles > kMostGlbTriangles ||
        out_.mesh.vertices.size() + points > 3 * kMostGlbTriangles) {
      return BadGlb("more than twenty million triangles");
    }
    const int first = static_cast<int>(out_.mesh.vertices.size());
    for (size_t i = 0; i < points; ++i) {
      out_.mesh.vertices.push_back(place *
                                   Eigen::Vector3d(xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]));
    }
    const bool mirrored = place.linear().determinant() < 0.0;
    const Rgba color = ColorOf(primitive);
    for (size_t t = 0; t < triangles; ++t) {
      size_t c[3] = {t, t + 1, t + 2};
      if (*mode == kTriangles) c[0] = 3 * t, c[1] = 3 * t + 1, c[2] = 3 * t + 2;
      if (*mode == kStrip && t % 2 == 1) std::swap(c[1], c[2]);
      if (*mode == kFan) c[0] = 0;
      if (mirrored) std::swap(c[1], c[2]);
      out_.mesh.triangles.emplace_back(first + static_cast<int>(indices[c[0]]),
                                       first + static_cast<int>(indices[c[1]]),
                                       first + static_cast<int>(indices[c[2]]));
      out_.mesh.colors.push_back(color);
    }
    return absl::OkStatus();
  }

  const json& root_;
  std::string_view data_;
  MeshFile out_;
  std::set<std::uint64_t> visited_;
  int left_out_ = 0;
};

}  // namespace

absl::StatusOr<MeshFile> ParseGlb(std::string_view bytes) {
  constexpr size_t kHeader = 12, kChunk = 8;
  constexpr std::uint32_t kJson = 0x4E4F534A, kBinary = 0x004E4942;
  if (bytes.size() < kHeader + kChunk || bytes.substr(0, 4) != "glTF") return BadGlb("no GLB file");
  if (GlbWord(bytes, 4) != 2) return BadGlb("glTF of another version than 2");
  if (GlbWord(bytes, 8) > bytes.size()) return BadGlb("cut short");
  std::string_view text, data;
  for (size_t at = kHeader; at + kChunk <= bytes.size();) {
    const size_t length = GlbWord(bytes, at);
    const std::uint32_t type = GlbWord(bytes, at + 4);
    if (length > bytes.size() - at - kChunk) return BadGlb("cut short");
    const std::string_view chunk = bytes.substr(at + kChunk, length);
    if (type == kJson && text.empty()) text = chunk;
    if (type == kBinary && data.empty()) data = chunk;
    at += kChunk + length;
  }
  const json root = json::parse(text.begin(), text.end(), nullptr, false);
  if (root.is_discarded() || !root.is_object()) return BadGlb("its JSON part cannot be read");
  return GlbReader(root, data).Read();
}

}  // namespace horopter
