#include "server/vision/recognition/scoring/view_evidence.h"

#include <cmath>

namespace horopter {

ViewEvidence BuildViewEvidence(const ImageFeatures& features, int threads) {
  ViewEvidence view;
  view.width = features.width;
  view.height = features.height;
  view.features = &features;
  view.maps = BuildEdgeMaps(features, threads);
  const double scale = view.maps.working_from_image;
  for (int i = 0; i < static_cast<int>(features.segments.size()); ++i) {
    const Segment& s = features.segments[i];
    if (s.in_texture) continue;
    const Eigen::Vector2d d = s.end - s.start;
    const int n = std::max(
        1, static_cast<int>(std::lround(d.norm() * scale / ViewEvidence::kSegmentSampleStep)));
    const int bin = OrientationBin(static_cast<float>(d.x()), static_cast<float>(d.y()));
    for (int k = 0; k < n; ++k) {
      SegmentSample sample;
      sample.point = ((s.start + d * ((k + 0.5) / n)) * scale).cast<float>();
      sample.bin = static_cast<std::uint8_t>(bin);
      sample.segment = i;
      view.segment_samples.push_back(sample);
    }
  }
  return view;
}

}  // namespace horopter
