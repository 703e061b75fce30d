#include "server/vision/features/split_and_merge.h"

#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

// Sums up to each point, so that the line fit of any range costs the same.
class LineSums {
 public:
  explicit LineSums(std::span<const Eigen::Vector2f> points) : origin_(points[0].cast<double>()) {
    sums_.resize(points.size() + 1);
    for (size_t i = 0; i < points.size(); ++i) {
      const double x = points[i].x() - origin_.x(), y = points[i].y() - origin_.y();
      const Sum& s = sums_[i];
      sums_[i + 1] = {s.x + x, s.y + y, s.xx + x * x, s.xy + x * y, s.yy + y * y};
    }
  }

  // Mean square distance of points [begin, end) from their total-least-squares line.
  double MeanSquare(int begin, int end) const {
    const Sum &a = sums_[begin], &b = sums_[end];
    const double n = end - begin;
    const double x = (b.x - a.x) / n, y = (b.y - a.y) / n;
    const double xx = (b.xx - a.xx) / n - x * x;
    const double xy = (b.xy - a.xy) / n - x * y;
    const double yy = (b.yy - a.yy) / n - y * y;
    const double skew = 0.5 * (xx - yy);
    return std::max(0.5 * (xx + yy) - std::sqrt(skew * skew + xy * xy), 0.0);
  }

 private:
  struct Sum {
    double x = 0, y = 0, xx = 0, xy = 0, yy = 0;
  };
  Eigen::Vector2d origin_;
  std::vector<Sum> sums_;
};

// Index of the point farthest from the chord of [begin, last], and the square of its distance.
std::pair<int, float> Farthest(std::span<const Eigen::Vector2f> points, int begin, int last) {
  const Eigen::Vector2f a = points[begin];
  const Eigen::Vector2f chord = points[last] - a;
  const float square = chord.squaredNorm();
  std::pair<int, float> worst = {begin, -1.0f};
  for (int i = begin + 1; i < last; ++i) {
    const Eigen::Vector2f q = points[i] - a;
    const float cross = chord.x() * q.y() - chord.y() * q.x();
    const float distance = square > 4.0f ? cross * cross / square : q.squaredNorm();
    if (distance > worst.second) {
      worst = {i, distance};
    }
  }
  return worst;
}

}  // namespace

std::vector<ChainPiece> SplitAndMerge(std::span<const Eigen::Vector2f> points,
                                      const SplitAndMergeOptions& options) {
  const int n = static_cast<int>(points.size());
  std::vector<ChainPiece> pieces;
  if (n < options.min_points || n < 3) {
    return pieces;
  }
  std::vector<ChainPiece> stack = {{0, n}};
  const auto limit = static_cast<float>(options.split_px * options.split_px);
  std::vector<ChainPiece> split;
  while (!stack.empty()) {
    const ChainPiece piece = stack.back();
    stack.pop_back();
    const auto [index, distance] = Farthest(points, piece.begin, piece.end - 1);
    if (distance > limit && piece.end - piece.begin > 3) {
      stack.push_back({index, piece.end});
      stack.push_back({piece.begin, index + 1});
    } else {
      split.push_back(piece);
    }
  }
  const LineSums sums(points);
  const double merge = options.merge_rms_px * options.merge_rms_px;
  // Cuts that chance made: join the pair that fits best until none fits.
  while (split.size() > 1) {
    size_t best = 0;
    double best_square = merge;
    for (size_t k = 0; k + 1 < split.size(); ++k) {
      const double square = sums.MeanSquare(split[k].begin, split[k + 1].end);
      if (square < best_square) {
        best_square = square;
        best = k + 1;
      }
    }
    if (best == 0) {
      break;
    }
    split[best - 1].end = split[best].end;
    split.erase(split.begin() + static_cast<ptrdiff_t>(best));
  }
  // A cut belongs where the two lines together fit best.
  for (size_t k = 0; k + 1 < split.size(); ++k) {
    constexpr int kShift = 4;  // points by which a cut may move
    const int cut = split[k + 1].begin;
    int best = cut;
    double best_square = 1e18;
    for (int c = std::max(cut - kShift, split[k].begin + 2);
         c <= std::min(cut + kShift, split[k + 1].end - 3);
         ++c) {
      const double square = (c + 1 - split[k].begin) * sums.MeanSquare(split[k].begin, c + 1) +
                            (split[k + 1].end - c) * sums.MeanSquare(c, split[k + 1].end);
      if (square < best_square) {
        best_square = square;
        best = c;
      }
    }
    split[k].end = best + 1;
    split[k + 1].begin = best;
  }
  for (const ChainPiece& piece : split) {
    if (piece.end - piece.begin >= options.min_points) {
      pieces.push_back(piece);
    }
  }
  return pieces;
}

}  // namespace horopter
