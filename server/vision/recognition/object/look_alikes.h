// Which parts of a catalog may be taken for each other, by their shapes.
#pragma once

#include <memory>
#include <vector>

#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/object/shape_alignment.h"

namespace horopter {

// How b lies over a part that it looks like, best first; empty where it does not, or one of them
// has no aspects. Remembered for later calls. Thread-safe.
std::vector<ShapeAlignment> LookAlikeAlignments(const std::shared_ptr<const PreparedObject>& a,
                                                const std::shared_ptr<const PreparedObject>& b);

}  // namespace horopter
