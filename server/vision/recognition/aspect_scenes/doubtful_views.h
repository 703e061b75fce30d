// Views of a scene whose cameras may hang on a wrong hypothesis.
#pragma once

#include <span>
#include <vector>

#include "server/vision/recognition/aspect_scenes/view_links.h"

namespace horopter {

// Of what the middle view shows: views that show less are left out in the end.
inline constexpr double kPoorShare = 0.4;

// Views that show less than `share` of what the middle view shows of the objects, and those that
// show another surface than most do: of three and more.
std::vector<bool> PoorViews(const LinkedScene& scene, double share);

// Without poor ones, and those whose own hypothesis of an object, elsewhere in pose, explains more,
// as long as two are left.
LinkedScene WithoutDoubtfulViews(const LinkedScene& scene,
                                 std::span<const AspectModel> models,
                                 const ViewLinks& links);

}  // namespace horopter
