// What the bottom-up routes are made of, beside peers: time and what each gets right.
//   association   one-to-one assignment of a vote table; peer: largest entries first
//   collineation  six noisy points; peers: the linear equations, and a plain DLT by Eigen's SVD
//   clustering    votes of 15 coordinates, a third scattered; peer: OpenCV's k-means, told how many
#include <benchmark/benchmark.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <opencv2/core.hpp>
#include <tuple>

#include "server/vision/recognition/invariant_matching/association.h"
#include "server/vision/recognition/invariant_matching/mean_shift.h"
#include "tests/support/random.h"

namespace horopter {
namespace {

// A table of `n` points and vertices: the true pairs have a mean of 6 votes, all others of 1.
Eigen::MatrixXd VoteTable(int n, unsigned seed) {
  Random random(seed);
  Eigen::MatrixXd votes(n, n);
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < n; ++k) {
      const double mean = i == k ? 6.0 : 1.0;
      votes(i, k) = std::max(0.0, mean + 2.0 * random.Normal());
    }
  }
  return votes;
}

std::vector<int> LargestFirst(const Eigen::MatrixXd& votes) {
  std::vector<std::tuple<double, int, int>> entries;
  for (int i = 0; i < votes.rows(); ++i) {
    for (int k = 0; k < votes.cols(); ++k) entries.push_back({-votes(i, k), i, k});
  }
  std::sort(entries.begin(), entries.end());
  std::vector<int> out(votes.rows(), -1);
  std::vector<bool> used(votes.cols(), false);
  for (const auto& [value, i, k] : entries) {
    if (out[i] >= 0 || used[k]) continue;
    out[i] = k;
    used[k] = true;
  }
  return out;
}

template <typename Method>
void RunAssignment(benchmark::State& state, const Method& method) {
  const int n = static_cast<int>(state.range(0));
  std::vector<Eigen::MatrixXd> tables;
  for (unsigned seed = 1; seed <= 50; ++seed) tables.push_back(VoteTable(n, seed));
  double right = 0.0, total = 0.0;
  for (auto _ : state) {
    right = total = 0.0;
    for (const Eigen::MatrixXd& table : tables) {
      const std::vector<int> assigned = method(table);
      for (int i = 0; i < n; ++i) {
        right += assigned[i] == i;
        total += assigned[i] >= 0 ? table(i, assigned[i]) : 0.0;
      }
    }
  }
  state.counters["right"] = right / (50.0 * n);
  state.counters["votes"] = total / 50.0;
}
void BM_AssignHungarian(benchmark::State& state) {
  RunAssignment(state, MaximumAssignment);
}
void BM_AssignLargestFirst(benchmark::State& state) {
  RunAssignment(state, LargestFirst);
}
BENCHMARK(BM_AssignHungarian)->Arg(16)->Arg(64)->Unit(benchmark::kMicrosecond);
BENCHMARK(BM_AssignLargestFirst)->Arg(16)->Arg(64)->Unit(benchmark::kMicrosecond);

// Six points and more of a shape, their images under a mild collineation with noise.
struct PointSet {
  SceneStructure structure;
  ObjectShape shape;
  std::vector<VertexMatch> matches;
  std::vector<Eigen::Vector4d> from, to;
  std::vector<Eigen::Vector3d> check, check_image;  // not used by the methods
};
std::vector<PointSet> PointSets(int points) {
  std::vector<PointSet> out;
  for (unsigned seed = 1; seed <= 100; ++seed) {
    Random random(seed);
    Eigen::Matrix4d H = Eigen::Matrix4d::Identity();
    for (int i = 0; i < 4; ++i) {
      for (int k = 0; k < 4; ++k) H(i, k) += (i == 3 ? 0.15 : 0.3) * random.Uniform(-1.0, 1.0);
    }
    PointSet& set = out.emplace_back();
    const auto draw = [&] {
      return Eigen::Vector3d(
          random.Uniform(-0.5, 0.5), random.Uniform(-0.5, 0.5), random.Uniform(-0.5, 0.5));
    };
    for (int i = 0; i < points; ++i) {
      const Eigen::Vector3d x = draw();
      Eigen::Vector3d y = (H * x.homogeneous()).hnormalized();
      for (int k = 0; k < 3; ++k) y(k) += 1e-3 * random.Normal();
      set.shape.vertices.push_back(x);
      set.structure.points.push_back(y);
      set.matches.push_back({i, i});
      set.from.push_back(x.homogeneous());
      set.to.push_back(y.homogeneous());
    }
    for (int i = 0; i < 20; ++i) {
      set.check.push_back(draw());
      set.check_image.push_back((H * set.check.back().homogeneous()).hnormalized());
    }
  }
  return out;
}

absl::StatusOr<Eigen::Matrix4d> PlainDlt(const PointSet& set) {
  const int n = static_cast<int>(set.from.size());
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(3 * n, 16);
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < 3; ++k) {
      A.block<1, 4>(3 * i + k, 4 * k) = set.from[i].transpose() * set.to[i].w();
      A.block<1, 4>(3 * i + k, 12) = -set.from[i].transpose() * set.to[i](k);
    }
  }
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(A, Eigen::ComputeFullV);
  return Eigen::Matrix4d(
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(svd.matrixV().col(15).data()));
}

