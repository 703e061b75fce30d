#include "server/vision/recognition/candidates/plane_sighting.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/vision/recognition/scene/support_surface.h"

namespace horopter {
namespace {

constexpr double kTwinCos = 0.9999;      // 0.8 degrees: one stable pose up to a symmetry
constexpr double kMaxHeightShare = 0.5;  // of the lowest camera's height over the plane
constexpr float kHeightReachPx = 7.0f;   // working pixels
constexpr float kHeightSupport = 0.45f;  // mean support of a segment in another view

}  // namespace

std::vector<StandingObject> StandingObjects(const PreparedObject& object) {
  std::vector<StandingObject> out;
  const auto& poses = object.stable_poses;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const StablePose& stable = poses[i];
    // One of the poses that the part's symmetry takes into each other is enough.
    const bool twin = std::any_of(poses.begin(), poses.begin() + i, [&](const StablePose& other) {
      return std::any_of(
          object.model.symmetries.begin(), object.model.symmetries.end(), [&](const Rigid3& s) {
            return (s.R * other.up).dot(stable.up) > kTwinCos;
          });
    });
    if (twin) continue;
    StandingObject standing;
    const Eigen::Vector3d u = stable.up.unitOrthogonal();
    standing.plane_from_object.R << u.transpose(), stable.up.cross(u).transpose(),
        stable.up.transpose();
    standing.plane_from_object.t << 0.0, 0.0, stable.height_m;
    for (const Eigen::Vector3d& v : object.model.vertices)
      standing.vertices.push_back(standing.plane_from_object * v);
    const Outline outline = OutlineOnPlane(object, standing.plane_from_object, SupportingPlane{});
    const Eigen::Vector2d middle = outline.Middle();
    standing.outline_middle = (outline.x * middle.x() + outline.y * middle.y()).head<2>();
    out.push_back(std::move(standing));
  }
  return out;
}

bool SightPlane(const PinholeCamera& camera,
                const Rigid3& camera_from_plane,
                const Eigen::Vector2d& pixel,
                PlaneSighting* sighting) {
  const Eigen::Vector3d ray =
      camera_from_plane.R.transpose() * NormalizedPoint(camera, pixel).homogeneous();
  if (ray.z() > -0.02 * ray.norm()) return false;
  const Eigen::Vector3d eye = -(camera_from_plane.R.transpose() * camera_from_plane.t);
  sighting->shift = ray.head<2>() / ray.z();
  sighting->base = eye.head<2>() - eye.z() * sighting->shift;
  return true;
}

double MaxHeight(std::span<const KnownView> views) {
  double lowest = 1e300;
  for (const KnownView& view : views)
    lowest = std::min(lowest, view.camera_from_scene.Inverse().t.z());
  return kMaxHeightShare * lowest;
}

HeightMask SupportedHeights(std::span<const KnownView> views,
                            std::size_t own,
                            const PlaneSighting& from,
                            const PlaneSighting& to,
                            double max_height,
                            double needed_height) {
  constexpr int kPoints = 5;  // along an edge that are asked
  HeightMask mask;
  const int needed = views.size() > 2 ? 2 : 1;
  for (int bin = 0; bin < HeightMask::kBins; ++bin) {
    const double z = (bin + 0.5) * max_height / HeightMask::kBins;
    // Two bins more: a bin's support counts for its neighbours.
    if (z > needed_height + 2.0 * max_height / HeightMask::kBins) break;
    const Eigen::Vector2d a = from.base + z * from.shift, b = to.base + z * to.shift;
    const Eigen::Vector3d tangent(b.x() - a.x(), b.y() - a.y(), 0.0);
    int seen = 0;
    for (std::size_t v = 0; v < views.size() && seen < needed; ++v) {
      if (v == own) continue;
      const KnownView& view = views[v];
      const Eigen::Vector3d q = view.camera_from_scene.R * tangent;
      float sum = 0.0f;
      for (int k = 0; k < kPoints; ++k) {
        const double w = (k + 0.5) / kPoints;
        const Eigen::Vector3d p =
            view.camera_from_scene *
            Eigen::Vector3d((1 - w) * a.x() + w * b.x(), (1 - w) * a.y() + w * b.y(), z);
        if (p.z() <= 0) break;
        // What the remaining points can add at most does not suffice.
        if (sum + static_cast<float>(kPoints - k) <= kHeightSupport * kPoints) break;
        const Eigen::Vector2d u = Project(view.camera, p);
        const int o = OrientationBin(static_cast<float>(q.x() * p.z() - p.x() * q.z()),
                                     static_cast<float>(q.y() * p.z() - p.y() * q.z()));
        const float d =
            view.maps->DistanceAt(static_cast<float>(u.x()), static_cast<float>(u.y()), o);
        sum += std::max(0.0f, 1.0f - d / kHeightReachPx);
      }
      seen += sum > kHeightSupport * kPoints;
    }
    if (seen < needed) continue;
    for (int k = std::max(0, bin - 1); k <= std::min(HeightMask::kBins - 1, bin + 1); ++k)
      mask.Set(k);
  }
  return mask;
}

