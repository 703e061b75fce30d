#include "server/vision/recognition/aspects/aspect_fragments.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "server/vision/recognition/aspects/segment_pairs.h"

namespace horopter {
namespace {

// Of an aspect; more: more poses found, slower.
constexpr int kFragmentsPerAspect = 20;
constexpr int kPairsPerAspect = 24;  // of adjacent straight edges, with the longest shorter ones
// Diameters.
constexpr double kLeastFragment = 0.14, kLongestFragment = 1.6;
constexpr double kFragmentFactor = 1.3;  // between one length and the next
constexpr double kLinkedGap = 0.03;      // contours are linked over such gaps, as in images
constexpr double kLeastArm = 0.07;

// A fragment that covers nearly the same piece as one drawn before adds nothing.
bool IsNew(const ContourFragment& f, const std::vector<ContourFragment>& drawn) {
  return std::none_of(drawn.begin(), drawn.end(), [&](const ContourFragment& other) {
    const float ratio = f.length / other.length;
    return ratio > 0.72f && ratio < 1.39f &&
           (f.center - other.center).norm() < 0.12f * other.length;
  });
}

// Of an aspect's image: what its pixels are measured from and in.
struct Frame {
  Eigen::Vector2f origin = Eigen::Vector2f::Zero();
  float render_px = 1.0f;
  int aspect = 0;
};

std::int16_t To16(float v) {
  return static_cast<std::int16_t>(std::clamp(std::lround(v), -32768L, 32767L));
}

std::uint16_t ToUnsigned16(float v) {
  return static_cast<std::uint16_t>(std::clamp(std::lround(v), 1L, 65535L));
}

AspectFragment PackFragment(const ContourFragment& f, const Frame& frame) {
  const float unit = 1.0f / frame.render_px;
  const Eigen::Vector2f center = (f.center - frame.origin) * (unit * AspectFragment::kPlaceScale);
  AspectFragment packed;
  packed.key = PackKey(f.key);
  packed.x = To16(center.x());
  packed.y = To16(center.y());
  packed.spread = ToUnsigned16(f.spread * unit * AspectFragment::kSpreadScale);
  packed.chord = To16(f.chord_rad * AspectFragment::kTurnScale);
  packed.aspect = static_cast<std::uint16_t>(frame.aspect);
  return packed;
}

AspectSegmentPair PackPair(const SegmentPair& p, const Frame& frame) {
  const float scale = AspectSegmentPair::kPlaceScale / frame.render_px;
  const Eigen::Vector2f corner = (p.corner - frame.origin) * scale;
  AspectSegmentPair packed;
  packed.x = To16(corner.x());
  packed.y = To16(corner.y());
  packed.direction = To16(p.direction_rad * AspectSegmentPair::kTurnScale);
  packed.opening = ToUnsigned16(p.opening_rad * AspectSegmentPair::kTurnScale);
  packed.length_a = ToUnsigned16(p.length_a * scale);
  packed.length_b = ToUnsigned16(p.length_b * scale);
  packed.aspect = static_cast<std::uint16_t>(frame.aspect);
  return packed;
}

// Weighted drawing without replacement: largest log(u) / weight first (Efraimidis, Spirakis 2006).
std::vector<AspectFragment> DrawFragments(const ContourGraph& graph, const Frame& frame) {
  FragmentOptions pieces;
  pieces.min_length = kLeastFragment * frame.render_px;
  pieces.max_length = kLongestFragment * frame.render_px;
  pieces.length_factor = kFragmentFactor;
  std::vector<ContourFragment> all = CollectFragments(graph, pieces);
  std::mt19937 random(1234567u + static_cast<unsigned>(frame.aspect));
  std::vector<std::pair<double, int>> order;
  for (int i = 0; i < static_cast<int>(all.size()); ++i) {
    const double u = (random() + 1.0) / 4294967297.0;
    order.push_back({std::log(u) / (all[i].length * all[i].turning + 1e-9), i});
  }
  std::sort(order.rbegin(), order.rend());
  std::vector<ContourFragment> drawn;
  std::vector<AspectFragment> out;
  for (const auto& [priority, i] : order) {
    if (static_cast<int>(drawn.size()) >= kFragmentsPerAspect) break;
    const ContourFragment& f = all[i];
    if (!IsNew(f, drawn)) continue;
    drawn.push_back(f);
    out.push_back(PackFragment(f, frame));
  }
  return out;
}

std::vector<AspectSegmentPair> TakePairs(const ContourGraph& graph, const Frame& frame) {
  SegmentPairOptions pairs;
  pairs.min_length = kLeastArm * frame.render_px;
  pairs.max_gap = kLinkedGap * frame.render_px;
  pairs.max_pairs = kPairsPerAspect;
  std::vector<AspectSegmentPair> out;
  for (const SegmentPair& p : CollectSegmentPairs(graph, pairs)) out.push_back(PackPair(p, frame));
  return out;
}

// What is taken of one aspect.
struct DrawnAspect {
  std::vector<AspectFragment> fragments;
  std::vector<AspectSegmentPair> pairs;
  float edge_length = 0.0f;
};

DrawnAspect DrawAspect(const VisibleEdges& edges,
                       const PinholeCamera& camera,
                       double render_px,
                       int aspect) {
  DrawnAspect out;
  std::vector<Eigen::Vector2f> points;
  points.reserve(edges.points.size());
  for (const VisibleEdgePoint& p : edges.points) points.push_back(p.image);
  for (std::size_t i = 1; i < edges.points.size(); ++i) {
    if (edges.points[i].chain != edges.points[i - 1].chain) continue;
    out.edge_length += static_cast<float>((points[i] - points[i - 1]).norm() / render_px);
  }
  const ContourGraph graph =
      TraceContours(MakePointRaster(camera.width, camera.height, points), kLinkedGap * render_px);
  const Frame frame{Eigen::Vector2f(static_cast<float>(camera.cx), static_cast<float>(camera.cy)),
                    static_cast<float>(render_px),
                    aspect};
  out.fragments = DrawFragments(graph, frame);
  out.pairs = TakePairs(graph, frame);
  return out;
}

void AppendAspect(const DrawnAspect& drawn, ModelFragments* out) {
  out->fragments.insert(out->fragments.end(), drawn.fragments.begin(), drawn.fragments.end());
  out->pairs.insert(out->pairs.end(), drawn.pairs.begin(), drawn.pairs.end());
  out->edge_length.push_back(drawn.edge_length);
}

}  // namespace

ModelFragments MakeModelFragments(const RenderMesh& mesh, const AspectSet& set) {
  const int count = static_cast<int>(set.aspects.size());
  const PinholeCamera camera = AspectCamera(set);
  ModelFragments out;
  for (int a = 0; a < count; ++a)
    AppendAspect(DrawAspect(AspectEdges(mesh, set, a), camera, set.render_px, a), &out);
  return out;
}

AspectsWithFragments MakeAspectsWithFragments(const RenderMesh& mesh,
                                              std::span<const Rigid3> symmetries,
                                              const AspectOptions& options) {
  AspectsWithFragments out;
  // The camera follows from the size and distance alone.
  AspectSet frame;
  frame.diameter_m = mesh.diameter_m;
  frame.distance_m = options.distance_diameters * mesh.diameter_m;
  frame.render_px = options.render_px;
  const PinholeCamera camera = AspectCamera(frame);
  out.aspects = MakeAspects(mesh, symmetries, options, [&](int aspect, const VisibleEdges& edges) {
    AppendAspect(DrawAspect(edges, camera, frame.render_px, aspect), &out.fragments);
  });
  return out;
}

}  // namespace horopter
