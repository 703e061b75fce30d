// The X-tree (Berchtold, Keim, Kriegel, VLDB 1996): a dynamic index of points or boxes of R^n with
// ids.
//
// It is an R*-tree (Beckmann et al. 1990) whose directory nodes remember along which dimensions
// their entries have been split. When the topological split of a directory node would overlap too
// much, the history offers dimensions along which an overlap-free split exists; when that split
// would be unbalanced, the node grows into a supernode instead. Many supernodes are a linear scan,
// which is what is right in many dimensions.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace horopter {

namespace index_internal {
struct Node;
struct Entry;
}  // namespace index_internal

enum class IndexMode {
  kXTree,     // split history and supernodes
  kRStarTree  // topological splits only, forced reinsertion: for comparison
};

struct XTreeOptions {
  int dimensions = 0;  // 1..kMaxDimensions
  bool boxes = false;  // entries are boxes; false: points, at half the memory
  IndexMode mode = IndexMode::kXTree;
  // Entries of a leaf and of a directory node, >= 4; 31 and the one too many fill whole cache
  // lines. Larger: fewer nodes to jump between, more entries tested by each query.
  int leaf_capacity = 31;
  int directory_capacity = 31;
  double min_fill = 0.35;     // share of the capacity a split leaves on each side (paper: 35 %)
  double max_overlap = 0.20;  // of a topological directory split before the history is asked
  // A query that meets more than this share of the first directory nodes' children stops testing
  // bounds and reads all leaves in storage order: a linear scan. Nearest() never needs it, as its
  // bounds shrink while it runs. Larger: switches later.
  double scan_share = 0.9;
};

inline constexpr int kMaxDimensions = 64;

// Errors: INVALID_ARGUMENT, names the field.
absl::Status Validate(const XTreeOptions& options);

// What queries touched. A supernode counts as the number of blocks it spans, as in the paper.
struct QueryStats {
  int64_t directory_accesses = 0;
  int64_t leaf_accesses = 0;
  int64_t entries_tested = 0;
  int64_t scans = 0;  // queries answered by reading all leaves

  int64_t accesses() const { return directory_accesses + leaf_accesses; }
};

struct MemoryReport {
  int64_t entries = 0;
  int64_t leaves = 0;
  int64_t directory_nodes = 0;
  int64_t supernodes = 0;
  int64_t largest_supernode = 0;  // entries it can hold
  int64_t bytes = 0;
  int height = 0;  // levels; 1: the root is a leaf
};

struct Neighbor {
  int64_t id = 0;
  double distance = 0.0;  // Euclidean; to the nearest point of a box

  friend bool operator==(const Neighbor&, const Neighbor&) = default;
};

// {x : (x - center)' covariance^-1 (x - center) <= gate}
struct Ellipsoid {
  Eigen::VectorXd center;
  Eigen::MatrixXd covariance;  // symmetric positive definite
  double gate = 0.0;           // e.g. a quantile of the chi-square distribution
};

struct EllipsoidMatch {
  int64_t id = 0;
  double squared_mahalanobis = 0.0;

  friend bool operator==(const EllipsoidMatch&, const EllipsoidMatch&) = default;
};

// An immutable state of a tree. Copies share it; any number of threads may query it while the tree
// it came from changes. Coordinates given to queries must have the tree's dimension (CHECKed by
// assert only: they come from code, not from users). Answers are in no particular order unless
// stated.
class XTreeSnapshot {
 public:
  XTreeSnapshot() = default;

  int64_t size() const { return size_; }
  int dimensions() const { return options_.dimensions; }

  // Entries that share a point with the closed box [low, high].
  std::vector<int64_t> Box(std::span<const double> low,
                           std::span<const double> high,
                           QueryStats* stats = nullptr) const;

  // Entries within `radius` of the center.
  std::vector<Neighbor> Radius(std::span<const double> center,
                               double radius,
                               QueryStats* stats = nullptr) const;

  // The k nearest entries, nearest first, equal distances by id.
  std::vector<Neighbor> Nearest(std::span<const double> center,
                                int k,
                                QueryStats* stats = nullptr) const;

  // Points inside the ellipsoid; of a tree of boxes, boxes whose centre is. Errors:
  // INVALID_ARGUMENT (wrong size, covariance not positive definite).
  absl::StatusOr<std::vector<EllipsoidMatch>> Inside(const Ellipsoid& ellipsoid,
                                                     QueryStats* stats = nullptr) const;

