// The parts of a BOP data set as the search for aspects knows them, from its true models.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/bop_dataset.h"
#include "server/vision/recognition/aspects/fragment_index.h"
#include "server/vision/recognition/object/prepared_object.h"

namespace horopter {

struct AspectCatalog {
  std::vector<int> obj_ids;
  std::vector<ObjectModel> models;
  std::vector<std::shared_ptr<const PreparedObject>> objects;
  std::vector<AspectModel> parts;  // point into the others: do not copy
  FragmentIndex index;
};

// cache: folder that keeps what was derived of the parts between runs; empty: none. Errors: those
// of the readers and of PrepareObject.
absl::Status LoadAspectCatalog(const BopDataset& dataset,
                               const std::string& cache,
                               AspectCatalog* catalog);

// The scenes that were asked for, or all of the split. Errors: those of ListBopScenes.
absl::StatusOr<std::vector<int>> ScenesOf(const std::string& dataset,
                                          const std::string& split,
                                          const std::vector<int>& asked);

// Worst distance (px) of the mesh's vertices in the image under two cameras and poses, the least
// over its symmetries; infinite behind a camera.
double WorstVertexPx(const ObjectModel& model,
                     const PinholeCamera& camera,
                     const Rigid3& pose,
                     const PinholeCamera& true_camera,
                     const Rigid3& truth);

}  // namespace horopter
