// The header of a PLY file.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace horopter {

enum class PlyType {
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kInt64,
  kUint64,
  kFloat,
  kDouble
};

// Bytes of one.
size_t SizeOf(PlyType type);

struct PlyProperty {
  std::string name;
  PlyType type = PlyType::kFloat;
  bool list = false;
  PlyType count_type = PlyType::kUint8;  // of a list's length
};

struct PlyElement {
  std::string name;
  std::uint64_t count = 0;
  std::vector<PlyProperty> properties;
  // Index of the property, or -1.
  int Find(const std::string& property) const;
};

struct PlyHeader {
  bool text = false;
  bool big_endian = false;
  std::vector<PlyElement> elements;
  size_t size = 0;  // bytes up to what it declares
  int lines = 0;
};

// Words in any case; comments and obj_info are passed by. Errors: INVALID_ARGUMENT (no PLY header,
// no end, an unknown format, type or count).
absl::StatusOr<PlyHeader> ParsePlyHeader(std::string_view bytes);

}  // namespace horopter
