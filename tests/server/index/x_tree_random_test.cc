// Random inserts, deletes and queries against a linear scan.
#include <gtest/gtest.h>

#include <cstdio>
#include <string>

#include "server/index/x_tree.h"
#include "tests/server/index/brute_force.h"

namespace horopter {
namespace {

enum class Data { kUniform, kClustered, kGrid };  // grid: many equal coordinates and equal points

struct Plan {
  XTreeOptions options;
  Data data = Data::kUniform;
  int operations = 0;
  int about = 300;  // entries in the tree, on average
};

class Run {
 public:
  Run(const Plan& plan, unsigned seed)
      : plan_(plan), rng_(seed), tree_(XTree::Create(plan.options).value()) {}

  // False when the tree and the scan disagree.
  bool Execute() {
    for (int i = 0; i < plan_.operations; ++i) {
      Step();
      if (::testing::Test::HasFailure()) return false;
      if (i % 5000 == 4999 && !tree_.view().CheckInvariants().ok()) {
        ADD_FAILURE() << tree_.view().CheckInvariants();
        return false;
      }
    }
    return true;
  }

 private:
  double Uniform() { return std::uniform_real_distribution<double>(0.0, 1.0)(rng_); }
  size_t Below(size_t n) { return std::uniform_int_distribution<size_t>(0, n - 1)(rng_); }

  std::vector<double> Point() {
    std::vector<double> point(plan_.options.dimensions);
    const double cluster = static_cast<double>(Below(4)) / 4.0;
    for (double& x : point) {
      x = Uniform();
      if (plan_.data == Data::kGrid) x = std::floor(4.0 * x) / 4.0;
      if (plan_.data == Data::kClustered) x = cluster + 0.02 * x;
    }
    return point;
  }

  void Step() {
    const size_t n = scan_.items.size();
    const double choice = Uniform();
    // Grows and shrinks in turn, so that nodes are split and dissolved at every size.
    const double insert_share = ((++steps_ / (4 * plan_.about)) % 2 == 0) ? 0.42 : 0.28;
    if (choice < insert_share || n == 0) return Insert();
    if (choice < 0.7) return Delete(Below(n));
    const std::vector<double> center = Point();
    const double size = 0.6 * Uniform() * Uniform();
    if (choice < 0.78) {
      std::vector<double> low = center, high = center;
      for (double& x : high) x += size * Uniform();
      EXPECT_EQ(Sorted(tree_.view().Box(low, high)), scan_.Box(low, high));
    } else if (choice < 0.86) {
      EXPECT_EQ(SortedIds(tree_.view().Radius(center, size)), scan_.Radius(center, size));
    } else if (choice < 0.94) {
      const int k = 1 + static_cast<int>(Below(12));
      EXPECT_EQ(tree_.view().Nearest(center, k), scan_.Nearest(center, k));
    } else {
      const Ellipsoid e = RandomEllipsoid(center, 0.3 * size + 1e-3, rng_);
      const std::vector<int64_t> found = SortedIds(tree_.view().Inside(e).value());
      const BruteForce::InsideIds expected = scan_.Inside(e);
      EXPECT_TRUE(std::includes(
          found.begin(), found.end(), expected.surely.begin(), expected.surely.end()));
      EXPECT_TRUE(std::includes(
          expected.perhaps.begin(), expected.perhaps.end(), found.begin(), found.end()));
    }
  }

  void Insert() {
    BruteForce::Item item{Point(), {}, next_id_++};
    item.high = item.low;
    if (plan_.options.boxes) {
      for (double& x : item.high) x += 0.1 * Uniform();
    }
    ASSERT_TRUE(tree_.InsertBox(item.low, item.high, item.id).ok());
    scan_.items.push_back(std::move(item));
  }

  void Delete(size_t i) {
    const BruteForce::Item item = scan_.items[i];
    ASSERT_TRUE(tree_.DeleteBox(item.low, item.high, item.id).ok());
    EXPECT_EQ(tree_.DeleteBox(item.low, item.high, item.id).code(), absl::StatusCode::kNotFound);
    scan_.items[i] = scan_.items.back();
    scan_.items.pop_back();
    ASSERT_EQ(tree_.size(), static_cast<int64_t>(scan_.items.size()));
  }

  Plan plan_;
  std::mt19937 rng_;
  XTree tree_;
  BruteForce scan_;
  int64_t next_id_ = 1;
  int64_t steps_ = 0;
};

void RunAll(int operations_each, unsigned first_seed) {
  int64_t total = 0;
  unsigned seed = first_seed;
  for (const IndexMode mode : {IndexMode::kXTree, IndexMode::kRStarTree}) {
    for (const bool boxes : {false, true}) {
      for (const Data data : {Data::kUniform, Data::kClustered, Data::kGrid}) {
        for (const int dimensions : {1, 2, 3, 6, 16}) {
          for (const int capacity : {4, 9, 32}) {
            ++seed;
            Plan plan;
            plan.options = {.dimensions = dimensions,
                            .boxes = boxes,
                            .mode = mode,
                            .leaf_capacity = capacity,
                            .directory_capacity = capacity};
            plan.data = data;
            plan.operations = operations_each;
            SCOPED_TRACE("seed " + std::to_string(seed));
            if (!Run(plan, seed).Execute()) return;
            total += operations_each;
          }
        }
      }
    }
  }
  std::printf("%lld operations from seed %u\n", static_cast<long long>(total), first_seed);
}

TEST(XTreeRandomTest, AgreesWithALinearScan) {
  RunAll(1000, 1000);
}

// 180 trees x 56000 operations, 10 million in all: about a minute. Run by -DHOROPTER_LONG_TESTS=ON.
TEST(XTreeRandomTest, DISABLED_TenMillionOperationsAgreeWithALinearScan) {
  RunAll(56000, 5000);
}

}  // namespace
}  // namespace horopter
