#include "server/vision/matching/plane_homography.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <set>
#include <utility>

#include "server/base/stop_scope.h"
#include "server/base/target_clones.h"
#include "server/vision/features/image_strips.h"

namespace horopter {
namespace {

constexpr double kMeanSigmaPx = 12.0;       // light changes more slowly than this ...
constexpr double kDeviationSigmaPx = 20.0;  // ... and contrast than this
constexpr double kDeviationFloor = 1.0;     // grey levels: below it there is only noise
constexpr double kBlurSigmaPx = 1.0;        // against the noise that normalising enlarges
constexpr int kBlurSide = 7;                // px; three deviations on each side
constexpr int kReduction = 4;               // of the image for the wide blurs
constexpr double kGreyPerDeviation = 40.0;  // +-3 deviations fill the byte
constexpr int kDescriptorLength = 128;      // of SIFT
// Views from above: of a camera with this focal length, cut where one pixel becomes longer than
// kMaxStretch times what the middle of the image shows.
constexpr double kAssumedFocalWidths = 1.5;
constexpr double kMaxStretch = 2.5;
constexpr double kAreaGrowth = 1.2;  // pixels of the view from above per pixel of the image
// Px of a view from above; planes seen nearly edge-on would need more.
constexpr int kMaxSide = 3000;
// Larger images are searched for keypoints in tiles, with a margin that the patches of all but the
// largest keypoints fit into.
constexpr int kWholePixels = 400000;
constexpr int kTileWidth = 640;
constexpr int kTileHeight = 480;
constexpr int kTileMargin = 48;
constexpr int kBorderPx = 4;  // points this close to the cut are left out

struct Keypoints {
  std::vector<cv::KeyPoint> points;
  cv::Mat descriptors;  // a row each
};

// Empty for images too small for one octave.
Keypoints Sift(const cv::Mat& grey, const cv::Mat& within, const MatchingOptions& options) {
  Keypoints found;
  try {
    const auto sift = cv::SIFT::create(options.max_keypoints, 3, options.sift_contrast, 10.0, 1.6);
    sift->detectAndCompute(grey, within, found.points, found.descriptors);
  } catch (const cv::Exception&) {
    return {};
  }
  return found;
}

// The strongest of all tiles, each searched with a margin: what SIFT does to a whole image at a
// time would keep a call that is cancelled.
Keypoints SiftInTiles(const cv::Mat& grey, const cv::Mat& within, const MatchingOptions& options) {
  const int across = (grey.cols + kTileWidth - 1) / kTileWidth;
  const int down = (grey.rows + kTileHeight - 1) / kTileHeight;
  std::vector<cv::KeyPoint> points;
  cv::Mat descriptors;
  for (int tile = 0; tile < across * down; ++tile) {
    const int i = tile % across, j = tile / across;
    const cv::Rect core(cv::Point(i * grey.cols / across, j * grey.rows / down),
                        cv::Point((i + 1) * grey.cols / across, (j + 1) * grey.rows / down));
    const cv::Rect searched = cv::Rect(core.tl() - cv::Point(kTileMargin, kTileMargin),
                                       core.br() + cv::Point(kTileMargin, kTileMargin)) &
                              cv::Rect(cv::Point(), grey.size());
    LeaveIfStopped();
    const Keypoints found =
        Sift(grey(searched).clone(), within.empty() ? within : within(searched).clone(), options);
    for (int k = 0; k < found.descriptors.rows; ++k) {
      cv::KeyPoint point = found.points[k];
      point.pt += cv::Point2f(searched.tl());
      // A point between two tiles belongs to one.
      if (!cv::Rect2f(core).contains(point.pt + cv::Point2f(0.5f, 0.5f))) continue;
      points.push_back(point);
      descriptors.push_back(found.descriptors.row(k));
    }
  }
  std::vector<int> order(points.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return points[a].response > points[b].response;
  });
  if (order.size() > static_cast<size_t>(options.max_keypoints))
    order.resize(options.max_keypoints);
  Keypoints strongest;
  for (const int k : order) {
    strongest.points.push_back(points[k]);
    strongest.descriptors.push_back(descriptors.row(k));
  }
  return strongest;
}

// within: CV_8UC1 mask of the pixels whose points are wanted; empty: all.
KeypointSet DetectKeypoints(const cv::Mat& grey,
                            const cv::Mat& within,
                            const MatchingOptions& options) {
  KeypointSet set;
  const bool large = static_cast<int>(grey.total()) > kWholePixels;
  const auto [keypoints, descriptors] =
      large ? SiftInTiles(grey, within, options) : Sift(grey, within, options);
  const int n = std::min<int>(descriptors.rows, options.max_keypoints);
  set.points.reserve(n);
  set.descriptors.resize(static_cast<size_t>(n) * kDescriptorLength);
  set.squared_norms.resize(n);
  for (int i = 0; i < n; ++i) {
    set.points.emplace_back(keypoints[i].pt.x, keypoints[i].pt.y);
    const float* from = descriptors.ptr<float>(i);
    std::int16_t* to = &set.descriptors[static_cast<size_t>(i) * kDescriptorLength];
    std::int32_t norm = 0;
    for (int k = 0; k < kDescriptorLength; ++k) {
      to[k] = static_cast<std::int16_t>(std::clamp(from[k], 0.0f, 255.0f) + 0.5f);
      norm += to[k] * to[k];
    }
    set.squared_norms[i] = norm;
  }
  return set;
}

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

struct Nearest {
  std::int32_t best = std::numeric_limits<std::int32_t>::max();
  std::int32_t second = std::numeric_limits<std::int32_t>::max();
  int index = -1;

