#include "server/vision/euclidean/texture_points.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "server/vision/euclidean/robust_scatter.h"
#include "server/vision/geometry/nearest_point.h"
#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr int kColumns = 8, kRows = 6;    // cells of an image, for points that are spread over it
constexpr double kLeastParallax = 0.035;  // radians between the outermost rays of a point
constexpr int kFollowSteps = 2;           // of a point after its cameras
constexpr double kLeastCurvatureShare =
    1e-9;  // keeps a point's matrix regular, of its largest entry

using Matrix23 = Eigen::Matrix<double, 2, 3>;

// A point's sights under the cameras as they are, in sigmas; derivatives by the point.
struct Seen {
  Eigen::Vector2d residual;
  Matrix23 by_point;
  ViewJacobian by_view;
  double weight = 0.0;
};

std::optional<Seen> See(const AdjustedView& view,
                        const ObservedTexture& texture,
                        const Eigen::Vector3d& point_in_scene,
                        const Eigen::Vector2d& pixel,
                        double slack) {
  const Eigen::Vector3d arm = view.camera_from_scene.R * point_in_scene;
  const Eigen::Vector3d p = arm + view.camera_from_scene.t;
  if (!(p.z() > kMinDepthM)) return std::nullopt;
  Seen out;
  Matrix23 in_camera;
  const Eigen::Vector2d u = ProjectWithJacobian(view.camera, p, arm, &in_camera, &out.by_view);
  const double unit = 1.0 / (texture.sigma_px * slack);
  out.residual = unit * (u - pixel);
  out.by_point = unit * in_camera * view.camera_from_scene.R;
  out.by_view *= unit;
  out.weight = RobustWeight(texture.cauchy_sigmas, out.residual.squaredNorm());
  return out;
}

// The point nearest to the rays of its sights; none where they are nearly parallel or it lies
// behind a camera.
std::optional<Eigen::Vector3d> NearestToSights(
    const TexturePoint& point, std::span<const std::optional<CalibratedCamera>> views) {
  std::vector<SpaceLine> rays;
  for (const TexturePoint::Sight& sight : point.seen) {
    const CalibratedCamera& view = *views[sight.view];
    const Rigid3 scene_from_camera = view.camera_from_scene.Inverse();
    rays.push_back({scene_from_camera.t,
                    (scene_from_camera.R * NormalizedPoint(view.camera, sight.pixel).homogeneous())
                        .normalized()});
  }
  const std::optional<Eigen::Vector3d> x = NearestToLines(rays, kLeastParallax);
  if (!x) return std::nullopt;
  for (const TexturePoint::Sight& sight : point.seen) {
    if (!((views[sight.view]->camera_from_scene * *x).z() > kMinDepthM)) return std::nullopt;
  }
  return x;
}

// Which cells of the images hold how many points already.
class Spread {
 public:
  explicit Spread(std::span<const std::optional<CalibratedCamera>> views)
      : views_(views), taken_(views.size() * kColumns * kRows, 0) {}

  // Points of the cell of a sight that holds fewest.
  int Fewest(const TexturePoint& point) const {
    int fewest = 1 << 30;
    for (const auto& sight : point.seen) fewest = std::min(fewest, taken_[CellOf(sight)]);
    return fewest;
  }
  void Take(const TexturePoint& point) {
    for (const auto& sight : point.seen) ++taken_[CellOf(sight)];
  }

 private:
  std::size_t CellOf(const TexturePoint::Sight& sight) const {
    const PinholeCamera& camera = views_[sight.view]->camera;
    const auto part = [](double at, int size, int parts) {
      return std::clamp(static_cast<int>(parts * at / size), 0, parts - 1);
    };
    return static_cast<std::size_t>(
        (sight.view * kRows + part(sight.pixel.y(), camera.height, kRows)) * kColumns +
        part(sight.pixel.x(), camera.width, kColumns));
  }

  std::span<const std::optional<CalibratedCamera>> views_;
  std::vector<int> taken_;
};

std::vector<TexturePoint> PointsOf(const Reconstruction& reconstruction,
                                   std::span<const std::optional<CalibratedCamera>> views,
                                   int max_sights) {
  std::vector<TexturePoint> out;
  for (const ReconstructedPoint& source : reconstruction.points) {
    TexturePoint point;
    for (std::size_t i = 0; i < source.pixels.size(); ++i) {
      const int view = source.observations[i].first;
      if (view < std::ssize(views) && views[view] && std::ssize(point.seen) < max_sights)
        point.seen.push_back({view, source.pixels[i]});
    }
    if (point.seen.size() < 2) continue;
    const auto at = NearestToSights(point, views);
    if (!at) continue;
    point.point_in_scene = *at;
    out.push_back(std::move(point));
  }
  std::stable_sort(out.begin(), out.end(), [](const TexturePoint& a, const TexturePoint& b) {
    return a.seen.size() > b.seen.size();
  });
  return out;
}

}  // namespace

