// What is sent: scenes of datasets, folders of images.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/camera_hints.h"
#include "horopter/v1/recognition.pb.h"

namespace horopter {

struct LoadItem {
  std::string name;
  v1::RecognizeSceneRequest request;
  // Of a scene of a dataset with ground truth; else `dataset` is empty.
  std::string dataset, split;
  int scene_id = 0;
  std::vector<int> im_ids;
};

struct LoadItemOptions {
  int max_images = 0;  // per set, spread evenly; 0: all
  DatasetHints hints = DatasetHints::kNone;
};

// Each source is a recording (`horopterd --record-dir`), a scene folder or a whole split of a
// dataset in BOP layout, or a folder of images of one scene.
// Errors: NOT_FOUND (nothing there), INVALID_ARGUMENT (nothing to send in it), those of the
// readers.
absl::StatusOr<std::vector<LoadItem>> ReadLoadItems(const std::vector<std::string>& sources,
                                                    const LoadItemOptions& options);

}  // namespace horopter
