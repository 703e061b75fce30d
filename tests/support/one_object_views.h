// Views of one object with exact or noisy edges, as the joint search reads them.
#pragma once

#include <cmath>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "server/vision/recognition/scene/scene_model.h"
#include "tests/support/synthetic_part.h"

namespace horopter {

// Views of one object in the origin, `step` radians apart; end points with Gaussian noise.
struct OneObjectViews {
  std::vector<std::shared_ptr<const PreparedObject>> objects;
  std::vector<ImageFeatures> features;
  MatchingResult matching;
  JointContext context;
  SceneModel scene;

  OneObjectViews(ObjectModel model, int views, double step, double noise_px) {
    objects.push_back(PrepareObject(std::move(model)).value());
    context.objects = objects;
    context.matching = &matching;
    std::mt19937 rng(21);
    features.resize(views);
    for (int v = 0; v < views; ++v) {
      const double a = 0.3 + step * v;
      const PinholeCamera camera = CenteredCamera(640, 480, 900);
      const Rigid3 camera_from_scene =
          LookAt({0.6 * std::sin(a), -0.6 * std::cos(a), 0.45}, {0.05, 0.05, 0.04});
      features[v].width = 640;
      features[v].height = 480;
      AddSyntheticFeatures(*objects[0], camera, camera_from_scene, noise_px, &rng, &features[v]);
      scene.views.push_back(CalibratedCamera{camera, camera_from_scene});
    }
    for (const ImageFeatures& f : features) {
      context.views.push_back(BuildViewEvidence(f));
      context.start_cameras.push_back(CenteredCamera(640, 480, 900));
      context.focal_log_sigma.push_back(0.05);
    }
    matching.component.assign(views, -1);
  }

  void Place(const Rigid3& pose) {
    PlacedObject p;
    p.object = 0;
    p.scene_from_object = pose;
    VerifyScratch scratch;
    EvaluatePlacement(context, scene.views, {}, &scratch, &p);
    scene.objects = {p};
    scene.description_gain = p.description_gain;
  }
};

}  // namespace horopter
