#include "tests/bench/aspect_catalog.h"

#include <fstream>
#include <limits>
#include <sstream>

#include "server/base/parallel_for.h"
#include "server/base/status_macros.h"
#include "server/vision/recognition/aspects/fragment_blob.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {
namespace {

std::string ReadAll(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  std::stringstream text;
  text << in.rdbuf();
  return text.str();
}

absl::Status LoadPart(const ObjectModel& model,
                      const std::string& cache,
                      ObjectAspects* object,
                      PartFragments* fragments) {
  const std::string stem = cache + "/" + model.id;
  if (!cache.empty()) {
    auto known = DecodeObjectAspects(ReadAll(stem + ".aspects"), model);
    if (known.ok()) {
      *object = *std::move(known);
      auto drawn = DecodePartFragments(ReadAll(stem + ".fragments"), object->aspects);
      if (drawn.ok()) {
        *fragments = *std::move(drawn);
        return absl::OkStatus();
      }
    }
  }
  HOROPTER_ASSIGN_OR_RETURN(*object, MakeObjectAspects(model));
  *fragments = MakePartFragments(object->mesh, object->aspects);
  if (cache.empty()) return absl::OkStatus();
  std::ofstream(stem + ".aspects", std::ios::binary) << EncodeObjectAspects(*object, model);
  std::ofstream(stem + ".fragments", std::ios::binary)
      << EncodePartFragments(*fragments, object->aspects);
  return absl::OkStatus();
}

}  // namespace

absl::Status LoadAspectCatalog(const BopDataset& dataset,
                               const std::string& cache,
                               AspectCatalog* catalog,
                               const FragmentIndexOptions& lookup) {
  HOROPTER_ASSIGN_OR_RETURN(auto models, ReadTrueModels(dataset));
  for (auto& [obj_id, model] : models) {
    catalog->obj_ids.push_back(obj_id);
    catalog->models.push_back(std::move(model));
  }
  const int n = static_cast<int>(catalog->models.size());
  catalog->objects.resize(n);
  catalog->fragments.resize(n);
  std::vector<absl::Status> status(n);
  ParallelFor(n, 2, [&](int i) {
    status[i] = LoadPart(catalog->models[i], cache, &catalog->objects[i], &catalog->fragments[i]);
  });
  for (const absl::Status& s : status) HOROPTER_RETURN_IF_ERROR(s);
  for (int i = 0; i < n; ++i) {
    catalog->parts.push_back(
        {&catalog->objects[i], &catalog->fragments[i], catalog->models[i].symmetries});
  }
  HOROPTER_ASSIGN_OR_RETURN(catalog->index, BuildFragmentIndex(catalog->parts, lookup));
  return absl::OkStatus();
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