template <typename Method>
void RunCollineation(benchmark::State& state, const Method& method) {
  const std::vector<PointSet> sets = PointSets(static_cast<int>(state.range(0)));
  std::vector<double> errors;
  int refused = 0;
  for (auto _ : state) {
    errors.clear();
    refused = 0;
    for (const PointSet& set : sets) {
      const auto H = method(set);
      if (!H.ok()) {
        ++refused;
        continue;
      }
      for (std::size_t i = 0; i < set.check.size(); ++i) {
        errors.push_back(
            ((*H * set.check[i].homogeneous()).hnormalized() - set.check_image[i]).norm());
      }
    }
  }
  std::sort(errors.begin(), errors.end());
  if (!errors.empty()) state.counters["error"] = errors[errors.size() / 2];
  state.counters["refused"] = refused;
}
void BM_CollineationClosedForm(benchmark::State& state) {
  RunCollineation(state, [](const PointSet& s) { return CollineationFromBasis(s.from, s.to); });
}
void BM_CollineationLinear(benchmark::State& state) {
  RunCollineation(state, [](const PointSet& s) {
    return FitTransform(TransformGroup::kCollineation, s.structure, s.shape, s.matches, {});
  });
}
void BM_CollineationPlainDlt(benchmark::State& state) {
  RunCollineation(state, PlainDlt);
}
BENCHMARK(BM_CollineationClosedForm)->Arg(6)->Arg(20)->Unit(benchmark::kMicrosecond);
BENCHMARK(BM_CollineationLinear)->Arg(6)->Arg(20)->Unit(benchmark::kMicrosecond);
BENCHMARK(BM_CollineationPlainDlt)->Arg(6)->Arg(20)->Unit(benchmark::kMicrosecond);

struct Votes {
  Eigen::MatrixXd votes;
  std::vector<int> mode;  // -1: scattered
};
constexpr int kModes = 4;
Votes MakeVotes(int n, unsigned seed) {
  Random random(seed);
  Votes out{Eigen::MatrixXd(15, n), {}};
  Eigen::MatrixXd centres(15, kModes);
  for (Eigen::Index i = 0; i < centres.size(); ++i) centres(i) = random.Uniform(-1.0, 1.0);
  for (int i = 0; i < n; ++i) {
    const int mode = 3 * i < 2 * n ? i % kModes : -1;
    out.mode.push_back(mode);
    for (int d = 0; d < 15; ++d) {
      out.votes(d, i) =
          mode < 0 ? random.Uniform(-1.2, 1.2) : centres(d, mode) + 0.03 * random.Normal();
    }
  }
  return out;
}

// Share of the true modes of which the heaviest found cluster with most of its members is pure to
// nine tenths and holds nine tenths of it.
double ModesFound(const Votes& truth, const std::vector<int>& cluster) {
  int found = 0;
  for (int mode = 0; mode < kModes; ++mode) {
    std::map<int, int> of_mode, of_cluster;
    int size = 0;
    for (std::size_t i = 0; i < cluster.size(); ++i) {
      ++of_cluster[cluster[i]];
      if (truth.mode[i] != mode) continue;
      ++of_mode[cluster[i]];
      ++size;
    }
    const auto best = std::max_element(
        of_mode.begin(), of_mode.end(), [](auto& a, auto& b) { return a.second < b.second; });
    found += best->second >= 0.9 * size && best->second >= 0.9 * of_cluster[best->first];
  }
  return static_cast<double>(found) / kModes;
}

template <typename Method>
void RunClustering(benchmark::State& state, const Method& method) {
  const int n = static_cast<int>(state.range(0));
  std::vector<Votes> sets;
  for (unsigned seed = 1; seed <= 5; ++seed) sets.push_back(MakeVotes(n, seed));
  double found = 0.0;
  for (auto _ : state) {
    found = 0.0;
    for (const Votes& votes : sets) found += ModesFound(votes, method(votes)) / 5.0;
  }
  state.counters["modes_found"] = found;
}
std::vector<int> ClusterByMeanShift(const Votes& votes) {
  ClusterOptions options;
  options.min_bandwidth = 0.02;
  options.max_bandwidth = 0.5;
  const auto modes = FindModes(votes.votes, Eigen::VectorXd::Ones(votes.votes.cols()), options);
  std::vector<int> out(votes.votes.cols(), -1);
  if (!modes.ok()) return out;
  for (std::size_t m = 0; m < modes->size(); ++m) {
    for (const int i : (*modes)[m].members) out[i] = static_cast<int>(m);
  }
  return out;
}
void BM_ClusterFams(benchmark::State& state) {
  RunClustering(state, ClusterByMeanShift);
}
void BM_ClusterKMeans(benchmark::State& state) {
  RunClustering(state, [](const Votes& v) {
    cv::Mat data(static_cast<int>(v.votes.cols()), 15, CV_32F), labels;
    for (int i = 0; i < data.rows; ++i) {
      for (int d = 0; d < 15; ++d) data.at<float>(i, d) = static_cast<float>(v.votes(d, i));
    }
    cv::setRNGSeed(1);
    cv::kmeans(data,
               kModes + 1,
               labels,
               {cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 60, 1e-3},
               5,
               cv::KMEANS_PP_CENTERS);
    return std::vector<int>(labels.begin<int>(), labels.end<int>());
  });
}
BENCHMARK(BM_ClusterFams)->Arg(100)->Arg(300)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_ClusterKMeans)->Arg(100)->Arg(300)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace horopter

BENCHMARK_MAIN();
