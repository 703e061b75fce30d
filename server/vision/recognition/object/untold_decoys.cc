#include "server/vision/recognition/object/untold_decoys.h"

#include <algorithm>

#include "server/vision/geometry/model_features.h"
#include "server/vision/recognition/aspects/edge_difference.h"
#include "server/vision/recognition/object/shape_alignment.h"

namespace horopter {
namespace {

double MostOf(const std::vector<ViewDifference>& views) {
  double most = 0.0;
  for (const ViewDifference& v : views) most = std::max(most, v.differing_px);
  return most;
}

// How long each feature's edges are in the view that shows most of them.
std::vector<double> MostVisible(const RenderMesh& mesh, const std::vector<ModelFeature>& features) {
  const FeatureMap map(features, mesh.diameter_m);
  std::vector<double> most(features.size(), 0.0);
  for (const VisibleEdges& edges : FindEdgesAround(mesh)) {
    std::vector<double> here(features.size(), 0.0);
    for (std::size_t i = 0; i < edges.points.size(); ++i) {
      const int f = map.At(edges.points[i].point.cast<double>());
      if (f >= 0) here[f] += LengthAt(edges, i);
    }
    for (std::size_t f = 0; f < most.size(); ++f) most[f] = std::max(most[f], here[f]);
  }
  return most;
}

}  // namespace

std::vector<UntoldDecoy> FindUntoldDecoys(const ObjectModel& model, double least_px) {
  std::vector<UntoldDecoy> out;
  const absl::StatusOr<RenderMesh> mesh = MakeRenderMesh(model.mesh, model.diameter_m);
  if (!mesh.ok()) return out;
  const MirrorTwin twin = MakeMirrorTwin(model.mesh, model.diameter_m, *mesh);
  if (twin.chiral && !twin.alignments.empty()) {
    const double px = MostOf(
        FindDistinguishingFeatures(*mesh, twin.mesh, twin.alignments.front().a_from_b).views);
    if (px < least_px) out.push_back({.kind = UntoldDecoy::Kind::kMirrorImage, .differing_px = px});
  }
  const std::vector<ModelFeature> features = FindModelFeatures(model);
  const std::vector<double> visible = MostVisible(*mesh, features);
  for (std::size_t f = 0; f < features.size(); ++f) {
    if (visible[f] >= least_px) continue;
    out.push_back({UntoldDecoy::Kind::kFeature, features[f].place, features[f].size_m, visible[f]});
  }
  return out;
}

}  // namespace horopter
