#include "server/vision/recognition/aspects/pattern_edges.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <span>
#include <utility>

#include "server/vision/recognition/aspects/dot_lattice.h"
#include "server/vision/recognition/aspects/strewn_dots.h"

namespace horopter {
namespace {

constexpr double kMinLengthShare =
    0.045;                               // of the image's width: straight pieces that make a family
constexpr double kMaxBendPx = 1.4;       // of a straight piece from its chord
constexpr double kMaxFamilyRad = 0.026;  // between a piece and the direction of the vanishing point
// Of the image's area, in blocks, by the pattern itself: where its far end is so fine that it was
// dropped as texture, that counts as well.
constexpr double kMinOwnCoverage = 0.08;
constexpr int kMinPieces = 24;   // of a family
constexpr int kMaxFamilies = 2;  // a grid has two
constexpr int kMinDots = 40;     // closed curves that make a pattern
// Perimeters as shares of the width. The holes of a lattice may be small; what is strewn and so
// small are speckles, which are told by texture.
constexpr double kMinDotShare = 0.035;
// Shortest perimeter of a hole of a lattice, as a share of the width
constexpr double kMinLatticeShare = 0.016;
constexpr double kMaxDotShare = 0.25;   // longest perimeter, as a share of the width
constexpr double kMinRoundness = 0.35;  // least area as a share of a circle's of the same perimeter
constexpr int kTrials = 300;            // pairs of pieces that are asked for a vanishing point
constexpr int kMostTried = 4;           // families, with those of parts
constexpr int kBlocks = 8;              // along the width and the height
constexpr float kMarkReachPx = 1.6f;    // of a piece: its own points
constexpr float kMaxOpeningPx = 4.0f;   // between the ends of a chain that is closed
constexpr float kShortShare = 0.4f;     // of the least length: pieces of a known family

struct StraightPiece {
  Eigen::Vector2f from, to;
  float length = 0.0f;
};

// Straight pieces of a run of points (Ramer 1972, Douglas and Peucker 1973).
void SplitAtBends(const Eigen::Vector2f* points,
                  int from,
                  int to,
                  float max_bend,
                  std::vector<StraightPiece>* pieces) {
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
    SplitAtBends(points, from, farthest, max_bend, pieces);
    from = farthest;
  }
}

Eigen::Vector3f LineOf(const StraightPiece& p) {
  return p.from.homogeneous().cross(p.to.homogeneous());
}

// Whether the piece runs through the point, which may be at infinity.
bool RunsThrough(const StraightPiece& p, const Eigen::Vector3f& vanishing, float max_sine) {
  const Eigen::Vector2f middle = 0.5f * (p.from + p.to);
  const Eigen::Vector2f there = vanishing.head<2>() - vanishing.z() * middle;
  const Eigen::Vector2f along = p.to - p.from;
  const float norm = there.norm() * along.norm();
  return norm > 1e-9f && std::abs(there.x() * along.y() - there.y() * along.x()) < max_sine * norm;
}

// Blocks of the image that a pattern runs over.
class Coverage {
 public:
  Coverage(int width, int height) : width_(width), height_(height) {}

  void Add(const Eigen::Vector2f& at) {
    const int bx = std::clamp(static_cast<int>(at.x() * kBlocks / width_), 0, kBlocks - 1);
    const int by = std::clamp(static_cast<int>(at.y() * kBlocks / height_), 0, kBlocks - 1);
    ++points_[by * kBlocks + bx];
  }

  void Add(const std::vector<StraightPiece>& pieces) {
    for (const StraightPiece& p : pieces) {
      const int steps = std::max(1, static_cast<int>(p.length / 8));
      for (int i = 0; i <= steps; ++i)
        Add(p.from + (p.to - p.from) * (static_cast<float>(i) / steps));
    }
  }

  double Share() const {
    return 1.0 - static_cast<double>(std::count(points_.begin(), points_.end(), 0)) /
                     static_cast<double>(points_.size());
  }

  // Of the blocks that either has.
  static double Share(const Coverage& pattern, const Coverage& texture) {
    constexpr double kTextured = 0.02;  // of a block's pixels
    const double block =
        static_cast<double>(texture.width_) * texture.height_ / (kBlocks * kBlocks);
    int covered = 0;
    for (std::size_t b = 0; b < pattern.points_.size(); ++b)
      covered += pattern.points_[b] > 0 || texture.points_[b] > kTextured * block;
    return static_cast<double>(covered) / static_cast<double>(pattern.points_.size());
  }

