// The steps of the incremental reconstruction; all in normalised coordinates.
#pragma once

#include <array>
#include <optional>
#include <random>

#include "server/vision/reconstruction/grow_projective.h"

namespace horopter {

struct GrowContext {
  const MultiviewTracks& tracks;  // normalised
  const TrackIndex& index;
  const GrowOptions& options;
  const StopRequested& stop;
};

// Two cameras of a pair and the points of its inliers.
std::optional<ProjectiveScene> StartFromPair(const GrowContext& context,
                                             const ProjectiveScene& screened,
                                             const ViewPair& pair);

// Three cameras from points and lines seen in all three, robustly; the triple with most equations.
std::optional<ProjectiveScene> StartFromTriple(const GrowContext& context,
                                               const ProjectiveScene& screened,
                                               const std::array<int, 3>& views);
// Triples with at least 26 equations, most first, at most `keep`.
std::vector<std::array<int, 3>> RankTriples(const GrowContext& context, int keep);

int KnownCameras(const ProjectiveScene& scene);

// Registers every view that its known features determine, most features first; refines in between.
void RegisterViews(const GrowContext& context, std::mt19937* rng, ProjectiveScene* scene);

// Adjustment (or alternation, as the options say) and the outlier test, up to four times; drops
// views of which too little fits. False when fewer than two views are left.
bool Finish(const GrowContext& context, ProjectiveScene* scene);

// Share of the observations in known cameras, of features that two or more known cameras see, that
// are inliers; of one view when view >= 0.
double InlierShare(const GrowContext& context, const ProjectiveScene& scene, int view = -1);

}  // namespace horopter
