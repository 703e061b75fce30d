#include "server/vision/recognition/aspect_scenes/texture_structure.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "server/vision/geometry/nearest_point.h"
#include "server/vision/recognition/aspect_scenes/standing_planes.h"
#include "server/vision/recognition/aspects/quantile.h"
#include "server/vision/reconstruction/point_planes.h"

namespace horopter {
namespace {

constexpr int kInsidePx = 5;          // working px from the part's outline
constexpr double kNearer = 0.05;      // step in depth that tells which way the other image moves
constexpr double kLeastStepPx = 2.0;  // of it there; less parallax tells nothing
constexpr double kOnFacePx = 4.0;     // working px in the other image, of points on a face
constexpr double kBehindPx = 8.0;     // ... and of those that are clearly not
constexpr double kOffLinePx = 4.0;    // from the epipolar line; farther is no match
constexpr int kLeastBehind = 8;
constexpr double kMoreBehind = 2.0;  // than on faces

// 1 / m at a working pixel whose neighbourhood the part covers; else 0.
float CoveredAt(const ObjectLayer& layer, const Eigen::Vector2d& working) {
  const int x = static_cast<int>(std::lround(working.x()));
  const int y = static_cast<int>(std::lround(working.y()));
  for (const int dx : {-kInsidePx, 0, kInsidePx}) {
    for (const int dy : {-kInsidePx, 0, kInsidePx}) {
      if (!layer.Has(x + dx, y + dy) || layer.inverse_depth[layer.Cell(x + dx, y + dy)] <= 0.0f)
        return 0.0f;
    }
  }
  return layer.inverse_depth[layer.Cell(x, y)];
}

constexpr double kLeastParallax = 0.035;  // radians between a point's outermost rays
constexpr std::size_t kLeastOnPlane = 20;
constexpr int kPlaneRounds = 4;            // points beyond three deviations are left out in each
constexpr double kPlaneTolerance = 0.008;  // of the cameras' distance, of a further plane's points
constexpr double kLeastLevel = 0.5;        // cosine to the first: from steeper ones things slide
// Of the diameter. Places in ten scenes of cad-dev, in prague and in benchvise that score .3 and
// more reach .02 below the first plane at most; a hub with its underside up in noise .33. ADR 117.
constexpr double kUnderShare = 0.1;
constexpr double kOnPlaneShare = 0.03;  // of points of the plane
constexpr int kLeastAround = 12;        // of these within a diameter of the part
constexpr double kMostGapRad = 2.1;     // between their directions: half of a plane has pi
constexpr double kOutlierDeviations = 3.0, kNormalFromMedian = 1.4826;

// Least squares, and again without what is far off: distances are to be small against the part's.
SupportingPlane FitPlane(std::vector<Eigen::Vector3d> points) {
  SupportingPlane plane;
  for (int round = 0; round < kPlaneRounds; ++round) {
    Eigen::Vector3d middle = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& x : points) middle += x / static_cast<double>(points.size());
    Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
    for (const Eigen::Vector3d& x : points) moment += (x - middle) * (x - middle).transpose();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(moment);
    plane = {eigen.eigenvectors().col(0), eigen.eigenvectors().col(0).dot(middle)};
    const auto off = [&](const Eigen::Vector3d& x) {
      return std::abs(plane.normal.dot(x) - plane.offset_m);
    };
    std::vector<double> distances;
    for (const Eigen::Vector3d& x : points) distances.push_back(off(x));
    const double most = kOutlierDeviations * kNormalFromMedian * Median(&distances);
    std::erase_if(points, [&](const Eigen::Vector3d& x) { return off(x) > most; });
  }
  return plane;
}

// Where these views show the point.
std::optional<Eigen::Vector3d> PointIn(const std::vector<std::optional<AspectSceneView>>& views,
                                       const ReconstructedPoint& point) {
  std::vector<SpaceLine> rays;
  for (std::size_t i = 0; i < point.pixels.size(); ++i) {
    const auto& view = views[point.observations[i].first];
    if (!view) continue;
    const Rigid3 scene_from_camera = view->camera_from_scene.Inverse();
    rays.push_back(
        {scene_from_camera.t,
         (scene_from_camera.R * NormalizedPoint(view->camera, point.pixels[i]).homogeneous())
             .normalized()});
  }
  return NearestToLines(rays, kLeastParallax);
}

double MeanDistance(const std::vector<std::optional<AspectSceneView>>& views,
                    const std::vector<Eigen::Vector3d>& points) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& x : points) middle += x / static_cast<double>(points.size());
  double sum = 0.0, count = 0.0;
  for (const auto& view : views) {
    if (!view) continue;
    sum += (view->camera_from_scene * middle).norm();
    count += 1.0;
  }
  return sum / std::max(count, 1.0);
}

