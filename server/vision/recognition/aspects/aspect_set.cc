#include "server/vision/recognition/aspects/aspect_set.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "server/base/stop_scope.h"

namespace horopter {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3d;
using Eigen::Vector3f;

// Coordinates are within half a diameter of the centre of the box, and a little for rounding.
constexpr double kPlaceRange = 1.02;
constexpr int kPlaceSteps = 2047;
// Directions drawn in turn and kept if far enough from those before fill the sphere with as many as
// asked for at this share of their mean distance.
constexpr double kSpacing = 0.9;
constexpr int kCandidates = 4;
constexpr int kOctahedronX = 127, kOctahedronY = 63;  // steps of 7 and 6 bits

// Unit sphere on the square [-1, 1]^2: Meyer et al. 2010, octahedral normal vectors.
Vector2f ToOctahedron(const Vector3f& n) {
  const float sum = std::abs(n.x()) + std::abs(n.y()) + std::abs(n.z());
  Vector2f p = n.head<2>() / std::max(sum, 1e-12f);
  if (n.z() < 0.0f) {
    p = {(1.0f - std::abs(p.y())) * (p.x() < 0.0f ? -1.0f : 1.0f),
         (1.0f - std::abs(p.x())) * (p.y() < 0.0f ? -1.0f : 1.0f)};
  }
  return p;
}

Vector3f FromOctahedron(const Vector2f& p) {
  Vector3f n(p.x(), p.y(), 1.0f - std::abs(p.x()) - std::abs(p.y()));
  if (n.z() < 0.0f) {
    n.head<2>() = Vector2f((1.0f - std::abs(p.y())) * (p.x() < 0.0f ? -1.0f : 1.0f),
                           (1.0f - std::abs(p.x())) * (p.y() < 0.0f ? -1.0f : 1.0f));
  }
  return n.normalized();
}

std::uint64_t Steps(double share, int steps) {
  return static_cast<std::uint64_t>(std::clamp(std::lround(share * steps), 0l, long{steps}));
}

PackedAspectPoint Pack(const AspectSet& set, const VisibleEdgePoint& p) {
  const Vector3d place = (p.point - set.center).cast<double>() / (kPlaceRange * set.diameter_m);
  const Vector2f direction = ToOctahedron(p.direction);
  std::uint64_t bits = 0;
  for (int k = 0; k < 3; ++k) bits |= Steps(place[k] + 0.5, kPlaceSteps) << (11 * k);
  bits |= Steps(0.5 * direction.x() + 0.5, kOctahedronX) << 33;
  bits |= Steps(0.5 * direction.y() + 0.5, kOctahedronY) << 40;
  bits |= static_cast<std::uint64_t>(p.kind) << 46;
  return {static_cast<std::uint16_t>(bits & 0xffff),
          static_cast<std::uint16_t>(bits >> 16 & 0xffff),
          static_cast<std::uint16_t>(bits >> 32)};
}

AspectPoint Unpack(const AspectSet& set, const PackedAspectPoint& packed) {
  const std::uint64_t bits = packed[0] | static_cast<std::uint64_t>(packed[1]) << 16 |
                             static_cast<std::uint64_t>(packed[2]) << 32;
  AspectPoint p;
  for (int k = 0; k < 3; ++k) {
    const double share = static_cast<double>(bits >> (11 * k) & 2047) / kPlaceSteps - 0.5;
    p.point[k] = set.center[k] + static_cast<float>(share * kPlaceRange * set.diameter_m);
  }
  p.direction = FromOctahedron({2.0f * static_cast<float>(bits >> 33 & 127) / kOctahedronX - 1.0f,
                                2.0f * static_cast<float>(bits >> 40 & 63) / kOctahedronY - 1.0f});
  p.kind = static_cast<VisibleEdgeKind>(bits >> 46 & 3);
  return p;
}

// Looks along -direction; the image's x axis is perpendicular to the object's axis that the
// direction is farthest from.
Eigen::Matrix3d RotationFrom(const Vector3d& direction) {
  const Vector3d z = -direction;
  int axis = 0;
  z.cwiseAbs().minCoeff(&axis);
  const Vector3d x = Vector3d::Unit(axis).cross(z).normalized();
  Eigen::Matrix3d R;
  R.row(0) = x;
  R.row(1) = z.cross(x);
  R.row(2) = z;
  return R;
}

std::vector<Vector3d> SphereDirections(int count) {
  const double golden = std::numbers::pi * (3.0 - std::sqrt(5.0));
  std::vector<Vector3d> out;
  for (int i = 0; i < count; ++i) {
    const double z = 1.0 - (2.0 * i + 1.0) / count;
    const double r = std::sqrt(1.0 - z * z);
    out.emplace_back(r * std::cos(golden * i), r * std::sin(golden * i), z);
  }
  return out;
}

// Evenly over the sphere (Fibonacci); with symmetries one of every set that they make equal, as far
// apart as `count` directions over the sphere are: of a body of revolution a meridian.
std::vector<Vector3d> Directions(int count, std::span<const Rigid3> symmetries) {
  if (symmetries.empty()) return SphereDirections(count);
  const double spacing = kSpacing * std::sqrt(4.0 * std::numbers::pi / count);
  const double near = std::cos(spacing);
  std::vector<Vector3d> kept;
  for (const Vector3d& d : SphereDirections(kCandidates * count)) {
    LeaveIfStopped();
    const auto is_near = [&](const Vector3d& equal) {
      return std::any_of(
          kept.begin(), kept.end(), [&](const Vector3d& k) { return k.dot(equal) > near; });
    };
    if (is_near(d) || std::any_of(symmetries.begin(), symmetries.end(), [&](const Rigid3& s) {
          return is_near(s.R * d);
        })) {
      continue;
    }
    kept.push_back(d);
  }
  return kept;
}

// Farthest-point order of the first ones (Gonzalez 1985), then evenly along the chains.
std::vector<int> PickPoints(const std::vector<VisibleEdgePoint>& points,
                            const AspectOptions& options) {
  const int count = static_cast<int>(points.size());
  std::vector<int> picked;
  if (count == 0) return picked;
  std::vector<float> distance(points.size(), std::numeric_limits<float>::max());
  std::vector<char> taken(points.size(), 0);
  // From the point farthest from the mean, which is an end of the view.
  Vector2f mean = Vector2f::Zero();
  for (const VisibleEdgePoint& p : points) mean += p.image / static_cast<float>(count);
  int next = 0;
  for (int i = 1; i < count; ++i) {
    if ((points[i].image - mean).squaredNorm() > (points[next].image - mean).squaredNorm()) {
      next = i;
    }
  }
  const int spread = std::min({options.spread_points, options.max_points, count});
  while (static_cast<int>(picked.size()) < spread) {
    picked.push_back(next);
    taken[next] = 1;
    const Vector2f at = points[next].image;
    distance[next] = 0.0f;
    for (int i = 0; i < count; ++i) {
      distance[i] = std::min(distance[i], (points[i].image - at).squaredNorm());
      if (distance[i] > distance[next]) next = i;
    }
    if (taken[next]) break;
  }
  std::vector<int> rest;
  for (int i = 0; i < count; ++i) {
    if (!taken[i]) rest.push_back(i);
  }
  const int wanted = std::min<int>(options.max_points - static_cast<int>(picked.size()),
                                   static_cast<int>(rest.size()));
  for (int k = 0; k < wanted; ++k) {
    picked.push_back(rest[(2 * static_cast<std::size_t>(k) + 1) * rest.size() / (2 * wanted)]);
  }
  return picked;
}

VisibleEdgeOptions EdgeOptions(const AspectSet& set) {
  VisibleEdgeOptions options;
  options.render_px = set.render_px;
  return options;
}

}  // namespace

