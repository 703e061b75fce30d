#include "server/vision/recognition/aspects/plane_edges.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "server/vision/recognition/aspects/quantile.h"

namespace horopter {
namespace {

constexpr double kTolerancePx = 1.4;  // working px: a homography and an edge are so exact; chosen
// Of the views that a homography takes an edge into, in so many it must be met, or in all; of three
// and more some may hide it.
constexpr int kMeetingViews = 2;
constexpr int kMayMiss = 1;
// A ground leaves no more room between its edges: the radius of discs that touch an edge at its
// better side, px, of the middle one. Others hide no parts; or they are no ground but faces of
// parts. Seen: 0 - 7 px. ADR 56.
constexpr float kMostUsualRoomPx = 12.0f;
// An edge beside which there is so many times the usual room, which counts for so much at least, is
// the outline of what lies flat on the ground; chosen.
constexpr double kOutlineRoom = 3.0, kLeastRoomPx = 5.0;
constexpr double kStepPx = 1.0;        // along an edge, to see how a homography turns it
constexpr int kBesidePx = 3;           // edges so near ...
constexpr float kAlikeCosine = 0.87f;  // ... and so alike in direction go with each other
constexpr float kMostRoomPx = 48.0f;   // that is looked for beside an edge
constexpr double kLeastNearPx = 3.0;   // edges of the ground's texture so near: ground between them
constexpr float kTouching = 0.8f;      // of its radius: a disc that touches an edge is free so far

enum class Meeting { kOutside, kMet, kMissed };

Meeting Meets(const ImageEdgePoint& edge, const GroundView& view, float tolerance) {
  const Eigen::Vector2d p = edge.point.cast<double>();
  const Eigen::Vector2d along(-edge.normal.y(), edge.normal.x());
  const Eigen::Vector3d at = view.there_from_here * p.homogeneous();
  const Eigen::Vector3d next =
      view.there_from_here * Eigen::Vector2d(p + kStepPx * along).homogeneous();
  if (!(at.z() * next.z() > 0.0)) return Meeting::kOutside;
  const Eigen::Vector2f there = at.hnormalized().cast<float>();
  const Eigen::Vector2f turn = next.hnormalized().cast<float>() - there;
  const AspectImage& image = *view.image;
  if (!(there.x() >= 0 && there.y() >= 0 && there.x() < static_cast<float>(image.width) - 1 &&
        there.y() < static_cast<float>(image.height) - 1))
    return Meeting::kOutside;
  const int bin = AspectBin(turn.x(), turn.y());
  return image.DistanceAt(there.x(), there.y(), bin) <= tolerance ? Meeting::kMet
                                                                  : Meeting::kMissed;
}

struct MovingEdges {
  std::vector<std::uint8_t> marked;  // they go where the plane does
  // At the rim of the ground, where few or none of the others see it: what those that do bear out.
  // What none sees none could bear out.
  std::vector<std::uint8_t> rim;
};

MovingEdges MovesWithPlane(const AspectImage& here, std::span<const GroundView> others) {
  const float tolerance = static_cast<float>(kTolerancePx) * AspectImage::kDistanceScale;
  const std::size_t n = here.edges.size();
  MovingEdges out{std::vector<std::uint8_t>(n, 0), std::vector<std::uint8_t>(n, 0)};
  for (std::size_t i = 0; i < n; ++i) {
    int met = 0, asked = 0;
    for (const GroundView& view : others) {
      const Meeting meeting = Meets(here.edges[i], view, tolerance);
      asked += meeting != Meeting::kOutside;
      met += meeting == Meeting::kMet;
    }
    const int may_miss = asked > kMeetingViews ? kMayMiss : 0;
    out.marked[i] = met >= kMeetingViews && met + may_miss >= asked;
    out.rim[i] = asked < kMeetingViews && met == asked;
  }
  return out;
}

// Edges go with most of those beside them: what meets another by chance does so for a few pixels.
std::vector<std::uint8_t> WithNeighbours(const AspectImage& here,
                                         const std::vector<std::uint8_t>& marked) {
  std::vector<std::uint8_t> out(marked.size());
  for (std::size_t i = 0; i < out.size(); ++i) {
    const ImageEdgePoint& edge = here.edges[i];
    const int cx = static_cast<int>(std::lround(edge.point.x()));
    const int cy = static_cast<int>(std::lround(edge.point.y()));
    int alike = 0, on_plane = 0;
    for (int y = std::max(0, cy - kBesidePx); y <= std::min(here.height - 1, cy + kBesidePx); ++y) {
      for (int x = std::max(0, cx - kBesidePx); x <= std::min(here.width - 1, cx + kBesidePx);
           ++x) {
        const std::int32_t e = here.edge_at[here.Cell(x, y)];
        if (e < 0 || std::abs(here.edges[e].normal.dot(edge.normal)) < kAlikeCosine) continue;
        ++alike;
        on_plane += marked[e];
      }
    }
    out[i] = 2 * on_plane > alike;
  }
  return out;
}

// Share of the blocks that have marked edges.
double CoverageOf(const AspectImage& here, const std::vector<std::uint8_t>& marked) {
  std::vector<std::uint8_t> blocks(static_cast<std::size_t>(here.chance_width) * here.chance_height,
                                   0);
  for (std::size_t i = 0; i < marked.size(); ++i) {
    if (marked[i]) blocks[here.Block(here.edges[i].point.x(), here.edges[i].point.y())] = 1;
  }
  return static_cast<double>(std::count(blocks.begin(), blocks.end(), 1)) /
         static_cast<double>(std::max<std::size_t>(1, blocks.size()));
}

// Of every pixel to the nearest marked edge, px.
cv::Mat DistanceToMarked(const AspectImage& here, const std::vector<std::uint8_t>& marked) {
  cv::Mat zero_at_edges(here.height, here.width, CV_8U, cv::Scalar(1));
  for (std::size_t i = 0; i < marked.size(); ++i) {
    if (!marked[i]) continue;
    zero_at_edges.at<std::uint8_t>(static_cast<int>(std::lround(here.edges[i].point.y())),
                                   static_cast<int>(std::lround(here.edges[i].point.x()))) = 0;
  }
  cv::Mat distance;
  cv::distanceTransform(zero_at_edges, distance, cv::DIST_L2, cv::DIST_MASK_3, CV_32F);
  return distance;
}

// Radius of the largest disc without marked edges that touches an edge at its better side.
std::vector<float> RoomBeside(const AspectImage& here, const std::vector<std::uint8_t>& marked) {
  const cv::Mat distance = DistanceToMarked(here, marked);
  const auto side = [&](const ImageEdgePoint& e, float sign) {
    float room = 0.0f;
    for (float r = 2.0f; r <= kMostRoomPx; r += 1.0f) {
      const Eigen::Vector2f p = e.point + sign * r * e.normal;
      const auto x = static_cast<int>(std::lround(p.x())), y = static_cast<int>(std::lround(p.y()));
      if (x < 0 || y < 0 || x >= here.width || y >= here.height) break;
      if (distance.at<float>(y, x) < kTouching * r) break;
      room = r;
    }
    return room;
  };
  std::vector<float> out(marked.size(), 0.0f);
  for (std::size_t i = 0; i < marked.size(); ++i) {
    if (marked[i]) out[i] = std::max(side(here.edges[i], 1.0f), side(here.edges[i], -1.0f));
  }
  return out;
}

// Marked edges of an image's blocks, and those of them that another image of it does not have.
struct DroppedEdges {
  std::vector<int> marked, dropped;
};

DroppedEdges CountDropped(const AspectImage& all,
                          const std::vector<std::uint8_t>& marked,
                          const AspectImage& left) {
  const std::size_t blocks = static_cast<std::size_t>(all.chance_width) * all.chance_height;
  DroppedEdges out{std::vector<int>(blocks, 0), std::vector<int>(blocks, 0)};
  for (std::size_t i = 0; i < marked.size(); ++i) {
    if (!marked[i]) continue;
    const Eigen::Vector2f& p = all.edges[i].point;
    const std::size_t block = all.Block(p.x(), p.y());
    const std::int32_t at =
        left.edge_at[left.Cell(static_cast<int>(p.x() + 0.5f), static_cast<int>(p.y() + 0.5f))];
    ++out.marked[block];
    out.dropped[block] += at < 0 || left.edges[at].point != p;
  }
  return out;
}

// Sums of what blocks have, over windows of them.
class MarkedSums {
 public:
  MarkedSums(const cv::Size& size, const std::vector<int>& counts) : size_(size) {
    cv::Mat wide(size, CV_32F);
    std::copy(counts.begin(), counts.end(), wide.begin<float>());
    cv::integral(wide, sums_, CV_64F);
  }

