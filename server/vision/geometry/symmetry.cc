#include "server/vision/geometry/symmetry.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <initializer_list>
#include <optional>
#include <utility>

#include "server/vision/geometry/box_tree.h"

namespace horopter {
namespace {

// A point any symmetry must map onto a point of the same kind.
struct Anchor {
  Eigen::Vector3d p = Eigen::Vector3d::Zero();  // relative to the centroid
  double radius = 0.0;                          // of a closed circle about p, 0 for a vertex
};

// One chord of an edge.
struct Chord {
  Eigen::Vector3d a = Eigen::Vector3d::Zero(), b = Eigen::Vector3d::Zero();
};

struct Part {
  const ObjectModel* model = nullptr;
  Eigen::Vector3d centroid = Eigen::Vector3d::Zero();
  std::vector<Anchor> anchors;
  std::vector<std::vector<int>>
      orbits;  // anchors that may be mapped onto each other, smallest set first
  std::vector<Eigen::Vector3d> edge_samples;  // relative to the centroid, as all below
  std::vector<Eigen::Vector3d> mesh_samples;
  double tolerance_m = 0.0;
  // A candidate asks for what lies near thousands of points, and a part with a pattern of holes has
  // hundreds of candidates: of anchors, chords and triangles only those about a point are compared.
  std::vector<Chord> chords;  // of all edges; not relative to the centroid, nor is the mesh
  BoxTree near_anchors{{}}, near_chords{{}}, near_triangles{{}};
};

// Area centroid of the mesh: every rotation of the part fixes it, closed mesh or not.
Eigen::Vector3d Centroid(const TriangleMesh& mesh) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double area = 0.0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Eigen::Vector3d &a = mesh.vertices[t[0]], &b = mesh.vertices[t[1]],
                          &c = mesh.vertices[t[2]];
    const double w = (b - a).cross(c - a).norm();
    sum += w * (a + b + c) / 3.0;
    area += w;
  }
  return area > 0.0 ? Eigen::Vector3d(sum / area) : Eigen::Vector3d::Zero();
}

double DistanceToSegment(const Eigen::Vector3d& p,
                         const Eigen::Vector3d& a,
                         const Eigen::Vector3d& b) {
  const Eigen::Vector3d d = b - a;
  const double n = d.squaredNorm();
  const double s = n > 0.0 ? std::clamp((p - a).dot(d) / n, 0.0, 1.0) : 0.0;
  return (p - a - s * d).norm();
}

double DistanceToTriangle(const Eigen::Vector3d& p,
                          const Eigen::Vector3d& a,
                          const Eigen::Vector3d& b,
                          const Eigen::Vector3d& c) {
  const Eigen::Vector3d n = (b - a).cross(c - a);
  const bool inside = n.dot((b - a).cross(p - a)) >= 0.0 && n.dot((c - b).cross(p - b)) >= 0.0 &&
                      n.dot((a - c).cross(p - c)) >= 0.0;
  if (inside && n.norm() > 0.0) return std::abs(n.normalized().dot(p - a));
  return std::min(
      {DistanceToSegment(p, a, b), DistanceToSegment(p, b, c), DistanceToSegment(p, c, a)});
}

bool NearEdges(const Part& part, const Eigen::Vector3d& p) {
  const double limit = 2.0 * part.tolerance_m;
  const Eigen::Vector3d q = p + part.centroid;
  return part.near_chords.AnyAt(
      q, [&](int i) { return DistanceToSegment(q, part.chords[i].a, part.chords[i].b) <= limit; });
}

bool NearMesh(const Part& part, const Eigen::Vector3d& p) {
  const double limit = 2.0 * part.tolerance_m;
  const Eigen::Vector3d q = p + part.centroid;
  const TriangleMesh& mesh = part.model->mesh;
  return part.near_triangles.AnyAt(q, [&](int i) {
    const Eigen::Vector3i& t = mesh.triangles[i];
    const Eigen::Vector3d &a = mesh.vertices[t[0]], &b = mesh.vertices[t[1]],
                          &c = mesh.vertices[t[2]];
    for (int k = 0; k < 3; ++k) {
      if (q[k] < std::min({a[k], b[k], c[k]}) - limit ||
          q[k] > std::max({a[k], b[k], c[k]}) + limit) {
        return false;
      }
    }
    return DistanceToTriangle(q, a, b, c) <= limit;
  });
}

