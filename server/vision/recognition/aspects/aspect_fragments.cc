#include "server/vision/recognition/aspects/aspect_fragments.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "server/base/parallel_for.h"

namespace horopter {
namespace {

// A fragment that covers nearly the same piece as one drawn before adds nothing.
bool IsNew(const ContourFragment& f, const std::vector<ContourFragment>& drawn) {
  return std::none_of(drawn.begin(), drawn.end(), [&](const ContourFragment& other) {
    const float ratio = f.length / other.length;
    return ratio > 0.72f && ratio < 1.39f &&
           (f.center - other.center).norm() < 0.12f * other.length;
  });
}

AspectFragment PackFragment(const ContourFragment& f,
                            const Eigen::Vector2f& origin,
                            float unit,
                            int aspect) {
  const auto to16 = [](float v) {
    return static_cast<std::int16_t>(std::clamp(std::lround(v), -32768L, 32767L));
  };
  const Eigen::Vector2f center = (f.center - origin) * (unit * AspectFragment::kPlaceScale);
  AspectFragment packed;
  packed.key = PackKey(f.key);
  packed.x = to16(center.x());
  packed.y = to16(center.y());
  packed.spread = static_cast<std::uint16_t>(
      std::clamp(std::lround(f.spread * unit * AspectFragment::kSpreadScale), 1L, 65535L));
  packed.chord = to16(f.chord_rad * AspectFragment::kTurnScale);
  packed.aspect = static_cast<std::uint16_t>(aspect);
  return packed;
}

}  // namespace

std::vector<AspectFragment> DrawFragments(const std::vector<Eigen::Vector2f>& edge_points,
                                          int width,
                                          int height,
                                          double render_px,
                                          const Eigen::Vector2f& origin,
                                          int aspect,
                                          const AspectFragmentOptions& options) {
  const ContourGraph graph = TraceContours(MakePointRaster(width, height, edge_points),
                                           options.max_gap_diameters * render_px);
  FragmentOptions pieces;
  pieces.min_length = options.min_length_diameters * render_px;
  pieces.max_length = options.max_length_diameters * render_px;
  pieces.length_factor = options.length_factor;
  std::vector<ContourFragment> all = CollectFragments(graph, pieces);
  // Weighted drawing without replacement: largest log(u) / weight first (Efraimidis, Spirakis
  // 2006).
  std::mt19937 random(1234567u + static_cast<unsigned>(aspect));
  std::vector<std::pair<double, int>> order;
  for (int i = 0; i < static_cast<int>(all.size()); ++i) {
    const double u = (random() + 1.0) / 4294967297.0;
    order.push_back({std::log(u) / (all[i].length * all[i].turning + 1e-9), i});
  }
  std::sort(order.rbegin(), order.rend());
  std::vector<ContourFragment> drawn;
  std::vector<AspectFragment> out;
  const float unit = static_cast<float>(1.0 / render_px);
  for (const auto& [priority, i] : order) {
    if (static_cast<int>(drawn.size()) >= options.per_aspect) break;
    const ContourFragment& f = all[i];
    if (!IsNew(f, drawn)) continue;
    drawn.push_back(f);
    out.push_back(PackFragment(f, origin, unit, aspect));
  }
  return out;
}

PartFragments MakePartFragments(const RenderMesh& mesh,
                                const AspectSet& set,
                                const AspectFragmentOptions& options) {
  PartFragments out;
  const int count = static_cast<int>(set.aspects.size());
  out.edge_length.assign(count, 0.0f);
  std::vector<std::vector<AspectFragment>> of_aspect(count);
  const PinholeCamera camera = AspectCamera(set);
  const Eigen::Vector2f origin(static_cast<float>(camera.cx), static_cast<float>(camera.cy));
  ParallelFor(count, options.threads, [&](int a) {
    const VisibleEdges edges = AspectEdges(mesh, set, a);
    std::vector<Eigen::Vector2f> points;
    points.reserve(edges.points.size());
    for (const VisibleEdgePoint& p : edges.points) points.push_back(p.image);
    for (std::size_t i = 1; i < edges.points.size(); ++i) {
      if (edges.points[i].chain != edges.points[i - 1].chain) continue;
      out.edge_length[a] += static_cast<float>((points[i] - points[i - 1]).norm() / set.render_px);
    }
    of_aspect[a] =
        DrawFragments(points, camera.width, camera.height, set.render_px, origin, a, options);
  });
  for (const auto& fragments : of_aspect) {
    out.fragments.insert(out.fragments.end(), fragments.begin(), fragments.end());
  }
  return out;
}

}  // namespace horopter
