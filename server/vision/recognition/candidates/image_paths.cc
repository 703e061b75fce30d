#include "server/vision/recognition/candidates/image_paths.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

constexpr int kPerspectiveIterations = 4;  // of a fixed point
// Ends that are no junction make a path less likely to end at a model vertex.
constexpr double kFreeEndFactor = 0.55;

// A corner of two edges on the supporting plane is texture or shadow more often than the foot of a
// part.
constexpr double kOnPlaneFactor = 0.4;

// Rotation that takes the ray of a pixel to the optical axis.
Eigen::Matrix3d AxisFromRay(const Eigen::Vector3d& ray) {
  return Eigen::Quaterniond::FromTwoVectors(ray, Eigen::Vector3d::UnitZ()).toRotationMatrix();
}

Eigen::Vector3d Ray(const PinholeCamera& camera, const Eigen::Vector2d& pixel) {
  return {
      (pixel.x() - camera.cx) / camera.focal_px, (pixel.y() - camera.cy) / camera.focal_px, 1.0};
}

}  // namespace

std::vector<ImagePath> FindImagePaths(const ImageFeatures& features,
                                      const std::vector<bool>& on_plane,
                                      double working_from_image,
                                      int max_paths) {
  std::vector<std::vector<int>> junction_at(features.segments.size(), std::vector<int>(2, -1));
  for (int j = 0; j < static_cast<int>(features.junctions.size()); ++j) {
    for (const Junction::End& end : features.junctions[j].ends) {
      junction_at[end.segment][end.at_start ? 0 : 1] = j;
    }
  }
  auto other_end = [&](const Junction::End& end, bool* is_junction) {
    const Segment& s = features.segments[end.segment];
    const int j = junction_at[end.segment][end.at_start ? 1 : 0];
    *is_junction = j >= 0;
    if (j >= 0) return features.junctions[j].point;
    return end.at_start ? s.end : s.start;
  };
  std::vector<ImagePath> paths;
  for (const Junction& junction : features.junctions) {
    for (std::size_t i = 0; i < junction.ends.size(); ++i) {
      if (features.segments[junction.ends[i].segment].in_texture) continue;
      for (std::size_t k = i + 1; k < junction.ends.size(); ++k) {
        if (features.segments[junction.ends[k].segment].in_texture) continue;
        if (junction.ends[i].segment == junction.ends[k].segment) continue;
        bool a_junction, c_junction;
        ImagePath path;
        path.b = junction.point;
        path.segment_ab = junction.ends[i].segment;
        path.segment_bc = junction.ends[k].segment;
        path.a = other_end(junction.ends[i], &a_junction);
        path.c = other_end(junction.ends[k], &c_junction);
        const double la = (path.a - path.b).norm() * working_from_image;
        const double lc = (path.c - path.b).norm() * working_from_image;
        if (la < 6 || lc < 6) continue;
        path.rank = std::sqrt(la * lc) * (a_junction ? 1.0 : kFreeEndFactor) *
                    (c_junction ? 1.0 : kFreeEndFactor);
        if (!on_plane.empty() && on_plane[junction.ends[i].segment] &&
            on_plane[junction.ends[k].segment]) {
          path.rank *= kOnPlaneFactor;
        }
        paths.push_back(path);
      }
    }
  }
  std::stable_sort(
      paths.begin(), paths.end(), [](const auto& x, const auto& y) { return x.rank > y.rank; });
  if (static_cast<int>(paths.size()) > max_paths) paths.resize(max_paths);
  return paths;
}

PathPoses PosesFromPath(const ObjectModel& model,
                        const VertexPath& path,
                        bool reversed,
                        const PinholeCamera& camera,
                        const ImagePath& image_path) {
  PathPoses out;
  // In a camera turned so that b lies on its axis: w (R U)_xy = a' (1 + w (R U)_z), w = 1 / depth
  // of b.
  const Eigen::Matrix3d axis_from_camera = AxisFromRay(Ray(camera, image_path.b));
  auto turned = [&](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
    const Eigen::Vector3d r = axis_from_camera * Ray(camera, pixel);
    return r.head<2>() / r.z();
  };
  const Eigen::Vector2d p1 = turned(reversed ? image_path.c : image_path.a);
  const Eigen::Vector2d p2 = turned(reversed ? image_path.a : image_path.c);
  const double uu = path.length_ab * path.length_ab;
  const double vv = path.length_bc * path.length_bc;
  const double uv = 0.5 * (uu + vv - path.length_ac * path.length_ac);
  const double quadratic = uu * vv - uv * uv;
  if (!(quadratic > 1e-12 * uu * vv)) return out;

  for (int sign = -1; sign <= 1; sign += 2) {
    double e1 = 0, e2 = 0, w = 0, h1 = 0, h2 = 0;
    Eigen::Vector2d q1 = p1, q2 = p2;
    for (int iteration = 0; iteration < kPerspectiveIterations; ++iteration) {
      q1 = p1 * (1 + e1);
      q2 = p2 * (1 + e2);
      const double b = uu * q2.squaredNorm() + vv * q1.squaredNorm() - 2 * uv * q1.dot(q2);
      const double cross = q1.x() * q2.y() - q1.y() * q2.x();
      const double root = std::sqrt(std::max(0.0, b * b - 4 * quadratic * cross * cross));
      const double w2 = (b + root) / (2 * quadratic);
      w = std::sqrt(w2);
      h1 = sign * std::sqrt(std::max(0.0, w2 * uu - q1.squaredNorm()));
      h2 = std::sqrt(std::max(0.0, w2 * vv - q2.squaredNorm()));
      const double product = w2 * uv - q1.dot(q2);  // h1 h2
      if ((h1 < 0) != (product < 0)) h2 = -h2;
      if (std::abs(h1) < 1e-12) h2 = sign * std::abs(h2);
      e1 = h1;
      e2 = h2;
    }
    if (!(w > 1e-9) || e1 < -0.8 || e2 < -0.8) continue;
    const Eigen::Vector3d u(q1.x() / w, q1.y() / w, h1 / w);
    const Eigen::Vector3d v(q2.x() / w, q2.y() / w, h2 / w);
    Eigen::Matrix3d image_frame;
    image_frame << u, v, u.cross(v);
    const Eigen::Matrix3d R = axis_from_camera.transpose() * (image_frame * path.inverse_frame);
    if (!R.allFinite()) continue;
    const Eigen::Vector3d b_in_camera = axis_from_camera.transpose() * Eigen::Vector3d(0, 0, 1 / w);
    out.camera_from_object[out.count++] = {R, b_in_camera - R * model.vertices[path.b]};
  }
  return out;
}

}  // namespace horopter
