#include "server/vision/euclidean/supporting_plane_search.h"

#include <algorithm>
#include <cmath>
#include <tuple>

namespace horopter {
namespace {

constexpr double kTouchM = 0.003;         // an object this near to the plane stands on it
constexpr double kOnPlaneM = 0.004;       // of a point of texture
constexpr double kMinPlanePoints = 20.0;  // fewer lie on any plane
constexpr double kMinPlaneShare = 0.2;    // of all points: the rest is beside the table
constexpr double kBelow = 0.1;  // of an object's diameter below the plane: it is another plane

double LowestAlong(const AdjustedObject& o, const Eigen::Vector3d& normal) {
  double lowest = 1e9;
  const Eigen::Vector3d n = o.scene_from_object.R.transpose() * normal;
  for (const auto& v : o.model->model.mesh.vertices) lowest = std::min(lowest, n.dot(v));
  return lowest + normal.dot(o.scene_from_object.t);
}

// Where an object's stable pose says that the plane is.
struct PlaneUnderObject {
  SupportingPlane plane;
  int texture = 0;  // points on it; of few 0
  int resting = 0;
  double margin_m = 0.0;

  auto Rank() const { return std::tuple(texture, resting, margin_m); }
};

int TextureOn(const SceneBundle& bundle, const SupportingPlane& plane) {
  const auto& points = bundle.texture.points;
  const auto on = std::count_if(points.begin(), points.end(), [&](const TexturePoint& p) {
    return std::abs(plane.normal.dot(p.point_in_scene) - plane.offset_m) < kOnPlaneM;
  });
  return on >= std::max<double>(kMinPlanePoints, kMinPlaneShare * points.size())
             ? static_cast<int>(on)
             : 0;
}

// Nothing where an object or a camera is below it.
std::optional<PlaneUnderObject> PlaneUnderPose(const SceneBundle& bundle,
                                               const AdjustedObject& o,
                                               const StablePose& stable) {
  PlaneUnderObject out;
  out.plane.normal = o.scene_from_object.R * stable.up;
  const double offset = out.plane.normal.dot(o.scene_from_object.t) - stable.height_m;
  out.plane.offset_m = offset;
  out.margin_m = stable.margin_m;
  for (const AdjustedView& view : bundle.views) {
    if (view.known && out.plane.normal.dot(view.camera_from_scene.Inverse().t) <= offset)
      return std::nullopt;
  }
  out.texture = TextureOn(bundle, out.plane);
  for (const AdjustedObject& other : bundle.objects) {
    const double at = LowestAlong(other, out.plane.normal);
    const double below =
        out.texture > 0 ? std::max(kTouchM, kBelow * other.model->model.diameter_m) : kTouchM;
    if (at <= offset - below) return std::nullopt;
    out.resting += at < offset + kTouchM;
    // What reaches deeper has a wrong pose: the texture knows the plane better.
    out.plane.offset_m = std::min(out.plane.offset_m, std::max(at, offset - kTouchM));
  }
  return out;
}

}  // namespace

std::optional<SupportingPlane> FindSupportingPlane(const SceneBundle& bundle) {
  if (!bundle.plane.cells.empty()) {
    // plane.(X - anchor) = -1; the anchor, a mean camera, lies on its positive side.
    const double norm = bundle.plane.plane.norm();
    SupportingPlane plane{bundle.plane.plane / norm,
                          (bundle.plane.plane.dot(bundle.plane.anchor) - 1.0) / norm};
    bool above = true;
    double lowest = plane.offset_m;
    for (const AdjustedObject& o : bundle.objects) {
      const double at = LowestAlong(o, plane.normal);
      above = above && at > plane.offset_m - kBelow * o.model->model.diameter_m;
      lowest = std::min(lowest, at);
    }
    plane.offset_m = lowest;
    if (above) return plane;
  }
  std::optional<PlaneUnderObject> best;
  for (const AdjustedObject& o : bundle.objects) {
    for (const StablePose& stable : o.model->stable_poses) {
      const std::optional<PlaneUnderObject> candidate = PlaneUnderPose(bundle, o, stable);
      if (candidate && (!best || candidate->Rank() > best->Rank())) best = candidate;
    }
  }
  if (!best) return std::nullopt;
  return best->plane;
}

}  // namespace horopter
