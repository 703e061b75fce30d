// Planes that parts of a scene stand on.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/supporting_plane.h"
#include "server/vision/recognition/aspect_scenes/aspect_adjustment.h"
#include "server/vision/recognition/aspects/fragment_index.h"

namespace horopter {

struct StandingPlane : SupportingPlane {
  int objects = 0;  // that rest on it
};

// The plane under a face of an object that rests on it.
SupportingPlane PlaneUnder(const Rigid3& scene_from_object, const RestingFace& face);

// Whether no camera is below the plane.
bool IsBelow(const SupportingPlane& plane,
             const std::vector<std::optional<AspectSceneView>>& views);

// The plane on which most objects rest by one of their faces, below no camera and with no object
// under it, of such that with which most objects are level, the lowest; then those parallel to it
// on which others rest: the tops of blocks. Empty without views, objects or such a plane.
std::vector<StandingPlane> PlanesUnder(std::span<const AspectSceneObject> objects,
                                       std::span<const AspectModel> models,
                                       const std::vector<std::optional<AspectSceneView>>& views);

// Planes on which a part may lie beside these objects, and on them: those under them and on top of
// them that are parallel to the one that most of them rest on, and not below it. `but`: index of an
// object that helps to choose that plane, but gives none itself; -1: none.
std::vector<SupportingPlane> PlanesToLieOn(std::span<const AspectSceneObject> objects,
                                           std::span<const AspectModel> models,
                                           const std::vector<std::optional<AspectSceneView>>& views,
                                           int but = -1);

// Whether one of the part's resting faces lies on one of the planes, to a few degrees and
// hundredths of its diameter. A pose that was settled freely does so by chance in one of some
// thousand. slack: times these limits.
bool LiesOn(std::span<const SupportingPlane> planes,
            const Rigid3& scene_from_object,
            const AspectModel& model,
            double slack = 1.0);

// Whether one of the part's resting faces is level with one of the planes, as what lies on it is,
// and not below the lowest.
bool IsLevel(std::span<const SupportingPlane> planes,
             const Rigid3& scene_from_object,
             const AspectModel& model);

// Whether none of the part's resting faces is level with any of the planes, at whatever height: it
// leans on something, or its pose is wrong. False without planes or resting faces.
bool Leans(std::span<const SupportingPlane> planes,
           const Rigid3& scene_from_object,
           const AspectModel& model);

}  // namespace horopter
