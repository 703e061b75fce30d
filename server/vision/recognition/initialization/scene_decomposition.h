// A scene of several objects at once from their collineations into one projective structure
// (thesis 5.3): one upgrade of the structure to a metric frame, a rigid transform per object.
#pragma once

#include <optional>
#include <span>

#include "server/vision/recognition/initialization/bottom_up_route.h"
#include "server/vision/recognition/invariant_matching/scene_structure.h"
#include "server/vision/recognition/invariant_matching/structure_support.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

// hypotheses: of a projective structure, best first. The best of them that share no point and are
// of four vertices and more, not in a plane, are taken; objects stretched by more than
// kMaxStretch under the upgrade are left out. The images have not judged the scene yet.
// Empty for DecompositionMethod::kNone, with fewer than two such objects, or two cameras.
std::optional<AspectScene> SceneByDecomposition(
    std::span<const std::shared_ptr<const PreparedObject>> objects,
    std::span<const PinholeCamera> start_cameras,
    const SceneStructure& structure,
    std::span<const StructureHypothesis> hypotheses,
    const BottomUpOptions& options);

}  // namespace horopter
