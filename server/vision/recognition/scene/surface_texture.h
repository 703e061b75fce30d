// Whether the texture on an object's faces looks alike in all views, as it does where the faces
// are: evidence from inside the silhouette that edges do not give.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "server/vision/recognition/scene/scene_model.h"

namespace horopter {

// Patches of the visible faces with enough texture and parallax to say anything.
struct SurfaceTexture {
  int alike = 0;
  int unlike = 0;
};

struct SurfaceImages;

// The images as patches are compared in: grey, smoothed, at most 1280 pixels wide. Made once a
// request.
std::shared_ptr<const SurfaceImages> MakeSurfaceImages(std::span<const cv::Mat> images,
                                                       int threads);

// Compares the patches of some of the scene's objects between the view that shows them best and all
// others, by normalised correlation over the patch's plane. Patches that another accepted object
// hides, such as touch an edge of the object, and such as the supporting plane alone would make
// look alike, do not count. images: one per view; null: texture is not looked at and nothing is
// found. One result per index in `objects`.
std::vector<SurfaceTexture> CompareSurfaces(const JointContext& context,
                                            const SurfaceImages* images,
                                            const SceneModel& scene,
                                            std::span<const int> objects);

// What the texture on an object's faces adds to the log odds that it is right, for or against.
// Neighbouring patches are not independent, so that it is bounded.
double TextureLogLikelihoodRatio(const SurfaceTexture& texture);

// Sets the texture evidence of the scene's objects, of all or of one.
void JudgeTexture(const JointContext& context, const SurfaceImages* images, SceneModel* scene);
void JudgeTexture(const JointContext& context,
                  const SurfaceImages* images,
                  int object,
                  SceneModel* scene);

}  // namespace horopter