 private:
  int width_, height_;
  std::array<int, kBlocks * kBlocks> points_{};
};

// Whether pieces run over enough of the image, with what was dropped as texture.
bool RunsOverImage(const std::vector<StraightPiece>& pieces,
                   const PointRaster& raster,
                   const std::vector<Eigen::Vector2f>& texture,
                   const PatternOptions& options) {
  Coverage own(raster.width, raster.height), dropped(raster.width, raster.height);
  own.Add(pieces);
  for (const Eigen::Vector2f& p : texture) dropped.Add(p);
  return own.Share() >= kMinOwnCoverage && Coverage::Share(own, dropped) >= options.min_coverage;
}

// The vanishing point through which the greatest length of pieces runs.
Eigen::Vector3f BestVanishingPoint(const std::vector<StraightPiece>& pieces, float max_sine) {
  std::mt19937 random(1);
  Eigen::Vector3f best = Eigen::Vector3f::Zero();
  float most = 0.0f;
  for (int trial = 0; trial < kTrials; ++trial) {
    const StraightPiece& a = pieces[random() % pieces.size()];
    const StraightPiece& b = pieces[random() % pieces.size()];
    const Eigen::Vector3f point = LineOf(a).cross(LineOf(b));
    if (!(point.norm() > 0)) continue;
    float sum = 0.0f;
    for (const StraightPiece& p : pieces) {
      if (RunsThrough(p, point, max_sine)) sum += p.length;
    }
    if (sum > most) most = sum, best = point;
  }
  return best;
}

void Mark(const PointRaster& raster,
          const StraightPiece& piece,
          std::vector<std::uint8_t>* marked) {
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
                 const std::vector<Eigen::Vector2f>& texture,
                 const PatternOptions& options,
                 std::vector<std::uint8_t>* marked) {
  const float least = static_cast<float>(kMinLengthShare * raster.width);
  const float max_sine = static_cast<float>(std::sin(kMaxFamilyRad));
  std::vector<StraightPiece> pieces, all;
  for (const ContourChain& c : contours.chains) {
    SplitAtBends(
        contours.points.data() + c.begin, 0, c.size - 1, static_cast<float>(kMaxBendPx), &all);
  }
  std::copy_if(all.begin(), all.end(), std::back_inserter(pieces), [&](const StraightPiece& p) {
    return p.length >= least;
  });
  // The pieces of a grid's far cells are short: they tell how far a family runs, long ones that
  // there is one.
  int families = 0;
  for (int tried = 0; tried < kMostTried && families < kMaxFamilies; ++tried) {
    if (static_cast<int>(pieces.size()) < kMinPieces) break;
    const Eigen::Vector3f point = BestVanishingPoint(pieces, max_sine);
    const auto through = [&](const StraightPiece& p) { return RunsThrough(p, point, max_sine); };
    const auto count = std::count_if(pieces.begin(), pieces.end(), through);
    std::erase_if(pieces, through);
    if (count < kMinPieces) continue;
    std::vector<StraightPiece> found;
    std::copy_if(all.begin(), all.end(), std::back_inserter(found), [&](const StraightPiece& p) {
      return p.length >= kShortShare * least && through(p);
    });
    if (!RunsOverImage(found, raster, texture, options)) continue;
    for (const StraightPiece& p : found) Mark(raster, p, marked);
    ++families;
  }
}

// A closed curve.
struct Rim {
  std::vector<StraightPiece> sides;
  float perimeter = 0.0f;
};

// Of a chain that closes on itself and is round enough; without sides for others.
Rim RimOf(const ContourGraph& contours, const ContourChain& chain, float width) {
  const Eigen::Vector2f* p = contours.points.data() + chain.begin;
  const int n = chain.size;
  Rim rim;
  if ((p[n - 1] - p[0]).norm() > kMaxOpeningPx) return rim;
  float twice_area = 0.0f;
  for (int i = 0; i < n; ++i) {
    const Eigen::Vector2f &from = p[i], &to = p[(i + 1) % n];
    rim.sides.push_back({from, to, (to - from).norm()});
    rim.perimeter += rim.sides.back().length;
    twice_area += from.x() * to.y() - from.y() * to.x();
  }
  constexpr double kFourPi = 12.566370614359172;  // area = perimeter^2 / 4 pi of a circle
  if (rim.perimeter < kMinLatticeShare * width || rim.perimeter > kMaxDotShare * width ||
      0.5 * kFourPi * std::abs(twice_area) < kMinRoundness * rim.perimeter * rim.perimeter) {
    rim.sides.clear();
  }
  return rim;
}

template <typename Points>
Dot BoxOf(const Points& points) {
  Eigen::Vector2f low = points.front(), high = low;
  for (const Eigen::Vector2f& p : points) low = low.cwiseMin(p), high = high.cwiseMax(p);
  return {0.5f * (low + high), (high - low).maxCoeff()};
}

// 8-connected runs of edge points, as indices of the raster's points.
std::vector<std::vector<int>> Components(const PointRaster& raster) {
  std::vector<std::vector<int>> out;
  std::vector<char> seen(raster.points.size(), 0);
  for (std::size_t cell = 0; cell < raster.at.size(); ++cell) {
    if (raster.at[cell] < 0 || seen[raster.at[cell]]) continue;
    std::vector<int>& points = out.emplace_back();
    std::vector<std::size_t> open{cell};
    seen[raster.at[cell]] = 1;
    while (!open.empty()) {
      const std::size_t at = open.back();
      open.pop_back();
      points.push_back(raster.at[at]);
      const int cx = static_cast<int>(at % raster.width), cy = static_cast<int>(at / raster.width);
      for (int y = std::max(0, cy - 1); y <= std::min(raster.height - 1, cy + 1); ++y) {
        for (int x = std::max(0, cx - 1); x <= std::min(raster.width - 1, cx + 1); ++x) {
          const std::size_t next = static_cast<std::size_t>(y) * raster.width + x;
          const std::int32_t e = raster.at[next];
          if (e < 0 || seen[e]) continue;
          seen[e] = 1;
          open.push_back(next);
        }
      }
    }
  }
  return out;
}

// Marks what stands where the holes of a lattice are, if it is no larger than they are: holes whose
// rims are broken by glints, cut off by the image or half hidden by a part.
void MarkLattice(const PointRaster& raster,
                 const std::vector<Dot>& dots,
                 std::vector<std::uint8_t>* marked) {
  const std::vector<std::vector<int>> components = Components(raster);
  std::vector<const std::vector<int>*> open;
  std::vector<Dot> boxes;
  for (const std::vector<int>& c : components) {
    std::vector<Eigen::Vector2f> places;
    int of_pattern = 0;
    for (const int e : c) {
      places.push_back(raster.points[e]);
      of_pattern += (*marked)[e];
    }
    if (2 * of_pattern >= static_cast<int>(c.size())) continue;
    open.push_back(&c);
    boxes.push_back(BoxOf(places));
  }
  const std::vector<char> holes = HolesOfLattice(dots, boxes);
  for (std::size_t i = 0; i < open.size(); ++i) {
    if (!holes[i]) continue;
    for (const int e : *open[i]) (*marked)[e] = 1;
  }
}

// Whether there are enough of them over enough of the image.
bool CoverImage(const std::vector<Rim>& rims,
                const PointRaster& raster,
                const std::vector<Eigen::Vector2f>& texture,
                const PatternOptions& options) {
  if (static_cast<int>(rims.size()) < kMinDots) return false;
  std::vector<StraightPiece> all;
  for (const Rim& rim : rims) all.insert(all.end(), rim.sides.begin(), rim.sides.end());
  return RunsOverImage(all, raster, texture, options);
}

// Closed curves that are no larger than holes, and their boxes.
struct Dots {
  std::vector<Rim> rims;
  std::vector<Dot> boxes;
};

Dots FindDots(const PointRaster& raster, const ContourGraph& contours) {
  Dots out;
  for (const ContourChain& c : contours.chains) {
    Rim rim = RimOf(contours, c, static_cast<float>(raster.width));
    if (rim.sides.empty()) continue;
    out.boxes.push_back(BoxOf(std::span(contours.points).subspan(c.begin, c.size)));
    out.rims.push_back(std::move(rim));
  }
  return out;
}

// Returns whether most of the dots are of a lattice, which is marked then.
bool MarkHoles(const PointRaster& raster, const Dots& dots, std::vector<std::uint8_t>* marked) {
  constexpr double kRegular = 0.6;  // of the dots: else they are strewn
  const std::vector<char> regular = RegularDots(dots.boxes);
  if (static_cast<double>(std::count(regular.begin(), regular.end(), 1)) <
      kRegular * static_cast<double>(regular.size()))
    return false;
  std::vector<Dot> lattice;
  for (std::size_t i = 0; i < regular.size(); ++i) {
    if (!regular[i]) continue;
    for (const StraightPiece& side : dots.rims[i].sides) Mark(raster, side, marked);
    lattice.push_back(dots.boxes[i]);
  }
  MarkLattice(raster, lattice, marked);
  return true;
}

void MarkDots(const PointRaster& raster,
              const ContourGraph& contours,
              const std::vector<Eigen::Vector2f>& texture,
              const PatternOptions& options,
              std::vector<std::uint8_t>* marked) {
  Dots dots = FindDots(raster, contours);
  if (!CoverImage(dots.rims, raster, texture, options) || MarkHoles(raster, dots, marked)) return;
  std::erase_if(dots.rims,
                [&](const Rim& rim) { return rim.perimeter < kMinDotShare * raster.width; });
  if (!CoverImage(dots.rims, raster, texture, options)) return;
  std::vector<std::vector<Eigen::Vector2f>> curves;
  for (const Rim& rim : dots.rims) {
    std::vector<Eigen::Vector2f>& curve = curves.emplace_back();
    for (const StraightPiece& side : rim.sides) curve.push_back(side.from);
  }
  const std::vector<char> strewn = AmongOthers(raster, texture, curves);
  for (std::size_t i = 0; i < strewn.size(); ++i) {
    if (!strewn[i]) continue;
    for (const StraightPiece& side : dots.rims[i].sides) Mark(raster, side, marked);
  }
}

}  // namespace

std::vector<std::uint8_t> FindPatternPoints(const PointRaster& raster,
                                            const ContourGraph& contours,
                                            const std::vector<Eigen::Vector2f>& texture,
                                            const PatternOptions& options) {
  std::vector<std::uint8_t> marked;
  MarkStripes(raster, contours, texture, options, &marked);
  if (options.dots) MarkDots(raster, contours, texture, options, &marked);
  return marked;
}

}  // namespace horopter
