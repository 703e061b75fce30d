// Whether two scenes say the same.
#pragma once

#include <span>

#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

// Whether the other scene has all views of the first, and shows each of its objects there in the
// same pose, to a few hundredths of its size; but for one of its symmetries, the same for all
// views.
bool IsWithin(const AspectScene& scene,
              const AspectScene& other,
              std::span<const AspectModel> models);

}  // namespace horopter
