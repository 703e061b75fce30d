#include "server/service/derived_cache.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <thread>
#include <vector>

#include "db/object_digest.h"
#include "server/base/sha256.h"
#include "server/service/catalog_store.h"
#include "tests/support/fake_objects.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;

constexpr int64_t kLarge = int64_t{1} << 30;

DerivedData DataOf(int number, size_t size = 100) {
  std::string data = std::to_string(number) + std::string("\0\xff", 2);
  data.resize(size, 'd');
  return {7, std::move(data), "keys" + std::to_string(number), Sha256Hex(std::to_string(number))};
}

class DerivedCacheTest : public testing::Test {
 protected:
  std::string Folder() const { return dir_.File("cache"); }
  std::string FileOf(const DerivedData& data) const {
    return Folder() + "/" + data.address.substr(0, 2) + "/" + data.address;
  }
  bool InQuarantine(const DerivedData& data) const {
    return fs::exists(Folder() + "/quarantine/" + data.address);
  }
  const ScratchDir dir_;
};

TEST_F(DerivedCacheTest, GivesBackWhatWasPutAlsoToAnotherServer) {
  const DerivedData data = DataOf(1);
  DerivedCache first(Folder(), kLarge);
  EXPECT_FALSE(first.Get(data.address).has_value());
  first.Put(data);
  DerivedCache second(Folder(), kLarge);
  for (DerivedCache* cache : {&first, &second}) {
    const auto got = cache->Get(data.address);
    ASSERT_TRUE(got.has_value());
    EXPECT_EQ(got->data, data.data);
    EXPECT_EQ(got->keys, data.keys);
    EXPECT_EQ(got->version, 7);
    EXPECT_EQ(got->address, data.address);
  }
  EXPECT_EQ(first.figures().misses, 1);
  EXPECT_EQ(first.figures().hits, 1);
}

TEST_F(DerivedCacheTest, DamagedEntriesGoIntoQuarantineAndAreNoHit) {
  const DerivedData data = DataOf(2), other = DataOf(3);
  DerivedCache cache(Folder(), kLarge);
  cache.Put(other);
  const auto size = [&] { return fs::file_size(FileOf(data)); };
  int damaged = 0;
  for (const int kind : {0, 1, 2, 3}) {
    cache.Put(data);
    if (kind == 0) {  // one bit
      std::fstream file(FileOf(data), std::ios::in | std::ios::out | std::ios::binary);
      file.seekp(50);
      file.put('#');
    } else if (kind == 1) {
      fs::resize_file(FileOf(data), size() - 1);
    } else if (kind == 2) {
      fs::resize_file(FileOf(data), 0);
    } else {  // a sound entry of something else
      fs::copy_file(FileOf(other), FileOf(data), fs::copy_options::overwrite_existing);
    }
    EXPECT_FALSE(cache.Get(data.address).has_value()) << kind;
    EXPECT_FALSE(fs::exists(FileOf(data))) << kind;
    EXPECT_TRUE(InQuarantine(data)) << kind;
    EXPECT_EQ(cache.figures().quarantined, ++damaged);
  }
  EXPECT_TRUE(cache.Get(other.address).has_value());
}

TEST_F(DerivedCacheTest, QuarantineIsBounded) {
  DerivedCache cache(Folder(), kLarge);
  for (int i = 0; i < kKeptInQuarantine + 9; ++i) {
    cache.Put(DataOf(i));
    fs::resize_file(FileOf(DataOf(i)), 3);
    EXPECT_FALSE(cache.Get(DataOf(i).address).has_value());
  }
  EXPECT_EQ(std::distance(fs::directory_iterator(Folder() + "/quarantine"), {}), kKeptInQuarantine);
}

