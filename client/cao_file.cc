#include "client/cao_file.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <numeric>
#include <sstream>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/mesh_topology.h"
#include "client/polygon.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

constexpr int kMaxItems = 1'000'000;
constexpr int kMaxFaceCorners = 10'000;
constexpr int kCylinderSides = 72;

// Lines without comments; an item's options (name="..") stand behind its numbers and are ignored.
class Reader {
 public:
  Reader(const std::string& path, std::istream& in) : path_(path) {
    std::string line;
    while (std::getline(in, line)) {
      line = line.substr(0, line.find('#'));
      if (line.find_first_not_of(" \t\r") != std::string::npos) lines_.push_back(line);
    }
  }

  bool AtEnd() const { return next_ >= lines_.size(); }

  absl::Status Error(std::string_view what) const {
    return absl::InvalidArgumentError(
        absl::StrCat(path_, ": item ", next_, ": ", std::string(what)));
  }

  absl::StatusOr<std::istringstream> Next() {
    if (AtEnd()) return Error("the file ends too early");
    return std::istringstream(lines_[next_++]);
  }

  // A section's count; a missing section counts as empty.
  absl::StatusOr<int> Count() {
    if (AtEnd()) return 0;
    if (lines_[next_].find("load") != std::string::npos) {
      return Error("`load` is not supported: name the loaded file itself");
    }
    HOROPTER_ASSIGN_OR_RETURN(std::istringstream line, Next());
    long count = -1;
    if (!(line >> count) || count < 0 || count > kMaxItems) return Error("not a count");
    return static_cast<int>(count);
  }

  absl::StatusOr<std::vector<int>> Indices(std::istringstream& line, int n, size_t limit) const {
    std::vector<int> indices(n);
    for (int& i : indices) {
      if (!(line >> i) || i < 0 || static_cast<size_t>(i) >= limit) {
        return Error("an index is missing or out of range");
      }
    }
    return indices;
  }

 private:
  std::string path_;
  std::vector<std::string> lines_;
  size_t next_ = 0;
};

void AddPolygon(TriangleMesh& soup, const std::vector<int>& polygon) {
  const auto triangles = TriangulatePolygon(soup.vertices, polygon);
  soup.triangles.insert(soup.triangles.end(), triangles.begin(), triangles.end());
}

// Corners in order around a face given by its lines; empty when they make no closed loop.
std::vector<int> LoopOf(std::vector<std::pair<int, int>> lines) {
  std::vector<int> loop;
  if (lines.size() < 3) return loop;
  loop = {lines[0].first, lines[0].second};
  lines.erase(lines.begin());
  while (!lines.empty()) {
    const auto next = std::find_if(lines.begin(), lines.end(), [&](const auto& l) {
      return l.first == loop.back() || l.second == loop.back();
    });
    if (next == lines.end()) return {};
    loop.push_back(next->first == loop.back() ? next->second : next->first);
    lines.erase(next);
  }
  if (loop.front() != loop.back()) return {};
  loop.pop_back();
  return loop;
}

void AddCylinder(TriangleMesh& soup, const Eigen::Vector3d& a, const Eigen::Vector3d& b, double r) {
  const Eigen::Vector3d axis = (b - a).normalized();
  const Eigen::Vector3d x = axis.unitOrthogonal(), y = axis.cross(x);
  const int first = static_cast<int>(soup.vertices.size());
  for (const Eigen::Vector3d& center : {a, b}) {
    for (int i = 0; i < kCylinderSides; ++i) {
      const double angle = 2.0 * M_PI * i / kCylinderSides;
      soup.vertices.push_back(center + r * (std::cos(angle) * x + std::sin(angle) * y));
    }
  }
  std::vector<int> bottom(kCylinderSides), top(kCylinderSides);
  for (int i = 0; i < kCylinderSides; ++i) {
    const int j = (i + 1) % kCylinderSides;
    bottom[kCylinderSides - 1 - i] = first + i;
    top[i] = first + kCylinderSides + i;
    AddPolygon(soup,
               {first + i, first + j, first + kCylinderSides + j, first + kCylinderSides + i});
  }
  AddPolygon(soup, bottom);
  AddPolygon(soup, top);
}

// Connected triangles of one plane.
std::vector<std::vector<int>> PlaneRegions(const TriangleMesh& mesh) {
  std::vector<int> parent(mesh.triangles.size());
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int t) {
    while (parent[t] != t) t = parent[t] = parent[parent[t]];
    return t;
  };
  for (const MeshEdge& e : MeshEdges(mesh)) {
    if (e.triangle_2 >= 0 && e.dihedral_rad < kCoplanarRad) {
      parent[root(e.triangle_1)] = root(e.triangle_2);
    }
  }
  std::map<int, std::vector<int>> regions;
  for (size_t t = 0; t < parent.size(); ++t) {
    regions[root(static_cast<int>(t))].push_back(static_cast<int>(t));
  }
  std::vector<std::vector<int>> result;
  for (auto& [head, triangles] : regions) result.push_back(std::move(triangles));
  return result;
}