int YawsFromEdge(const Eigen::Vector3d& a,
                 const Eigen::Vector3d& b,
                 const PlaneSighting& at_a,
                 const PlaneSighting& at_b,
                 PlaneYaw out[2]) {
  // The sighting of b minus that of a, at their heights, is A + scale * B; its length is that of
  // the edge times scale.
  const Eigen::Vector2d ab = (b - a).head<2>();
  const Eigen::Vector2d A = at_b.base - at_a.base, B = b.z() * at_b.shift - a.z() * at_a.shift;
  const double q2 = B.squaredNorm() - ab.squaredNorm(), q1 = A.dot(B), q0 = A.squaredNorm();
  const double d = q1 * q1 - q2 * q0;
  if (d < 0 || std::abs(q2) < 1e-15) return 0;
  const double root = std::sqrt(d), model_norm = ab.norm();
  int n = 0;
  for (const double scale : {(-q1 + root) / q2, (-q1 - root) / q2}) {
    if (!(scale > 1e-9)) continue;
    const Eigen::Vector2d seen = A + scale * B;
    const double norms = seen.norm() * model_norm;
    if (norms <= 0) continue;
    PlaneYaw yaw;
    yaw.units_per_metre = scale;
    yaw.cos_yaw = ab.dot(seen) / norms;
    yaw.sin_yaw = (ab.x() * seen.y() - ab.y() * seen.x()) / norms;
    yaw.position = at_b.base + scale * b.z() * at_b.shift -
                   scale * Turned(yaw.cos_yaw, yaw.sin_yaw, b.head<2>());
    out[n++] = yaw;
  }
  return n;
}

double MissOf(const PlaneYaw& yaw, const Eigen::Vector3d& vertex, const PlaneSighting& sighting) {
  const double scale = yaw.units_per_metre;
  const Eigen::Vector2d seen = sighting.base + scale * vertex.z() * sighting.shift;
  return (yaw.position + scale * Turned(yaw.cos_yaw, yaw.sin_yaw, vertex.head<2>()) - seen).norm() /
         scale;
}

int PosesFromSightings(const Eigen::Vector3d vertices[3],
                       const PlaneSighting sightings[3],
                       double tolerance,
                       PlaneYaw out[2]) {
  const Eigen::Vector3d &a = vertices[0], &b = vertices[1], &c = vertices[2];
  const double limit = tolerance * ((b - a).norm() + (c - b).norm());
  if (!IsUpright(a, b)) {
    PlaneYaw yaws[2];
    const int found = YawsFromEdge(a, b, sightings[0], sightings[1], yaws);
    int n = 0;
    for (int i = 0; i < found; ++i) {
      if (MissOf(yaws[i], c, sightings[2]) <= limit) out[n++] = yaws[i];
    }
    return n;
  }
  // a and b are seen at one place: they fix the scale, b and c the yaw.
  const Eigen::Vector2d A = sightings[1].base - sightings[0].base;
  const Eigen::Vector2d B = b.z() * sightings[1].shift - a.z() * sightings[0].shift;
  if (B.squaredNorm() <= 0 || IsUpright(b, c)) return 0;
  const double scale = -A.dot(B) / B.squaredNorm();
  if (!(scale > 1e-9) || (A + scale * B).norm() > limit * scale) return 0;
  const Eigen::Vector2d at_b = sightings[1].base + scale * b.z() * sightings[1].shift;
  const Eigen::Vector2d at_c = sightings[2].base + scale * c.z() * sightings[2].shift;
  const Eigen::Vector2d model = (c - b).head<2>(), seen = at_c - at_b;
  const double norms = model.norm() * seen.norm();
  if (norms <= 0) return 0;
  PlaneYaw yaw;
  yaw.units_per_metre = scale;
  yaw.cos_yaw = model.dot(seen) / norms;
  yaw.sin_yaw = (model.x() * seen.y() - model.y() * seen.x()) / norms;
  yaw.position = at_b - scale * Turned(yaw.cos_yaw, yaw.sin_yaw, b.head<2>());
  if (MissOf(yaw, c, sightings[2]) > limit) return 0;
  out[0] = yaw;
  return 1;
}

}  // namespace horopter
