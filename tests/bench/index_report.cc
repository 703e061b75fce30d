// Times the X-tree beside its peers on the same data, queries and run: boost.geometry's packed
// R*-tree, libspatialindex's R*-tree, nanoflann's kd-tree and an Eigen linear scan; then counts
// node accesses of dynamic trees in X-tree and R*-tree mode.
//
//   index_report [--quick] [--accesses] [--dimensions D] [--leaf N] [--directory N] [KEYS...]
//     --quick     10^4 and 10^5 points only
//     --accesses  only the node accesses
//     KEYS        files of invariant keys: doubles, first the dimension, then point after point
#include <spatialindex/SpatialIndex.h>

#include <Eigen/Dense>
#include <algorithm>
#include <boost/geometry.hpp>
#include <boost/geometry/index/rtree.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <functional>
#include <nanoflann.hpp>
#include <numeric>
#include <random>
#include <string>
#include <vector>

#include "server/index/x_tree.h"

namespace horopter {
namespace {

namespace bg = boost::geometry;
namespace bgi = boost::geometry::index;
namespace si = SpatialIndex;

constexpr int kNearest = 10;
constexpr int kRounds = 3;  // of all peers in turn; the fastest counts

struct Query {
  std::vector<double> center;
  std::vector<double> low;
  std::vector<double> high;
  Ellipsoid ellipsoid;
};

struct DataSet {
  std::string name;
  int dimensions = 0;
  int count = 0;
  std::vector<double> points;
  std::vector<Query> queries;

