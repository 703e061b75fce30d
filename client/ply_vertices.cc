#include "client/ply_vertices.h"

#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <map>
#include <sstream>

#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

struct Property {
  std::string name;
  std::string type;
};

// Header of a PLY file as far as the vertices need it.
struct Header {
  std::string format;
  size_t vertices = 0;
  std::vector<Property> properties;
  bool vertices_first = true;
};

size_t SizeOf(const std::string& type) {
  static const std::map<std::string, size_t> kSizes{{"char", 1},
                                                    {"int8", 1},
                                                    {"uchar", 1},
                                                    {"uint8", 1},
                                                    {"short", 2},
                                                    {"int16", 2},
                                                    {"ushort", 2},
                                                    {"uint16", 2},
                                                    {"int", 4},
                                                    {"int32", 4},
                                                    {"uint", 4},
                                                    {"uint32", 4},
                                                    {"float", 4},
                                                    {"float32", 4},
                                                    {"double", 8},
                                                    {"float64", 8}};
  const auto it = kSizes.find(type);
  return it == kSizes.end() ? 0 : it->second;
}

bool ReadHeader(std::istream& file, Header& header) {
  std::string line;
  if (!std::getline(file, line) || line.rfind("ply", 0) != 0) return false;
  bool in_vertex = false, seen_element = false;
  while (std::getline(file, line)) {
    std::istringstream words(line);
    std::string word, a, b;
    words >> word >> a >> b;
    if (word == "end_header") return true;
    if (word == "format") header.format = a;
    if (word == "element") {
      in_vertex = a == "vertex";
      if (in_vertex) {
        header.vertices = std::strtoull(b.c_str(), nullptr, 10);
        header.vertices_first = !seen_element;
      }
      seen_element = true;
    }
    if (word == "property" && in_vertex) header.properties.push_back({b, a});
  }
  return false;
}

double Decode(const unsigned char* bytes, const std::string& type, bool big_endian) {
  unsigned char raw[8];
  const size_t n = SizeOf(type);
  for (size_t i = 0; i < n; ++i) raw[i] = bytes[big_endian ? n - 1 - i : i];
  if (type == "double" || type == "float64") {
    uint64_t u = 0;
    for (size_t i = 8; i-- > 0;) u = u << 8 | raw[i];
    return std::bit_cast<double>(u);
  }
  uint32_t u = 0;
  for (size_t i = std::min<size_t>(n, 4); i-- > 0;) u = u << 8 | raw[i];
  return std::bit_cast<float>(u);
}

}  // namespace

absl::StatusOr<std::vector<Eigen::Vector3d>> ReadPlyVertices(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  const auto broken = [&](const std::string& why) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", why));
  };
  Header header;
  if (!ReadHeader(file, header)) return broken("not a PLY file");
  if (header.vertices == 0 || !header.vertices_first) return broken("no vertices at the start");
  int column[3] = {-1, -1, -1};
  std::vector<size_t> offset;
  size_t stride = 0;
  for (size_t k = 0; k < header.properties.size(); ++k) {
    const Property& p = header.properties[k];
    if (p.name.size() == 1 && p.name[0] >= 'x' && p.name[0] <= 'z') {
      column[p.name[0] - 'x'] = static_cast<int>(k);
    }
    if (SizeOf(p.type) == 0) return broken(absl::StrCat("unknown property type ", p.type));
    offset.push_back(stride);
    stride += SizeOf(p.type);
  }
  std::vector<Eigen::Vector3d> points;
  for (const int c : column) {
    if (c < 0) return broken("vertices without x, y, z");
    const std::string& type = header.properties[static_cast<size_t>(c)].type;
    if (header.format != "ascii" && type.rfind("float", 0) != 0 && type.rfind("double", 0) != 0) {
      return broken("x, y, z are no floating-point numbers");
    }
  }
  std::vector<unsigned char> record(stride);
  for (size_t i = 0; i < header.vertices; ++i) {
    Eigen::Vector3d p;
    if (header.format == "ascii") {
      std::vector<double> values(header.properties.size());
      for (double& v : values) file >> v;
      for (int k = 0; k < 3; ++k) p[k] = values[static_cast<size_t>(column[k])];
    } else {
      file.read(reinterpret_cast<char*>(record.data()), static_cast<std::streamsize>(stride));
      for (int k = 0; k < 3; ++k) {
        const auto c = static_cast<size_t>(column[k]);
        p[k] = Decode(
            &record[offset[c]], header.properties[c].type, header.format == "binary_big_endian");
      }
    }
    if (!file || !p.allFinite())
      return broken(absl::StrCat("vertex ", i, " is missing or not finite"));
    points.push_back(p);
  }
  return points;
}

}  // namespace horopter