  // Calls `visit(id, low, high)` for every entry, in storage order.
  void ForEach(const std::function<void(int64_t, std::span<const double>, std::span<const double>)>&
                   visit) const;

  MemoryReport Memory() const;

  // Every box is the tight bound of what is below it, fills and levels are right, the count
  // agrees. Errors: INTERNAL, says what is broken.
  absl::Status CheckInvariants() const;

 private:
  friend class XTree;
  XTreeOptions options_;
  std::shared_ptr<const index_internal::Node> root_;  // never null in a tree
  int64_t size_ = 0;
};

// The tree that changes. Not thread-safe: one writer. Snapshot() costs nothing; after it, the nodes
// that a write touches are copied (path copying) and all others shared.
//
//   HOROPTER_ASSIGN_OR_RETURN(XTree tree, XTree::Create({.dimensions = 3}));
//   HOROPTER_RETURN_IF_ERROR(tree.Insert(point, 17));
//   const XTreeSnapshot snapshot = tree.Snapshot();   // hand to readers
class XTree {
 public:
  // Errors: INVALID_ARGUMENT.
  static absl::StatusOr<XTree> Create(const XTreeOptions& options);

  // Builds a packed tree of ids.size() points: coordinates one point after the other. Overlap-free
  // for points; the same for every number of threads. Besides the tree it needs 20 bytes an entry.
  // Errors: INVALID_ARGUMENT (sizes disagree, a coordinate is not finite).
  static absl::StatusOr<XTree> BulkLoad(const XTreeOptions& options,
                                        std::span<const double> points,
                                        std::span<const int64_t> ids,
                                        int threads = 1);
  // The same for boxes: lows and highs, of points the same.
  static absl::StatusOr<XTree> BulkLoadBoxes(const XTreeOptions& options,
                                             std::span<const double> lows,
                                             std::span<const double> highs,
                                             std::span<const int64_t> ids,
                                             int threads = 1);
  static absl::StatusOr<XTree> BulkLoadBoxes(const XTreeOptions& options,
                                             std::span<const float> lows,
                                             std::span<const float> highs,
                                             std::span<const int64_t> ids,
                                             int threads = 1);

  // Ids need not be unique. Errors: INVALID_ARGUMENT (dimension, not finite, low > high).
  absl::Status Insert(std::span<const double> point, int64_t id);
  absl::Status InsertBox(std::span<const double> low, std::span<const double> high, int64_t id);

  // Removes one entry with exactly these coordinates and id. Errors: NOT_FOUND, INVALID_ARGUMENT.
  absl::Status Delete(std::span<const double> point, int64_t id);
  absl::Status DeleteBox(std::span<const double> low, std::span<const double> high, int64_t id);

  int64_t size() const { return state_.size_; }
  const XTreeOptions& options() const { return state_.options_; }

  XTreeSnapshot Snapshot();
  // The present state, valid until the next write.
  const XTreeSnapshot& view() const { return state_; }

 private:
  using Node = index_internal::Node;
  using Entry = index_internal::Entry;
  struct PathStep {
    Node* node = nullptr;
    int child = -1;  // entry of `node` that was taken
  };

  explicit XTree(const XTreeOptions& options);
  template <typename Scalar>
  static absl::StatusOr<XTree> Packed(const XTreeOptions& options,
                                      std::span<const Scalar> lows,
                                      std::span<const Scalar> highs,
                                      std::span<const int64_t> ids,
                                      int threads);
  absl::Status CheckBox(std::span<const double> low, std::span<const double> high) const;
  std::shared_ptr<Node> NewNode(int level, int blocks = 1) const;
  // Makes the node behind `link` the writer's own: copies it when a snapshot may see it.
  Node* Own(std::shared_ptr<Node>& link);
  Node* OwnRoot();

  void Place(Entry entry, int level, uint64_t* reinserted_levels);
  void Overflow(std::vector<PathStep>& path, uint64_t* reinserted_levels);
  bool SplitNode(std::vector<PathStep>& path);
  void Reinsert(std::vector<PathStep>& path, uint64_t* reinserted_levels);
  void TightenPath(const std::vector<PathStep>& path);
  bool FindEntry(const Entry& entry, std::vector<int>& path) const;
  void Condense(std::vector<PathStep>& path);

  XTreeSnapshot state_;
  uint64_t epoch_ = 1;  // nodes of older epochs belong to snapshots too
};

}  // namespace horopter
