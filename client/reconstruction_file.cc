#include "client/reconstruction_file.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "absl/strings/str_cat.h"

namespace horopter {
namespace {

using Json = nlohmann::json;

constexpr double kSegmentWeldShare = 1e-3;
// More are no wireframe of a part, and would take minutes to weld.
constexpr size_t kMaxSegments = 20000;

Eigen::Vector3d PointOf(const Json& json) {
  if (!json.is_array() || json.size() != 3) throw std::invalid_argument("a point is [x, y, z]");
  const Eigen::Vector3d p(json[0].get<double>(), json[1].get<double>(), json[2].get<double>());
  if (!p.allFinite()) throw std::invalid_argument("a coordinate is not finite");
  return p;
}

Wireframe WeldSegments(const std::vector<std::pair<Eigen::Vector3d, Eigen::Vector3d>>& segments) {
  Eigen::AlignedBox3d box;
  for (const auto& [a, b] : segments) box.extend(a), box.extend(b);
  const double distance = kSegmentWeldShare * box.diagonal().norm();
  Wireframe wireframe;
  std::vector<int> counts;
  const auto corner = [&](const Eigen::Vector3d& p) {
    for (size_t i = 0; i < wireframe.points.size(); ++i) {
      if ((wireframe.points[i] - p).norm() > distance) continue;
      wireframe.points[i] += (p - wireframe.points[i]) / ++counts[i];
      return static_cast<int>(i);
    }
    wireframe.points.push_back(p);
    counts.push_back(1);
    return static_cast<int>(wireframe.points.size()) - 1;
  };
  std::set<std::pair<int, int>> edges;
  for (const auto& [a, b] : segments) {
    const int i = corner(a), k = corner(b);
    if (i != k) edges.insert(std::minmax(i, k));
  }
  wireframe.edges.assign(edges.begin(), edges.end());
  return wireframe;
}

}  // namespace

absl::StatusOr<ReconstructionFile> ReadReconstruction(const std::string& path) {
  const auto bad = [&](const std::string& what) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", what));
  };
  std::ifstream file(path, std::ios::binary);
  if (!file) return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  ReconstructionFile result;
  try {
    const Json json = Json::parse(file);
    if (!json.is_object() || json.value("format", "") != "horopter_reconstruction") {
      return bad("no reconstruction (\"format\": \"horopter_reconstruction\" is missing)");
    }
    result.unit = json.value("unit", "");
    std::vector<Eigen::Vector3d> points;
    for (const Json& p : json.value("points", Json::array())) points.push_back(PointOf(p));
    const auto end_of = [&](const Json& end) {
      if (!end.is_number_integer()) return PointOf(end);
      const auto index = end.get<long long>();
      if (index < 0 || index >= static_cast<long long>(points.size())) {
        throw std::invalid_argument(
            absl::StrCat("point ", index, " is outside 0..", points.size(), " - 1"));
      }
      return points[static_cast<size_t>(index)];
    };
    std::vector<std::pair<Eigen::Vector3d, Eigen::Vector3d>> segments;
    for (const Json& segment : json.value("segments", Json::array())) {
      if (!segment.is_array() || segment.size() != 2) return bad("a segment has two ends");
      segments.push_back({end_of(segment[0]), end_of(segment[1])});
    }
    if (segments.empty() || segments.size() > kMaxSegments) {
      return bad(absl::StrCat(segments.size(), " segments, need 1 to ", kMaxSegments));
    }
    result.wireframe = WeldSegments(segments);
  } catch (const std::exception& e) {
    return bad(e.what());
  }
  return result;
}

}  // namespace horopter