// The region's border when it is a single loop; empty otherwise.
std::vector<int> SingleBorder(const TriangleMesh& mesh, const std::vector<int>& region) {
  std::map<std::pair<int, int>, int> directed;
  for (const int t : region) {
    for (int k = 0; k < 3; ++k) {
      ++directed[{mesh.triangles[t](k), mesh.triangles[t]((k + 1) % 3)}];
    }
  }
  std::map<int, int> next;
  size_t count = 0;
  for (const auto& [edge, uses] : directed) {
    if (directed.count({edge.second, edge.first}) > 0) continue;
    if (uses > 1 || next.count(edge.first) > 0) return {};
    next[edge.first] = edge.second;
    ++count;
  }
  std::vector<int> loop;
  if (next.empty()) return loop;
  const int start = next.begin()->first;
  for (int v = start; loop.size() <= count;) {
    loop.push_back(v);
    const auto it = next.find(v);
    if (it == next.end()) return {};
    v = it->second;
    if (v == start) break;
  }
  return loop.size() == count ? loop : std::vector<int>{};
}

// Of lines, or of corners; corners: how many there are.
absl::Status ReadFaces(Reader& reader,
                       bool from_lines,
                       const std::vector<std::pair<int, int>>& lines,
                       size_t corners,
                       TriangleMesh& soup) {
  HOROPTER_ASSIGN_OR_RETURN(const int faces, reader.Count());
  for (int i = 0; i < faces; ++i) {
    HOROPTER_ASSIGN_OR_RETURN(std::istringstream line, reader.Next());
    int n = 0;
    if (!(line >> n) || n < 3 || n > kMaxFaceCorners) {
      return reader.Error("a face needs at least three corners");
    }
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<int> named,
                              reader.Indices(line, n, from_lines ? lines.size() : corners));
    std::vector<int> polygon = named;
    if (from_lines) {
      std::vector<std::pair<int, int>> sides;
      for (const int l : named) sides.push_back(lines[l]);
      polygon = LoopOf(std::move(sides));
      if (polygon.empty()) return reader.Error("the lines of a face do not close");
    }
    AddPolygon(soup, polygon);
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<TriangleMesh> ReadCao(const std::string& path, double metres_per_unit) {
  std::ifstream file(path);
  if (!file) return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  Reader reader(path, file);
  HOROPTER_ASSIGN_OR_RETURN(std::istringstream header, reader.Next());
  std::string version;
  header >> version;
  if (version != "V1") return reader.Error("does not begin with V1");

  TriangleMesh soup;
  HOROPTER_ASSIGN_OR_RETURN(const int points, reader.Count());
  for (int i = 0; i < points; ++i) {
    HOROPTER_ASSIGN_OR_RETURN(std::istringstream line, reader.Next());
    Eigen::Vector3d p;
    if (!(line >> p.x() >> p.y() >> p.z()) || !p.allFinite()) {
      return reader.Error("not a point of three finite numbers");
    }
    soup.vertices.push_back(metres_per_unit * p);
  }
  const size_t corners = soup.vertices.size();

  std::vector<std::pair<int, int>> lines;
  HOROPTER_ASSIGN_OR_RETURN(const int line_count, reader.Count());
  for (int i = 0; i < line_count; ++i) {
    HOROPTER_ASSIGN_OR_RETURN(std::istringstream line, reader.Next());
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<int> ends, reader.Indices(line, 2, corners));
    lines.emplace_back(ends[0], ends[1]);
  }
  for (const bool from_lines : {true, false})
    HOROPTER_RETURN_IF_ERROR(ReadFaces(reader, from_lines, lines, corners, soup));
  HOROPTER_ASSIGN_OR_RETURN(const int cylinders, reader.Count());
  for (int i = 0; i < cylinders; ++i) {
    HOROPTER_ASSIGN_OR_RETURN(std::istringstream line, reader.Next());
    HOROPTER_ASSIGN_OR_RETURN(const std::vector<int> ends, reader.Indices(line, 2, corners));
    double radius = 0.0;
    if (!(line >> radius) || !(radius > 0.0) || !std::isfinite(radius) ||
        soup.vertices[ends[0]] == soup.vertices[ends[1]]) {
      return reader.Error("a cylinder needs two different points and a radius");
    }
    AddCylinder(soup, soup.vertices[ends[0]], soup.vertices[ends[1]], metres_per_unit * radius);
  }
  if (soup.triangles.empty()) return reader.Error("the model has no faces");
  return soup;
}

absl::Status WriteCao(const std::string& path, const ObjectModel& model) {
  std::ofstream out(path);
  out << "V1\n# 3D points, metres\n" << model.mesh.vertices.size() << "\n";
  for (const Eigen::Vector3d& v : model.mesh.vertices) {
    out << absl::StrFormat("%.17g %.17g %.17g\n", v.x(), v.y(), v.z());
  }
  std::vector<std::vector<int>> faces;
  for (const std::vector<int>& region : PlaneRegions(model.mesh)) {
    const std::vector<int> border = SingleBorder(model.mesh, region);
    if (!border.empty()) {
      faces.push_back(border);
      continue;
    }
    for (const int t : region) {
      const Eigen::Vector3i& triangle = model.mesh.triangles[t];
      faces.push_back({triangle(0), triangle(1), triangle(2)});
    }
  }
  out << "# 3D lines\n0\n# Faces from 3D lines\n0\n# Faces from 3D points\n"
      << faces.size() << "\n";
  for (const std::vector<int>& face : faces) {
    out << face.size();
    for (const int v : face) out << ' ' << v;
    out << '\n';
  }
  out << "# 3D cylinders\n0\n# 3D circles\n0\n";
  out.close();
  if (!out) return absl::FailedPreconditionError(absl::StrCat(path, ": cannot be written"));
  return absl::OkStatus();
}

}  // namespace horopter
