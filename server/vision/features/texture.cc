#include "server/vision/features/texture.h"

#include <algorithm>
#include <cmath>

namespace horopter {
namespace {

constexpr int kCellPx = 16;         // of the grid that counts chains
constexpr int kReachCells = 2;      // density is taken over 5x5 cells: 80 px
constexpr size_t kShortChain = 60;  // points
constexpr double kLongFactor =
    1.5;  // x texture_max_length_px: a segment that anchors its neighbours

// Points of short chains per pixel, averaged over the neighbourhood of each cell.
class ShortChainDensity {
 public:
  ShortChainDensity(const std::vector<EdgeChain>& chains, int width, int height)
      : columns_(width / kCellPx + 1),
        rows_(height / kCellPx + 1),
        count_(static_cast<size_t>(columns_) * rows_, 0) {
    for (const EdgeChain& chain : chains) {
      if (chain.points.size() <= kShortChain) {
        for (const Eigen::Vector2f& p : chain.points) {
          ++count_[Index(p.cast<double>())];
        }
      }
    }
  }

  double At(const Eigen::Vector2d& p) const {
    const int cx = Column(p), cy = Row(p);
    int sum = 0, cells = 0;
    for (int y = std::max(cy - kReachCells, 0); y <= std::min(cy + kReachCells, rows_ - 1); ++y) {
      for (int x = std::max(cx - kReachCells, 0); x <= std::min(cx + kReachCells, columns_ - 1);
           ++x) {
        sum += count_[static_cast<size_t>(y) * columns_ + x];
        ++cells;
      }
    }
    return static_cast<double>(sum) / (cells * kCellPx * kCellPx);
  }

 private:
  int Column(const Eigen::Vector2d& p) const {
    return std::clamp(static_cast<int>(p.x()) / kCellPx, 0, columns_ - 1);
  }
  int Row(const Eigen::Vector2d& p) const {
    return std::clamp(static_cast<int>(p.y()) / kCellPx, 0, rows_ - 1);
  }
  size_t Index(const Eigen::Vector2d& p) const {
    return static_cast<size_t>(Row(p)) * columns_ + Column(p);
  }

  int columns_;
  int rows_;
  std::vector<int> count_;
};

// Ends that close a corner, and contact with a long segment, per segment.
struct Ties {
  bool start_closed = false;
  bool end_closed = false;
  bool touches_long = false;
};

std::vector<Ties> FindTies(const std::vector<Junction>& junctions,
                           const std::vector<Segment>& segments,
                           double long_px) {
  std::vector<Ties> ties(segments.size());
  for (const Junction& junction : junctions) {
    bool any_long = false;
    for (const Junction::End& end : junction.ends) {
      any_long |= segments[end.segment].Length() >= long_px;
    }
    for (const Junction::End& end : junction.ends) {
      Ties& own = ties[end.segment];
      own.touches_long |= any_long;
      if (!end.interior) {
        (end.at_start ? own.start_closed : own.end_closed) = true;
      }
    }
  }
  return ties;
}

}  // namespace

int MarkTexture(const std::vector<EdgeChain>& chains,
                const std::vector<Junction>& junctions,
                const FeatureOptions& options,
                int width,
                int height,
                std::vector<Segment>* segments) {
  const ShortChainDensity density(chains, width, height);
  const std::vector<Ties> ties =
      FindTies(junctions, *segments, kLongFactor * options.texture_max_length_px);
  int marked = 0;
  for (size_t i = 0; i < segments->size(); ++i) {
    Segment& segment = (*segments)[i];
    const bool tied = (ties[i].start_closed && ties[i].end_closed) || ties[i].touches_long;
    segment.in_texture = segment.Length() <= options.texture_max_length_px && !tied &&
                         density.At(0.5 * (segment.start + segment.end)) >= options.texture_density;
    marked += segment.in_texture ? 1 : 0;
  }
  return marked;
}

}  // namespace horopter
