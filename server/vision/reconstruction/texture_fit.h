// How well the images' texture fits the scene that was made of it: view by view, and in shares.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "server/vision/matching/texture_matching.h"
#include "server/vision/reconstruction/incremental_scene.h"
#include "server/vision/reconstruction/texture_route.h"

namespace horopter {

// Cameras and points of all tracks, adjusted together.
struct AdjustedTexture {
  CalibratedScene scene;
  ProjectiveScene inliers;
  CalibratedBundleSummary summary;
};

// Observations of each view, and how many of them agree with the scene.
struct ViewCount {
  int seen = 0;
  int agree = 0;
  double squared_px = 0.0;
};

std::vector<ViewCount> CountViews(const MultiviewTracks& tracks, const AdjustedTexture& adjusted);

// The registered view that fits worst and does not belong, with the reason; -1: all do.
std::pair<int, std::string> WorstView(const MultiviewTracks& tracks,
                                      const AdjustedTexture& adjusted,
                                      const TextureRouteOptions& options);

// Cost of the registered views' observations, as a share of what nothing would explain. An
// observation of another view costs just that.
double UnexplainedShare(const MultiviewTracks& tracks,
                        const CalibratedScene& scene,
                        double outlier_chi2);

// Pairs of the registered views that see something beside one plane, in shares of 1.
double ShareBesidePlane(const TextureMatching& texture,
                        const CalibratedScene& scene,
                        double plane_share);

}  // namespace horopter
