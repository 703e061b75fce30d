#include "server/vision/matching/known_cameras.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/plucker_line.h"
#include "server/vision/matching/feature_tracks.h"
#include "server/vision/matching/homography.h"
#include "server/vision/matching/on_plane.h"
#include "server/vision/matching/pair_geometry.h"

namespace horopter {
namespace {

constexpr double kMaxPlaneRmsPx = 4.0;
constexpr size_t kMaxPlanePoints = 200;
constexpr double kVisibleDistortionPx = 0.05;  // at a corner of the image; less is not undone
constexpr double kMinDepth = 1e-6;

bool IsFinite(const PosedView& view) {
  const PinholeCamera& c = view.camera;
  return std::isfinite(c.focal_px) && c.focal_px > 0.0 && std::isfinite(c.cx) &&
         std::isfinite(c.cy) && std::isfinite(c.k1) && view.camera_from_scene.R.allFinite() &&
         view.camera_from_scene.t.allFinite();
}

absl::Status ValidateInput(std::span<const cv::Mat> images,
                           std::span<const ImageFeatures> features,
                           const KnownCameras& known,
                           const MatchingResult& first) {
  const size_t n = images.size();
  if (features.size() != n || known.views.size() != n || first.component.size() != n) {
    return absl::InvalidArgumentError("second pass: " + std::to_string(n) + " images, " +
                                      std::to_string(features.size()) + " feature sets, " +
                                      std::to_string(known.views.size()) + " cameras and " +
                                      std::to_string(first.component.size()) + " matched views");
  }
  if (!known.middle.allFinite())
    return absl::InvalidArgumentError("second pass: the scene's middle is not finite");
  for (size_t v = 0; v < n; ++v) {
    if (images[v].empty() || (images[v].type() != CV_8UC1 && images[v].type() != CV_8UC3) ||
        images[v].cols != features[v].width || images[v].rows != features[v].height)
      return absl::InvalidArgumentError("second pass: image " + std::to_string(v) +
                                        " is not 8-bit or not of its features' size");
    if (known.views[v] && !IsFinite(*known.views[v]))
      return absl::InvalidArgumentError("second pass: camera " + std::to_string(v) +
                                        " is not finite");
  }
  return absl::OkStatus();
}

Eigen::Vector2d Undistorted(const PinholeCamera& camera, const Eigen::Vector2d& pixel) {
  const Eigen::Vector2d n = NormalizedPoint(camera, pixel);
  return {camera.focal_px * n.x() + camera.cx, camera.focal_px * n.y() + camera.cy};
}

bool HasVisibleDistortion(const PinholeCamera& camera, const cv::Mat& image) {
  const Eigen::Vector2d corner(camera.cx < 0.5 * image.cols ? image.cols - 1.0 : 0.0,
                               camera.cy < 0.5 * image.rows ? image.rows - 1.0 : 0.0);
  return (Undistorted(camera, corner) - corner).norm() > kVisibleDistortionPx;
}

cv::Mat UndistortedImage(const PinholeCamera& camera, const cv::Mat& image) {
  cv::Mat map(image.size(), CV_32FC2), out;
  for (int y = 0; y < image.rows; ++y) {
    cv::Vec2f* row = map.ptr<cv::Vec2f>(y);
    for (int x = 0; x < image.cols; ++x) {
      const Eigen::Vector2d at = Project(
          camera, {(x - camera.cx) / camera.focal_px, (y - camera.cy) / camera.focal_px, 1.0});
      row[x] = {static_cast<float>(at.x()), static_cast<float>(at.y())};
    }
  }
  cv::remap(image, out, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  return out;
}

// What of the features matching looks at; indices stay.
ImageFeatures UndistortedFeatures(const PinholeCamera& camera, const ImageFeatures& features) {
  ImageFeatures out = features;
  for (Segment& s : out.segments) {
    s.start = Undistorted(camera, s.start);
    s.end = Undistorted(camera, s.end);
  }
  for (Junction& j : out.junctions) j.point = Undistorted(camera, j.point);
  return out;
}

struct PreparedView {
  ImageFeatures features;
  MatchingView view;
};

Eigen::Vector3d CentreOf(const PosedView& view) {
  return view.camera_from_scene.Inverse().t;
}

double ParallaxOf(const PosedView& a, const PosedView& b, const Eigen::Vector3d& middle) {
  const Eigen::Vector3d u = CentreOf(a) - middle, v = CentreOf(b) - middle;
  return std::atan2(u.cross(v).norm(), u.dot(v));
}

// Of undistorted pixels, unit norm.
Eigen::Matrix3d FundamentalOf(const PosedView& a, const PosedView& b) {
  const Rigid3 b_from_a = b.camera_from_scene * a.camera_from_scene.Inverse();
  const Eigen::Matrix3d F = b.camera.K().inverse().transpose() * CrossMatrix(b_from_a.t) *
                            b_from_a.R * a.camera.K().inverse();
  return F / F.norm();
}

// b_from_a of the plane for undistorted pixels: H = K_b (R + t n^T / d) K_a^-1, n . x = d in camera
// a. nullopt for a plane through a camera.
std::optional<Eigen::Matrix3d> HomographyOf(const PosedView& a,
                                            const PosedView& b,
                                            const SupportingPlane& plane) {
  const Rigid3 b_from_a = b.camera_from_scene * a.camera_from_scene.Inverse();
  const Eigen::Vector3d normal = a.camera_from_scene.R * plane.normal;
  const double offset = plane.offset + normal.dot(a.camera_from_scene.t);
  if (!(std::abs(offset) > kMinDepth)) return std::nullopt;
  return NormalizeDeterminant(b.camera.K() *
                              (b_from_a.R + b_from_a.t * normal.transpose() / offset) *
                              a.camera.K().inverse());
}

// Point nearest to the rays of one pixel in several views; nullopt for parallel rays.
std::optional<Eigen::Vector3d> Intersect(
    const std::vector<std::pair<const PosedView*, Eigen::Vector2d>>& sights) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d g = Eigen::Vector3d::Zero();
  for (const auto& [view, pixel] : sights) {
    const Eigen::Vector3d ray = view->camera_from_scene.R.transpose() *
                                NormalizedPoint(view->camera, pixel).homogeneous().normalized();
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - ray * ray.transpose();
    A += across;
    g += across * CentreOf(*view);
  }
  if (!(A.determinant() > 1e-9)) return std::nullopt;
  return A.inverse() * g;
}

// Components by size, the largest known one; -1: none has two known views.
int LargestKnownComponent(const KnownCameras& known, const std::vector<int>& component) {
  std::map<int, int> count;
  for (size_t v = 0; v < component.size(); ++v) count[component[v]] += known.views[v].has_value();
  int best = -1;
  for (const auto& [id, n] : count) {
    if (id >= 0 && n >= 2 && (best < 0 || n > count[best])) best = id;
  }
  return best;
}

}  // namespace

std::optional<SupportingPlane> PlaneUnderCameras(const KnownCameras& known,
                                                 const MatchingResult& matching) {
  if (known.views.size() != matching.component.size()) return std::nullopt;
  const int component = LargestKnownComponent(known, matching.component);
  if (component < 0) return std::nullopt;
  std::vector<Eigen::Vector2d> mapped;  // pixels of the component's first view
  for (const PlaneHomography& plane : matching.planes) {
    if (matching.component[plane.view_a] != component) continue;
    const Eigen::Matrix3d plane_from_view = matching.view_from_plane[plane.view_a].inverse();
    for (const Eigen::Vector2d& p : plane.inliers_a) mapped.push_back(Transfer(plane_from_view, p));
  }
  const size_t step = 1 + mapped.size() / kMaxPlanePoints;
  std::vector<Eigen::Vector3d> points;
  double squared = 0.0;
  int residuals = 0;
  for (size_t k = 0; k < mapped.size(); k += step) {
    std::vector<std::pair<const PosedView*, Eigen::Vector2d>> sights;
    for (size_t v = 0; v < known.views.size(); ++v) {
      if (matching.component[v] != component || !known.views[v]) continue;
      const Eigen::Vector2d at = Transfer(matching.view_from_plane[v], mapped[k]);
      const PinholeCamera& c = known.views[v]->camera;
      if (at.x() >= 0 && at.y() >= 0 && at.x() < c.width && at.y() < c.height)
        sights.emplace_back(&*known.views[v], at);
    }
    if (sights.size() < 2) continue;
    const auto x = Intersect(sights);
    if (!x || !x->allFinite()) continue;
    points.push_back(*x);
    for (const auto& [view, pixel] : sights) {
      const Eigen::Vector3d in_camera = view->camera_from_scene * *x;
      if (!(in_camera.z() > kMinDepth)) return std::nullopt;
      squared += (Project(view->camera, in_camera) - pixel).squaredNorm();
      ++residuals;
    }
  }
  if (points.size() < 3 || squared > 2.0 * residuals * kMaxPlaneRmsPx * kMaxPlaneRmsPx)
    return std::nullopt;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& x : points) mean += x / static_cast<double>(points.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& x : points) scatter += (x - mean) * (x - mean).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(scatter);
  // Points along one line fix no plane.
  if (!(solver.eigenvalues()(1) > 1e-6 * solver.eigenvalues()(2))) return std::nullopt;
  SupportingPlane plane;
  plane.normal = solver.eigenvectors().col(0);
  plane.offset = plane.normal.dot(mean);
  return plane;
}