  // So many blocks a side, less what is outside.
  double Around(int x, int y, int side) const {
    const int x0 = std::max(0, x - side / 2), x1 = std::min(size_.width, x + side / 2 + 1);
    const int y0 = std::max(0, y - side / 2), y1 = std::min(size_.height, y + side / 2 + 1);
    return sums_.at<double>(y1, x1) - sums_.at<double>(y0, x1) - sums_.at<double>(y1, x0) +
           sums_.at<double>(y0, x0);
  }

 private:
  cv::Size size_;
  cv::Mat sums_;
};

// ToldAlone::blocks.
std::vector<std::uint8_t> DroppedAround(const AspectImage& image,
                                        const DroppedEdges& edges,
                                        double share) {
  constexpr int kEnough = 100;                   // chosen
  constexpr int kWindows[] = {3, 5, 9, 17, 33};  // blocks a side; else all
  const cv::Size size(image.chance_width, image.chance_height);
  const int all = 2 * std::max(size.width, size.height);
  const MarkedSums marked(size, edges.marked), dropped(size, edges.dropped);
  std::vector<std::uint8_t> out;
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      const auto* const window =
          std::find_if(std::begin(kWindows), std::end(kWindows), [&](int side) {
            return marked.Around(x, y, side) >= kEnough;
          });
      const int side = window != std::end(kWindows) ? *window : all;
      out.push_back(dropped.Around(x, y, side) >= share * marked.Around(x, y, side));
    }
  }
  return out;
}

}  // namespace

