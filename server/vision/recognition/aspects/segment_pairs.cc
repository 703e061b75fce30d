#include "server/vision/recognition/aspects/segment_pairs.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "server/base/constants.h"
#include "server/base/stop_scope.h"

namespace horopter {
namespace {

constexpr double kMinOpeningRad = 0.4;     // of a pair, and least turn of it from straight on
constexpr std::size_t kMostPieces = 1200;  // the longest: pairs are sought among all of them
constexpr float kShortestPiece = 0.4f;     // of an arm: pieces that may join in line
constexpr float kInLineSine = 0.087f;      // 5 degrees
constexpr float kGapShare = 0.12f;         // of the shorter piece: what a corner may lack
constexpr float kThroughCorner = 0.5f;     // of the gap: an arm may run so far past its corner

struct Piece {
  Eigen::Vector2f from = Eigen::Vector2f::Zero(), to = Eigen::Vector2f::Zero();

  float length() const { return (to - from).norm(); }
  Eigen::Vector2f direction() const { return (to - from).normalized(); }
};

// The straight line through points [begin, end), its ends where the outer ones fall on it.
Piece FitPiece(const Eigen::Vector2f* points, int begin, int end) {
  // Corners are round: the ends of a piece do not lie on its line.
  const int trim = std::min(2, (end - begin) / 6);
  Eigen::Vector2f mean = Eigen::Vector2f::Zero();
  const auto n = static_cast<float>(end - begin - 2 * trim);
  for (int i = begin + trim; i < end - trim; ++i) mean += points[i] / n;
  float xx = 0, xy = 0, yy = 0;
  for (int i = begin + trim; i < end - trim; ++i) {
    const Eigen::Vector2f d = points[i] - mean;
    xx += d.x() * d.x();
    xy += d.x() * d.y();
    yy += d.y() * d.y();
  }
  const float angle = 0.5f * std::atan2(2 * xy, xx - yy);
  const Eigen::Vector2f along(std::cos(angle), std::sin(angle));
  return {mean + along * along.dot(points[begin] - mean),
          mean + along * along.dot(points[end - 1] - mean)};
}

// Splits [begin, end) where it leaves its chord farthest (Ramer 1972; Douglas, Peucker 1973).
void SplitStraight(const Eigen::Vector2f* points,
                   int begin,
                   int end,
                   const SegmentPairOptions& options,
                   std::vector<Piece>* out) {
  const auto shortest = static_cast<float>(options.min_length) * kShortestPiece;
  const Eigen::Vector2f chord = points[end - 1] - points[begin];
  if (end - begin < 4 || static_cast<float>(end - begin) < 0.6f * shortest) return;
  const float length = chord.norm();
  float worst = 0.0f;
  int at = begin;
  for (int i = begin + 1; i < end - 1; ++i) {
    const Eigen::Vector2f d = points[i] - points[begin];
    const float off =
        length > 1e-3f ? std::abs(chord.x() * d.y() - chord.y() * d.x()) / length : d.norm();
    if (off > worst) {
      worst = off;
      at = i;
    }
  }
  if (worst <= options.max_offset) {
    const Piece piece = FitPiece(points, begin, end);
    if (piece.length() >= shortest) out->push_back(piece);
    return;
  }
  SplitStraight(points, begin, at + 1, options, out);
  SplitStraight(points, at, end, options, out);
}

std::vector<Piece> StraightPieces(const ContourGraph& graph, const SegmentPairOptions& options) {
  std::vector<Piece> out;
  for (const ContourChain& chain : graph.chains)
    SplitStraight(graph.points.data() + chain.begin, 0, chain.size, options, &out);
  std::stable_sort(out.begin(), out.end(), [](const Piece& a, const Piece& b) {
    return a.length() > b.length();
  });
  if (out.size() > kMostPieces) out.resize(kMostPieces);
  return out;
}

// Joins b to the end of a when it goes on in line there.
bool Join(const Piece& b, const SegmentPairOptions& options, Piece* a) {
  const Eigen::Vector2f along = a->direction();
  const float length = a->length(), most = 1.5f * static_cast<float>(options.max_offset);
  // Short pieces have no sure direction.
  const Eigen::Vector2f other = b.direction();
  if (std::abs(along.x() * other.y() - along.y() * other.x()) >
      std::max(kInLineSine, most / b.length()))
    return false;
  const auto offset = [&](const Eigen::Vector2f& p) {
    const Eigen::Vector2f d = p - a->from;
    return std::abs(along.x() * d.y() - along.y() * d.x());
  };
  if (offset(b.from) > most || offset(b.to) > most) return false;
  float low = along.dot(b.from - a->from), high = along.dot(b.to - a->from);
  if (low > high) std::swap(low, high);
  const float gap =
      std::max(static_cast<float>(options.max_gap), kGapShare * std::min(length, b.length()));
  if (low > length + gap || high < -gap) return false;
  if (low >= 0 && high <= length) return true;  // covered
  const Eigen::Vector2f origin = a->from;
  a->from = origin + along * std::min(0.0f, low);
  a->to = origin + along * std::max(length, high);
  return true;
}

// Longest first, each with what goes on in line with it.
std::vector<Piece> JoinInLine(const std::vector<Piece>& pieces, const SegmentPairOptions& options) {
  std::vector<Piece> out;
  std::vector<char> used(pieces.size(), 0);
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    LeaveIfStopped();
    if (used[i]) continue;
    Piece joined = pieces[i];
    for (bool grown = true; grown;) {
      grown = false;
      for (std::size_t j = i + 1; j < pieces.size(); ++j) {
        if (used[j] || !Join(pieces[j], options, &joined)) continue;
        used[j] = 1;
        grown = true;
      }
    }
    if (joined.length() >= options.min_length) out.push_back(joined);
  }
  return out;
}

// How far `corner` lies beyond the nearer end of a piece (negative: within it), and the arm.
struct Arm {
  float beyond = 0.0f;
  Eigen::Vector2f far = Eigen::Vector2f::Zero();
};
Arm ArmFrom(const Piece& piece, const Eigen::Vector2f& corner) {
  const Eigen::Vector2f along = piece.direction();
  const float at = along.dot(corner - piece.from), length = piece.length();
  if (at < 0.5f * length) return {-at, piece.to};
  return {at - length, piece.from};
}

void AddPair(const Piece& a,
             const Piece& b,
             const SegmentPairOptions& options,
             std::vector<SegmentPair>* out) {
  const Eigen::Vector2f da = a.direction(), db = b.direction();
  const float cross = da.x() * db.y() - da.y() * db.x();
  if (std::abs(cross) < std::sin(kMinOpeningRad)) return;
  const Eigen::Vector2f between = b.from - a.from;
  const float t = (between.x() * db.y() - between.y() * db.x()) / cross;
  const Eigen::Vector2f corner = a.from + t * da;
  const float gap =
      std::max(static_cast<float>(options.max_gap), kGapShare * std::min(a.length(), b.length()));
  const Arm arm_a = ArmFrom(a, corner), arm_b = ArmFrom(b, corner);
  if (arm_a.beyond > gap || arm_b.beyond > gap) return;
  // An end that meets the middle of another piece makes two pairs with it.
  const auto ways = [&](const Piece& piece, const Arm& arm) {
    std::vector<Eigen::Vector2f> ends = {arm.far};
    if (arm.beyond < -kThroughCorner * gap)
      ends.push_back(arm.far == piece.to ? piece.from : piece.to);
    return ends;
  };
  for (const Eigen::Vector2f& end_a : ways(a, arm_a)) {
    for (const Eigen::Vector2f& end_b : ways(b, arm_b)) {
      Eigen::Vector2f first = end_a - corner, second = end_b - corner;
      if (first.x() * second.y() - first.y() * second.x() < 0) std::swap(first, second);
      SegmentPair pair;
      pair.corner = corner;
      pair.length_a = first.norm();
      pair.length_b = second.norm();
      if (std::min(pair.length_a, pair.length_b) < options.min_length) continue;
      pair.direction_rad = std::atan2(first.y(), first.x());
      float opening = std::atan2(second.y(), second.x()) - pair.direction_rad;
      if (opening < 0) opening += 2 * kPiF;
      pair.opening_rad = opening;
      out->push_back(pair);
    }
  }
}

}  // namespace

std::vector<SegmentPair> CollectSegmentPairs(const ContourGraph& graph,
                                             const SegmentPairOptions& options) {
  LeaveIfStopped();
  const std::vector<Piece> arms = JoinInLine(StraightPieces(graph, options), options);
  std::vector<SegmentPair> out;
  for (std::size_t i = 0; i < arms.size(); ++i) {
    LeaveIfStopped();
    for (std::size_t j = i + 1; j < arms.size(); ++j) AddPair(arms[i], arms[j], options, &out);
  }
  const auto shorter = [](const SegmentPair& p) { return std::min(p.length_a, p.length_b); };
  std::stable_sort(out.begin(), out.end(), [&](const SegmentPair& a, const SegmentPair& b) {
    return shorter(a) > shorter(b);
  });
  if (static_cast<int>(out.size()) > options.max_pairs) out.resize(options.max_pairs);
  return out;
}

}  // namespace horopter
