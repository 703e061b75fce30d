#include "tests/bench/index_peers.h"

#include <spatialindex/SpatialIndex.h>

#include <Eigen/Dense>
#include <algorithm>
#include <boost/geometry.hpp>
#include <boost/geometry/index/rtree.hpp>
#include <nanoflann.hpp>
#include <numeric>

namespace horopter {
namespace {

namespace bg = boost::geometry;
namespace bgi = boost::geometry::index;
namespace si = SpatialIndex;

using Found = std::vector<int64_t>;

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

IndexQuery Bounds(const IndexQuery& query) {
  IndexQuery bounds;
  const Eigen::VectorXd half = query.ellipsoid.covariance.diagonal().cwiseSqrt();
  for (size_t d = 0; d < query.center.size(); ++d) {
    bounds.low.push_back(query.center[d] - half(static_cast<Eigen::Index>(d)));
    bounds.high.push_back(query.center[d] + half(static_cast<Eigen::Index>(d)));
  }
  return bounds;
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

// Calls make.operator()<D>() for the data's dimension.
template <typename Make>
IndexPeer ForDimension(int dimensions, const Make& make) {
  switch (dimensions) {
    case 2:
      return make.template operator()<2>();
    case 3:
      return make.template operator()<3>();
    case 4:
      return make.template operator()<4>();
    case 5:
      return make.template operator()<5>();
    case 6:
      return make.template operator()<6>();
    case 8:
      return make.template operator()<8>();
    case 16:
      return make.template operator()<16>();
    default:
      return {};
  }
}

template <int D>
IndexPeer MakeBoostOfBoxes(const IndexData& data, bool packed) {
  using Point = bg::model::point<double, D, bg::cs::cartesian>;
  using Box = bg::model::box<Point>;
  using Value = std::pair<Box, int64_t>;
  using Tree = bgi::rtree<Value, bgi::rstar<16>>;
  const auto box = [](const double* low, const double* high) {
    Box b;
    SetPoint<D>(b.min_corner(), low);
    SetPoint<D>(b.max_corner(), high);
    return b;
  };
  std::vector<Value> values(data.count);
  for (int i = 0; i < data.count; ++i) values[i] = {box(data.Row(i), data.High(i)), i};
  auto tree = packed ? std::make_shared<Tree>(values) : std::make_shared<Tree>();
  if (!packed) tree->insert(values);
  IndexPeer peer{packed ? "boost packed" : "boost R*", {}};
  peer.run = [tree, box](const IndexQuery& q, QueryKind kind, Found& ids) {
    const bool point = kind == QueryKind::kPoint;
    std::vector<Value> found;
    tree->query(bgi::intersects(box(point ? q.center.data() : q.low.data(),
                                    point ? q.center.data() : q.high.data())),
                std::back_inserter(found));
    for (const Value& v : found) ids.push_back(v.second);
  };
  return peer;
}

template <int D>
IndexPeer MakeBoost(const IndexData& data, bool packed) {
  using Point = bg::model::point<double, D, bg::cs::cartesian>;
  using Box = bg::model::box<Point>;
  using Value = std::pair<Point, int64_t>;
  using Tree = bgi::rtree<Value, bgi::rstar<16>>;
  std::vector<Value> values(data.count);
  for (int i = 0; i < data.count; ++i) {
    SetPoint<D>(values[i].first, data.Row(i));
    values[i].second = i;
  }
  auto tree = packed ? std::make_shared<Tree>(values) : std::make_shared<Tree>();
  if (!packed) tree->insert(values);
  IndexPeer peer{packed ? "boost packed" : "boost R*", {}};
  peer.run = [tree](const IndexQuery& q, QueryKind kind, Found& ids) {
    std::vector<Value> found;
    const auto box = [](const std::vector<double>& low, const std::vector<double>& high) {
      Box b;
      SetPoint<D>(b.min_corner(), low.data());
      SetPoint<D>(b.max_corner(), high.data());
      return b;
    };
    if (kind == QueryKind::kPoint) {
      tree->query(bgi::intersects(box(q.center, q.center)), std::back_inserter(found));
    } else if (kind == QueryKind::kBox) {
      tree->query(bgi::intersects(box(q.low, q.high)), std::back_inserter(found));
    } else if (kind == QueryKind::kNeighbors) {
      Point p;
      SetPoint<D>(p, q.center.data());
      tree->query(bgi::nearest(p, kNearestCount), std::back_inserter(found));
    } else {
      const IndexQuery b = Bounds(q);
      const Eigen::MatrixXd whiten = Whiten(q.ellipsoid);
      tree->query(bgi::intersects(box(b.low, b.high)), std::back_inserter(found));
      std::erase_if(found, [&](const Value& v) {
        double x[D];
        GetPoint<D>(v.first, x);
        return !InEllipsoid(whiten, q.ellipsoid.center, x);
      });
    }
    for (const Value& v : found) ids.push_back(v.second);
  };
  return peer;
}

// Boxes of four dimensions, points of all others: each instance takes the compiler long.
template <int D>
IndexPeer MakeEither(const IndexData& data, bool packed) {
  if constexpr (D == 4) {
    return MakeBoostOfBoxes<D>(data, packed);
  } else {
    return MakeBoost<D>(data, packed);
  }
}

struct Cloud {
  const IndexData* data;
  size_t kdtree_get_point_count() const { return data->count; }
  double kdtree_get_pt(size_t i, size_t d) const { return data->Row(static_cast<int>(i))[d]; }
  template <class B>
  bool kdtree_get_bbox(B&) const {
    return false;
  }
};

template <int D>
IndexPeer MakeKdTree(const IndexData& data) {
  using Tree = nanoflann::
      KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Cloud>, Cloud, D, size_t>;
  auto cloud = std::make_shared<Cloud>(Cloud{&data});
  auto tree = std::make_shared<Tree>(D, *cloud, nanoflann::KDTreeSingleIndexAdaptorParams(10));
  tree->buildIndex();
  IndexPeer peer{"nanoflann", {}};
  peer.run = [tree, cloud](const IndexQuery& q, QueryKind kind, Found& ids) {
    nanoflann::SearchParams unsorted(32, 0.0f, false);
    std::vector<std::pair<size_t, double>> found;
    const auto keep = [&](const auto& accept) {
      for (const auto& [i, squared] : found) {
        if (accept(cloud->data->Row(static_cast<int>(i)))) ids.push_back(static_cast<int64_t>(i));
      }
    };
    if (kind == QueryKind::kPoint) {
      tree->radiusSearch(q.center.data(), 1e-300, found, unsorted);
      keep([](const double*) { return true; });
    } else if (kind == QueryKind::kBox) {
      const double half = q.high[0] - q.center[0];
      tree->radiusSearch(q.center.data(), half * half * D * 1.001, found, unsorted);
      keep([&](const double* x) {
        bool in = true;
        for (int d = 0; d < D; ++d) in &= x[d] >= q.low[d] && x[d] <= q.high[d];
        return in;
      });
    } else if (kind == QueryKind::kNeighbors) {
      size_t indices[kNearestCount];
      double squared[kNearestCount];
      const size_t n = tree->knnSearch(q.center.data(), kNearestCount, indices, squared);
      for (size_t i = 0; i < n; ++i) ids.push_back(static_cast<int64_t>(indices[i]));
    } else {
      const Eigen::MatrixXd whiten = Whiten(q.ellipsoid);
      const double squared_radius = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(
                                        q.ellipsoid.covariance, Eigen::EigenvaluesOnly)
                                        .eigenvalues()
                                        .maxCoeff();
      tree->radiusSearch(q.center.data(), squared_radius * 1.001, found, unsorted);
      keep([&](const double* x) { return InEllipsoid(whiten, q.ellipsoid.center, x); });
    }
  };
  return peer;
}

struct IdVisitor : si::IVisitor {
  std::function<bool(const si::IData&)> accept;
  Found* ids = nullptr;
  void visitNode(const si::INode&) override {}
  void visitData(const si::IData& data) override {
    if (!accept || accept(data)) ids->push_back(data.getIdentifier());
  }
  void visitData(std::vector<const si::IData*>&) override {}
};

struct DataStream : si::IDataStream {
  const IndexData* data = nullptr;
  int next = 0;
  si::IData* getNext() override {
    si::Region region(data->Row(next), data->High(next), static_cast<uint32_t>(data->dimensions));
    return new si::RTree::Data(0, nullptr, region, next++);
  }
  bool hasNext() override { return next < data->count; }
  uint32_t size() override { return static_cast<uint32_t>(data->count); }
  void rewind() override { next = 0; }
};

}  // namespace

bool IsComparedDimension(int dimensions) {
  return !!ForDimension(dimensions, []<int D>() {
             return IndexPeer{"", [](const IndexQuery&, QueryKind, Found&) {}};
           }).run;
}

IndexPeer MakeXTreePeer(const IndexData& data) {
  Found numbers(data.count);
  std::iota(numbers.begin(), numbers.end(), 0);
  auto tree = std::make_shared<XTree>(
      XTree::BulkLoadBoxes({.dimensions = data.dimensions, .boxes = data.boxes()},
                           data.points,
                           data.boxes() ? data.highs : data.points,
                           numbers)
          .value());
  IndexPeer peer{"x-tree", {}};
  peer.run = [tree](const IndexQuery& q, QueryKind kind, Found& ids) {
    if (kind == QueryKind::kPoint) {
      ids = tree->view().Box(q.center, q.center);
    } else if (kind == QueryKind::kBox) {
      ids = tree->view().Box(q.low, q.high);
    } else if (kind == QueryKind::kNeighbors) {
      for (const Neighbor& n : tree->view().Nearest(q.center, kNearestCount)) ids.push_back(n.id);
    } else {
      const std::vector<EllipsoidMatch> found = tree->view().Inside(q.ellipsoid).value();
      for (const EllipsoidMatch& m : found) ids.push_back(m.id);
    }
  };
  return peer;
}

IndexPeer MakeBoostPacked(const IndexData& data) {
  return ForDimension(data.dimensions, [&]<int D>() { return MakeEither<D>(data, true); });
}

IndexPeer MakeBoostRStar(const IndexData& data) {
  return ForDimension(data.dimensions, [&]<int D>() { return MakeEither<D>(data, false); });
}

IndexPeer MakeNanoflann(const IndexData& data) {
  return ForDimension(data.dimensions, [&]<int D>() { return MakeKdTree<D>(data); });
}

IndexPeer MakeLibspatialindex(const IndexData& data) {
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
  IndexPeer peer{"libspatialindex", {}};
  const uint32_t d = static_cast<uint32_t>(data.dimensions);
  peer.run = [tree, d, &data](const IndexQuery& q, QueryKind kind, Found& ids) {
    IdVisitor visitor;
    visitor.ids = &ids;
    if (kind == QueryKind::kNeighbors) {
      // It returns ties of the last distance too; they are as rare here as equal points.
      tree->nearestNeighborQuery(kNearestCount, si::Point(q.center.data(), d), visitor);
    } else if (kind == QueryKind::kEllipsoid) {
      const IndexQuery b = Bounds(q);
      const Eigen::MatrixXd whiten = Whiten(q.ellipsoid);
      visitor.accept = [&](const si::IData& found) {
        return InEllipsoid(
            whiten, q.ellipsoid.center, data.Row(static_cast<int>(found.getIdentifier())));
      };
      tree->intersectsWithQuery(si::Region(b.low.data(), b.high.data(), d), visitor);
    } else {
      const double* low = kind == QueryKind::kPoint ? q.center.data() : q.low.data();
      const double* high = kind == QueryKind::kPoint ? q.center.data() : q.high.data();
      tree->intersectsWithQuery(si::Region(low, high, d), visitor);
    }
  };
  return peer;
}

IndexPeer MakeEigenScan(const IndexData& data) {
  using Matrix = Eigen::Map<const Eigen::MatrixXd>;
  IndexPeer peer{"Eigen scan", {}};
  peer.run = [&data](const IndexQuery& q, QueryKind kind, Found& ids) {
    const Matrix x(data.points.data(), data.dimensions, data.count);
    const Eigen::Map<const Eigen::VectorXd> center(q.center.data(), data.dimensions);
    if (kind == QueryKind::kNeighbors) {
      const Eigen::VectorXd squared = (x.colwise() - center).colwise().squaredNorm();
      std::vector<int> order(data.count);
      std::iota(order.begin(), order.end(), 0);
      std::nth_element(
          order.begin(), order.begin() + kNearestCount, order.end(), [&](int a, int b) {
            return squared(a) != squared(b) ? squared(a) < squared(b) : a < b;
          });
      ids.assign(order.begin(), order.begin() + kNearestCount);
    } else if (kind == QueryKind::kEllipsoid) {
      const Eigen::MatrixXd whiten = Whiten(q.ellipsoid);
      constexpr int kBlock = 1024;  // stays in the cache
      Eigen::MatrixXd y;
      for (int begin = 0; begin < data.count; begin += kBlock) {
        const int n = std::min(kBlock, data.count - begin);
        y.noalias() = whiten * (x.middleCols(begin, n).colwise() - center);
        const Eigen::VectorXd squared = y.colwise().squaredNorm();
        for (int i = 0; i < n; ++i) {
          if (squared(i) <= 1.0) ids.push_back(begin + i);
        }
      }
    } else {
      const std::vector<double>& low_values = kind == QueryKind::kPoint ? q.center : q.low;
      const std::vector<double>& high_values = kind == QueryKind::kPoint ? q.center : q.high;
      const Eigen::Map<const Eigen::ArrayXd> low(low_values.data(), data.dimensions);
      const Eigen::Map<const Eigen::ArrayXd> high(high_values.data(), data.dimensions);
      const Matrix top(data.High(0), data.dimensions, data.count);
      for (int i = 0; i < data.count; ++i) {
        if ((top.col(i).array() >= low).all() && (x.col(i).array() <= high).all()) {
          ids.push_back(i);
        }
      }
    }
  };
  return peer;
}

}  // namespace horopter
