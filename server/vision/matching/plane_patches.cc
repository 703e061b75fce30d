#include "server/vision/matching/plane_patches.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

namespace horopter {
namespace {

constexpr int kSide = 16;  // of a patch, pixels of its level
constexpr int kPixels = kSide * kSide;
constexpr int kMaxSearch = 13;          // positions along one axis
constexpr double kMinDeviation = 12.0;  // grey levels of the normalised image, of a patch
constexpr double kMaxAreaChange = 12.0;
constexpr int kRefits = 3;
constexpr std::size_t kMinInliers = 8;

// One search: every patch within `radius` of where the homography puts it, then a refit to those
// within `inlier_px` of it. In pixels of the level.
struct Round {
  int level;
  int step;
  int radius;
  double inlier_px;
};
constexpr Round kRounds[] = {{1, 10, 6, 2.5}, {1, 10, 3, 1.5}, {0, 14, 3, 1.0}};
constexpr double kLastInlierPx = 1.0;

struct Template {
  float value[kPixels];  // zero mean, unit norm
  // Structure tensor over its larger eigenvalue: 1 across the patch's edges, less along them.
  Eigen::Matrix2d information;
};

struct PatchMatch {
  PointPair pair;
  Eigen::Matrix2d information;  // of the point in b
};

Eigen::Matrix2d RelativeStructure(const float* value) {
  double xx = 0, xy = 0, yy = 0;
  for (int v = 1; v + 1 < kSide; ++v) {
    for (int u = 1; u + 1 < kSide; ++u) {
      const float* at = value + v * kSide + u;
      const double dx = at[1] - at[-1], dy = at[kSide] - at[-kSide];
      xx += dx * dx, xy += dx * dy, yy += dy * dy;
    }
  }
  const double mean = (xx + yy) / 2, half = std::hypot((xx - yy) / 2, xy);
  Eigen::Matrix2d tensor;
  tensor << xx, xy, xy, yy;
  return tensor / std::max(1e-12, mean + half);
}

// Values of image a about `center`, sampled along the axes of b. False off the image or without
// structure.
bool SampleTemplate(const cv::Mat& a,
                    const Eigen::Vector2d& center,
                    const Eigen::Matrix2d& a_from_b,
                    Template* out) {
  const Eigen::Vector2d x_step = a_from_b.col(0), y_step = a_from_b.col(1);
  const Eigen::Vector2d first = center - 0.5 * (kSide - 1) * (x_step + y_step);
  for (const double u : {0.0, kSide - 1.0}) {
    for (const double v : {0.0, kSide - 1.0}) {
      const Eigen::Vector2d p = first + u * x_step + v * y_step;
      if (!(p.x() >= 0 && p.y() >= 0 && p.x() < a.cols - 1 && p.y() < a.rows - 1)) return false;
    }
  }
  double sum = 0.0;
  for (int v = 0; v < kSide; ++v) {
    for (int u = 0; u < kSide; ++u) {
      const Eigen::Vector2d p = first + u * x_step + v * y_step;
      const int x = static_cast<int>(p.x()), y = static_cast<int>(p.y());
      const float fx = static_cast<float>(p.x() - x), fy = static_cast<float>(p.y() - y);
      const float* row = a.ptr<float>(y) + x;
      const float* below = a.ptr<float>(y + 1) + x;
      const float value =
          (1 - fy) * ((1 - fx) * row[0] + fx * row[1]) + fy * ((1 - fx) * below[0] + fx * below[1]);
      out->value[v * kSide + u] = value;
      sum += value;
    }
  }
  const float mean = static_cast<float>(sum / kPixels);
  double squares = 0.0;
  for (float& value : out->value) {
    value -= mean;
    squares += static_cast<double>(value) * value;
  }
  if (squares < kPixels * kMinDeviation * kMinDeviation) return false;
  const float scale = static_cast<float>(1.0 / std::sqrt(squares));
  for (float& value : out->value) value *= scale;
  out->information = RelativeStructure(out->value);
  return true;
}

double WindowSum(const cv::Mat& integral, int x, int y) {
  return integral.at<double>(y + kSide, x + kSide) - integral.at<double>(y, x + kSide) -
         integral.at<double>(y + kSide, x) + integral.at<double>(y, x);
}

// Normalised correlation with the window of b whose first pixel is (x, y).
float Correlate(const PatchImage::Level& b, const Template& t, int x, int y) {
  float sums[kSide] = {};
  for (int v = 0; v < kSide; ++v) {
    const float* row = b.value.ptr<float>(y + v) + x;
    const float* of_template = t.value + v * kSide;
    for (int u = 0; u < kSide; ++u) sums[u] += of_template[u] * row[u];
  }
  float product = 0.0f;
  for (float s : sums) product += s;
  const double mean = WindowSum(b.sum, x, y) / kPixels;
  const double spread = WindowSum(b.squares, x, y) - mean * mean * kPixels;
  if (spread < kPixels * kMinDeviation * kMinDeviation) return 0.0f;
  return product / static_cast<float>(std::sqrt(spread));
}

// Where the template is found near `start` (first pixel of the window), with sub-pixel parabolas.
bool Search(const PatchImage::Level& b,
            const Template& t,
            int start_x,
            int start_y,
            int radius,
            const AlignOptions& options,
            Eigen::Vector2d* shift) {
  const int side = 2 * radius + 1;
  float map[kMaxSearch * kMaxSearch] = {};
  if (start_x - radius < 0 || start_y - radius < 0 || start_x + radius + kSide > b.value.cols ||
      start_y + radius + kSide > b.value.rows) {
    return false;
  }
  int best = 0;
  for (int k = 0; k < side * side; ++k) {
    map[k] = Correlate(b, t, start_x + k % side - radius, start_y + k / side - radius);
    if (map[k] > map[best]) best = k;
  }
  if (map[best] < options.min_correlation) return false;
  const int bx = best % side, by = best / side;
  if (bx == 0 || by == 0 || bx == side - 1 || by == side - 1) return false;
  const auto vertex = [](float before, float at, float after) {
    const float curvature = before - 2 * at + after;
    return curvature < 0 ? 0.5 * (before - after) / curvature : 0.0;
  };
  *shift = Eigen::Vector2d(bx - radius + vertex(map[best - 1], map[best], map[best + 1]),
                           by - radius + vertex(map[best - side], map[best], map[best + side]));
  return true;
}

Eigen::Matrix3d AtLevel(const Eigen::Matrix3d& H, int level) {
  // Pixel centres are whole numbers: u_half = (u - 0.5) / 2.
  Eigen::Matrix3d half = Eigen::Matrix3d::Identity();
  if (level == 1) half << 0.5, 0, -0.25, 0, 0.5, -0.25, 0, 0, 1;
  return half * H * half.inverse();
}

Eigen::Vector2d FullPixel(const Eigen::Vector2d& x, int level) {
  return level == 1 ? Eigen::Vector2d(2 * x.x() + 0.5, 2 * x.y() + 0.5) : x;
}

std::vector<PatchMatch> MatchPatches(const PatchImage& a,
                                     const PatchImage& b,
                                     const Eigen::Matrix3d& b_from_a,
                                     const Round& round,
                                     const AlignOptions& options) {
  const PatchImage::Level& level_a = a.levels[round.level];
  const PatchImage::Level& level_b = b.levels[round.level];
  const Eigen::Matrix3d H = AtLevel(b_from_a, round.level);
  std::vector<PatchMatch> matches;
  Template t;
  for (int y = kSide / 2; y < level_a.value.rows - kSide / 2; y += round.step) {
    for (int x = kSide / 2; x < level_a.value.cols - kSide / 2; x += round.step) {
      // The same points in all pairs of a view, so that they become tracks through many views.
      const Eigen::Vector2d center(x, y);
      const Eigen::Vector2d at = Transfer(H, center);
      if (!(at.x() >= 0 && at.y() >= 0 && at.x() < level_b.value.cols &&
            at.y() < level_b.value.rows)) {
        continue;
      }
      // The window's middle lies between pixels.
      const int first_x = static_cast<int>(at.x()) - kSide / 2 + 1;
      const int first_y = static_cast<int>(at.y()) - kSide / 2 + 1;
      const Eigen::Vector2d middle(first_x + 0.5 * (kSide - 1), first_y + 0.5 * (kSide - 1));
      const Eigen::Matrix2d a_from_b = TransferJacobian(H, center).inverse();
      const double area = std::abs(a_from_b.determinant());
      if (!(area < kMaxAreaChange && area > 1.0 / kMaxAreaChange)) continue;
      if (!SampleTemplate(level_a.value, center, a_from_b, &t)) continue;
      Eigen::Vector2d shift;
      if (!Search(level_b, t, first_x, first_y, round.radius, options, &shift)) continue;
      matches.push_back({{FullPixel(center, round.level), FullPixel(middle + shift, round.level)},
                         t.information});
    }
  }
  return matches;
}

std::vector<PatchMatch> Within(double limit_px,
                               const Eigen::Matrix3d& H,
                               const std::vector<PatchMatch>& matches) {
  std::vector<PatchMatch> within;
  for (const PatchMatch& m : matches) {
    const Eigen::Vector2d e = m.pair.b - Transfer(H, m.pair.a);
    if (e.dot(m.information * e) < limit_px * limit_px) within.push_back(m);
  }
  return within;
}

// One Gauss-Newton step is enough: the matches are searched again before they are believed.
Eigen::Matrix3d Refit(const Eigen::Matrix3d& H, const std::vector<PatchMatch>& matches) {
  // Centred and scaled coordinates keep the normal equations well conditioned.
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const PatchMatch& m : matches) mean += m.pair.a / static_cast<double>(matches.size());
  constexpr double kScale = 1.0 / 200.0;
  Eigen::Matrix3d T;
  T << kScale, 0, -kScale * mean.x(), 0, kScale, -kScale * mean.y(), 0, 0, 1;
  Eigen::Matrix3d G = H * T.inverse();
  G /= G(2, 2);
  Eigen::Matrix<double, 8, 8> A = Eigen::Matrix<double, 8, 8>::Zero();
  Eigen::Matrix<double, 8, 1> g = Eigen::Matrix<double, 8, 1>::Zero();
  for (const PatchMatch& m : matches) {
    const Eigen::Vector3d a = (T * m.pair.a.homogeneous());
    const Eigen::Vector3d y = G * a;
    const Eigen::Vector2d p = y.head<2>() / y.z();
    Eigen::Matrix<double, 2, 8> J = Eigen::Matrix<double, 2, 8>::Zero();
    J.block<1, 3>(0, 0) = a.transpose() / y.z();
    J.block<1, 3>(1, 3) = a.transpose() / y.z();
    J.block<2, 2>(0, 6) = -(p / y.z()) * a.head<2>().transpose();
    A += J.transpose() * m.information * J;
    g += J.transpose() * m.information * (m.pair.b - p);
  }
  A.diagonal() *= 1.0 + 1e-9;
  const Eigen::Matrix<double, 8, 1> step = A.ldlt().solve(g);
  if (!step.allFinite()) return H;
  G.row(0) += step.head<3>().transpose();
  G.row(1) += step.segment<3>(3).transpose();
  G.block<1, 2>(2, 0) += step.tail<2>().transpose();
  return NormalizeDeterminant(G * T).value_or(H);
}

}  // namespace