std::vector<AspectPoint> AspectPoints(const AspectSet& set, int aspect, std::size_t most) {
  const Aspect& a = set.aspects[aspect];
  const std::size_t count = std::min<std::size_t>(most, a.point_count);
  std::vector<AspectPoint> out;
  out.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    out.push_back(Unpack(set, set.points[a.first_point + i]));
  }
  return out;
}

Rigid3 AspectPose(const AspectSet& set, int aspect) {
  const Eigen::Matrix3d R = set.aspects[aspect].camera_from_object.cast<double>();
  return {R, Vector3d(0, 0, set.distance_m) - R * set.center.cast<double>()};
}

PinholeCamera AspectCamera(const AspectSet& set) {
  const int size = 2 * static_cast<int>(std::ceil(set.render_px)) + 1;
  return CenteredCamera(size, size, set.render_px * set.distance_m / set.diameter_m);
}

VisibleEdges AspectEdges(const RenderMesh& mesh, const AspectSet& set, int aspect) {
  return FindVisibleEdges(mesh, AspectCamera(set), AspectPose(set, aspect), EdgeOptions(set));
}

AspectSet MakeAspects(const RenderMesh& mesh,
                      std::span<const Rigid3> symmetries,
                      const AspectOptions& options,
                      const AspectVisitor& visit) {
  AspectSet set;
  set.diameter_m = mesh.diameter_m;
  set.distance_m = options.distance_diameters * mesh.diameter_m;
  set.render_px = options.render_px;
  set.center = mesh.center;
  for (const Vector3d& direction : Directions(options.directions, symmetries)) {
    LeaveIfStopped();
    Aspect aspect;
    aspect.camera_from_object = RotationFrom(direction).cast<float>();
    set.aspects.push_back(aspect);
    const int index = static_cast<int>(set.aspects.size()) - 1;
    const VisibleEdges edges = AspectEdges(mesh, set, index);
    set.aspects[index].first_point = static_cast<std::uint32_t>(set.points.size());
    for (const int i : PickPoints(edges.points, options)) {
      set.points.push_back(Pack(set, edges.points[i]));
    }
    set.aspects[index].point_count =
        static_cast<std::uint32_t>(set.points.size()) - set.aspects[index].first_point;
    if (visit) visit(index, edges);
  }
  return set;
}

}  // namespace horopter