bool MapsAnchors(const Part& part, const Eigen::Matrix3d& R) {
  return std::all_of(part.anchors.begin(), part.anchors.end(), [&](const Anchor& a) {
    const Eigen::Vector3d moved = R * a.p;
    return part.near_anchors.AnyAt(moved, [&](int i) {
      const Anchor& b = part.anchors[i];
      return std::abs(a.radius - b.radius) <= part.tolerance_m &&
             (moved - b.p).norm() <= part.tolerance_m;
    });
  });
}

// But for single ones: where smooth surfaces meet, an edge may be told on one side only.
bool KeepsEdges(const Part& part, const Eigen::Matrix3d& R) {
  constexpr double kMostLost = 0.005;  // share of the edge samples that may miss the edges
  const auto lost = std::count_if(part.edge_samples.begin(),
                                  part.edge_samples.end(),
                                  [&](const auto& p) { return !NearEdges(part, R * p); });
  return static_cast<double>(lost) <= kMostLost * static_cast<double>(part.edge_samples.size());
}

bool Verify(const Part& part, const Eigen::Matrix3d& R) {
  return MapsAnchors(part, R) &&
         std::all_of(part.edge_samples.begin(),
                     part.edge_samples.end(),
                     [&](const auto& p) { return NearEdges(part, R * p); }) &&
         std::all_of(part.mesh_samples.begin(), part.mesh_samples.end(), [&](const auto& p) {
           return NearMesh(part, R * p);
         });
}

void SampleSurface(Part& part) {
  constexpr size_t kMaxEdgeSamples = 1200, kMaxMeshSamples = 600;  // that are compared; for time
  const auto thin = [](std::vector<Eigen::Vector3d>& points, size_t most) {
    if (points.size() <= most) return;
    std::vector<Eigen::Vector3d> kept;
    for (size_t i = 0; i < most; ++i) kept.push_back(points[i * points.size() / most]);
    points = std::move(kept);
  };
  for (const ModelEdge& e : part.model->edges) {
    for (size_t i = 1; i < e.polyline.size(); ++i) {
      const Eigen::Vector3d &a = e.polyline[i - 1], &b = e.polyline[i];
      const int n = e.polyline.size() == 2 ? 10 : 2;  // points of lines, of chords
      for (int k = 1; k <= n; ++k) {
        part.edge_samples.push_back(a + (b - a) * (static_cast<double>(k) / n) - part.centroid);
      }
    }
  }
  const TriangleMesh& mesh = part.model->mesh;
  for (const Eigen::Vector3d& v : mesh.vertices) part.mesh_samples.push_back(v - part.centroid);
  for (const Eigen::Vector3i& t : mesh.triangles) {
    part.mesh_samples.push_back(
        (mesh.vertices[t[0]] + mesh.vertices[t[1]] + mesh.vertices[t[2]]) / 3.0 - part.centroid);
  }
  thin(part.edge_samples, kMaxEdgeSamples);
  thin(part.mesh_samples, kMaxMeshSamples);
}

void CollectAnchors(Part& part) {
  for (const Eigen::Vector3d& v : part.model->vertices) {
    part.anchors.push_back({v - part.centroid, 0.0});
  }
  for (const ModelEdge& e : part.model->edges) {
    if (e.kind != CurveKind::kCircle || e.start_vertex >= 0 || e.polyline.size() < 4) continue;
    Eigen::Vector3d center = Eigen::Vector3d::Zero();  // evenly sampled, so the mean is the centre
    for (size_t i = 1; i < e.polyline.size(); ++i) {
      center += e.polyline[i] / static_cast<double>(e.polyline.size() - 1);
    }
    part.anchors.push_back({center - part.centroid, (e.polyline[0] - center).norm()});
  }
  std::vector<bool> used(part.anchors.size(), false);
  for (size_t i = 0; i < part.anchors.size(); ++i) {
    if (used[i]) continue;
    std::vector<int> orbit;
    for (size_t j = i; j < part.anchors.size(); ++j) {
      if (used[j] || std::abs(part.anchors[i].radius - part.anchors[j].radius) > part.tolerance_m ||
          std::abs(part.anchors[i].p.norm() - part.anchors[j].p.norm()) > part.tolerance_m) {
        continue;
      }
      used[j] = true;
      orbit.push_back(static_cast<int>(j));
    }
    part.orbits.push_back(std::move(orbit));
  }
  std::stable_sort(part.orbits.begin(), part.orbits.end(), [](const auto& a, const auto& b) {
    return a.size() < b.size();
  });
}

