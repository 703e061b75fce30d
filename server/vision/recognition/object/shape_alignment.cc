#include "server/vision/recognition/object/shape_alignment.h"

#include <Eigen/Dense>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>

#include "server/vision/geometry/mesh_symmetry.h"

namespace horopter {
namespace {

using Points = Eigen::Matrix<float, 3, Eigen::Dynamic>;

constexpr int kPoints = 2400;       // of a surface, that are looked up
constexpr int kAsked = 240;         // of them whose distances are taken
constexpr int kRefined = 8;         // turns that are refined
constexpr int kRounds = 8;          // of closest points
constexpr double kOther = 0.26;     // radians between turns that are different ones
constexpr int kMirrored = 4;        // alignments of a mirror image that are tried
constexpr double kNearBest = 0.01;  // diameters by which they may be worse than the best
// Diameters: farthest place of the surface of what is its own mirror image, aligned by points.
constexpr double kAchiral = 0.012;
constexpr double kTooFar = 0.15;  // mean distance, diameters, of what is no alignment

// Points spread evenly over the surface, in an order of which each prefix is spread as well.
Points SurfacePoints(const RenderMesh& mesh, int count) {
  std::vector<double> areas;
  double total = 0.0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Eigen::Vector3f u = mesh.vertices[t[1]] - mesh.vertices[t[0]];
    const Eigen::Vector3f v = mesh.vertices[t[2]] - mesh.vertices[t[0]];
    areas.push_back(total += 0.5 * u.cross(v).norm());
  }
  Points out(3, count);
  // Sequence of Weyl in three dimensions by powers of the generalised golden ratio.
  constexpr double kG = 1.22074408460575947536;
  for (int i = 0; i < count; ++i) {
    const auto part = [&](double power) {
      const double x = 0.5 + (i + 1) / power;
      return x - std::floor(x);
    };
    const auto at = std::upper_bound(areas.begin(), areas.end(), part(kG) * total);
    const std::size_t k = std::min<std::size_t>(at - areas.begin(), areas.size() - 1);
    float s = static_cast<float>(part(kG * kG)), t = static_cast<float>(part(kG * kG * kG));
    if (s + t > 1.0f) s = 1.0f - s, t = 1.0f - t;
    const Eigen::Vector3f &a = mesh.vertices[mesh.triangles[k][0]],
                          &b = mesh.vertices[mesh.triangles[k][1]],
                          &c = mesh.vertices[mesh.triangles[k][2]];
    out.col(i) = a + s * (b - a) + t * (c - a);
  }
  return out;
}

struct Shape {
  Points points;
  Eigen::Vector3d middle;
  Eigen::Matrix3d axes;     // principal, columns, right-handed, largest extent last
  Eigen::Vector3d extents;  // deviations along them
};

Shape ShapeOf(const RenderMesh& mesh) {
  Shape out;
  out.points = SurfacePoints(mesh, kPoints);
  out.middle = out.points.cast<double>().rowwise().mean();
  const Eigen::Matrix3Xd d = out.points.cast<double>().colwise() - out.middle;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solved(d * d.transpose() / kPoints);
  out.axes = solved.eigenvectors();
  if (out.axes.determinant() < 0.0) out.axes.col(0) = -out.axes.col(0);
  out.extents = solved.eigenvalues().cwiseMax(0.0).cwiseSqrt();
  return out;
}

// The 24 turns that take a cube to itself.
std::vector<Eigen::Matrix3d> CubeTurns() {
  std::vector<Eigen::Matrix3d> out;
  std::array<int, 3> order = {0, 1, 2};
  do {
    for (int signs = 0; signs < 8; ++signs) {
      Eigen::Matrix3d turn = Eigen::Matrix3d::Zero();
      for (int k = 0; k < 3; ++k) turn(k, order[k]) = signs >> k & 1 ? -1.0 : 1.0;
      if (turn.determinant() > 0.0) out.push_back(turn);
    }
  } while (std::next_permutation(order.begin(), order.end()));
  return out;
}

struct Nearest {
  int index = 0;
  float distance = 0.0f;
};

Nearest NearestOf(const Points& points, const Eigen::Vector3f& x) {
  Nearest out;
  out.distance = std::sqrt((points.colwise() - x).colwise().squaredNorm().minCoeff(&out.index));
  return out;
}

double MeanDistance(const Shape& a, const Shape& b, const Rigid3& a_from_b, int asked) {
  const Rigid3 b_from_a = a_from_b.Inverse();
  double sum = 0.0;
  for (int i = 0; i < asked; ++i) {
    const Eigen::Vector3d in_a = a_from_b * Eigen::Vector3d(b.points.col(i).cast<double>());
    const Eigen::Vector3d in_b = b_from_a * Eigen::Vector3d(a.points.col(i).cast<double>());
    sum += NearestOf(a.points, in_a.cast<float>()).distance +
           NearestOf(b.points, in_b.cast<float>()).distance;
  }
  return sum / (2.0 * asked);
}

// The motion that takes b's points nearest to their partners on a (Arun et al. 1987).
Rigid3 Refined(const Shape& a, const Shape& b, Rigid3 a_from_b) {
  for (int round = 0; round < kRounds; ++round) {
    Eigen::Matrix3Xd from(3, kAsked), to(3, kAsked);
    for (int i = 0; i < kAsked; ++i) {
      from.col(i) = b.points.col(i).cast<double>();
      const Eigen::Vector3d at = a_from_b * Eigen::Vector3d(from.col(i));
      to.col(i) = a.points.col(NearestOf(a.points, at.cast<float>()).index).cast<double>();
    }
    const Eigen::Vector3d from_mean = from.rowwise().mean(), to_mean = to.rowwise().mean();
    const Eigen::Matrix3d cross =
        (to.colwise() - to_mean) * (from.colwise() - from_mean).transpose();
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(cross, Eigen::ComputeFullU | Eigen::ComputeFullV);
    const double sign = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1.0 : 1.0;
    a_from_b.R =
        svd.matrixU() * Eigen::Vector3d(1, 1, sign).asDiagonal() * svd.matrixV().transpose();
    a_from_b.t = to_mean - a_from_b.R * from_mean;
  }
  return a_from_b;
}

double AngleBetween(const Rigid3& a, const Rigid3& b) {
  return std::acos(std::clamp(0.5 * ((a.R.transpose() * b.R).trace() - 1.0), -1.0, 1.0));
}

void SortByDistance(std::vector<ShapeAlignment>* list) {
  std::stable_sort(list->begin(), list->end(), [](const auto& x, const auto& y) {
    return x.distance < y.distance;
  });
}

}  // namespace

