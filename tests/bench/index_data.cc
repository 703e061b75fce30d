#include "tests/bench/index_data.h"

#include <Eigen/Dense>
#include <cstdlib>
#include <fstream>
#include <numeric>
#include <random>

namespace horopter {

const char* NameOf(QueryKind kind) {
  constexpr const char* kNames[] = {"point", "box", "10-NN", "ellipsoid"};
  return kNames[static_cast<int>(kind)];
}

IndexData GenerateIndexData(const std::string& name, int dimensions, int count, unsigned seed) {
  IndexData data{name, dimensions, count, {}, {}, {}};
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> uniform;
  std::normal_distribution<double> normal;
  data.points.resize(static_cast<size_t>(dimensions) * count);
  if (name == "uniform") {
    for (double& x : data.points) x = uniform(rng);
  } else {
    constexpr int kClusters = 100;
    std::vector<double> centers(static_cast<size_t>(kClusters) * dimensions);
    for (double& x : centers) x = uniform(rng);
    for (int i = 0; i < count; ++i) {
      const size_t cluster = rng() % kClusters;
      for (int d = 0; d < dimensions; ++d) {
        data.points[static_cast<size_t>(i) * dimensions + d] =
            centers[cluster * dimensions + d] + 0.02 * normal(rng);
      }
    }
  }
  return data;
}

IndexData ReadIndexKeys(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  double dimensions = 0.0;
  file.read(reinterpret_cast<char*>(&dimensions), sizeof(dimensions));
  IndexData data{path.substr(path.rfind('/') + 1), static_cast<int>(dimensions), 0, {}, {}, {}};
  const bool boxes = data.dimensions < 0;
  data.dimensions = std::abs(data.dimensions);
  std::vector<double> row(data.dimensions);
  const auto read = [&](std::vector<double>& to) {
    file.read(reinterpret_cast<char*>(row.data()),
              static_cast<std::streamsize>(row.size() * sizeof(double)));
    if (file) to.insert(to.end(), row.begin(), row.end());
  };
  while (file && data.dimensions > 0) {
    read(data.points);
    if (boxes) read(data.highs);
  }
  if (data.dimensions > 0) data.count = static_cast<int>(data.points.size()) / data.dimensions;
  return data;
}

void AddIndexQueries(IndexData& data, int count, unsigned seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> normal;
  std::vector<int64_t> ids(data.count);
  std::iota(ids.begin(), ids.end(), 0);
  const int d = data.dimensions;
  if (data.boxes()) {
    constexpr double kHalf = 0.03;
    for (int q = 0; q < count; ++q) {
      const int i = static_cast<int>(rng() % data.count);
      IndexQuery& query = data.queries.emplace_back();
      for (int k = 0; k < d; ++k) {
        query.center.push_back(0.5 * (data.Row(i)[k] + data.High(i)[k]));
        query.low.push_back(query.center.back() - kHalf);
        query.high.push_back(query.center.back() + kHalf);
      }
    }
    return;
  }
  const XTree tree = XTree::BulkLoad({.dimensions = d}, data.points, ids).value();
  for (int q = 0; q < count; ++q) {
    const double* at = data.Row(static_cast<int>(rng() % data.count));
    IndexQuery query;
    query.center.assign(at, at + d);
    const double size = tree.view().Nearest(query.center, 20).back().distance + 1e-9;
    for (const double x : query.center) {
      query.low.push_back(x - 0.7 * size);
      query.high.push_back(x + 0.7 * size);
    }
    Eigen::MatrixXd a(d, d);
    for (Eigen::Index i = 0; i < a.size(); ++i) a.data()[i] = normal(rng);
    const Eigen::MatrixXd rotation = Eigen::HouseholderQR<Eigen::MatrixXd>(a).householderQ();
    Eigen::VectorXd axes(d);
    for (int i = 0; i < d; ++i) axes(i) = size * (i % 2 == 0 ? 1.0 : 0.25);
    query.ellipsoid.center = Eigen::Map<const Eigen::VectorXd>(at, d);
    query.ellipsoid.covariance = rotation * axes.cwiseAbs2().asDiagonal() * rotation.transpose();
    query.ellipsoid.gate = 1.0;
    data.queries.push_back(std::move(query));
  }
}

}  // namespace horopter