// Boxes with room for `limit` around the points and for rounding: they may hold more than is near,
// never less.
Eigen::AlignedBox3d Around(const std::initializer_list<Eigen::Vector3d>& points, double limit) {
  constexpr double kRounding = 1e-9;
  Eigen::AlignedBox3d box;
  double size = 0.0;
  for (const Eigen::Vector3d& p : points) {
    box.extend(p);
    size = std::max(size, p.cwiseAbs().maxCoeff());
  }
  const Eigen::Vector3d margin = Eigen::Vector3d::Constant(limit + kRounding * (limit + size));
  return {box.min() - margin, box.max() + margin};
}

void PlaceInSpace(Part& part) {
  std::vector<Eigen::AlignedBox3d> boxes;
  for (const Anchor& a : part.anchors) boxes.push_back(Around({a.p}, part.tolerance_m));
  part.near_anchors = BoxTree(std::move(boxes));
  boxes.clear();
  for (const ModelEdge& e : part.model->edges) {
    for (size_t i = 1; i < e.polyline.size(); ++i) {
      part.chords.push_back({e.polyline[i - 1], e.polyline[i]});
      boxes.push_back(Around({e.polyline[i - 1], e.polyline[i]}, 2.0 * part.tolerance_m));
    }
  }
  part.near_chords = BoxTree(std::move(boxes));
  boxes.clear();
  const TriangleMesh& mesh = part.model->mesh;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    boxes.push_back(Around({mesh.vertices[t[0]], mesh.vertices[t[1]], mesh.vertices[t[2]]},
                           2.0 * part.tolerance_m));
  }
  part.near_triangles = BoxTree(std::move(boxes));
}

// Right-handed frame from two directions.
Eigen::Matrix3d Frame(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  Eigen::Matrix3d f;
  f.col(0) = a.normalized();
  f.col(2) = a.cross(b).normalized();
  f.col(1) = f.col(2).cross(f.col(0));
  return f;
}

bool IsNew(const std::vector<Eigen::Matrix3d>& known, const Eigen::Matrix3d& R) {
  constexpr double kSameRotation =
      0.02;  // Frobenius; two elements of a group of order 60 differ by far more
  return std::none_of(known.begin(), known.end(), [&](const Eigen::Matrix3d& k) {
    return (k - R).norm() < kSameRotation;
  });
}

// Two anchors that are well away from the centroid and from one line with it: the pair that leaves
// fewest candidates.
std::optional<std::pair<int, int>> BasePair(const Part& part, double diameter_m) {
  const double min_distance = 0.02 * diameter_m;
  constexpr double kMinSine = 0.05;  // of two axes' angle; nearer ones do not tell the turn
  for (size_t i = 0; i < part.orbits.size(); ++i) {
    for (size_t j = 0; j <= i; ++j) {
      for (const int a : part.orbits[j]) {
        for (const int b : part.orbits[i]) {
          const Eigen::Vector3d &p = part.anchors[a].p, &q = part.anchors[b].p;
          if (p.norm() < min_distance || q.norm() < min_distance) continue;
          if (p.cross(q).norm() > kMinSine * p.norm() * q.norm()) return std::pair{a, b};
        }
      }
    }
  }
  return std::nullopt;
}

const std::vector<int>& OrbitOf(const Part& part, int anchor) {
  return *std::find_if(part.orbits.begin(), part.orbits.end(), [&](const auto& orbit) {
    return std::find(orbit.begin(), orbit.end(), anchor) != orbit.end();
  });
}

std::vector<Eigen::Matrix3d> RotationsFromPairs(const Part& part, int a, int b, int max_order) {
  std::vector<Eigen::Matrix3d> found{Eigen::Matrix3d::Identity()};
  const Eigen::Vector3d &p = part.anchors[a].p, &q = part.anchors[b].p;
  const Eigen::Matrix3d base = Frame(p, q);
  for (const int c : OrbitOf(part, a)) {
    for (const int d : OrbitOf(part, b)) {
      const Eigen::Vector3d &r = part.anchors[c].p, &s = part.anchors[d].p;
      if (std::abs((p - q).norm() - (r - s).norm()) > 2.0 * part.tolerance_m) continue;
      if (r.cross(s).norm() <= 0.0) continue;
      const Eigen::Matrix3d R = Frame(r, s) * base.transpose();
      if (static_cast<int>(found.size()) < max_order && IsNew(found, R) && Verify(part, R)) {
        found.push_back(R);
      }
    }
  }
  return found;
}