TEST_F(DerivedCacheTest, WhatWasUsedLeastLatelyMakesRoom) {
  DerivedCache cache(Folder(), 100'000);
  for (int i = 0; i < 8; ++i) {
    cache.Put(DataOf(i, 10'000));
    // Times of files are not finer than some milliseconds everywhere.
    fs::last_write_time(FileOf(DataOf(i, 10'000)),
                        fs::file_time_type::clock::now() - std::chrono::hours(100 - i));
  }
  ASSERT_TRUE(cache.Get(DataOf(0).address).has_value());  // now the one used last
  for (int i = 8; i < 12; ++i) cache.Put(DataOf(i, 10'000));
  EXPECT_TRUE(cache.Get(DataOf(0).address).has_value());
  EXPECT_FALSE(cache.Get(DataOf(1).address).has_value());
  EXPECT_TRUE(cache.Get(DataOf(11).address).has_value());
  int64_t bytes = 0;
  for (const auto& entry : fs::recursive_directory_iterator(Folder())) {
    if (entry.is_regular_file()) bytes += static_cast<int64_t>(entry.file_size());
  }
  EXPECT_LE(bytes, 100'000);
  cache.Put(DataOf(20, 200'000));  // larger than all of it: not at all
  EXPECT_FALSE(cache.Get(DataOf(20).address).has_value());
  EXPECT_TRUE(cache.Get(DataOf(11).address).has_value());
}

TEST_F(DerivedCacheTest, AFolderThatCannotBeWrittenIsAFindingAndNoFailure) {
  std::ofstream(Folder()) << "a file in its place";
  DerivedCache none(Folder(), kLarge);
  none.Put(DataOf(1));
  none.Put(DataOf(2));
  EXPECT_FALSE(none.Get(DataOf(1).address).has_value());
  EXPECT_EQ(none.figures().unwritten, 2);
  EXPECT_TRUE(fs::is_regular_file(Folder()));
  EXPECT_FALSE(WriteWholeFile("/proc/horopter", "x").ok());
}

TEST_F(DerivedCacheTest, NothingButAnAddressBecomesAName) {
  DerivedCache cache(Folder(), kLarge);
  for (const std::string& bad : {std::string(),
                                 std::string("../../secret"),
                                 std::string(64, 'G'),
                                 std::string(63, 'a') + "/",
                                 std::string(65, 'a')}) {
    EXPECT_FALSE(IsDerivedAddress(bad));
    DerivedData data = DataOf(1);
    data.address = bad;
    cache.Put(data);
    EXPECT_FALSE(cache.Get(bad).has_value());
  }
  EXPECT_FALSE(fs::exists(Folder()));
}

TEST_F(DerivedCacheTest, ManyThreadsMayPutAndGetTheSame) {
  DerivedCache cache(Folder(), 300'000);
  std::vector<std::thread> threads;
  std::atomic<int> wrong = 0;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < 60; ++i) {
        const DerivedData data = DataOf((i + 7 * t) % 20, 20'000);
        cache.Put(data);
        const auto got = cache.Get(data.address);
        if (got && got->data != data.data) ++wrong;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(wrong, 0);
  EXPECT_EQ(cache.figures().quarantined, 0);
  EXPECT_GT(cache.figures().hits, 0);
}

// A server with a cache.
class CachedCatalogTest : public DerivedCacheTest {
 protected:
  void SetUp() override {
    auto catalog = Catalog::Open(path_).value();
    auto store = CatalogStore::Load(std::move(catalog), FakePreparer()).value();
    for (int i = 0; i < 5; ++i) {
      ASSERT_TRUE(store->Create(SampleRecord("obj_" + std::to_string(i), i)).ok());
    }
  }
  std::unique_ptr<CatalogStore> Start(int max_resident, int version = 1) {
    return CatalogStore::Load(Catalog::Open(path_).value(),
                              FakePreparer(version),
                              {.max_resident = max_resident, .derived_cache = Folder()})
        .value();
  }
  void UseAll(CatalogStore& store) {
    const auto published = store.Published();
    ASSERT_EQ(published->ids.size(), 5u);
    for (int i = 0; i < 5; ++i) {
      const auto object = ObjectAt(published->snapshot, i);
      ASSERT_TRUE(object.ok()) << object.status();
      EXPECT_EQ(ModelOfFake(**object).diameter_m,
                SampleRecord(published->ids[i], i).model.diameter_m);
    }
  }
  const std::string path_ = dir_.File("parts.db");
};

TEST_F(CachedCatalogTest, TheSecondStartReadsDerivedDataFromTheCache) {
  for (const int max_resident : {1000, 2}) {
    fs::remove_all(Folder());
    {
      const auto store = Start(max_resident);
      UseAll(*store);
      EXPECT_EQ(store->load_report().restored, 5);
      EXPECT_EQ(store->cache_figures().misses, 5);
    }
    const auto store = Start(max_resident);
    UseAll(*store);
    EXPECT_EQ(store->load_report().prepared, 0);
    EXPECT_EQ(store->cache_figures().hits, 5);
    EXPECT_EQ(store->cache_figures().misses, 0);
  }
}

TEST_F(CachedCatalogTest, AnEntryThatIsSoundButWrongIsNotUsedTwice) {
  { UseAll(*Start(1000)); }
  {
    DerivedCache cache(Folder(), kLarge);
    DerivedData wrong = *cache.Get(DerivedAddress(SampleRecord("obj_3", 3).model, 1));
    wrong.data = "of something else";
    cache.Put(wrong);
  }
  {
    const auto store = Start(1000);
    UseAll(*store);
    EXPECT_EQ(store->load_report().prepared, 0);
    EXPECT_EQ(store->cache_figures().quarantined, 1);
  }
  const auto again = Start(1000);
  UseAll(*again);
  EXPECT_EQ(again->cache_figures().hits, 5);
}

TEST_F(CachedCatalogTest, ADamagedCacheAndCatalogAreBothMended) {
  { UseAll(*Start(1000)); }
  fs::remove_all(Folder());
  ASSERT_TRUE(
      Catalog::Open(path_)
          .value()
          ->StoreDerived(
              {{"obj_2", {1, "damaged", "", DerivedAddress(SampleRecord("obj_2", 2).model, 1)}}})
          .ok());
  {
    const auto store = Start(1000);
    UseAll(*store);
    EXPECT_EQ(store->load_report().prepared, 1);
  }
  const auto store = Start(1000);
  UseAll(*store);
  EXPECT_EQ(store->load_report().prepared, 0);
  EXPECT_EQ(store->cache_figures().quarantined, 0);  // what was damaged was not put there
}

TEST_F(CachedCatalogTest, TwoVersionsOfTheProgramKeepTheirOwnAndPrepareNothingTwice) {
  for (const int max_resident : {1000, 2}) {
    for (int turn = 0; turn < 2; ++turn) {
      for (const int version : {1, 2}) {
        const auto store = Start(max_resident, version);
        UseAll(*store);
        const bool first = max_resident == 1000 && turn == 0 && version == 2;
        EXPECT_EQ(store->load_report().prepared, first ? 5 : 0)
            << max_resident << " " << turn << " " << version;
        EXPECT_TRUE(store->CheckIndex().ok());
      }
    }
  }
}

TEST_F(CachedCatalogTest, AnObjectThatChangesIsFoundUnderItsNewAddress) {
  { UseAll(*Start(2)); }
  const auto store = Start(2);
  ObjectModel other = SampleRecord("obj_1", 77).model;
  for (const UpdateParts& parts :
       {UpdateParts{.geometry = true}, UpdateParts{.symmetries = true}}) {
    if (parts.symmetries) other.symmetries.emplace_back();
    const std::string before = store->Published()->addresses[1];
    ASSERT_TRUE(store
                    ->Update("obj_1",
                             parts,
                             [&](CatalogRecord current) -> absl::StatusOr<CatalogRecord> {
                               const CatalogRecord changed = SampleRecord("obj_1", 77);
                               current.model = changed.model;
                               current.model.symmetries = other.symmetries;
                               return current;
                             })
                    .ok());
    const std::string after = store->Published()->addresses[1];
    EXPECT_NE(after, before);
    EXPECT_EQ(after, DerivedAddress(store->catalog().GetObject("obj_1")->model, 1));
    EXPECT_EQ(store->catalog().GetDerived("obj_1")->address, after);
    EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
  }
}

}  // namespace
}  // namespace horopter
