#include "tests/bench/aspect_catalog.h"

#include <fstream>
#include <limits>
#include <sstream>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/object/aspect_model.h"
#include "server/vision/recognition/object/prepared_blob.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {
namespace {

std::string ReadAll(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  std::stringstream text;
  text << in.rdbuf();
  return text.str();
}

absl::StatusOr<std::shared_ptr<const PreparedObject>> LoadPart(const ObjectModel& model,
                                                               const std::string& cache) {
  PrepareOptions options;
  options.aspects = true;
  const std::string stem = cache + "/" + model.id;
  if (!cache.empty()) {
    auto known =
        RestorePrepared(model, {ReadAll(stem + ".derived"), ReadAll(stem + ".keys")}, options);
    if (known.ok()) return known;
  }
  auto made = PrepareObject(model, options);
  if (cache.empty() || !made.ok()) return made;
  const PreparedBytes bytes = EncodePrepared(**made, options);
  std::ofstream(stem + ".derived", std::ios::binary) << bytes.data;
  std::ofstream(stem + ".keys", std::ios::binary) << bytes.keys;
  return made;
}

}  // namespace

absl::Status LoadAspectCatalog(const BopDataset& dataset,
                               const std::string& cache,
                               AspectCatalog* catalog) {
  HOROPTER_ASSIGN_OR_RETURN(auto models, ReadTrueModels(dataset));
  for (auto& [obj_id, model] : models) {
    catalog->obj_ids.push_back(obj_id);
    catalog->models.push_back(std::move(model));
  }
  const int n = static_cast<int>(catalog->models.size());
  std::vector<absl::StatusOr<std::shared_ptr<const PreparedObject>>> prepared(n);
  ParallelFor(n, 2, [&](int i) { prepared[i] = LoadPart(catalog->models[i], cache); });
  for (auto& object : prepared) {
    HOROPTER_RETURN_IF_ERROR(object.status());
    catalog->objects.push_back(*std::move(object));
    catalog->parts.push_back(AspectModelOf(*catalog->objects.back()));
  }
  catalog->index = BuildFragmentIndex(catalog->parts);
  return absl::OkStatus();
}

absl::StatusOr<std::vector<int>> ScenesOf(const std::string& dataset,
                                          const std::string& split,
                                          const std::vector<int>& asked) {
  if (!asked.empty()) return asked;
  return ListBopScenes(dataset, split);
}

double WorstVertexPx(const ObjectModel& model,
                     const PinholeCamera& camera,
                     const Rigid3& pose,
                     const PinholeCamera& true_camera,
                     const Rigid3& truth) {
  const std::size_t step = std::max<std::size_t>(1, model.mesh.vertices.size() / 300);
  const auto worst_of = [&](const Rigid3* symmetry, double bound) {
    double worst = 0.0;
    for (std::size_t v = 0; v < model.mesh.vertices.size() && worst < bound; v += step) {
      const Eigen::Vector3d& x = model.mesh.vertices[v];
      const Eigen::Vector3d a = pose * (symmetry != nullptr ? *symmetry * x : x);
      const Eigen::Vector3d b = truth * x;
      if (a.z() <= 0 || b.z() <= 0) return std::numeric_limits<double>::infinity();
      worst = std::max(worst, (Project(camera, a) - Project(true_camera, b)).norm());
    }
    return worst;
  };
  double best = worst_of(nullptr, 1e9);
  for (const Rigid3& symmetry : model.symmetries) {
    best = std::min(best, worst_of(&symmetry, best));
  }
  return best;
}

}  // namespace horopter
