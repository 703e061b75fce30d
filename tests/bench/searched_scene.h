// A scene of a data set, searched for the parts of a catalog image by image, as requests search it.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "server/vision/recognition/aspect_scenes/aspect_linking.h"
#include "tests/bench/aspect_catalog.h"

namespace horopter {

// A scene's images, and what they show of all parts.
struct SearchedScene {
  BopScene scene;
  std::vector<AspectImage> images;
  std::vector<AspectViewPrior> priors;
  std::vector<std::vector<AspectHypothesis>> hypotheses;
};

struct SceneSearchOptions {
  AspectImageOptions image;
  bool on_ground = false;      // edges that move with the supporting plane are dropped
  std::size_t max_images = 0;  // the first ones; 0: all
  std::string hypotheses;      // folder that keeps what was found, or empty
  int threads = 2;
};

SearchedScene SearchImages(const SceneSearchOptions& options,
                           const AspectCatalog& catalog,
                           BopScene scene);

}  // namespace horopter
