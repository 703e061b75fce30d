#include "server/vision/recognition/scene/remaining_evidence.h"

#include <algorithm>
#include <cmath>

#include "server/base/parallel_for.h"
#include "server/vision/recognition/scoring/log_odds.h"

namespace horopter {
namespace {

constexpr double kExplainedShare = 0.6;  // of a segment's samples, to count as explained
constexpr int kReachPx = 3;              // edge points so near to an explained sample go with it

// Per cell of the working image the orientation bins that explained segments pass through.
std::vector<std::uint8_t> ExplainedCells(const ViewEvidence& view,
                                         const std::vector<std::uint8_t>& explained) {
  const EdgeMaps& maps = view.maps;
  std::vector<std::uint8_t> cells(static_cast<std::size_t>(maps.width) * maps.height, 0);
  for (std::size_t i = 0; i < explained.size(); ++i) {
    if (!explained[i]) continue;
    const SegmentSample& s = view.segment_samples[i];
    const int bin = s.bin;
    const auto bits =
        static_cast<std::uint8_t>((1u << bin) | (1u << ((bin + 1) % kOrientationBins)) |
                                  (1u << ((bin + kOrientationBins - 1) % kOrientationBins)));
    const int x = static_cast<int>(std::lround(s.point.x()));
    const int y = static_cast<int>(std::lround(s.point.y()));
    for (int v = std::max(0, y - kReachPx); v <= std::min(maps.height - 1, y + kReachPx); ++v) {
      for (int u = std::max(0, x - kReachPx); u <= std::min(maps.width - 1, x + kReachPx); ++u)
        cells[maps.Cell(u, v)] |= bits;
    }
  }
  return cells;
}

ImageFeatures WithoutSegments(const ViewEvidence& view,
                              const std::vector<std::uint8_t>& explained) {
  const ImageFeatures& all = *view.features;
  ImageFeatures out;
  out.width = all.width;
  out.height = all.height;
  out.segments = all.segments;
  out.arcs = all.arcs;
  out.junctions = all.junctions;
  std::vector<int> samples(all.segments.size(), 0), gone(all.segments.size(), 0);
  for (std::size_t i = 0; i < explained.size(); ++i) {
    ++samples[view.segment_samples[i].segment];
    gone[view.segment_samples[i].segment] += explained[i];
  }
  for (std::size_t s = 0; s < samples.size(); ++s) {
    if (samples[s] > 0 && gone[s] >= kExplainedShare * samples[s])
      out.segments[s].in_texture = true;
  }
  return out;
}

std::vector<EdgePoint> WithoutPoints(const EdgeMaps& maps, const std::vector<std::uint8_t>& cells) {
  std::vector<EdgePoint> out;
  for (const EdgePoint& p : maps.points) {
    const int x = static_cast<int>(std::lround(p.point.x() * maps.scale_f));
    const int y = static_cast<int>(std::lround(p.point.y() * maps.scale_f));
    const int bin = OrientationBin(std::cos(p.direction), std::sin(p.direction));
    if (x >= 0 && y >= 0 && x < maps.width && y < maps.height &&
        (cells[maps.Cell(x, y)] >> bin & 1))
      continue;
    out.push_back(p);
  }
  return out;
}

}  // namespace

RemainingEvidence WithoutExplained(const JointContext& context,
                                   const SceneModel& scene,
                                   double sure_evidence) {
  std::vector<DepthBuffer> nearest;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    const EdgeMaps& maps = context.views[v].maps;
    nearest.push_back(MakeDepthBuffer(maps.width, maps.height));
    if (!scene.views[v]) continue;
    for (const PlacedObject& o : scene.objects) {
      RenderDepth(context.objects[o.object]->model.mesh,
                  WorkingCamera(scene.views[v]->camera, maps),
                  scene.views[v]->camera_from_scene * o.scene_from_object,
                  &nearest.back());
    }
  }
  ExplainedSegments gone;
  for (const ViewEvidence& view : context.views) gone.emplace_back(view.segment_samples.size(), 0);
  VerifyScratch scratch;
  for (const PlacedObject& o : scene.objects) {
    if (EdgeLogLikelihoodRatio(o.score, o.total.Sharpness()) < sure_evidence) continue;
    PlacedObject again = o;
    ExplainedSegments explained;
    EvaluatePlacement(context, scene.views, nearest, &scratch, &again, &explained);
    for (std::size_t v = 0; v < gone.size(); ++v) {
      for (std::size_t i = 0; i < explained[v].size(); ++i) gone[v][i] |= explained[v][i];
    }
  }
  RemainingEvidence out;
  const auto features = std::make_shared<std::vector<ImageFeatures>>(context.views.size());
  out.features = features;
  out.context.objects = context.objects;
  out.context.views.resize(context.views.size());
  out.context.matching = context.matching;
  out.context.options = context.options;
  out.context.stop = context.stop;
  out.context.give_up = context.give_up;
  ParallelFor(static_cast<int>(context.views.size()), context.options.threads, [&](int v) {
    const ViewEvidence& view = context.views[v];
    ViewEvidence& rest = out.context.views[v];
    (*features)[v] = WithoutSegments(view, gone[v]);
    rest.width = view.width;
    rest.height = view.height;
    rest.features = &(*features)[v];
    if (!scene.views[v]) return;
    rest.maps = BuildEdgeMaps(
        WithoutPoints(view.maps, ExplainedCells(view, gone[v])), view.width, view.height);
  });
  return out;
}

}  // namespace horopter
