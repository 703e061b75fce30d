// The cameras of a scene by themselves: intrinsics, and poses relative to one of them. What the
// images say of them (evidence) and what was known of them before (prior) have this form.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/vision/euclidean/edge_observations.h"
#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// Parameters of a view of the group: perturbation of camera_from_anchor (6; zero for the anchor),
// log f, cx, cy, k1, as those of SceneBundle.
inline constexpr int kGroupParameters = 10;

struct CameraGroup {
  std::vector<int> views;  // of the request; the first is the anchor
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> camera_from_anchor;
};

// information: ten rows a view; those of the anchor's pose are zero.
struct CameraGroupPrior {
  CameraGroup group;
  Eigen::MatrixXd information;
};

// What the data of one adjustment say, without any prior: a Gaussian in the perturbation of
// `group` with this information matrix; vector = information * (its mean). Directions of which the
// data say nothing have no information.
struct CameraEvidence {
  CameraGroup group;
  Eigen::MatrixXd information;  // empty: nothing is said
  Eigen::VectorXd vector;
};

// From `group` to the cameras as they are adjusted, ten numbers a view; and its derivative by the
// perturbations of all of them, ten columns a view of the group in its order.
Eigen::VectorXd GroupOffset(const CameraGroup& group, std::span<const AdjustedView> views);
Eigen::MatrixXd GroupJacobian(const CameraGroup& group, std::span<const AdjustedView> views);

// Squared distance from the prior; 0 without one.
double GroupCost(const CameraGroupPrior& prior, std::span<const AdjustedView> views);

// Adds the prior to normal equations A x = -b; at[v]: first parameter of view v. b may be null.
void AddGroupPrior(const CameraGroupPrior& prior,
                   std::span<const AdjustedView> views,
                   std::span<const int> at,
                   Eigen::MatrixXd* A,
                   Eigen::VectorXd* b);

}  // namespace horopter