// Rotations of a part whose anchors all lie on one axis through the centroid, or that has none: the
// axis is an eigenvector of the second moment of the mesh samples.
std::vector<Eigen::Matrix3d> RotationsAboutAxis(const Part& part, int steps) {
  Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
  for (const Anchor& a : part.anchors) moment += a.p * a.p.transpose();
  if (moment.norm() < part.tolerance_m * part.tolerance_m) {
    for (const Eigen::Vector3d& p : part.edge_samples) moment += p * p.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(moment);
  for (int k = 2; k >= 0; --k) {
    const Eigen::Vector3d axis = solver.eigenvectors().col(k);
    const auto about = [&](double angle) {
      return Eigen::AngleAxisd(angle, axis).toRotationMatrix();
    };
    // One radian is no rational part of a turn: only a surface of revolution passes.
    if (!Verify(part, about(1.0)) || !Verify(part, about(2.3))) continue;
    std::vector<Eigen::Matrix3d> found;
    for (int i = 0; i < steps; ++i) found.push_back(about(2.0 * M_PI * i / steps));
    const Eigen::Matrix3d flip = Eigen::AngleAxisd(M_PI, axis.unitOrthogonal()).toRotationMatrix();
    if (Verify(part, flip)) {
      for (int i = 0; i < steps; ++i) found.push_back(found[i] * flip);
    }
    return found;
  }
  return {Eigen::Matrix3d::Identity()};
}

}  // namespace

MeshSymmetryOptions OfSurface(const SymmetryOptions& options) {
  MeshSymmetryOptions out;
  out.tolerance = 2.0 * options.tolerance;
  return out;
}

std::vector<Rigid3> DeriveSymmetries(const ObjectModel& model, const SymmetryOptions& options) {
  return DeriveSymmetries(
      model, options, FindMeshSymmetries(model.mesh, model.diameter_m, OfSurface(options)));
}

std::vector<Rigid3> DeriveSymmetries(const ObjectModel& model,
                                     const SymmetryOptions& options,
                                     const MeshSymmetries& of_surface) {
  Part part;
  part.model = &model;
  part.tolerance_m = options.tolerance * model.diameter_m;
  if (part.tolerance_m <= 0.0 || model.mesh.triangles.empty()) return {};
  part.centroid = Centroid(model.mesh);
  CollectAnchors(part);
  SampleSurface(part);
  PlaceInSpace(part);
  const auto base = BasePair(part, model.diameter_m);
  const std::vector<Eigen::Matrix3d> rotations =
      base ? RotationsFromPairs(part, base->first, base->second, options.max_order)
           : RotationsAboutAxis(part, options.revolution_steps);
  std::vector<Rigid3> symmetries;
  for (const Eigen::Matrix3d& R : rotations) {
    if ((R - Eigen::Matrix3d::Identity()).norm() < 1e-6) continue;
    symmetries.push_back({R, part.centroid - R * part.centroid});
  }
  // Where edges do not match one by one (a seam, a rim cut elsewhere) the surface still may.
  std::vector<Rigid3> own = SymmetryGroup(of_surface, options.revolution_steps);
  std::erase_if(own, [&](const Rigid3& s) { return !KeepsEdges(part, s.R); });
  if (of_surface.sphere) return own;
  return own.size() > symmetries.size() ? own : symmetries;
}

SymmetryDifference CompareSymmetries(const std::vector<Rigid3>& declared,
                                     const std::vector<Rigid3>& derived,
                                     const ObjectModel& model,
                                     double tolerance) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& v : model.mesh.vertices) box.extend(v);
  std::array<Eigen::Vector3d, 8> corners;
  for (int k = 0; k < 8; ++k) {
    corners[k] = box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(k));
  }
  const auto is_in = [&](const std::vector<Rigid3>& list, const Rigid3& a) {
    return std::any_of(list.begin(), list.end(), [&](const Rigid3& b) {
      return std::all_of(corners.begin(), corners.end(), [&](const Eigen::Vector3d& c) {
        return (a * c - b * c).norm() <= tolerance * model.diameter_m;
      });
    });
  };
  SymmetryDifference difference;
  for (const Rigid3& s : declared) difference.only_declared += !is_in(derived, s);
  for (const Rigid3& s : derived) difference.only_derived += !is_in(declared, s);
  return difference;
}

}  // namespace horopter
