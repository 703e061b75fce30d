#include "server/vision/recognition/aspects/contour_chains.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

namespace horopter {
namespace {

constexpr int kMinChain = 4;          // points; shorter runs are no contour
constexpr int kDirectionReach = 4;    // points an end's direction is taken over
constexpr int kJunctionReachPx = 2;   // an end this near to another chain's middle meets it there
constexpr float kMaxUTurn = -0.8f;    // cosine below which going on is turning back
constexpr float kTurnCostPx = 3.0f;   // of a turn by 180 degrees, against a gap of so many px
constexpr std::size_t kMaxLinks = 3;  // ways on from an end; chosen

struct Tracer {
  const PointRaster& raster;
  std::vector<std::uint8_t> used;

  // Unused neighbour that continues the run best, -1: none.
  std::int32_t Next(std::int32_t at, const Eigen::Vector2f& direction) const {
    const Eigen::Vector2f& p = raster.points[at];
    const int x = static_cast<int>(std::lround(p.x())), y = static_cast<int>(std::lround(p.y()));
    std::int32_t best = -1;
    float best_score = -0.5f;
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const int nx = x + dx, ny = y + dy;
        if (nx < 0 || ny < 0 || nx >= raster.width || ny >= raster.height) continue;
        const std::int32_t other = raster.at[static_cast<std::size_t>(ny) * raster.width + nx];
        if (other < 0 || used[other]) continue;
        const Eigen::Vector2f step = raster.points[other] - p;
        const float length = std::max(step.norm(), 1e-3f);
        // Near points first among those ahead: a diagonal step would skip a cell of a staircase.
        const float score = step.dot(direction) / length - 0.2f * length;
        if (score > best_score) {
          best_score = score;
          best = other;
        }
      }
    }
    return best;
  }

  void Extend(std::vector<std::int32_t>* run) {
    while (true) {
      const std::size_t n = run->size();
      const Eigen::Vector2f here = raster.points[run->back()];
      Eigen::Vector2f direction = Eigen::Vector2f::Zero();
      if (n > 1) {
        direction = here - raster.points[(*run)[n - std::min<std::size_t>(n, 5)]];
        direction.normalize();
      }
      const std::int32_t next = Next(run->back(), direction);
      if (next < 0) return;
      used[next] = 1;
      run->push_back(next);
    }
  }
};

std::vector<std::vector<std::int32_t>> TraceRuns(const PointRaster& raster) {
  Tracer tracer{raster, std::vector<std::uint8_t>(raster.points.size(), 0)};
  std::vector<std::vector<std::int32_t>> runs;
  for (std::size_t i = 0; i < raster.points.size(); ++i) {
    if (tracer.used[i]) continue;
    tracer.used[i] = 1;
    std::vector<std::int32_t> run = {static_cast<std::int32_t>(i)};
    tracer.Extend(&run);
    std::reverse(run.begin(), run.end());
    tracer.Extend(&run);
    if (static_cast<int>(run.size()) >= kMinChain) runs.push_back(std::move(run));
  }
  return runs;
}

// Splits runs where the end of a run meets the middle of one.
std::vector<std::vector<std::int32_t>> SplitAtJunctions(
    const PointRaster& raster, std::vector<std::vector<std::int32_t>> runs) {
  std::vector<std::pair<std::int32_t, std::int32_t>> owner(raster.points.size(), {-1, 0});
  for (std::size_t r = 0; r < runs.size(); ++r) {
    for (std::size_t k = 0; k < runs[r].size(); ++k) {
      owner[runs[r][k]] = {static_cast<std::int32_t>(r), static_cast<std::int32_t>(k)};
    }
  }
  std::vector<std::vector<std::int32_t>> cuts(runs.size());
  for (const auto& run : runs) {
    for (const std::int32_t end : {run.front(), run.back()}) {
      const auto self = owner[end];
      const Eigen::Vector2f& p = raster.points[end];
      const int x = static_cast<int>(std::lround(p.x())), y = static_cast<int>(std::lround(p.y()));
      std::pair<std::int32_t, std::int32_t> best{-1, 0};
      float best_squared = 1e9f;
      for (int ny = std::max(0, y - kJunctionReachPx);
           ny <= std::min(raster.height - 1, y + kJunctionReachPx);
           ++ny) {
        for (int nx = std::max(0, x - kJunctionReachPx);
             nx <= std::min(raster.width - 1, x + kJunctionReachPx);
             ++nx) {
          const std::int32_t other = raster.at[static_cast<std::size_t>(ny) * raster.width + nx];
          if (other < 0 || owner[other].first < 0) continue;
          const auto [r, k] = owner[other];
          if (r == self.first && std::abs(k - self.second) < 3 * kMinChain) continue;
          const float squared = (raster.points[other] - p).squaredNorm();
          if (squared >= best_squared) continue;
          best_squared = squared;
          best = {r, k};
        }
      }
      if (best.first < 0) continue;
      const int n = static_cast<int>(runs[best.first].size());
      if (best.second >= kMinChain && best.second < n - kMinChain) {
        cuts[best.first].push_back(best.second);
      }
    }
  }
  std::vector<std::vector<std::int32_t>> pieces;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    std::sort(cuts[r].begin(), cuts[r].end());
    int from = 0;
    for (const int cut : cuts[r]) {
      if (cut - from < kMinChain) continue;
      pieces.emplace_back(runs[r].begin() + from, runs[r].begin() + cut);
      from = cut;
    }
    pieces.emplace_back(runs[r].begin() + from, runs[r].end());
  }
  return pieces;
}

