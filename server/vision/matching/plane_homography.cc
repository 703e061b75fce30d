#include "server/vision/matching/plane_homography.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <set>
#include <utility>

#include "server/vision/features/image_strips.h"
#include "server/vision/matching/usac.h"

namespace horopter {
namespace {

constexpr double kMeanSigmaPx = 12.0;       // light changes more slowly than this ...
constexpr double kDeviationSigmaPx = 20.0;  // ... and contrast than this
constexpr double kDeviationFloor = 1.0;     // grey levels: below it there is only noise
constexpr double kBlurSigmaPx = 1.0;        // against the noise that normalising enlarges
constexpr int kBlurSide = 7;                // px; three deviations on each side
constexpr int kReduction = 4;               // of the image for the wide blurs
constexpr double kGreyPerDeviation = 40.0;  // +-3 deviations fill the byte
// Views from above: of a camera with this focal length, cut where one pixel becomes longer than
// kMaxStretch times what the middle of the image shows.
constexpr double kAssumedFocalWidths = 1.5;
constexpr double kMaxStretch = 2.5;
constexpr double kAreaGrowth = 1.2;  // pixels of the view from above per pixel of the image
// Px of a view from above; planes seen nearly edge-on would need more.
constexpr int kMaxSide = 3000;
constexpr int kBorderPx = 4;  // points this close to the cut are left out

// The image as a camera turned to look straight down sees it, and the homography from the image.
struct ViewFromAbove {
  cv::Mat grey;
  cv::Mat within;
  Eigen::Matrix3d above_from_image = Eigen::Matrix3d::Identity();
};

// elevation_rad: assumed angle between the optical axis and the plane, image upright. nullopt when
// the view would be empty or too large.
std::optional<ViewFromAbove> LookFromAbove(const cv::Mat& grey, double elevation_rad) {
  const double w = grey.cols, h = grey.rows, f = kAssumedFocalWidths * w;
  Eigen::Matrix3d K;
  K << f, 0, w / 2, 0, f, h / 2, 0, 0, 1;
  const double c = std::sin(elevation_rad), s = std::cos(elevation_rad);
  Eigen::Matrix3d R;
  R << 1, 0, 0, 0, c, -s, 0, s, c;
  const Eigen::Matrix3d W = K * R * K.inverse();
  const auto stretch = [&](double y) {
    const double z = W.row(2).dot(Eigen::Vector3d(w / 2, y, 1));
    return z > 0 ? 1.0 / z : std::numeric_limits<double>::infinity();
  };
  // Rows above the cut are too near to the horizon.
  const double limit = kMaxStretch * stretch(h / 2);
  int top = 0;
  while (top < grey.rows / 2 && stretch(top) > limit) top += 4;
  Eigen::AlignedBox2d box;
  for (const double y : {static_cast<double>(top), h - 1}) {
    for (const double x : {0.0, w - 1}) box.extend((W * Eigen::Vector3d(x, y, 1)).hnormalized());
  }
  const Eigen::Vector2d extent = box.sizes();
  if (!(extent.x() > 0 && extent.y() > 0)) return std::nullopt;
  const double scale = std::sqrt(kAreaGrowth * w * h / (extent.x() * extent.y()));
  const int width = static_cast<int>(std::ceil(std::min(1e6, scale * extent.x())));
  const int height = static_cast<int>(std::ceil(std::min(1e6, scale * extent.y())));
  if (width > kMaxSide || height > kMaxSide) return std::nullopt;
  Eigen::Matrix3d S;
  S << scale, 0, -scale * box.min().x(), 0, scale, -scale * box.min().y(), 0, 0, 1;
  ViewFromAbove view;
  view.above_from_image = S * W;
  cv::Matx33d M;
  for (int r = 0; r < 3; ++r) {
    for (int k = 0; k < 3; ++k) M(r, k) = view.above_from_image(r, k);
  }
  cv::Mat shown(grey.size(), CV_8UC1, cv::Scalar(255));
  shown.rowRange(0, top).setTo(0);
  const cv::Size size(width, height);
  cv::warpPerspective(grey, view.grey, M, size, cv::INTER_LINEAR, cv::BORDER_CONSTANT, 128);
  cv::warpPerspective(shown, view.within, M, size, cv::INTER_NEAREST);
  cv::erode(view.within, view.within, cv::Mat::ones(2 * kBorderPx + 1, 2 * kBorderPx + 1, CV_8UC1));
  return view;
}

// Pixel of the image from that of a version of it at `scale` of its size; pixel centres are whole
// numbers.
Eigen::Vector2d FullSize(const Eigen::Vector2d& x, double scale) {
  return ((x.array() + 0.5) / scale - 0.5).matrix();
}

// Several descriptors at one place (SIFT's second orientations) are one observation.
std::vector<PointPair> DistinctPairs(std::vector<PointPair> pairs) {
  std::set<std::pair<std::int64_t, std::int64_t>> seen_a, seen_b;
  const auto cell = [](const Eigen::Vector2d& x) {
    return std::make_pair(std::llround(x.x() * 2.0), std::llround(x.y() * 2.0));
  };
  std::vector<PointPair> distinct;
  for (const PointPair& p : pairs) {
    if (seen_a.insert(cell(p.a)).second && seen_b.insert(cell(p.b)).second) distinct.push_back(p);
  }
  return distinct;
}

std::vector<PointPair> InliersOfPlane(const Eigen::Matrix3d& H,
                                      const std::vector<PointPair>& pairs,
                                      double max_px) {
  const Eigen::Matrix3d H_inverse = H.inverse();
  std::vector<PointPair> inliers;
  for (const PointPair& p : pairs) {
    if (SymmetricTransferError(H, H_inverse, p) < max_px) inliers.push_back(p);
  }
  return inliers;
}

KeypointOptions KeypointsOf(const MatchingOptions& options) {
  return {.max_keypoints = options.max_keypoints, .contrast = options.sift_contrast};
}

// Gaussian of many pixels, taken at reduced size, where it loses nothing.
cv::Mat WideBlur(const cv::Mat& value, double sigma_px) {
  const cv::Mat blurred = BlurInStrips(
      ShrinkInStrips(value, kReduction), cv::Size(), sigma_px / kReduction, cv::BORDER_REFLECT);
  return EnlargeInStrips(blurred, kReduction, value.size());
}

}  // namespace

cv::Mat NormalizeLocalContrast(const cv::Mat& grey) {
  cv::Mat value = ConvertInStrips(grey, CV_32F);
  const cv::Mat mean = WideBlur(value, kMeanSigmaPx);
  cv::Mat square(value.size(), value.type());
  ForEachStrip(value.size(), [&](const cv::Range& rows) {
    cv::Mat of_value = value.rowRange(rows), of_square = square.rowRange(rows);
    of_value -= mean.rowRange(rows);
    cv::multiply(of_value, of_value, of_square);
  });
  cv::Mat deviation = WideBlur(square, kDeviationSigmaPx);
  ForEachStrip(value.size(), [&](const cv::Range& rows) {
    cv::Mat of_value = value.rowRange(rows), of_deviation = deviation.rowRange(rows);
    cv::sqrt(of_deviation, of_deviation);
    cv::max(of_deviation, kDeviationFloor, of_deviation);
    cv::divide(of_value, of_deviation, of_value);
  });
  const cv::Mat smooth = BlurInStrips(value, cv::Size(kBlurSide, kBlurSide), kBlurSigmaPx);
  return ConvertInStrips(smooth, CV_8U, kGreyPerDeviation, 128.0);
}

KeypointSet DetectPlaneKeypoints(const cv::Mat& grey,
                                 double scale,
                                 const MatchingOptions& options) {
  KeypointSet set = DetectKeypoints(grey, {}, KeypointsOf(options));
  for (Eigen::Vector2d& p : set.points) p = FullSize(p, scale);
  return set;
}

KeypointSet DetectKeypointsFromAbove(const cv::Mat& grey,
                                     double scale,
                                     double elevation_rad,
                                     const MatchingOptions& options) {
  const auto above = LookFromAbove(grey, elevation_rad);
  if (!above) return {};
  KeypointSet set = DetectKeypoints(above->grey, above->within, KeypointsOf(options));
  const Eigen::Matrix3d image_from_above = above->above_from_image.inverse();
  for (Eigen::Vector2d& p : set.points) p = FullSize(Transfer(image_from_above, p), scale);
  return set;
}

std::optional<PlaneEstimate> EstimatePlane(const std::vector<PointPair>& pairs,
                                           const MatchingOptions& options) {
  if (static_cast<int>(pairs.size()) < options.min_plane_inliers) return std::nullopt;
  std::vector<cv::Point2d> from, to;
  for (const PointPair& p : pairs) {
    from.emplace_back(p.a.x(), p.a.y());
    to.emplace_back(p.b.x(), p.b.y());
  }
  const cv::UsacParams usac = Magsac(options.ransac_px, 0.999, 5000, options.seed);
  cv::Mat mask, estimate;
  try {
    estimate = cv::findHomography(from, to, mask, usac);
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  if (estimate.rows != 3 || estimate.cols != 3) return std::nullopt;
  Eigen::Matrix3d H;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) H(r, c) = estimate.at<double>(r, c);
  }
  PlaneEstimate plane;
  for (int round = 0; round < 3; ++round) {
    plane.inliers = DistinctPairs(InliersOfPlane(H, pairs, options.ransac_px));
    if (static_cast<int>(plane.inliers.size()) < options.min_plane_inliers) return std::nullopt;
    H = RefineHomography(H, plane.inliers);
  }
  plane.b_from_a = H;
  if (!ImplausibleHomography(H, plane.inliers).empty()) return std::nullopt;
  return plane;
}

}  // namespace horopter
