#include "server/vision/matching/plane_patches.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <opencv2/imgproc.hpp>
#include <span>
#include <utility>
#include <vector>

#include "server/base/stop_scope.h"
#include "server/base/target_clones.h"
#include "server/vision/features/image_strips.h"

namespace horopter {
namespace {

constexpr int kPatchSide = 16;                    // of a patch, pixels of its level
constexpr int kPixels = kPatchSide * kPatchSide;  // of a patch
constexpr int kPatchLanes = 8;                    // positions correlated at once along a row
constexpr double kMinPatchDeviation = 12.0;       // grey levels of the normalised image, of a patch
constexpr int kPadding = 24;       // columns and rows a block may read beyond its windows
constexpr double kMiddle = 128.0;  // of the normalised image
// Between two views: a patch stretched more shows other texture.
constexpr double kMaxAreaChange = 12.0;
constexpr int kRefits = 3;              // of the homography in a round
constexpr std::size_t kMinInliers = 8;  // twice what a homography needs

// One search: every patch within `radius` of where the homography puts it, then a refit to those
// within `inlier_px` of it. In pixels of the level.
struct Round {
  int level;
  int step;
  int radius;
  double inlier_px;
};
// Coarse and wide, then fine and narrow; see Round.
constexpr Round kRounds[] = {{1, 14, 6, 3.5}, {1, 14, 6, 2.5}, {1, 14, 3, 1.5}, {0, 14, 3, 1.0}};
constexpr double kLastInlierPx = 1.0;   // of the answer, px of the full image
constexpr double kMaxPatches = 1600.0;  // of one search, about

struct Template {
  float value[kPixels];  // zero mean, unit norm
};

struct PatchMatch {
  PointPair pair;
  Eigen::Matrix2d information;  // of the point in b
};

// Structure tensor over its larger eigenvalue: 1 across the patch's edges, less along them.
Eigen::Matrix2d RelativeStructure(const float* value) {
  double xx = 0, xy = 0, yy = 0;
  for (int v = 1; v + 1 < kPatchSide; ++v) {
    for (int u = 1; u + 1 < kPatchSide; ++u) {
      const float* at = value + v * kPatchSide + u;
      const double dx = at[1] - at[-1], dy = at[kPatchSide] - at[-kPatchSide];
      xx += dx * dx, xy += dx * dy, yy += dy * dy;
    }
  }
  const double mean = (xx + yy) / 2, half = std::hypot((xx - yy) / 2, xy);
  Eigen::Matrix2d tensor;
  tensor << xx, xy, xy, yy;
  return tensor / std::max(1e-12, mean + half);
}

// Bilinear values at first + u x_step + v y_step (pixels), row by row.
HOROPTER_TARGET_CLONES void SampleGrid(const float* origin,
                                       int stride,
                                       const Eigen::Vector2f& first,
                                       const Eigen::Vector2f& x_step,
                                       const Eigen::Vector2f& y_step,
                                       float* values) {
  for (int v = 0; v < kPatchSide; ++v, values += kPatchSide) {
    const float row_x = first.x() + static_cast<float>(v) * y_step.x();
    const float row_y = first.y() + static_cast<float>(v) * y_step.y();
    int offset[kPatchSide];
    float fx[kPatchSide], fy[kPatchSide];
    for (int u = 0; u < kPatchSide; ++u) {
      const float px = row_x + static_cast<float>(u) * x_step.x();
      const float py = row_y + static_cast<float>(u) * x_step.y();
      const int x = static_cast<int>(px), y = static_cast<int>(py);
      fx[u] = px - static_cast<float>(x);
      fy[u] = py - static_cast<float>(y);
      offset[u] = y * stride + x;
    }
    float corner[4][kPatchSide];
    for (int u = 0; u < kPatchSide; ++u) {
      const float* at = origin + offset[u];
      corner[0][u] = at[0], corner[1][u] = at[1];
      corner[2][u] = at[stride], corner[3][u] = at[stride + 1];
    }
    for (int u = 0; u < kPatchSide; ++u) {
      const float above = corner[0][u] + fx[u] * (corner[1][u] - corner[0][u]);
      const float below = corner[2][u] + fx[u] * (corner[3][u] - corner[2][u]);
      values[u] = above + fy[u] * (below - above);
    }
  }
}

// To zero mean and unit norm. Returns the squared norm before.
HOROPTER_TARGET_CLONES float Normalize(float* values) {
  float sums[kPatchSide] = {}, squares[kPatchSide] = {};
  for (int v = 0; v < kPatchSide; ++v) {
    for (int u = 0; u < kPatchSide; ++u) sums[u] += values[v * kPatchSide + u];
  }
  float sum = 0.0f, square = 0.0f;
  for (const float s : sums) sum += s;
  const float mean = sum / kPixels;
  for (int v = 0; v < kPatchSide; ++v) {
    for (int u = 0; u < kPatchSide; ++u) {
      values[v * kPatchSide + u] -= mean;
      squares[u] += values[v * kPatchSide + u] * values[v * kPatchSide + u];
    }
  }
  for (const float s : squares) square += s;
  const float scale = 1.0f / std::sqrt(square);
  for (int k = 0; k < kPixels; ++k) values[k] *= scale;
  return square;
}

// Values of image a about `center`, sampled along the axes of b. False off the image or without
// structure.
bool SampleTemplate(const PatchImage::Level& a,
                    const Eigen::Vector2d& center,
                    const Eigen::Matrix2d& a_from_b,
                    Template* out) {
  const Eigen::Vector2d x_step = a_from_b.col(0), y_step = a_from_b.col(1);
  const Eigen::Vector2d first = center - 0.5 * (kPatchSide - 1) * (x_step + y_step);
  const int cols = a.inverse_spread.cols, rows = a.inverse_spread.rows;
  for (const double u : {0.0, kPatchSide - 1.0}) {
    for (const double v : {0.0, kPatchSide - 1.0}) {
      const Eigen::Vector2d p = first + u * x_step + v * y_step;
      if (!(p.x() >= 0 && p.y() >= 0 && p.x() < cols - 1 && p.y() < rows - 1)) return false;
    }
  }
  SampleGrid(a.value.ptr<float>(),
             static_cast<int>(a.value.step1()),
             first.cast<float>(),
             x_step.cast<float>(),
             y_step.cast<float>(),
             out->value);
  return Normalize(out->value) >= kPixels * kMinPatchDeviation * kMinPatchDeviation;
}

using Lanes = float __attribute__((vector_size(kPatchLanes * sizeof(float))));

// Inner products of the template with the kPatchLanes windows that begin at `at`, one pixel apart,
// and with those of the following rows: products[row][lane].
template <int kRows>
inline __attribute__((always_inline)) void CorrelateRows(const float* value,
                                                         const float* at,
                                                         std::ptrdiff_t stride,
                                                         float (*products)[kPatchLanes]) {
  Lanes sums[kRows] = {};
  for (int v = 0; v < kPatchSide; ++v) {
    for (int u = 0; u < kPatchSide; ++u) {
      const float weight = value[v * kPatchSide + u];
      for (int r = 0; r < kRows; ++r) {
        Lanes window;
        std::memcpy(&window, at + (v + r) * stride + u, sizeof(window));
        sums[r] += weight * window;
      }
    }
  }
  std::memcpy(products, sums, sizeof(sums));
}

constexpr int kBlockRows = 7;  // as many sums as registers hold

HOROPTER_TARGET_CLONES void CorrelateBlock(const float* value,
                                           const float* at,
                                           std::ptrdiff_t stride,
                                           float (*products)[kPatchLanes]) {
  CorrelateRows<kBlockRows>(value, at, stride, products);
}

constexpr int kMaxSearch = 2 * kBlockRows;   // positions along one axis, padded to whole blocks
constexpr int kMapStride = 2 * kPatchLanes;  // floats of a row of positions, in whole vectors

// Repeated texture: a patch is compared with its own image at a quarter of the size, up to
// kSelfRadius away.
constexpr int kSelfRadius = 24;
constexpr int kSelfSide = 2 * kSelfRadius + 1;
constexpr int kSelfPatches = 11;           // along a row of the image, at most
constexpr int kSelfPeak = 3;               // half side of the peak of the patch itself
constexpr float kSelfCorrelation = 0.85f;  // at another place, to count as the patch again
constexpr int kSelfLeast = 8;              // patches asked; of fewer no share is told

// Normalised correlations with the side x side windows of b from (first_x, first_y) on.
template <int kStride>
void CorrelationMap(const PatchImage::Level& b,
                    const Template& t,
                    int first_x,
                    int first_y,
                    int side,
                    float (*map)[kStride]) {
  const std::ptrdiff_t stride = static_cast<std::ptrdiff_t>(b.value.step1());
  for (int y = 0; y < side; y += kBlockRows) {
    for (int x = 0; x < side; x += kPatchLanes) {
      float products[kBlockRows][kPatchLanes];
      CorrelateBlock(t.value, b.value.ptr<float>(first_y + y) + first_x + x, stride, products);
      for (int r = 0; r < kBlockRows && y + r < side; ++r) {
        const float* inverse = b.inverse_spread.ptr<float>(first_y + y + r) + first_x + x;
        for (int k = 0; k < kPatchLanes; ++k) map[y + r][x + k] = products[r][k] * inverse[k];
      }
    }
  }
}

// Where the template is found near `start` (first pixel of the window), with sub-pixel parabolas.
bool SearchShift(const PatchImage::Level& b,
                 const Template& t,
                 int start_x,
                 int start_y,
                 int radius,
                 const AlignOptions& options,
                 Eigen::Vector2d* shift) {
  const int side = 2 * radius + 1;
  if (start_x - radius < 0 || start_y - radius < 0 ||
      start_x + radius + kPatchSide > b.inverse_spread.cols ||
      start_y + radius + kPatchSide > b.inverse_spread.rows) {
    return false;
  }
  float map[kMaxSearch][kMapStride];
  CorrelationMap(b, t, start_x - radius, start_y - radius, side, map);
  int bx = 0, by = 0;
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      if (map[y][x] > map[by][bx]) bx = x, by = y;
    }
  }
  if (!(map[by][bx] >= options.min_correlation)) return false;
  if (bx == 0 || by == 0 || bx == side - 1 || by == side - 1) return false;
  const auto vertex = [](float before, float at, float after) {
    const float curvature = before - 2 * at + after;
    return curvature < 0 ? 0.5 * (before - after) / curvature : 0.0;
  };
  *shift = Eigen::Vector2d(bx - radius + vertex(map[by][bx - 1], map[by][bx], map[by][bx + 1]),
                           by - radius + vertex(map[by - 1][bx], map[by][bx], map[by + 1][bx]));
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
  const int rows_a = level_a.inverse_spread.rows, cols_a = level_a.inverse_spread.cols;
  const int rows_b = level_b.inverse_spread.rows, cols_b = level_b.inverse_spread.cols;
  // Large images have no more patches than small ones.
  const double area = static_cast<double>(rows_a) * cols_a;
  const int step = std::max(round.step, static_cast<int>(std::sqrt(area / kMaxPatches)));
  for (int y = kPatchSide / 2; y < rows_a - kPatchSide / 2; y += step) {
    LeaveIfStopped();
    for (int x = kPatchSide / 2; x < cols_a - kPatchSide / 2; x += step) {
      // The same points in all pairs of a view, so that they become tracks through many views.
      const Eigen::Vector2d center(x, y);
      const Eigen::Vector2d at = Transfer(H, center);
      if (!(at.x() >= 0 && at.y() >= 0 && at.x() < cols_b && at.y() < rows_b)) {
        continue;
      }
      // The window's middle lies between pixels.
      const int first_x = static_cast<int>(at.x()) - kPatchSide / 2 + 1;
      const int first_y = static_cast<int>(at.y()) - kPatchSide / 2 + 1;
      const Eigen::Vector2d middle(first_x + 0.5 * (kPatchSide - 1),
                                   first_y + 0.5 * (kPatchSide - 1));
      const Eigen::Matrix2d a_from_b = TransferJacobian(H, center).inverse();
      const double change = std::abs(a_from_b.determinant());
      if (!(change < kMaxAreaChange && change > 1.0 / kMaxAreaChange)) continue;
      if (!SampleTemplate(level_a, center, a_from_b, &t)) continue;
      Eigen::Vector2d shift;
      if (!SearchShift(level_b, t, first_x, first_y, round.radius, options, &shift)) continue;
      matches.push_back({{FullPixel(center, round.level), FullPixel(middle + shift, round.level)},
                         RelativeStructure(t.value)});
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
  constexpr double kScale = 1.0 / 200.0;  // px to numbers of order 1, for conditioning
  Eigen::Matrix3d T;
  T << kScale, 0, -kScale * mean.x(), 0, kScale, -kScale * mean.y(), 0, 0, 1;
  Eigen::Matrix3d G = H * T.inverse();
  G /= G(2, 2);
  // With J = [a' 0 -p_x a2'; 0 a' -p_y a2'] / z all blocks of J'WJ are sums of multiples of aa'.
  Eigen::Matrix3d xx = Eigen::Matrix3d::Zero(), xy = xx, yy = xx, xp = xx, yp = xx, pp = xx;
  Eigen::Vector3d gx = Eigen::Vector3d::Zero(), gy = gx, gp = gx;
  for (const PatchMatch& m : matches) {
    const Eigen::Vector3d a = T * m.pair.a.homogeneous();
    const Eigen::Vector3d y = G * a;
    const Eigen::Vector2d p = y.head<2>() / y.z();
    const Eigen::Matrix2d W = m.information / (y.z() * y.z());
    const Eigen::Vector2d Wp = W * p;
    const Eigen::Vector2d q = m.information * (m.pair.b - p) / y.z();
    const Eigen::Matrix3d aa = a * a.transpose();
    xx += W(0, 0) * aa, xy += W(0, 1) * aa, yy += W(1, 1) * aa;
    xp -= Wp.x() * aa, yp -= Wp.y() * aa, pp += p.dot(Wp) * aa;
    gx += q.x() * a, gy += q.y() * a, gp -= p.dot(q) * a;
  }
  Eigen::Matrix<double, 8, 8> A;
  A << xx, xy, xp.leftCols<2>(), xy, yy, yp.leftCols<2>(), xp.topRows<2>(), yp.topRows<2>(),
      pp.topLeftCorner<2, 2>();
  Eigen::Matrix<double, 8, 1> g;
  g << gx, gy, gp.head<2>();
  A.diagonal() *= 1.0 + 1e-9;
  const Eigen::Matrix<double, 8, 1> step = A.ldlt().solve(g);
  if (!step.allFinite()) return H;
  G.row(0) += step.head<3>().transpose();
  G.row(1) += step.segment<3>(3).transpose();
  G.block<1, 2>(2, 0) += step.tail<2>().transpose();
  return NormalizeDeterminant(G * T).value_or(H);
}

// Sums over kPatchSide neighbours: out[x] = in[x] + ... + in[x + kPatchSide - 1]; the last
// kPatchSide - 1 of `in` are lost.
void SumAlong(std::vector<std::int32_t>* in) {
  for (int step = 1; step < kPatchSide; step *= 2) {
    const int n = static_cast<int>(in->size()) - step;
    std::int32_t* at = in->data();
    for (int x = 0; x < n; ++x) at[x] += at[x + step];
  }
}

// grey: CV_8UC1.
PatchImage::Level PrepareLevel(const cv::Mat& grey) {
  PatchImage::Level level;
  // Blocks of windows read beyond the last one asked for.
  cv::Mat padded;
  cv::copyMakeBorder(
      grey, padded, 0, kPadding, 0, kPadding, cv::BORDER_CONSTANT, cv::Scalar(kMiddle));
  level.value = ConvertInStrips(padded, CV_32F, 1.0, -kMiddle);
  level.inverse_spread.create(grey.size(), CV_32FC1);
  ForEachStrip(grey.size(),
               [&](const cv::Range& rows) { level.inverse_spread.rowRange(rows).setTo(0.0); });
  const int cols = grey.cols;
  std::vector<std::int32_t> column(cols, 0), column_squares(cols, 0), sums, squares;
  for (int y = 0; y < grey.rows; ++y) {
    LeaveIfStopped();
    const float* enter = level.value.ptr<float>(y);
    const float* leave = y >= kPatchSide ? level.value.ptr<float>(y - kPatchSide) : nullptr;
    for (int x = 0; x < cols; ++x) {
      const std::int32_t in = static_cast<std::int32_t>(enter[x]);
      column[x] += in, column_squares[x] += in * in;
    }
    for (int x = 0; leave != nullptr && x < cols; ++x) {
      const std::int32_t out = static_cast<std::int32_t>(leave[x]);
      column[x] -= out, column_squares[x] -= out * out;
    }
    if (y + 1 < kPatchSide || cols < kPatchSide) continue;
    sums = column, squares = column_squares;
    SumAlong(&sums), SumAlong(&squares);
    float* to = level.inverse_spread.ptr<float>(y + 1 - kPatchSide);
    for (int x = 0; x + kPatchSide <= cols; ++x) {
      const float mean = static_cast<float>(sums[x]) / kPixels;
      const float spread = static_cast<float>(squares[x]) - mean * static_cast<float>(sums[x]);
      // Sum of squares of a window of least deviation.
      constexpr float kLeast = kPixels * kMinPatchDeviation * kMinPatchDeviation;
      to[x] = spread < kLeast ? 0.0f : 1.0f / std::sqrt(spread);
    }
  }
  return level;
}

// Whether the template of the window at (x, y) is found again elsewhere about it: a maximum nearly
// as high as its own. Opposite shifts find the same, so half of them are looked at.
bool Repeats(const PatchImage::Level& level, const Template& t, int x, int y) {
  float map[kSelfSide + kBlockRows][kSelfSide + kPatchLanes];
  CorrelationMap(level, t, x - kSelfRadius, y - kSelfRadius, kSelfSide, map);
  for (int v = kSelfRadius; v + 1 < kSelfSide; ++v) {
    for (int u = 1; u + 1 < kSelfSide; ++u) {
      const float at = map[v][u];
      const bool own = v - kSelfRadius <= kSelfPeak && std::abs(u - kSelfRadius) <= kSelfPeak;
      if (own || at < kSelfCorrelation) continue;
      if (at >= std::max({map[v][u - 1], map[v][u + 1], map[v - 1][u], map[v + 1][u]})) return true;
    }
  }
  return false;
}

}  // namespace

cv::Mat HalfSize(const cv::Mat& grey) {
  const cv::Size half(std::max(1, grey.cols / 2), std::max(1, grey.rows / 2));
  const cv::Rect even(
      0, 0, std::min(grey.cols, 2 * half.width), std::min(grey.rows, 2 * half.height));
  if (even.height < 2 || even.width < 2) {
    cv::Mat out;
    cv::resize(grey(even), out, half, 0, 0, cv::INTER_AREA);
    return out;
  }
  return ShrinkInStrips(grey(even), 2);
}

PatchImage PreparePatches(const cv::Mat& image) {
  PatchImage out;
  const cv::Mat grey =
      image.channels() == 3 ? RecolourInStrips(image, cv::COLOR_BGR2GRAY, 1) : image;
  const cv::Mat normalized = NormalizeLocalContrast(grey);
  out.normalized_half = HalfSize(normalized);
  out.normalized_quarter = HalfSize(out.normalized_half);
  out.levels[0] = PrepareLevel(normalized);
  out.levels[1] = PrepareLevel(out.normalized_half);
  return out;
}

double RepeatedShare(const PatchImage& image) {
  const PatchImage::Level level = PrepareLevel(image.normalized_quarter);
  const int cols = level.inverse_spread.cols, rows = level.inverse_spread.rows;
  const int step = std::max(kPatchSide - 2, cols / kSelfPatches);
  int asked = 0, repeated = 0;
  Template t;
  for (int y = kSelfRadius; y + kSelfRadius + kPatchSide <= rows; y += step) {
    for (int x = kSelfRadius; x + kSelfRadius + kPatchSide <= cols; x += step) {
      if (!(level.inverse_spread.at<float>(y, x) > 0.0f)) continue;
      for (int v = 0; v < kPatchSide; ++v)
        std::memcpy(t.value + v * kPatchSide,
                    level.value.ptr<float>(y + v) + x,
                    kPatchSide * sizeof(float));
      Normalize(t.value);
      ++asked;
      repeated += Repeats(level, t, x, y);
    }
  }
  return asked < kSelfLeast ? 0.0 : static_cast<double>(repeated) / asked;
}

PlaneAlignment AlignPlane(const PatchImage& a,
                          const PatchImage& b,
                          const Eigen::Matrix3d& b_from_a,
                          const AlignOptions& options) {
  PlaneAlignment out;
  Eigen::Matrix3d& H = out.estimate.b_from_a;
  H = b_from_a;
  std::vector<PatchMatch> matches, inliers;
  for (const Round& round : std::span(kRounds).subspan(options.start_is_aligned ? 1 : 0)) {
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
    out.estimate.information.push_back(m.information);
  }
  return out;
}

}  // namespace horopter