// Turned to the cameras; nothing where they are on both sides.
std::optional<SupportingPlane> FacingPlane(
    SupportingPlane plane, const std::vector<std::optional<AspectSceneView>>& views) {
  for (int turned = 0; turned < 2; ++turned) {
    if (IsBelow(plane, views)) return plane;
    plane = {-plane.normal, -plane.offset_m};
  }
  return std::nullopt;
}

enum class Place { kUnknown, kOnFace, kBehind };

// Where another view shows what view `a` shows at a pixel, against the face that is there at
// `depth_m`.
Place PlaceIn(const AspectSceneView& a,
              const Eigen::Vector2d& pixel_a,
              double depth_m,
              const AspectSceneView& b,
              const Eigen::Vector2d& pixel_b,
              double working_from_image) {
  const Eigen::Vector3d ray = NormalizedPoint(a.camera, pixel_a).homogeneous();
  const Rigid3 b_from_a = b.camera_from_scene * a.camera_from_scene.Inverse();
  const Eigen::Vector3d face = b_from_a * Eigen::Vector3d(depth_m * ray);
  const Eigen::Vector3d farther = b_from_a * Eigen::Vector3d((1.0 + kNearer) * depth_m * ray);
  if (!(face.z() > 0.0) || !(farther.z() > 0.0)) return Place::kUnknown;
  const Eigen::Vector2d at = Project(b.camera, face);
  const Eigen::Vector2d step = working_from_image * (Project(b.camera, farther) - at);
  if (step.norm() < kLeastStepPx) return Place::kUnknown;
  const Eigen::Vector2d off = working_from_image * (pixel_b - at);
  const Eigen::Vector2d along = step.normalized();
  const double behind = along.dot(off);
  if ((off - behind * along).norm() > kOffLinePx) return Place::kUnknown;
  if (std::abs(behind) <= kOnFacePx) return Place::kOnFace;
  return behind >= kBehindPx ? Place::kBehind : Place::kUnknown;
}

// Those on the reconstruction's plane, or those beside it.
std::vector<Eigen::Vector3d> PointsIn(const std::vector<std::optional<AspectSceneView>>& views,
                                      std::span<const ReconstructedPoint> points,
                                      bool on_plane) {
  std::vector<Eigen::Vector3d> out;
  for (const ReconstructedPoint& point : points) {
    if (point.on_plane != on_plane) continue;
    if (const auto x = PointIn(views, point)) out.push_back(*x);
  }
  return out;
}

// Between neighbouring directions all around, radians.
double LargestGap(std::vector<double> directions) {
  std::sort(directions.begin(), directions.end());
  double gap = directions.front() + 2.0 * std::numbers::pi - directions.back();
  for (std::size_t i = 1; i < directions.size(); ++i)
    gap = std::max(gap, directions[i] - directions[i - 1]);
  return gap;
}

}  // namespace

bool TextureOnPart::Contradicts() const {
  return behind >= kLeastBehind && behind > kMoreBehind * on_faces;
}