PatchImage PreparePatches(const cv::Mat& image) {
  cv::Mat grey = image;
  if (image.channels() == 3) cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  PatchImage out;
  NormalizeLocalContrast(grey).convertTo(out.levels[0].value, CV_32F);
  const cv::Size half(std::max(1, grey.cols / 2), std::max(1, grey.rows / 2));
  cv::resize(out.levels[0].value, out.levels[1].value, half, 0, 0, cv::INTER_AREA);
  for (PatchImage::Level& level : out.levels)
    cv::integral(level.value, level.sum, level.squares, CV_64F, CV_64F);
  return out;
}

PlaneAlignment AlignPlane(const PatchImage& a,
                          const PatchImage& b,
                          const Eigen::Matrix3d& b_from_a,
                          const AlignOptions& options) {
  PlaneAlignment out;
  Eigen::Matrix3d& H = out.estimate.b_from_a;
  H = b_from_a;
  std::vector<PatchMatch> matches, inliers;
  for (const Round& round : kRounds) {
    matches = MatchPatches(a, b, H, round, options);
    out.matched = static_cast<int>(matches.size());
    const double limit = round.inlier_px * (1 << round.level);
    for (int k = 0; k < kRefits; ++k) {
      // What is left of the search is not known yet: the first refit is generous.
      inliers = Within(k == 0 ? 3.0 * limit : limit, H, matches);
      if (inliers.size() < kMinInliers) return out;
      H = Refit(H, inliers);
    }
  }
  for (PatchMatch m : Within(kLastInlierPx, H, matches)) {
    // Along an edge nothing was measured: there the homography speaks.
    const Eigen::Vector2d expected = Transfer(H, m.pair.a);
    m.pair.b = expected + m.information * (m.pair.b - expected);
    out.estimate.inliers.push_back(m.pair);
  }
  return out;
}

}  // namespace horopter