  void Offer(std::int32_t distance, int i) {
    if (distance < best) {
      second = best;
      best = distance;
      index = i;
    } else if (distance < second) {
      second = distance;
    }
  }
};

// Inner products of one descriptor with `count` consecutive ones.
HOROPTER_TARGET_CLONES void Dots(const std::int16_t* a,
                                 const std::int16_t* b,
                                 int count,
                                 std::int32_t* dots) {
  int j = 0;
  for (; j + 4 <= count; j += 4, b += 4 * kDescriptorLength) {
    std::int32_t s0 = 0, s1 = 0, s2 = 0, s3 = 0;
    for (int k = 0; k < kDescriptorLength; ++k) {
      s0 += static_cast<std::int32_t>(a[k]) * b[k];
      s1 += static_cast<std::int32_t>(a[k]) * b[k + kDescriptorLength];
      s2 += static_cast<std::int32_t>(a[k]) * b[k + 2 * kDescriptorLength];
      s3 += static_cast<std::int32_t>(a[k]) * b[k + 3 * kDescriptorLength];
    }
    dots[j] = s0;
    dots[j + 1] = s1;
    dots[j + 2] = s2;
    dots[j + 3] = s3;
  }
  for (; j < count; ++j, b += kDescriptorLength) {
    std::int32_t s = 0;
    for (int k = 0; k < kDescriptorLength; ++k) s += static_cast<std::int32_t>(a[k]) * b[k];
    dots[j] = s;
  }
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

std::vector<PointPair> InliersOf(const Eigen::Matrix3d& H,
                                 const std::vector<PointPair>& pairs,
                                 double max_px) {
  const Eigen::Matrix3d H_inverse = H.inverse();
  std::vector<PointPair> inliers;
  for (const PointPair& p : pairs) {
    if (SymmetricTransferError(H, H_inverse, p) < max_px) inliers.push_back(p);
  }
  return inliers;
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
  KeypointSet set = DetectKeypoints(grey, {}, options);
  for (Eigen::Vector2d& p : set.points) p = FullSize(p, scale);
  return set;
}

KeypointSet DetectKeypointsFromAbove(const cv::Mat& grey,
                                     double scale,
                                     double elevation_rad,
                                     const MatchingOptions& options) {
  const auto above = LookFromAbove(grey, elevation_rad);
  if (!above) return {};
  KeypointSet set = DetectKeypoints(above->grey, above->within, options);
  const Eigen::Matrix3d image_from_above = above->above_from_image.inverse();
  for (Eigen::Vector2d& p : set.points) p = FullSize(Transfer(image_from_above, p), scale);
  return set;
}

std::vector<PointPair> MatchKeypoints(const KeypointSet& a, const KeypointSet& b, double ratio) {
  std::vector<Nearest> of_a(a.size()), of_b(b.size());
  constexpr int kBlock = 64;  // rows of b that stay in the cache while all of a passes
  for (int j0 = 0; j0 < b.size(); j0 += kBlock) {
    LeaveIfStopped();
    const int j1 = std::min(j0 + kBlock, b.size());
    for (int i = 0; i < a.size(); ++i) {
      std::int32_t dots[kBlock];
      Dots(&a.descriptors[static_cast<size_t>(i) * kDescriptorLength],
           &b.descriptors[static_cast<size_t>(j0) * kDescriptorLength],
           j1 - j0,
           dots);
      for (int j = j0; j < j1; ++j) {
        const std::int32_t distance = a.squared_norms[i] + b.squared_norms[j] - 2 * dots[j - j0];
        of_a[i].Offer(distance, j);
        of_b[j].Offer(distance, i);
      }
    }
  }
  std::vector<std::pair<double, int>> order;
  for (int i = 0; i < a.size(); ++i) {
    const Nearest& n = of_a[i];
    if (n.index < 0 || of_b[n.index].index != i) continue;
    const double squared_ratio = n.best / std::max(1.0, static_cast<double>(n.second));
    if (squared_ratio < ratio * ratio) order.emplace_back(squared_ratio, i);
  }
  std::sort(order.begin(), order.end());
  std::vector<PointPair> pairs;
  pairs.reserve(order.size());
  for (const auto& [unused, i] : order) pairs.push_back({a.points[i], b.points[of_a[i].index]});
  return pairs;
}

std::optional<PlaneEstimate> EstimatePlane(const std::vector<PointPair>& pairs,
                                           const MatchingOptions& options) {
  if (static_cast<int>(pairs.size()) < options.min_plane_inliers) return std::nullopt;
  std::vector<cv::Point2d> from, to;
  for (const PointPair& p : pairs) {
    from.emplace_back(p.a.x(), p.a.y());
    to.emplace_back(p.b.x(), p.b.y());
  }
  cv::UsacParams usac;
  usac.confidence = 0.999;
  usac.isParallel = false;
  usac.maxIterations = 5000;
  usac.randomGeneratorState = static_cast<int>(options.seed);
  usac.sampler = cv::SAMPLING_UNIFORM;
  usac.score = cv::SCORE_METHOD_MAGSAC;
  usac.loMethod = cv::LOCAL_OPTIM_SIGMA;
  usac.loIterations = 10;
  usac.threshold = options.ransac_px;
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
    plane.inliers = DistinctPairs(InliersOf(H, pairs, options.ransac_px));
    if (static_cast<int>(plane.inliers.size()) < options.min_plane_inliers) return std::nullopt;
    H = RefineHomography(H, plane.inliers);
  }
  plane.b_from_a = H;
  if (!ImplausibleHomography(H, plane.inliers).empty()) return std::nullopt;
  return plane;
}

}  // namespace horopter