TextureOnPart CompareTexture(std::span<const AspectImage> images,
                             const std::vector<std::optional<AspectSceneView>>& views,
                             std::span<const ObjectLayer> layers,
                             std::span<const ReconstructedPoint> points) {
  TextureOnPart out;
  for (const ReconstructedPoint& point : points) {
    bool on_face = false, behind = false;
    for (std::size_t i = 0; i < point.pixels.size(); ++i) {
      const int a = point.observations[i].first;
      if (!views[a] || layers[a].width == 0) continue;
      const float inverse = CoveredAt(layers[a], WorkingPixel(images[a], point.pixels[i]));
      if (inverse <= 0.0f) continue;
      for (std::size_t k = 0; k < point.pixels.size(); ++k) {
        const int b = point.observations[k].first;
        if (k == i || !views[b]) continue;
        const Place place = PlaceIn(*views[a],
                                    point.pixels[i],
                                    1.0 / inverse,
                                    *views[b],
                                    point.pixels[k],
                                    images[b].working_from_image);
        on_face |= place == Place::kOnFace;
        behind |= place == Place::kBehind;
      }
    }
    out.on_faces += on_face;
    out.behind += behind && !on_face;
  }
  return out;
}

std::optional<TexturePlane> FirstPlaneOfTexture(
    const std::vector<std::optional<AspectSceneView>>& views,
    std::span<const ReconstructedPoint> points) {
  TexturePlane out;
  out.points = PointsIn(views, points, true);
  if (out.points.size() < kLeastOnPlane) return std::nullopt;
  const auto plane = FacingPlane(FitPlane(out.points), views);
  if (!plane) return std::nullopt;
  out.plane = *plane;
  return out;
}

bool IsUnderTexture(const TexturePlane& texture,
                    const RenderMesh& mesh,
                    const Rigid3& scene_from_object) {
  const SupportingPlane& plane = texture.plane;
  const auto height = [&](const Eigen::Vector3d& x) {
    return plane.normal.dot(x) - plane.offset_m;
  };
  double lowest = 0.0;
  for (const Eigen::Vector3f& x : mesh.vertices)
    lowest = std::min(lowest, height(scene_from_object * x.cast<double>()));
  if (lowest > -kUnderShare * mesh.diameter_m) return false;
  const Eigen::Vector3d center = scene_from_object * mesh.center.cast<double>();
  const Eigen::Vector3d right = plane.normal.unitOrthogonal(), up = plane.normal.cross(right);
  std::vector<double> directions;
  for (const Eigen::Vector3d& x : texture.points) {
    const double u = (x - center).dot(right), v = (x - center).dot(up);
    if (std::abs(height(x)) < kOnPlaneShare * mesh.diameter_m && std::hypot(u, v) < mesh.diameter_m)
      directions.push_back(std::atan2(v, u));
  }
  return std::ssize(directions) >= kLeastAround && LargestGap(std::move(directions)) < kMostGapRad;
}

std::vector<SupportingPlane> PlanesOfTexture(
    const std::vector<std::optional<AspectSceneView>>& views,
    std::span<const ReconstructedPoint> points) {
  std::vector<SupportingPlane> planes;
  const auto first = FirstPlaneOfTexture(views, points);
  if (!first) return planes;
  const std::vector<Eigen::Vector3d> beside = PointsIn(views, points, false);
  planes.push_back(first->plane);
  PointPlaneOptions options;
  --options.max_planes;
  const double tolerance = kPlaneTolerance * MeanDistance(views, first->points);
  for (const PointPlane& found : FindPointPlanes(beside, tolerance, options)) {
    std::vector<Eigen::Vector3d> of;
    for (const int j : found.points) of.push_back(beside[j]);
    const auto plane = FacingPlane(FitPlane(std::move(of)), views);
    if (plane && plane->normal.dot(first->plane.normal) > kLeastLevel) planes.push_back(*plane);
  }
  return planes;
}

}  // namespace horopter