  const double* Row(int i) const { return &points[static_cast<size_t>(i) * dimensions]; }
};

enum class Kind { kPoint, kBox, kNeighbors, kEllipsoid };
constexpr Kind kKinds[] = {Kind::kPoint, Kind::kBox, Kind::kNeighbors, Kind::kEllipsoid};
const char* NameOf(Kind kind) {
  constexpr const char* kNames[] = {"point", "box", "10-NN", "ellipsoid"};
  return kNames[static_cast<int>(kind)];
}

// Queries lie at data points; box and ellipsoid are as large as the distance of about the 20th
// neighbour, the ellipsoid with axes of 1 : 1/4 in a random direction.
void AddQueries(DataSet& data, int count, unsigned seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> normal;
  std::vector<int64_t> ids(data.count);
  std::iota(ids.begin(), ids.end(), 0);
  const XTree tree = XTree::BulkLoad({.dimensions = data.dimensions}, data.points, ids).value();
  const int d = data.dimensions;
  for (int q = 0; q < count; ++q) {
    const double* at = data.Row(static_cast<int>(rng() % data.count));
    Query query;
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

DataSet Generate(const std::string& name, int dimensions, int count, unsigned seed) {
  DataSet data{name, dimensions, count, {}, {}};
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

// Sum of found ids: all peers must agree on it.
using Runner = std::function<int64_t(const Query&, Kind)>;
struct Peer {
  std::string name;
  Runner run;
  double build_ms = 0.0;
};

double Now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

bool InEllipsoid(const Eigen::MatrixXd& whiten, const Eigen::VectorXd& center, const double* x) {
  const Eigen::Index n = center.size();
  double sum = 0.0;
  for (Eigen::Index r = 0; r < n && sum <= 1.0; ++r) {
    double y = 0.0;
    for (Eigen::Index c = 0; c <= r; ++c) y += whiten(r, c) * (x[c] - center(c));
    sum += y * y;
  }
  return sum <= 1.0;
}

Eigen::MatrixXd Whiten(const Ellipsoid& e) {
  const Eigen::LLT<Eigen::MatrixXd> factor(e.covariance);
  return factor.matrixL().solve(
      Eigen::MatrixXd::Identity(e.covariance.rows(), e.covariance.cols()));
}

Query Bounds(const Query& query) {
  Query bounds;
  const Eigen::VectorXd half = query.ellipsoid.covariance.diagonal().cwiseSqrt();
  for (size_t d = 0; d < query.center.size(); ++d) {
    bounds.low.push_back(query.center[d] - half(static_cast<Eigen::Index>(d)));
    bounds.high.push_back(query.center[d] + half(static_cast<Eigen::Index>(d)));
  }
  return bounds;
}

Peer MakeXTree(const DataSet& data, const XTreeOptions& base) {
  std::vector<int64_t> ids(data.count);
  std::iota(ids.begin(), ids.end(), 0);
  XTreeOptions options = base;
  options.dimensions = data.dimensions;
  const double start = Now();
  auto tree = std::make_shared<XTree>(XTree::BulkLoad(options, data.points, ids).value());
  Peer peer{"x-tree", {}, (Now() - start) * 1e3};
  peer.run = [tree](const Query& q, Kind kind) {
    int64_t sum = 0;
    if (kind == Kind::kPoint) {
      for (const int64_t id : tree->view().Box(q.center, q.center)) sum += id;
    } else if (kind == Kind::kBox) {
      for (const int64_t id : tree->view().Box(q.low, q.high)) sum += id;
    } else if (kind == Kind::kNeighbors) {
      for (const Neighbor& n : tree->view().Nearest(q.center, kNearest)) sum += n.id;
    } else {
      const std::vector<EllipsoidMatch> found = tree->view().Inside(q.ellipsoid).value();
      for (const EllipsoidMatch& m : found) sum += m.id;
    }
    return sum;
  };
  return peer;
}

template <int D, int I = 0, typename Point>
void SetPoint(Point& point, const double* x) {
  if constexpr (I < D) {
    bg::set<I>(point, x[I]);
    SetPoint<D, I + 1>(point, x);
  }
}
template <int D, int I = 0, typename Point>
void GetPoint(const Point& point, double* x) {
  if constexpr (I < D) {
    x[I] = bg::get<I>(point);
    GetPoint<D, I + 1>(point, x);
  }
}

template <int D>
Peer MakeBoost(const DataSet& data) {
  using Point = bg::model::point<double, D, bg::cs::cartesian>;
  using Box = bg::model::box<Point>;
  using Value = std::pair<Point, int64_t>;
  std::vector<Value> values(data.count);
  for (int i = 0; i < data.count; ++i) {
    SetPoint<D>(values[i].first, data.Row(i));
    values[i].second = i;
  }
  const double start = Now();
  auto tree = std::make_shared<bgi::rtree<Value, bgi::rstar<16>>>(values);
  Peer peer{"boost packed", {}, (Now() - start) * 1e3};
  peer.run = [tree](const Query& q, Kind kind) {
    int64_t sum = 0;
    std::vector<Value> found;
    const auto box = [](const std::vector<double>& low, const std::vector<double>& high) {
      Box b;
      SetPoint<D>(b.min_corner(), low.data());
      SetPoint<D>(b.max_corner(), high.data());
      return b;
    };
    if (kind == Kind::kPoint) {
      tree->query(bgi::intersects(box(q.center, q.center)), std::back_inserter(found));
    } else if (kind == Kind::kBox) {
      tree->query(bgi::intersects(box(q.low, q.high)), std::back_inserter(found));
    } else if (kind == Kind::kNeighbors) {
      Point p;
      SetPoint<D>(p, q.center.data());
      tree->query(bgi::nearest(p, kNearest), std::back_inserter(found));
    } else {
      const Query b = Bounds(q);
      const Eigen::MatrixXd whiten = Whiten(q.ellipsoid);
      tree->query(bgi::intersects(box(b.low, b.high)), std::back_inserter(found));
      std::erase_if(found, [&](const Value& v) {
        double x[D];
        GetPoint<D>(v.first, x);
        return !InEllipsoid(whiten, q.ellipsoid.center, x);
      });
    }
    for (const Value& v : found) sum += v.second;
    return sum;
  };
  return peer;
}

struct Cloud {
  const DataSet* data;
  size_t kdtree_get_point_count() const { return data->count; }
  double kdtree_get_pt(size_t i, size_t d) const { return data->Row(static_cast<int>(i))[d]; }
  template <class B>
  bool kdtree_get_bbox(B&) const {
    return false;
  }
};

template <int D>
Peer MakeNanoflann(const DataSet& data) {
  using Tree = nanoflann::
      KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Cloud>, Cloud, D, size_t>;
  auto cloud = std::make_shared<Cloud>(Cloud{&data});
  const double start = Now();
  auto tree = std::make_shared<Tree>(D, *cloud, nanoflann::KDTreeSingleIndexAdaptorParams(10));
  tree->buildIndex();
  Peer peer{"nanoflann", {}, (Now() - start) * 1e3};
  peer.run = [tree, cloud](const Query& q, Kind kind) {
    int64_t sum = 0;
    nanoflann::SearchParams unsorted(32, 0.0f, false);
    std::vector<std::pair<size_t, double>> found;
    if (kind == Kind::kPoint) {
      tree->radiusSearch(q.center.data(), 1e-300, found, unsorted);
      for (const auto& [i, squared] : found) sum += static_cast<int64_t>(i);
    } else if (kind == Kind::kBox) {  // it has no box query: the ball around it, then the test
      const double half = q.high[0] - q.center[0];
      tree->radiusSearch(q.center.data(), half * half * D * 1.001, found, unsorted);
      for (const auto& [i, squared] : found) {
        const double* x = cloud->data->Row(static_cast<int>(i));
        bool in = true;
        for (int d = 0; d < D; ++d) in &= x[d] >= q.low[d] && x[d] <= q.high[d];
        if (in) sum += static_cast<int64_t>(i);
      }
    } else if (kind == Kind::kNeighbors) {
      size_t indices[kNearest];
      double squared[kNearest];
      const size_t n = tree->knnSearch(q.center.data(), kNearest, indices, squared);
      for (size_t i = 0; i < n; ++i) sum += static_cast<int64_t>(indices[i]);
    } else {  // the ball around the ellipsoid, then the test
      const Eigen::MatrixXd whiten = Whiten(q.ellipsoid);
      const double squared_radius = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(
                                        q.ellipsoid.covariance, Eigen::EigenvaluesOnly)
                                        .eigenvalues()
                                        .maxCoeff();
      tree->radiusSearch(q.center.data(), squared_radius * 1.001, found, unsorted);
      for (const auto& [i, squared] : found) {
        if (InEllipsoid(whiten, q.ellipsoid.center, cloud->data->Row(static_cast<int>(i)))) {
          sum += static_cast<int64_t>(i);
        }
      }
    }
    return sum;
  };
  return peer;
}

Peer MakeEigen(const DataSet& data) {
  using Matrix = Eigen::Map<const Eigen::MatrixXd>;
  Peer peer{"Eigen scan", {}, 0.0};
  peer.run = [&data](const Query& q, Kind kind) {
    const Matrix x(data.points.data(), data.dimensions, data.count);
    const Eigen::Map<const Eigen::VectorXd> center(q.center.data(), data.dimensions);
    int64_t sum = 0;
    if (kind == Kind::kNeighbors) {
      const Eigen::VectorXd squared = (x.colwise() - center).colwise().squaredNorm();
      std::vector<int> order(data.count);
      std::iota(order.begin(), order.end(), 0);
      std::nth_element(order.begin(), order.begin() + kNearest, order.end(), [&](int a, int b) {
        return squared(a) != squared(b) ? squared(a) < squared(b) : a < b;
      });
      for (int i = 0; i < kNearest; ++i) sum += order[i];
      return sum;
    }
    if (kind == Kind::kEllipsoid) {
      const Eigen::MatrixXd whiten = Whiten(q.ellipsoid);
      constexpr int kBlock = 1024;  // stays in the cache
      Eigen::MatrixXd y;
      for (int begin = 0; begin < data.count; begin += kBlock) {
        const int n = std::min(kBlock, data.count - begin);
        y.noalias() = whiten * (x.middleCols(begin, n).colwise() - center);
        const Eigen::VectorXd squared = y.colwise().squaredNorm();
        for (int i = 0; i < n; ++i) {
          if (squared(i) <= 1.0) sum += begin + i;
        }
      }
      return sum;
    }
    const std::vector<double>& low_values = kind == Kind::kPoint ? q.center : q.low;
    const std::vector<double>& high_values = kind == Kind::kPoint ? q.center : q.high;
    const Eigen::Map<const Eigen::ArrayXd> low(low_values.data(), data.dimensions);
    const Eigen::Map<const Eigen::ArrayXd> high(high_values.data(), data.dimensions);
    for (int i = 0; i < data.count; ++i) {
      if ((x.col(i).array() >= low).all() && (x.col(i).array() <= high).all()) sum += i;
    }
    return sum;
  };
  return peer;
}

struct SumVisitor : si::IVisitor {
  std::function<bool(const si::IData&)> accept;
  int64_t sum = 0;
  void visitNode(const si::INode&) override {}
  void visitData(const si::IData& data) override {
    if (!accept || accept(data)) sum += data.getIdentifier();
  }
  void visitData(std::vector<const si::IData*>&) override {}
};

struct DataStream : si::IDataStream {
  const DataSet* data = nullptr;
  int next = 0;
  si::IData* getNext() override {
    const si::Point p(data->Row(next), static_cast<uint32_t>(data->dimensions));
    si::Region region;
    p.getMBR(region);
    return new si::RTree::Data(0, nullptr, region, next++);
  }
  bool hasNext() override { return next < data->count; }
  uint32_t size() override { return static_cast<uint32_t>(data->count); }
  void rewind() override { next = 0; }
};

Peer MakeSpatialIndex(const DataSet& data) {
  const double start = Now();
  std::shared_ptr<si::IStorageManager> storage(si::StorageManager::createNewMemoryStorageManager());
  DataStream stream;
  stream.data = &data;
  si::id_type id = 0;
  si::ISpatialIndex* made =
      si::RTree::createAndBulkLoadNewRTree(si::RTree::BLM_STR,
                                           stream,
                                           *storage,
                                           0.9,
                                           32,
                                           32,
                                           static_cast<uint32_t>(data.dimensions),
                                           si::RTree::RV_RSTAR,
                                           id);
  // The tree writes to its storage when it is destroyed.
  const std::shared_ptr<si::ISpatialIndex> tree(
      made, [storage](const si::ISpatialIndex* owned) { delete owned; });
  Peer peer{"libspatialindex", {}, (Now() - start) * 1e3};
  const uint32_t d = static_cast<uint32_t>(data.dimensions);
  peer.run = [tree, d, &data](const Query& q, Kind kind) {
    SumVisitor visitor;
    if (kind == Kind::kNeighbors) {
      // It returns ties of the last distance too; they are as rare here as equal points.
      tree->nearestNeighborQuery(kNearest, si::Point(q.center.data(), d), visitor);
    } else if (kind == Kind::kEllipsoid) {
      const Query b = Bounds(q);
      const Eigen::MatrixXd whiten = Whiten(q.ellipsoid);
      visitor.accept = [&](const si::IData& found) {
        return InEllipsoid(
            whiten, q.ellipsoid.center, data.Row(static_cast<int>(found.getIdentifier())));
      };
      tree->intersectsWithQuery(si::Region(b.low.data(), b.high.data(), d), visitor);
    } else {
      const double* low = kind == Kind::kPoint ? q.center.data() : q.low.data();
      const double* high = kind == Kind::kPoint ? q.center.data() : q.high.data();
      tree->intersectsWithQuery(si::Region(low, high, d), visitor);
    }
    return visitor.sum;
  };
  return peer;
}

// Microseconds per query, and the sums of ids.
std::pair<double, int64_t> Time(const Peer& peer, const DataSet& data, Kind kind) {
  int64_t sum = 0;
  const double start = Now();
  size_t done = 0;
  // Slow peers are cut off after a second; the mean is over what was done.
  for (; done < data.queries.size() && (done < 3 || Now() - start < 1.0); ++done) {
    sum += peer.run(data.queries[done], kind);
  }
  return {(Now() - start) * 1e6 / static_cast<double>(done),
          done == data.queries.size() ? sum : -1};
}

template <int D>
void Compare(DataSet data, const XTreeOptions& options) {
  AddQueries(data, data.count > 500000 ? 100 : 300, 17);
  std::vector<Peer> peers;
  peers.push_back(MakeXTree(data, options));
  peers.push_back(MakeNanoflann<D>(data));
  peers.push_back(MakeBoost<D>(data));
  peers.push_back(MakeSpatialIndex(data));
  peers.push_back(MakeEigen(data));
  for (const Kind kind : kKinds) {
    std::vector<double> best(peers.size(), 1e300);
    std::vector<int64_t> sums(peers.size());
    for (int round = 0; round < kRounds; ++round) {
      for (size_t p = 0; p < peers.size(); ++p) {
        if (round > 1 && best[p] > 2000.0) continue;
        const auto [time, sum] = Time(peers[p], data, kind);
        best[p] = std::min(best[p], time);
        sums[p] = sum;
      }
    }
    std::printf("| %s | %d | %d | %s |", data.name.c_str(), D, data.count, NameOf(kind));
    bool agree = true;
    for (size_t p = 0; p < peers.size(); ++p) {
      std::printf(" %.2f |", best[p]);
      agree &= sums[p] < 0 || sums[p] == sums[0];
    }
    const size_t fastest = std::min_element(best.begin(), best.end()) - best.begin();
    std::printf(" %s |%s\n", peers[fastest].name.c_str(), agree ? "" : " ANSWERS DIFFER");
    std::fflush(stdout);
  }
}

void CompareAny(const DataSet& data, const XTreeOptions& options) {
  switch (data.dimensions) {
    case 1:
      return Compare<1>(data, options);
    case 2:
      return Compare<2>(data, options);
    case 3:
      return Compare<3>(data, options);
    case 5:
      return Compare<5>(data, options);
    case 6:
      return Compare<6>(data, options);
    case 8:
      return Compare<8>(data, options);
    case 16:
      return Compare<16>(data, options);
    default:
      std::printf("no comparison is compiled for %d dimensions\n", data.dimensions);
  }
}

DataSet ReadKeys(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  double dimensions = 0.0;
  file.read(reinterpret_cast<char*>(&dimensions), sizeof(dimensions));
  DataSet data{path.substr(path.rfind('/') + 1), static_cast<int>(dimensions), 0, {}, {}};
  double x = 0.0;
  while (file.read(reinterpret_cast<char*>(&x), sizeof(x))) data.points.push_back(x);
  if (data.dimensions > 0) data.count = static_cast<int>(data.points.size()) / data.dimensions;
  return data;
}

// Dynamic insertion into pages of 4 KiB, as in the paper; point and 10-NN queries.
void CountAccesses(const std::string& name, int dimensions, int count) {
  DataSet data = Generate(name == "uniform" ? name : "clustered", dimensions, count, 5);
  const bool boxes = name == "boxes";
  const int entry_bytes = 8 * dimensions + 8;
  double point[2], nearest[2];
  int64_t supernodes = 0;
  for (const IndexMode mode : {IndexMode::kXTree, IndexMode::kRStarTree}) {
    XTree tree = XTree::Create({.dimensions = dimensions,
                                .boxes = boxes,
                                .mode = mode,
                                .leaf_capacity = 4096 / (boxes ? 2 * entry_bytes - 8 : entry_bytes),
                                .directory_capacity = 4096 / (2 * entry_bytes - 8)})
                     .value();
    for (int i = 0; i < count; ++i) {
      const std::span<const double> at(data.Row(i), dimensions);
      std::vector<double> high(at.begin(), at.end());
      if (boxes) {
        for (double& x : high) x += 0.05;
      }
      (void)tree.InsertBox(at, high, i);
    }
    QueryStats points, neighbours;
    std::mt19937 rng(3);
    constexpr int kQueries = 300;
    for (int q = 0; q < kQueries; ++q) {
      const std::span<const double> at(data.Row(static_cast<int>(rng() % count)), dimensions);
      tree.view().Box(at, at, &points);
      tree.view().Nearest(at, kNearest, &neighbours);
    }
    const int m = static_cast<int>(mode);
    point[m] = static_cast<double>(points.accesses()) / kQueries;
    nearest[m] = static_cast<double>(neighbours.accesses()) / kQueries;
    if (mode == IndexMode::kXTree) supernodes = tree.view().Memory().supernodes;
  }
  std::printf("| %s | %d | %d | %.1f | %.1f | %.2f | %.1f | %.1f | %.2f | %lld |\n",
              name.c_str(),
              dimensions,
              count,
              point[0],
              point[1],
              point[1] / point[0],
              nearest[0],
              nearest[1],
              nearest[1] / nearest[0],
              static_cast<long long>(supernodes));
  std::fflush(stdout);
}

int Main(int argc, char** argv) {
  bool quick = false, accesses = false;
  int only_dimensions = 0;
  XTreeOptions options;
  std::vector<std::string> keys;
  for (int i = 1; i < argc; ++i) {
    const std::string arg = argv[i];
    if (arg == "--quick") {
      quick = true;
    } else if (arg == "--accesses") {
      accesses = true;
    } else if (arg == "--dimensions" && i + 1 < argc) {
      only_dimensions = std::stoi(argv[++i]);
    } else if (arg == "--leaf" && i + 1 < argc) {
      options.leaf_capacity = std::stoi(argv[++i]);
    } else if (arg == "--directory" && i + 1 < argc) {
      options.directory_capacity = std::stoi(argv[++i]);
    } else {
      keys.push_back(arg);
    }
  }
  if (!accesses) {
    std::printf(
        "| data | d | n | query | x-tree us | nanoflann us | boost packed us | "
        "libspatialindex us | Eigen scan us | fastest "
        "|\n|---|---|---|---|---|---|---|---|---|---|\n");
    for (const std::string& path : keys) CompareAny(ReadKeys(path), options);
    if (!keys.empty()) return 0;
    for (const char* name : {"uniform", "clustered"}) {
      for (const int d : {2, 3, 6, 8, 16}) {
        for (const int n : {10000, 100000, 1000000}) {
          if ((quick && n > 100000) || (only_dimensions > 0 && d != only_dimensions)) continue;
          CompareAny(Generate(name, d, n, 1), options);
        }
      }
    }
    return 0;
  }
  std::printf(
      "| data | d | n | point: X | R* | R*/X | 10-NN: X | R* | R*/X | supernodes |\n"
      "|---|---|---|---|---|---|---|---|---|---|\n");
  for (const char* name : {"uniform", "clustered", "boxes"}) {
    for (const int d : {2, 4, 8, 16}) CountAccesses(name, d, quick ? 20000 : 100000);
  }
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
