#include "server/vision/recognition/aspects/pattern_edges.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>

namespace horopter {
namespace {

constexpr int kTrials = 300;           // pairs of pieces that are asked for a vanishing point
constexpr int kBlocks = 8;             // along the width and the height
constexpr float kMarkReachPx = 1.6f;   // of a piece: its own points
constexpr float kMaxOpeningPx = 4.0f;  // between the ends of a chain that is closed
constexpr float kShortShare = 0.4f;    // of the least length: pieces of a known family

struct Piece {
  Eigen::Vector2f from, to;
  float length = 0.0f;
};

// Straight pieces of a run of points (Ramer 1972, Douglas and Peucker 1973).
void SplitStraight(
    const Eigen::Vector2f* points, int from, int to, float max_bend, std::vector<Piece>* pieces) {
  while (to - from >= 2) {
    const Eigen::Vector2f chord = points[to] - points[from];
    const float length = chord.norm();
    int farthest = -1;
    float most = max_bend;
    for (int i = from + 1; i < to; ++i) {
      const Eigen::Vector2f arm = points[i] - points[from];
      const float off = length > 1e-3f
                            ? std::abs(chord.x() * arm.y() - chord.y() * arm.x()) / length
                            : arm.norm();
      if (off > most) most = off, farthest = i;
    }
    if (farthest < 0) {
      pieces->push_back({points[from], points[to], length});
      return;
    }
    SplitStraight(points, from, farthest, max_bend, pieces);
    from = farthest;
  }
}

Eigen::Vector3f LineOf(const Piece& p) {
  return p.from.homogeneous().cross(p.to.homogeneous());
}

// Whether the piece runs through the point, which may be at infinity.
bool RunsThrough(const Piece& p, const Eigen::Vector3f& vanishing, float max_sine) {
  const Eigen::Vector2f middle = 0.5f * (p.from + p.to);
  const Eigen::Vector2f there = vanishing.head<2>() - vanishing.z() * middle;
  const Eigen::Vector2f along = p.to - p.from;
  const float norm = there.norm() * along.norm();
  return norm > 1e-9f && std::abs(there.x() * along.y() - there.y() * along.x()) < max_sine * norm;
}

// Share of the image's blocks that the pieces run over.
double Coverage(const std::vector<Piece>& pieces, int width, int height) {
  std::vector<char> covered(kBlocks * kBlocks, 0);
  for (const Piece& p : pieces) {
    const int steps = std::max(1, static_cast<int>(p.length / 8));
    for (int i = 0; i <= steps; ++i) {
      const Eigen::Vector2f at = p.from + (p.to - p.from) * (static_cast<float>(i) / steps);
      const int bx = std::clamp(static_cast<int>(at.x() * kBlocks / width), 0, kBlocks - 1);
      const int by = std::clamp(static_cast<int>(at.y() * kBlocks / height), 0, kBlocks - 1);
      covered[by * kBlocks + bx] = 1;
    }
  }
  return static_cast<double>(std::count(covered.begin(), covered.end(), 1)) /
         static_cast<double>(covered.size());
}

// The vanishing point through which the greatest length of pieces runs.
Eigen::Vector3f BestVanishingPoint(const std::vector<Piece>& pieces, float max_sine) {
  std::mt19937 random(1);
  Eigen::Vector3f best = Eigen::Vector3f::Zero();
  float most = 0.0f;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Piece& a = pieces[random() % pieces.size()];
    const Piece& b = pieces[random() % pieces.size()];
    const Eigen::Vector3f point = LineOf(a).cross(LineOf(b));
    if (!(point.norm() > 0)) continue;
    float sum = 0.0f;
    for (const Piece& p : pieces) {
      if (RunsThrough(p, point, max_sine)) sum += p.length;
    }
    if (sum > most) most = sum, best = point;
  }
  return best;
}

void Mark(const PointRaster& raster, const Piece& piece, std::vector<std::uint8_t>* marked) {
  marked->resize(raster.points.size(), 0);
  if (!(piece.length > 0)) return;
  const Eigen::Vector2f along = (piece.to - piece.from) / piece.length;
  const Eigen::Vector2f normal(-along.y(), along.x());
  const int reach = static_cast<int>(std::ceil(kMarkReachPx));
  for (float t = 0.0f; t <= piece.length; t += 1.0f) {
    const Eigen::Vector2f at = piece.from + t * along;
    const int cx = static_cast<int>(std::lround(at.x())),
              cy = static_cast<int>(std::lround(at.y()));
    for (int y = std::max(0, cy - reach); y <= std::min(raster.height - 1, cy + reach); ++y) {
      for (int x = std::max(0, cx - reach); x <= std::min(raster.width - 1, cx + reach); ++x) {
        const std::int32_t e = raster.at[static_cast<std::size_t>(y) * raster.width + x];
        if (e < 0) continue;
        if (std::abs(normal.dot(raster.points[e] - at)) <= kMarkReachPx) (*marked)[e] = 1;
      }
    }
  }
}

void MarkStripes(const PointRaster& raster,
                 const ContourGraph& contours,
                 const PatternOptions& options,
                 std::vector<std::uint8_t>* marked) {
  const float least = static_cast<float>(options.min_length_share * raster.width);
  const float max_sine = static_cast<float>(std::sin(options.max_angle_rad));
  std::vector<Piece> pieces, all;
  for (const ContourChain& c : contours.chains) {
    SplitStraight(contours.points.data() + c.begin,
                  0,
                  c.size - 1,
                  static_cast<float>(options.max_bend_px),
                  &all);
  }
  std::copy_if(all.begin(), all.end(), std::back_inserter(pieces), [&](const Piece& p) {
    return p.length >= least;
  });
  for (int family = 0; family < options.max_families; ++family) {
    if (static_cast<int>(pieces.size()) < options.min_pieces) break;
    const Eigen::Vector3f point = BestVanishingPoint(pieces, max_sine);
    const auto through = [&](const Piece& p) { return RunsThrough(p, point, max_sine); };
    std::vector<Piece> found;
    std::copy_if(pieces.begin(), pieces.end(), std::back_inserter(found), through);
    if (static_cast<int>(found.size()) < options.min_pieces ||
        Coverage(found, raster.width, raster.height) < options.min_coverage) {
      break;
    }
    for (const Piece& p : all) {
      if (p.length >= kShortShare * least && through(p)) Mark(raster, p, marked);
    }
    std::erase_if(pieces, through);
  }
}

// The sides of a chain that closes on itself and is round enough; empty for others.
std::vector<Piece> DotOf(const ContourGraph& contours,
                         const ContourChain& chain,
                         float width,
                         const PatternOptions& options) {
  const Eigen::Vector2f* p = contours.points.data() + chain.begin;
  const int n = chain.size;
  std::vector<Piece> sides;
  if ((p[n - 1] - p[0]).norm() > kMaxOpeningPx) return sides;
  float perimeter = 0.0f, twice_area = 0.0f;
  for (int i = 0; i < n; ++i) {
    const Eigen::Vector2f &from = p[i], &to = p[(i + 1) % n];
    sides.push_back({from, to, (to - from).norm()});
    perimeter += sides.back().length;
    twice_area += from.x() * to.y() - from.y() * to.x();
  }
  constexpr double kFourPi = 12.566370614359172;
  if (perimeter < options.min_dot_share * width || perimeter > options.max_dot_share * width ||
      0.5 * kFourPi * std::abs(twice_area) < options.min_roundness * perimeter * perimeter) {
    sides.clear();
  }
  return sides;
}

void MarkDots(const PointRaster& raster,
              const ContourGraph& contours,
              const PatternOptions& options,
              std::vector<std::uint8_t>* marked) {
  std::vector<Piece> all;
  int dots = 0;
  for (const ContourChain& c : contours.chains) {
    const std::vector<Piece> sides = DotOf(contours, c, static_cast<float>(raster.width), options);
    dots += sides.empty() ? 0 : 1;
    all.insert(all.end(), sides.begin(), sides.end());
  }
  if (dots < options.min_dots ||
      Coverage(all, raster.width, raster.height) < options.min_coverage) {
    return;
  }
  for (const Piece& side : all) Mark(raster, side, marked);
}

}  // namespace

std::vector<std::uint8_t> FindPatternPoints(const PointRaster& raster,
                                            const ContourGraph& contours,
                                            const PatternOptions& options) {
  std::vector<std::uint8_t> marked;
  MarkStripes(raster, contours, options, &marked);
  MarkDots(raster, contours, options, &marked);
  return marked;
}

}  // namespace horopter
