#include <gtest/gtest.h>

#include <atomic>
#include <mutex>
#include <random>
#include <thread>

#include "server/index/x_tree.h"

namespace horopter {
namespace {

std::vector<double> PointOf(int64_t id) {
  std::mt19937_64 rng(static_cast<uint64_t>(id) * 7919 + 3);
  std::uniform_real_distribution<double> uniform;
  return {uniform(rng), uniform(rng), uniform(rng)};
}

std::vector<int64_t> AllIds(const XTreeSnapshot& snapshot) {
  const std::vector<double> low(3, -1.0), high(3, 2.0);
  std::vector<int64_t> ids = snapshot.Box(low, high);
  std::sort(ids.begin(), ids.end());
  return ids;
}

TEST(XTreeSnapshotTest, StaysAsItWasWhileTheTreeChanges) {
  XTree tree =
      XTree::Create({.dimensions = 3, .leaf_capacity = 6, .directory_capacity = 6}).value();
  std::vector<XTreeSnapshot> snapshots;
  // Snapshot i holds ids [i * 50, i * 50 + 300): 50 arrive and 50 leave between two of them.
  for (int64_t id = 0; id < 300; ++id) ASSERT_TRUE(tree.Insert(PointOf(id), id).ok());
  for (int64_t i = 0; i < 40; ++i) {
    snapshots.push_back(tree.Snapshot());
    for (int64_t k = 0; k < 50; ++k) {
      ASSERT_TRUE(tree.Insert(PointOf(300 + 50 * i + k), 300 + 50 * i + k).ok());
      ASSERT_TRUE(tree.Delete(PointOf(50 * i + k), 50 * i + k).ok());
    }
  }
  for (int64_t i = 0; i < 40; ++i) {
    EXPECT_TRUE(snapshots[i].CheckInvariants().ok()) << snapshots[i].CheckInvariants();
    const std::vector<int64_t> ids = AllIds(snapshots[i]);
    ASSERT_EQ(ids.size(), 300u);
    EXPECT_EQ(ids.front(), 50 * i);
    EXPECT_EQ(ids.back(), 50 * i + 299);
  }
}

TEST(XTreeSnapshotTest, SharesWhatAWriteDidNotTouch) {
  XTree tree = XTree::Create({.dimensions = 3}).value();
  for (int64_t id = 0; id < 20000; ++id) ASSERT_TRUE(tree.Insert(PointOf(id), id).ok());
  const XTreeSnapshot before = tree.Snapshot();
  ASSERT_TRUE(tree.Insert(PointOf(20000), 20000).ok());
  EXPECT_EQ(before.size(), 20000);
  EXPECT_EQ(tree.size(), 20001);
}

// Run under the tsan preset too: readers query snapshots while the writer goes on.
TEST(XTreeSnapshotTest, ReadersSeeWholeStatesWhileTheWriterGoesOn) {
  XTree tree =
      XTree::Create({.dimensions = 3, .leaf_capacity = 8, .directory_capacity = 8}).value();
  for (int64_t id = 0; id < 200; ++id) ASSERT_TRUE(tree.Insert(PointOf(id), id).ok());
  std::mutex mutex;
  XTreeSnapshot published = tree.Snapshot();  // guarded by mutex
  std::atomic<bool> done{false};
  std::atomic<int> broken{0}, checked{0};
  std::vector<std::thread> readers;
  for (int r = 0; r < 2; ++r) {
    readers.emplace_back([&] {
      while (!done || checked == 0) {
        XTreeSnapshot snapshot;
        {
          const std::lock_guard lock(mutex);
          snapshot = published;
        }
        // Every published state holds 200 consecutive ids.
        const std::vector<int64_t> ids = AllIds(snapshot);
        if (ids.size() != 200 || ids.back() - ids.front() != 199) ++broken;
        if (snapshot.Nearest(PointOf(ids.front()), 1)[0].id != ids.front()) ++broken;
        ++checked;
      }
    });
  }
  for (int64_t id = 200; id < 3000; ++id) {
    ASSERT_TRUE(tree.Insert(PointOf(id), id).ok());
    ASSERT_TRUE(tree.Delete(PointOf(id - 200), id - 200).ok());
    XTreeSnapshot next = tree.Snapshot();
    const std::lock_guard lock(mutex);
    published = std::move(next);
  }
  done = true;
  for (std::thread& reader : readers) reader.join();
  EXPECT_EQ(broken, 0);
  EXPECT_GT(checked, 0);
}

}  // namespace
}  // namespace horopter
