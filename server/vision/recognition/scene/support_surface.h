// Level surfaces that parts stand on: the plane and the tops of parts, and what lies over what.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

// A stacked part's middle may lie so far beside the outline of what carries it, metres.
inline constexpr double kOverhangM = 0.01;

// Heights of the object's lowest and highest point above a plane, metres.
struct HeightRange {
  double lowest_m = 0.0;
  double highest_m = 0.0;
};
HeightRange HeightAbovePlane(const PreparedObject& object,
                             const Rigid3& scene_from_object,
                             const SupportingPlane& plane);

// Outline of an object seen along a plane's normal.
struct Outline {
  std::vector<Eigen::Vector2d> hull;  // convex, counter-clockwise, along `x` and `y`
  Eigen::Vector3d x = Eigen::Vector3d::UnitX();
  Eigen::Vector3d y = Eigen::Vector3d::UnitY();

  // Mean of the corners.
  Eigen::Vector2d Middle() const;
  // Distance of the corner farthest from it.
  double Radius() const;
};
Outline OutlineOnPlane(const PreparedObject& object,
                       const Rigid3& scene_from_object,
                       const SupportingPlane& plane);

// Whether the middle of `above` lies over `below`, kOverhangM beside it at most.
bool LiesOver(const Outline& above, const Outline& below);

// A level surface on which parts are looked for.
struct SearchSurface {
  struct Disc {
    Eigen::Vector3d center = Eigen::Vector3d::Zero();  // scene frame, any height
    double radius_m = 0.0;
  };
  double height_m = 0.0;    // above the plane
  std::vector<Disc> discs;  // the middles of parts on it lie over one of these; empty: anywhere
};

// The plane, the tops of the scene's objects and of the doubtful placements with at least this
// score that stand on the plane; heights that one search covers are merged. The scene must have a
// plane.
std::vector<SearchSurface> SearchSurfaces(const JointContext& context,
                                          const SceneModel& scene,
                                          std::span<const PlacedObject> doubtful,
                                          double doubtful_score,
                                          double plane_tolerance_m,
                                          int max_surfaces);

// The surfaces that none of `searched` covers.
std::vector<SearchSurface> NotCovered(const std::vector<SearchSurface>& surfaces,
                                      const std::vector<SearchSurface>& searched);

}  // namespace horopter
