// Makes a large catalog out of a small one, straight into a file: its objects, and copies of them,
// each stretched along its own axes by random factors. Enrolling as many would take hours.
//
//   large_catalog CATALOG.db COUNT OUT.db [MOST_BYTES]
//     Geometry and keys of a copy are its own (six-point keys are those of the original, which a
//     stretch leaves alone). The rest of the derived data has the original's size but not the
//     copy's content: it is made when the copy is first asked for; with MOST_BYTES
//     what is longer is cut there, for disks that do not hold 0.5 MB an object, and keys are those
//     of the original, each value off by some hundredths: quicker. CAD files are left out.
//     OUT.db may be the address of a database.
//     CATALOG.db is read through a copy beside it.
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <random>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"
#include "db/catalog.h"
#include "db/object_digest.h"
#include "server/vision/recognition/object/prepared_blob.h"

namespace horopter {
namespace {

constexpr int kPerTransaction = 500;

ObjectModel Stretched(const ObjectModel& original, const std::string& id, std::mt19937& rng) {
  std::uniform_real_distribution<double> factor(0.6, 1.6);
  const Eigen::Vector3d s(factor(rng), factor(rng), factor(rng));
  ObjectModel model = original;
  model.id = id;
  model.symmetries.clear();
  model.grasps.clear();
  const auto stretch = [&](std::vector<Eigen::Vector3d>& points) {
    for (Eigen::Vector3d& p : points) p = p.cwiseProduct(s);
  };
  stretch(model.vertices);
  stretch(model.mesh.vertices);
  for (ModelEdge& edge : model.edges) {
    stretch(edge.polyline);
    if (edge.kind == CurveKind::kCircle) edge.kind = CurveKind::kOther;
  }
  model.diameter_m = 0.0;
  for (const Eigen::Vector3d& a : model.mesh.vertices) {
    for (const Eigen::Vector3d& b : model.mesh.vertices) {
      model.diameter_m = std::max(model.diameter_m, (a - b).norm());
    }
  }
  return model;
}

ObjectKeys Perturbed(ObjectKeys keys, std::mt19937& rng) {
  std::normal_distribution<float> off(0.0f, 0.03f);
  const auto perturb = [&](auto& rows) {
    for (auto& row : rows) {
      for (float& value : row.values) value += off(rng);
    }
  };
  perturb(keys.chains);
  perturb(keys.stars);
  perturb(keys.six_points);
  return keys;
}

int Main(int argc, char** argv) {
  if (argc != 4 && argc != 5) {
    std::fprintf(stderr, "usage: large_catalog CATALOG.db COUNT OUT.db [MOST_BYTES]\n");
    return 2;
  }
  const int count = std::atoi(argv[2]);
  const std::size_t most_bytes =
      argc == 5 ? static_cast<std::size_t>(std::atoll(argv[4])) : std::string::npos;
  const std::string copy = std::string(argv[1]) + ".from";
  std::filesystem::copy_file(argv[1], copy, std::filesystem::copy_options::overwrite_existing);
  auto from = Catalog::Open(copy);
  auto to = Catalog::Open(argv[3]);
  if (!from.ok() || !to.ok()) {
    std::fprintf(
        stderr, "%s %s\n", from.status().ToString().c_str(), to.status().ToString().c_str());
    return 1;
  }
  std::vector<LoadedObject> originals;
  std::vector<ObjectKeys> original_keys;
  while (true) {
    auto page = (*from)->LoadObjects(originals.empty() ? "" : originals.back().model.id, 500);
    if (!page.ok()) return 1;
    if (page->empty()) break;
    for (LoadedObject& object : *page) {
      constexpr std::size_t kLargestMesh = 3000;  // the diameter above is quadratic
      if (object.model.mesh.vertices.size() > kLargestMesh) continue;
      original_keys.push_back(ComputeObjectKeys(object.model));
      Catalog::NewObject whole;
      whole.record.model = object.model;
      whole.record.create_time = whole.record.update_time = "2026-01-01T00:00:00Z";
      whole.derived = object.derived;
      if (!(*to)->CreateObjects({whole}).ok()) return 1;
      originals.push_back(std::move(object));
    }
  }
  if (originals.empty()) return 1;
  std::mt19937 rng(1);
  std::vector<Catalog::NewObject> batch;
  for (int i = 0; i < count; ++i) {
    const std::size_t o = static_cast<std::size_t>(i) % originals.size();
    Catalog::NewObject& object = batch.emplace_back();
    PreparedObject prepared;
    prepared.model = Stretched(originals[o].model, absl::StrFormat("copy_%06d", i + 1), rng);
    if (most_bytes == std::string::npos) {
      prepared.keys = ComputeObjectKeys(prepared.model, {.six_point_sets = 0, .max_six_points = 0});
      prepared.keys.six_points = original_keys[o].six_points;
    } else {
      prepared.keys = Perturbed(original_keys[o], rng);
    }
    object.derived = {kPreparedVersion,
                      originals[o].derived.data.substr(0, most_bytes),
                      EncodePrepared(prepared).keys,
                      DerivedAddress(prepared.model, kPreparedVersion)};
    object.record.model = std::move(prepared.model);
    object.record.create_time = object.record.update_time = "2026-01-01T00:00:00Z";
    if (static_cast<int>(batch.size()) == kPerTransaction || i + 1 == count) {
      const absl::Status status = (*to)->CreateObjects(batch);
      if (!status.ok()) {
        std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
        return 1;
      }
      batch.clear();
    }
  }
  from->reset();
  for (const char* suffix : {"", "-wal", "-shm"}) std::filesystem::remove(copy + suffix);
  std::printf("%d objects, copies of %zu\n", count, originals.size());
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
