// Links the views of a set through one part: the part's pose in every view gives the cameras.
#pragma once

#include <optional>
#include <vector>

#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

// Camera and pose of a plane's metric frame (z = 0) from the homography M that maps plane
// coordinates (x, y, 1) in metres to pixels. The focal length comes from the orthogonality of the
// axes where that lies within a factor of 1.5 of the start camera's, else from the start camera.
struct PlaneCamera {
  PinholeCamera camera;
  Rigid3 camera_from_plane;
};
std::optional<PlaneCamera> CameraFromPlane(const Eigen::Matrix3d& M, const PinholeCamera& start);

// The homography of the supporting plane from view a to view b (pixels), when both hang in one
// chain.
std::optional<Eigen::Matrix3d> PlaneTransfer(const MatchingResult& matching, int a, int b);

// Whether the plane's texture links a view to another registered one.
bool LinkedByPlane(const JointContext& context, const SceneModel& scene, int v);

// Scene hypotheses of one placed object each, best description-length gain first: every initial
// hypothesis is a hypothesis of one view, continued into the other views by the plane homography
// (through_plane: initial hypotheses of views that have one) or by those views' own hypotheses of
// the same object (initial hypotheses of the other views). Links through the plane are the surer
// ones: a texture that repeats can fit a part in every single view.
std::vector<SceneModel> LinkedInitialScenes(const JointContext& context,
                                            const HypothesisTable& hypotheses,
                                            bool through_plane);

// Adds views that are not registered yet: resects them from the placed objects' hypotheses in those
// views. Returns the number of views added.
int RegisterMissingViews(const JointContext& context,
                         const HypothesisTable& hypotheses,
                         SceneModel* scene);

// Removes views that no plane texture links to another and in which the placed objects together
// predict more wrong than right, or most of them are not shown, as long as more than two remain.
int DropContradictedViews(const JointContext& context, SceneModel* scene);

}  // namespace horopter
