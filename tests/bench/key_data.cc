// Writes the keys that recognition looks up, for index_benchmark: the parts of a dataset, and
// copies of them stretched along their axes, stand for a catalog.
//
//   key_data DATASET COPIES OUT_PREFIX
//     writes OUT_PREFIX-chains and -stars (5 values, similarity) and -six (3 values, projective),
//     as many of an object as the catalog keeps
#include <Eigen/Geometry>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/vision/invariants/object_keys.h"
#include "server/vision/invariants/six_points.h"

namespace horopter {
namespace {

constexpr int kTuplesPerObject = 400;  // random six-tuples tried

class KeyFile {
 public:
  KeyFile(const std::string& path, int dimensions) : out_(path, std::ios::binary), name_(path) {
    Put(dimensions);
  }
  ~KeyFile() { std::printf("%s: %lld keys\n", name_.c_str(), count_); }
  template <typename Values>
  void Write(const Values& key) {
    for (const double x : key) Put(x);
    ++count_;
  }

 private:
  void Put(double x) { out_.write(reinterpret_cast<const char*>(&x), sizeof(x)); }
  std::ofstream out_;
  std::string name_;
  long long count_ = 0;
};

int Main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: key_data DATASET COPIES OUT_PREFIX\n");
    return 2;
  }
  const auto dataset = ReadBopDataset(argv[1]);
  if (!dataset.ok()) {
    std::fprintf(stderr, "%s\n", dataset.status().ToString().c_str());
    return 1;
  }
  const std::string prefix = argv[3];
  KeyFile chains(prefix + "-chains", 5), stars(prefix + "-stars", 5), six(prefix + "-six", 3);
  std::mt19937 rng(1);
  std::uniform_real_distribution<double> stretch(0.6, 1.6);
  for (const BopObject& object : dataset->objects) {
    const auto cad = ImportCad(object.cad_path.empty() ? object.mesh_path : object.cad_path, {});
    if (!cad.ok()) continue;
    ObjectModel model = cad->model;
    const std::vector<Eigen::Vector3d> vertices = model.vertices;
    for (int copy = 0; copy < std::atoi(argv[2]); ++copy) {
      Eigen::Vector3d s(1, 1, 1);
      if (copy > 0) s = {stretch(rng), stretch(rng), stretch(rng)};
      std::vector<Eigen::Vector3d> v;
      for (const Eigen::Vector3d& p : vertices) v.push_back(p.cwiseProduct(s) * 10.0);
      model.vertices = v;
      const ObjectKeys keys = ComputeObjectKeys(model, {.six_point_sets = 0});
      for (const FourVertexKey& key : keys.chains) chains.Write(key.values);
      for (const FourVertexKey& key : keys.stars) stars.Write(key.values);
      if (v.size() < 6 || copy >= 40) continue;
      // A stretched copy is projectively the same part: corners are moved one by one instead.
      for (Eigen::Vector3d& p : v) {
        for (double& x : p) x += copy > 0 ? 0.05 * (stretch(rng) - 1.1) : 0.0;
      }
      for (int t = 0; t < kTuplesPerObject; ++t) {
        std::array<Eigen::Vector4d, 6> points;
        for (auto& p : points) p = v[rng() % v.size()].homogeneous();
        const auto key = InvariantsOfSixPoints(points);
        if (key && key->invariants == 3) six.Write(key->labelings[0].key.values);
      }
    }
  }
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