std::vector<ShapeAlignment> AlignShapes(const RenderMesh& a,
                                        const RenderMesh& b,
                                        int most,
                                        double max_extent_ratio) {
  if (a.triangles.empty() || b.triangles.empty() || !(a.diameter_m > 0.0)) return {};
  const Shape of_a = ShapeOf(a), of_b = ShapeOf(b);
  const double least = 1e-3 * a.diameter_m;  // of sheets, whose thickness tells nothing
  for (int k = 0; k < 3; ++k) {
    const double ratio = std::max(of_a.extents[k], least) / std::max(of_b.extents[k], least);
    if (std::max(ratio, 1.0 / ratio) > max_extent_ratio) return {};
  }
  std::vector<ShapeAlignment> tried;
  for (const Eigen::Matrix3d& turn : CubeTurns()) {
    for (const Eigen::Matrix3d& R :
         {turn, Eigen::Matrix3d(of_a.axes * turn * of_b.axes.transpose())}) {
      const Rigid3 a_from_b{R, of_a.middle - R * of_b.middle};
      tried.push_back({a_from_b, MeanDistance(of_a, of_b, a_from_b, kAsked / 4)});
    }
  }
  SortByDistance(&tried);
  tried.resize(std::min<std::size_t>(tried.size(), kRefined));
  for (ShapeAlignment& t : tried) {
    t.a_from_b = Refined(of_a, of_b, t.a_from_b);
    t.distance = MeanDistance(of_a, of_b, t.a_from_b, kAsked) / a.diameter_m;
  }
  SortByDistance(&tried);
  std::vector<ShapeAlignment> out;
  for (const ShapeAlignment& t : tried) {
    if (static_cast<int>(out.size()) >= most || t.distance > kTooFar) break;
    if (std::none_of(out.begin(), out.end(), [&](const ShapeAlignment& other) {
          return AngleBetween(other.a_from_b, t.a_from_b) < kOther;
        }))
      out.push_back(t);
  }
  return out;
}

RenderMesh MirrorImage(const RenderMesh& mesh) {
  RenderMesh out;
  out.origin = mesh.origin;
  out.step_m = mesh.step_m;
  out.diameter_m = mesh.diameter_m;
  for (const Eigen::Vector3f& v : mesh.vertices)
    out.vertices.emplace_back(2.0f * mesh.center.x() - v.x(), v.y(), v.z());
  for (const Eigen::Vector3i& t : mesh.triangles) out.triangles.emplace_back(t[0], t[2], t[1]);
  ConnectRenderMesh(RenderMeshOptions{}.smooth_angle_rad, &out);
  return out;
}

MirrorTwin MakeMirrorTwin(const TriangleMesh& of_model, double diameter_m, const RenderMesh& mesh) {
  MirrorTwin out;
  out.mesh = MirrorImage(mesh);
  out.alignments = AlignShapes(mesh, out.mesh, kMirrored);
  std::vector<Rigid3> motions;  // of the part onto itself, with a reflection
  for (const ShapeAlignment& a : out.alignments) {
    const Eigen::Matrix3d R = a.a_from_b.R * Eigen::Vector3d(-1, 1, 1).asDiagonal();
    motions.push_back({R, a.a_from_b.t + a.a_from_b.R.col(0) * 2.0 * mesh.center.x()});
  }
  const std::vector<SurfaceMismatch> found = MeasureMismatches(of_model, diameter_m, motions);
  out.chiral = std::none_of(found.begin(), found.end(), [&](const SurfaceMismatch& m) {
    return m.largest_m < kAchiral * diameter_m;
  });
  if (!out.chiral || out.alignments.empty()) return {};
  const double best = out.alignments.front().distance;
  std::erase_if(out.alignments,
                [&](const ShapeAlignment& a) { return a.distance > best + kNearBest; });
  return out;
}

}  // namespace horopter