absl::StatusOr<MatchingResult> MatchUnderCameras(std::span<const cv::Mat> images,
                                                 std::span<const ImageFeatures> features,
                                                 const KnownCameras& known,
                                                 const MatchingResult& first,
                                                 const MatchingOptions& options,
                                                 const StopRequested& stop) {
  HOROPTER_RETURN_IF_ERROR(ValidateInput(images, features, known, first));
  const int n = static_cast<int>(images.size());
  std::vector<PreparedView> views(n);
  ParallelFor(n, options.threads, [&](int v) {
    if (!known.views[v] || IsStopRequested(stop)) return;
    const PinholeCamera& camera = known.views[v]->camera;
    const bool distorted = HasVisibleDistortion(camera, images[v]);
    views[v].features = distorted ? UndistortedFeatures(camera, features[v]) : features[v];
    views[v].view = PrepareMatchingView(distorted ? UndistortedImage(camera, images[v]) : images[v],
                                        views[v].features);
  });
  const auto plane = PlaneUnderCameras(known, first);
  MatchingResult result = first;
  std::vector<char> matched(result.pairs.size(), 0);
  ParallelFor(static_cast<int>(result.pairs.size()), options.threads, [&](int k) {
    PairGeometry& pair = result.pairs[k];
    const auto& a = known.views[pair.view_a];
    const auto& b = known.views[pair.view_b];
    if (!a || !b || IsStopRequested(stop)) return;
    if (!(ParallaxOf(*a, *b, known.middle) >= kMinKnownParallaxRad)) {
      pair.F.reset();
      pair.refusal = "no parallax between the known cameras";
      return;
    }
    pair.F = FundamentalOf(*a, *b);
    pair.refusal.clear();
    matched[k] = 1;
    MatchAlongEpipolarLines(views[pair.view_a].view,
                            views[pair.view_b].view,
                            plane ? HomographyOf(*a, *b, *plane) : std::nullopt,
                            &pair);
  });
  if (IsStopRequested(stop)) return absl::CancelledError("second pass: cancelled");
  JoinAllTracks(&result);
  result.segment_on_plane = FindSegmentsOnPlane(features, result);
  result.counts["pairs_under_cameras"] =
      static_cast<double>(std::count(matched.begin(), matched.end(), 1));
  return result;
}

}  // namespace horopter