ObservedTexture ChooseTexturePoints(const Reconstruction& reconstruction,
                                    std::span<const std::optional<CalibratedCamera>> views,
                                    const TexturePointOptions& options) {
  ObservedTexture out;
  out.sigma_px = options.sigma_px;
  std::vector<TexturePoint> left = PointsOf(reconstruction, views, options.max_sights);
  Spread spread(views);
  // Cells are filled evenly, with what most views see.
  for (int room = 0; !left.empty() && std::ssize(out.points) < options.max_points; ++room) {
    std::vector<TexturePoint> later;
    for (TexturePoint& point : left) {
      if (std::ssize(out.points) >= options.max_points) break;
      if (spread.Fewest(point) > room) {
        later.push_back(std::move(point));
        continue;
      }
      spread.Take(point);
      out.points.push_back(std::move(point));
    }
    left = std::move(later);
  }
  return out;
}

bool LinearizeTexturePoint(std::span<const AdjustedView> views,
                           const ObservedTexture& texture,
                           const TexturePoint& point,
                           double slack,
                           TextureRows* rows) {
  const auto n = static_cast<Eigen::Index>(point.seen.size());
  rows->views.clear();
  rows->residual.resize(2 * n);
  rows->weight.resize(2 * n);
  rows->J = Eigen::MatrixXd::Zero(2 * n, kViewParameters * n);
  Eigen::MatrixXd by_point(2 * n, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    const TexturePoint::Sight& sight = point.seen[i];
    const auto seen = See(views[sight.view], texture, point.point_in_scene, sight.pixel, slack);
    if (!seen) return false;
    const double root = std::sqrt(seen->weight);
    rows->views.push_back(sight.view);
    rows->weight.segment<2>(2 * i).setConstant(seen->weight);
    rows->residual.segment<2>(2 * i) = root * seen->residual;
    rows->J.block<2, kViewParameters>(2 * i, kViewParameters * i) = root * seen->by_view;
    by_point.middleRows<2>(2 * i) = root * seen->by_point;
  }
  // What the point takes up by moving.
  Eigen::Matrix3d A = by_point.transpose() * by_point;
  A.diagonal().array() += kLeastCurvatureShare * A.diagonal().maxCoeff();
  const Eigen::Matrix<double, 3, Eigen::Dynamic> solve = A.ldlt().solve(by_point.transpose());
  rows->residual -= by_point * (solve * rows->residual);
  rows->J -= by_point * (solve * rows->J);
  return rows->J.allFinite();
}

double TextureCost(std::span<const AdjustedView> views,
                   const ObservedTexture& texture,
                   double slack) {
  double cost = 0.0;
  for (const TexturePoint& point : texture.points) {
    for (const TexturePoint::Sight& sight : point.seen) {
      const AdjustedView& view = views[sight.view];
      const Eigen::Vector3d p = view.camera_from_scene * point.point_in_scene;
      double squared = kBehindSigmas * kBehindSigmas;
      if (p.z() > kMinDepthM)
        squared = (Project(view.camera, p) - sight.pixel).squaredNorm() /
                  std::pow(texture.sigma_px * slack, 2);
      cost += CauchyLoss(texture.cauchy_sigmas, squared);
    }
  }
  return cost;
}

void FollowCameras(std::span<const AdjustedView> views, double slack, ObservedTexture* texture) {
  for (TexturePoint& point : texture->points) {
    for (int step = 0; step < kFollowSteps; ++step) {
      Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
      Eigen::Vector3d b = Eigen::Vector3d::Zero();
      for (const TexturePoint::Sight& sight : point.seen) {
        const auto seen =
            See(views[sight.view], *texture, point.point_in_scene, sight.pixel, slack);
        if (!seen) continue;
        A += seen->weight * seen->by_point.transpose() * seen->by_point;
        b += seen->weight * seen->by_point.transpose() * seen->residual;
      }
      A.diagonal().array() += kLeastCurvatureShare * A.diagonal().maxCoeff();
      const Eigen::Vector3d move = A.ldlt().solve(b);
      if (move.allFinite()) point.point_in_scene -= move;
    }
  }
}

double TextureDeviation(std::span<const AdjustedView> views, const ObservedTexture& texture) {
  std::vector<double> squared;
  for (const TexturePoint& point : texture.points) {
    for (const TexturePoint::Sight& sight : point.seen) {
      const auto seen = See(views[sight.view], texture, point.point_in_scene, sight.pixel, 1.0);
      if (seen) squared.push_back(seen->residual.squaredNorm());
    }
  }
  return squared.empty() ? 0.0 : std::sqrt(Median(&squared) / kMedianOfChiSquare2);
}

}  // namespace horopter