// An end of a chain: where it is and where a walker that leaves through it is heading.
struct ChainEnd {
  int chain = -1;
  bool front = false;
  Eigen::Vector2f point = Eigen::Vector2f::Zero();
  Eigen::Vector2f leaving = Eigen::Vector2f::Zero();
};

ChainEnd MakeEnd(const ContourGraph& graph, int chain, bool front) {
  const ContourChain& c = graph.chains[chain];
  const Eigen::Vector2f* p = graph.points.data() + c.begin;
  const int reach = std::min(kDirectionReach, c.size - 1);
  ChainEnd end{chain, front, front ? p[0] : p[c.size - 1], {}};
  end.leaving = front ? Eigen::Vector2f(p[0] - p[reach])
                      : Eigen::Vector2f(p[c.size - 1] - p[c.size - 1 - reach]);
  end.leaving.normalize();
  return end;
}

// Links from one end to others near it.
std::vector<ChainLink> LinksOf(const ChainEnd& from,
                               const std::vector<ChainEnd>& ends,
                               const std::vector<int>& near,
                               float max_gap) {
  std::vector<std::pair<float, ChainLink>> ranked;
  for (const int i : near) {
    const ChainEnd& to = ends[i];
    if (to.chain == from.chain && to.front == from.front) continue;
    const Eigen::Vector2f gap = to.point - from.point;
    const float length = gap.norm();
    if (length > max_gap) continue;
    const float turn = -from.leaving.dot(to.leaving);  // cosine of the change of heading
    if (turn < kMaxUTurn) continue;
    // Over a wide gap both must face each other.
    if (length > 2.5f &&
        (gap.dot(from.leaving) < -0.2f * length || gap.dot(to.leaving) > 0.2f * length)) {
      continue;
    }
    ranked.push_back({length + kTurnCostPx * 0.5f * (1.0f - turn), {to.chain, to.front, length}});
  }
  std::sort(ranked.begin(), ranked.end(), [](const auto& a, const auto& b) {
    return std::make_pair(a.first, a.second.chain) < std::make_pair(b.first, b.second.chain);
  });
  std::vector<ChainLink> links;
  for (std::size_t i = 0; i < std::min(kMaxLinks, ranked.size()); ++i) {
    links.push_back(ranked[i].second);
  }
  return links;
}

void LinkEnds(double max_gap_px, const PointRaster& raster, ContourGraph* graph) {
  std::vector<ChainEnd> ends;
  for (int c = 0; c < static_cast<int>(graph->chains.size()); ++c) {
    ends.push_back(MakeEnd(*graph, c, true));
    ends.push_back(MakeEnd(*graph, c, false));
  }
  // Buckets as wide as the largest gap: partners are in the 3 x 3 around an end.
  const int size = std::max(4, static_cast<int>(std::ceil(max_gap_px)));
  const int columns = raster.width / size + 1, rows = raster.height / size + 1;
  std::vector<std::vector<int>> buckets(static_cast<std::size_t>(columns) * rows);
  const auto cell = [&](float v, int count) {
    return std::clamp(static_cast<int>(v) / size, 0, count - 1);
  };
  for (int i = 0; i < static_cast<int>(ends.size()); ++i) {
    buckets[cell(ends[i].point.y(), rows) * columns + cell(ends[i].point.x(), columns)].push_back(
        i);
  }
  std::vector<int> near;
  for (const ChainEnd& end : ends) {
    near.clear();
    const int cx = cell(end.point.x(), columns), cy = cell(end.point.y(), rows);
    for (int y = std::max(0, cy - 1); y <= std::min(rows - 1, cy + 1); ++y) {
      for (int x = std::max(0, cx - 1); x <= std::min(columns - 1, cx + 1); ++x) {
        const auto& bucket = buckets[y * columns + x];
        near.insert(near.end(), bucket.begin(), bucket.end());
      }
    }
    ContourChain& chain = graph->chains[end.chain];
    (end.front ? chain.after_front : chain.after_back) =
        LinksOf(end, ends, near, static_cast<float>(max_gap_px));
  }
}

}  // namespace

PointRaster MakePointRaster(int width, int height, const std::vector<Eigen::Vector2f>& points) {
  PointRaster raster{width, height, {}, {}};
  raster.at.assign(static_cast<std::size_t>(width) * height, -1);
  for (const Eigen::Vector2f& p : points) {
    if (!(p.x() >= -0.5f && p.y() >= -0.5f && p.x() < width - 0.5f && p.y() < height - 0.5f)) {
      continue;
    }
    const int x = static_cast<int>(p.x() + 0.5f), y = static_cast<int>(p.y() + 0.5f);
    std::int32_t& at = raster.at[static_cast<std::size_t>(y) * width + x];
    if (at >= 0) continue;
    at = static_cast<std::int32_t>(raster.points.size());
    raster.points.push_back(p);
  }
  return raster;
}

ContourGraph TraceContours(const PointRaster& raster, double max_gap_px) {
  ContourGraph graph;
  for (const auto& run : SplitAtJunctions(raster, TraceRuns(raster))) {
    ContourChain chain;
    chain.begin = static_cast<int>(graph.points.size());
    chain.size = static_cast<int>(run.size());
    for (int k = 0; k < chain.size; ++k) {
      // Means of three neighbours: sub-pixel positions jitter along staircases.
      const Eigen::Vector2f& before = raster.points[run[std::max(0, k - 1)]];
      const Eigen::Vector2f& after = raster.points[run[std::min(chain.size - 1, k + 1)]];
      graph.points.push_back(0.5f * raster.points[run[k]] + 0.25f * (before + after));
    }
    graph.chains.push_back(std::move(chain));
  }
  LinkEnds(max_gap_px, raster, &graph);
  return graph;
}

}  // namespace horopter
