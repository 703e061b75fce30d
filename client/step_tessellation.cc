#include "client/step_tessellation.h"

#include <map>
#include <optional>

#include "absl/strings/str_cat.h"
#include "client/mesh_file.h"
#include "client/mesh_text.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr const char* kFaceTypes[] = {"TRIANGULATED_FACE",
                                      "COMPLEX_TRIANGULATED_FACE",
                                      "TRIANGULATED_SURFACE_SET",
                                      "COMPLEX_TRIANGULATED_SURFACE_SET"};

absl::Status BadEntity(const StepText& step, int id, const std::string& why) {
  return absl::InvalidArgumentError(absl::StrCat("#", id, " (", step.TypeOf(id), "): ", why));
}

std::vector<int> NumbersOf(std::string_view list) {
  std::vector<int> numbers;
  for (const std::string_view item : StepList(list)) {
    const auto value = ParseNumber(item);
    numbers.push_back(value && *value >= 1.0 && *value < 2e9 ? static_cast<int>(*value) : 0);
  }
  return numbers;
}

// Of lists of corners, each a strip or a fan.
void Unroll(std::string_view lists, bool fans, std::vector<Eigen::Vector3i>* triangles) {
  for (const std::string_view list : StepList(lists)) {
    const std::vector<int> c = NumbersOf(list);
    for (size_t k = 0; k + 2 < c.size(); ++k) {
      if (fans) {
        triangles->emplace_back(c[0], c[k + 1], c[k + 2]);
      } else {
        const bool even = k % 2 == 0;
        triangles->emplace_back(c[k], c[even ? k + 1 : k + 2], c[even ? k + 2 : k + 1]);
      }
    }
  }
}

class Tessellation {
 public:
  explicit Tessellation(const StepText& step) : step_(step) {}

  absl::StatusOr<TriangleMesh> Read() {
    for (const char* type : kFaceTypes) {
      for (const int id : step_.OfType(type)) HOROPTER_RETURN_IF_ERROR(ReadFaces(id, type));
    }
    if (mesh_.triangles.empty())
      return absl::InvalidArgumentError("only a tessellated shape, and it holds no triangles");
    HOROPTER_RETURN_IF_ERROR(CheckCorners(mesh_));
    return std::move(mesh_);
  }

 private:
  // Index of the first vertex of a coordinates list and how many it has.
  absl::StatusOr<std::pair<int, int>> Coordinates(int id) {
    const auto known = lists_.find(id);
    if (known != lists_.end()) return known->second;
    const auto parameters = step_.Parameters(id, "COORDINATES_LIST");
    if (parameters.size() < 3) return BadEntity(step_, id, "no list of coordinates");
    const int first = static_cast<int>(mesh_.vertices.size());
    for (const std::string_view point : StepList(parameters[2])) {
      const auto xyz = StepList(point);
      Eigen::Vector3d p;
      for (size_t k = 0; k < 3; ++k) {
        const auto value = k < xyz.size() ? ParseNumber(xyz[k]) : std::nullopt;
        if (!value) return BadEntity(step_, id, "a point without three numbers");
        p[static_cast<int>(k)] = *value;
      }
      mesh_.vertices.push_back(p);
    }
    return lists_[id] = {first, static_cast<int>(mesh_.vertices.size()) - first};
  }

  // (name, coordinates, pnmax, normals, [geometric link,] pnindex, triangles | strips, fans)
  absl::Status ReadFaces(int id, std::string_view type) {
    const auto parameters = step_.Parameters(id, type);
    const bool face = type.ends_with("FACE"), complex = type.starts_with("COMPLEX");
    const size_t at = face ? 5 : 4;
    if (parameters.size() < at + (complex ? 3 : 2))
      return BadEntity(step_, id, "too few parameters");
    HOROPTER_ASSIGN_OR_RETURN(const auto list, Coordinates(StepReference(parameters[1])));
    const std::vector<int> through = NumbersOf(parameters[at]);  // empty: the numbers themselves
    std::vector<Eigen::Vector3i> triangles;
    if (complex) {
      Unroll(parameters[at + 1], false, &triangles);
      Unroll(parameters[at + 2], true, &triangles);
    } else {
      for (const std::string_view item : StepList(parameters[at + 1])) {
        const std::vector<int> c = NumbersOf(item);
        if (c.size() != 3) return BadEntity(step_, id, "a triangle without three corners");
        triangles.emplace_back(c[0], c[1], c[2]);
      }
    }
    for (Eigen::Vector3i t : triangles) {
      for (int& c : t) {
        if (!through.empty()) {
          c = c >= 1 && c <= static_cast<int>(through.size()) ? through[static_cast<size_t>(c - 1)]
                                                              : 0;
        }
        if (c < 1 || c > list.second) return BadEntity(step_, id, "a corner that names no point");
        c += list.first - 1;
      }
      mesh_.triangles.push_back(t);
    }
    return absl::OkStatus();
  }

  const StepText& step_;
  TriangleMesh mesh_;
  std::map<int, std::pair<int, int>> lists_;
};

}  // namespace

bool HoldsTessellation(const StepText& step) {
  return !step.OfTypesLike("TESSELLATED_").empty() || !step.OfTypesLike("TRIANGULATED_").empty();
}

absl::StatusOr<TriangleMesh> TessellationOf(const StepText& step) {
  if (!step.OfType("NEXT_ASSEMBLY_USAGE_OCCURRENCE").empty() ||
      !step.OfType("MAPPED_ITEM").empty()) {
    return absl::InvalidArgumentError(
        "only tessellated shapes, in an assembly: export exact geometry (AP214 or AP242 with "
        "solids) or single parts");
  }
  return Tessellation(step).Read();
}

}  // namespace horopter
