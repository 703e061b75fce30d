// Texture points over views as tracks that a reconstruction takes.
#pragma once

#include <span>
#include <vector>

#include "server/vision/matching/texture_matching.h"
#include "server/vision/reconstruction/alternation.h"
#include "server/vision/reconstruction/multiview_tracks.h"
#include "server/vision/reconstruction/view_prior.h"

namespace horopter {

// In pixels; at most kMaxFeatures. Sizes agree with the views.
MultiviewTracks TracksOfTexture(const TextureMatching& texture, std::span<const ImageSize> sizes);

// The longest tracks, until each view has `of_view` observations or all it has.
MultiviewTracks FewTracks(const MultiviewTracks& tracks, const TrackIndex& index, int of_view);

// Per image the number of its camera: one for all that may be of one camera, by their sizes and
// what is said of their focal lengths. priors: one per image or none.
std::vector<int> CamerasOfImages(std::span<const ImageSize> sizes,
                                 std::span<const ViewPrior> priors);

}  // namespace horopter