PlaneEdges FindPlaneEdges(const AspectImage& here,
                          std::span<const GroundView> others,
                          const PlaneEdgeOptions& options) {
  PlaneEdges out;
  if (static_cast<int>(others.size()) < kMeetingViews) return out;
  const MovingEdges moving = MovesWithPlane(here, others);
  std::vector<std::uint8_t> marked = WithNeighbours(here, moving.marked);
  if (CoverageOf(here, marked) < options.min_coverage) return out;
  const std::vector<float> room = RoomBeside(here, marked);
  std::vector<float> of_marked;
  for (std::size_t i = 0; i < marked.size(); ++i) {
    if (marked[i]) of_marked.push_back(room[i]);
  }
  const float usual = Median(&of_marked);
  if (usual > kMostUsualRoomPx) return out;
  const float outline = static_cast<float>(kOutlineRoom * std::max<double>(usual, kLeastRoomPx));
  const std::vector<std::uint8_t> rim = WithNeighbours(here, moving.rim);
  for (std::size_t i = 0; i < marked.size(); ++i)
    marked[i] = (marked[i] && room[i] < outline) || rim[i];
  out.marked = std::move(marked);
  out.room_px = usual;
  return out;
}

ToldAlone FindToldAlone(const AspectImage& here,
                        const std::vector<std::uint8_t>& marked,
                        const AspectImage& alone,
                        double share) {
  const DroppedEdges edges = CountDropped(here, marked, alone);
  const auto sum = [](const std::vector<int>& counts) {
    return std::accumulate(counts.begin(), counts.end(), 0.0);
  };
  return {sum(edges.dropped) >= share * sum(edges.marked), DroppedAround(here, edges, share)};
}

std::vector<std::uint8_t> GroundCells(const AspectImage& here, const PlaneEdges& edges) {
  if (edges.marked.empty()) return {};
  std::vector<std::uint8_t> out(static_cast<std::size_t>(here.half_width) * here.half_height, 0);
  for (std::size_t i = 0; i < edges.marked.size(); ++i) {
    if (!edges.marked[i]) continue;
    const Eigen::Vector2f& p = here.edges[i].point;
    out[static_cast<std::size_t>(p.y() + 0.5f) / 2 * here.half_width +
        static_cast<std::size_t>(p.x() + 0.5f) / 2] = 1;
  }
  // Up to twice the room between them is ground as well, but not what is beside their outermost.
  const int reach = static_cast<int>(std::lround(std::max(kLeastNearPx, edges.room_px)));
  cv::Mat cells(here.half_height, here.half_width, CV_8U, out.data());
  cv::morphologyEx(cells,
                   cells,
                   cv::MORPH_CLOSE,
                   cv::getStructuringElement(cv::MORPH_ELLIPSE, {2 * reach + 1, 2 * reach + 1}));
  return out;
}

}  // namespace horopter
