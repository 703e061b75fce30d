// Derived data: stored with the object, used at the next start, recomputed when they are not right.
#include "server/service/catalog_store.h"

#include <gtest/gtest.h>
#include <sqlite3.h>

#include <atomic>
#include <chrono>
#include <thread>

#include "absl/strings/str_cat.h"
#include "server/base/stop_scope.h"
#include "server/pipeline/exception_status.h"
#include "tests/support/fake_objects.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

// Counts what is prepared from the geometry; loads on one thread only.
struct Counted {
  int prepared = 0;
  std::unique_ptr<CatalogStore> store;
};

Counted OpenCounted(const std::string& path, int version = 1) {
  Counted opened;
  auto counter = std::make_shared<int>(0);
  ObjectPreparer preparer = FakePreparer(version);
  preparer.prepare = [counter](ObjectModel model) {
    ++*counter;
    return PrepareFake(std::move(model));
  };
  auto store = CatalogStore::Load(Catalog::Open(path).value(), preparer);
  EXPECT_TRUE(store.ok()) << store.status();
  opened.store = *std::move(store);
  opened.prepared = *counter;
  return opened;
}

class CatalogStoreTest : public testing::Test {
 protected:
  void SetUp() override {
    const Counted opened = OpenCounted(path_);
    for (int i = 0; i < 5; ++i) {
      ASSERT_TRUE(opened.store->Create(SampleRecord(absl::StrCat("obj_", i), i + 1)).ok());
    }
  }
  const ScratchDir dir_;
  const std::string path_ = dir_.File("a.db");
};

TEST_F(CatalogStoreTest, AnEnrolledObjectIsNotPreparedAgainAtTheNextStart) {
  const Counted opened = OpenCounted(path_);
  EXPECT_EQ(opened.prepared, 0);
  EXPECT_EQ(opened.store->load_report().restored, 5);
  EXPECT_EQ(opened.store->Published()->ids.size(), 5u);
}

TEST_F(CatalogStoreTest, DataOfAnotherVersionAreMadeOnceAndStoredBesideTheFormerOnes) {
  EXPECT_EQ(OpenCounted(path_, 2).prepared, 5);
  EXPECT_EQ(OpenCounted(path_, 2).prepared, 0);
  EXPECT_EQ(OpenCounted(path_, 1).prepared, 0);  // the older program has its own still
  EXPECT_EQ(OpenCounted(path_, 3).prepared, 5);
  EXPECT_EQ(OpenCounted(path_, 2).prepared, 0);
  EXPECT_EQ(OpenCounted(path_, 1).prepared, 5);  // two versions are kept
}

TEST_F(CatalogStoreTest, MissingAndDamagedDataAreMadeAnew) {
  {
    auto catalog = Catalog::Open(path_).value();
    ASSERT_TRUE(catalog->StoreDerived({{"obj_1", {1, "damaged", ""}}, {"obj_3", {}}}).ok());
  }
  {
    const Counted opened = OpenCounted(path_);
    EXPECT_EQ(opened.prepared, 2);
    EXPECT_EQ(opened.store->load_report().restored, 3);
    EXPECT_EQ(opened.store->Published()->ids.size(), 5u);
  }
  EXPECT_EQ(OpenCounted(path_).prepared, 0);
}

TEST_F(CatalogStoreTest, NewGeometryReplacesTheDataAndNewGraspsKeepThem) {
  {
    const Counted opened = OpenCounted(path_);
    CatalogRecord record = SampleRecord("obj_2", 77);
    const auto replace = [&](CatalogRecord) -> absl::StatusOr<CatalogRecord> { return record; };
    ASSERT_TRUE(opened.store->Update("obj_2", {.geometry = true, .grasps = true}, replace).ok());
    EXPECT_TRUE(opened.store->CheckDerived("obj_2", true).ok());
    record.model.grasps.clear();
    ASSERT_TRUE(opened.store->Update("obj_2", {.grasps = true}, replace).ok());
    EXPECT_TRUE(opened.store->CheckDerived("obj_2", true).ok());
    ASSERT_TRUE(opened.store->Delete("obj_4").ok());
    EXPECT_EQ(opened.store->catalog().GetDerived("obj_4").status().code(),
              absl::StatusCode::kNotFound);
  }
  const Counted opened = OpenCounted(path_);
  EXPECT_EQ(opened.prepared, 0);
  EXPECT_EQ(opened.store->Published()->ids.size(), 4u);
}

TEST_F(CatalogStoreTest, RebuildSaysWhatChangedAndCheckSaysWhatIsWrong) {
  const Counted opened = OpenCounted(path_);
  CatalogStore& store = *opened.store;
  EXPECT_TRUE(store.CheckDerived("obj_0", true).ok());
  EXPECT_FALSE(*store.Rebuild("obj_0"));
  ASSERT_TRUE(store.catalog().StoreDerived({{"obj_0", {1, "wrong", ""}}, {"obj_1", {}}}).ok());
  EXPECT_EQ(store.CheckDerived("obj_0", false).code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(store.CheckDerived("obj_1", false).code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_TRUE(*store.Rebuild("obj_0"));
  EXPECT_TRUE(*store.Rebuild("obj_1"));
  EXPECT_TRUE(store.CheckDerived("obj_0", true).ok());
  EXPECT_TRUE(store.CheckDerived("obj_1", true).ok());
  EXPECT_EQ(store.Rebuild("obj_9").status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(store.Published()->ids.size(), 5u);
}

// A statement by another connection, for damage that no call of the catalog can do.
void Tamper(const std::string& path, const std::string& sql) {
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &db), SQLITE_OK);
  EXPECT_EQ(sqlite3_exec(db, sql.c_str(), nullptr, nullptr, nullptr), SQLITE_OK);
  sqlite3_close(db);
}

TEST_F(CatalogStoreTest, ADamagedObjectIsLeftOutToldAndNeverMadeAnew) {
  Tamper(path_, "UPDATE grasp SET tz = tz + 0.01 WHERE object_id = 'obj_2'");
  const Counted opened = OpenCounted(path_);
  EXPECT_EQ(opened.prepared, 0);
  const auto published = opened.store->Published();
  EXPECT_EQ(published->ids, (std::vector<std::string>{"obj_0", "obj_1", "obj_3", "obj_4"}));
  ASSERT_EQ(published->unusable.count("obj_2"), 1u);
  EXPECT_NE(published->unusable.at("obj_2").find("digest"), std::string::npos);
  ASSERT_EQ(opened.store->load_report().failures.size(), 1u);
  EXPECT_EQ(opened.store->Rebuild("obj_2").status().code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(opened.store->CheckDerived("obj_2", true).code(), absl::StatusCode::kDataLoss);
  const auto contents = opened.store->Compare({}).value();
  EXPECT_EQ(contents.stored.size(), 5u);
  EXPECT_EQ(contents.unusable.size(), 1u);
  // What it takes to have it back.
  ASSERT_TRUE(opened.store->Delete("obj_2").ok());
  EXPECT_TRUE(opened.store->Published()->unusable.empty());
  ASSERT_TRUE(opened.store->Create(SampleRecord("obj_2", 3)).ok());
  EXPECT_EQ(opened.store->Published()->ids.size(), 5u);
}

TEST_F(CatalogStoreTest, LoadingStopsWhenItIsAskedTo) {
  int looks = 0;
  const auto load = [&](int at) {
    looks = 0;
    return CatchExceptions([&] {
             return CatalogStore::Load(Catalog::Open(path_).value(),
                                       FakePreparer(),
                                       {.stop = [&looks, at] { return ++looks >= at; }});
           })
        .status();
  };
  ASSERT_TRUE(load(1 << 20).ok());
  const int all = looks;
  ASSERT_GE(all, 5);  // at least one an object
  for (int at = 1; at <= 5; ++at) EXPECT_TRUE(absl::IsCancelled(load(at))) << at;
}

// A preparer whose preparations wait until they are let through, and stop when they are told to.
struct Gate {
  std::atomic<int> open{0};  // how many may pass
  std::atomic<int> waiting{0};

  ObjectPreparer Preparer(int version) {
    ObjectPreparer preparer = FakePreparer(version);
    preparer.prepare = [this](ObjectModel model) {
      ++waiting;
      while (open.fetch_sub(1) <= 0) {
        open.fetch_add(1);
        LeaveIfStopped();
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
      return PrepareFake(std::move(model));
    };
    return preparer;
  }
};

class PreparedBeside : public CatalogStoreTest {
 protected:
  void SetUp() override {
    CatalogStoreTest::SetUp();
    auto catalog = Catalog::Open(path_).value();
    ASSERT_TRUE(
        catalog
            ->StoreDerived({{"obj_1", {}}, {"obj_1", {0, "of another version", ""}}, {"obj_3", {}}})
            .ok());
  }
  std::unique_ptr<CatalogStore> Open(ObjectPreparer preparer, int max_resident = 5000) {
    auto store = CatalogStore::Load(Catalog::Open(path_).value(),
                                    std::move(preparer),
                                    {.max_resident = max_resident, .prepare_beside = true});
    EXPECT_TRUE(store.ok()) << store.status();
    return *std::move(store);
  }
  static bool Await(const std::function<bool()>& condition) {
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    while (!condition() && std::chrono::steady_clock::now() < until)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return condition();
  }
  static size_t Pending(const CatalogStore& store) { return store.Published()->pending.size(); }
};

TEST_F(PreparedBeside, WhatIsReadyIsServedAndTheRestJoins) {
  for (const int max_resident : {5000, 2}) {
    Gate gate;
    {
      const auto store = Open(gate.Preparer(1), max_resident);
      EXPECT_EQ(store->load_report().pending, 2);
      const auto first = store->Published();
      EXPECT_EQ(first->ids, (std::vector<std::string>{"obj_0", "obj_2", "obj_4"}));
      EXPECT_EQ(first->pending, (std::set<std::string>{"obj_1", "obj_3"}));
      EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
      gate.open = 2;
      ASSERT_TRUE(Await([&] { return Pending(*store) == 0; }));
      const auto last = store->Published();
      EXPECT_EQ(last->ids.size(), 5u);
      EXPECT_GT(last->snapshot.generation, first->snapshot.generation);
      EXPECT_EQ(last->snapshot.generation, store->catalog().Generation().value());
      EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
      EXPECT_EQ(store->Compare({})->pending.size(), 0u);
    }
    EXPECT_EQ(OpenCounted(path_).prepared, 0);  // all is stored
    ASSERT_TRUE(Catalog::Open(path_).value()->StoreDerived({{"obj_1", {}}, {"obj_3", {}}}).ok());
  }
}

TEST_F(PreparedBeside, TheNextStartGoesOnWhereThisOneWasStopped) {
  Gate gate;
  {
    const auto store = Open(gate.Preparer(1));
    gate.open = 1;
    ASSERT_TRUE(Await([&] { return Pending(*store) == 1 && gate.waiting == 2; }));
  }  // ends though one is being prepared
  const Counted again = OpenCounted(path_);
  EXPECT_EQ(again.prepared, 1);
  EXPECT_EQ(again.store->Published()->ids.size(), 5u);
}

TEST_F(PreparedBeside, WritesMeanwhileWin) {
  Gate gate;
  const auto store = Open(gate.Preparer(1));
  ASSERT_TRUE(Await([&] { return gate.waiting == 1; }));  // obj_1 is at work
  ASSERT_TRUE(store->Delete("obj_1").ok());
  gate.open = 1;
  ASSERT_TRUE(
      Await([&] { return gate.waiting == 2; }));  // obj_3, and what was made of obj_1 is dropped
  EXPECT_FALSE(store->Published()->Contains("obj_1"));
  gate.open = 2;  // obj_3 once for the thread and once for the write
  ASSERT_TRUE(store
                  ->Update("obj_3",
                           {.display_name = true},
                           [](CatalogRecord current) -> absl::StatusOr<CatalogRecord> {
                             current.model.display_name = "renamed";
                             return current;
                           })
                  .ok());
  ASSERT_TRUE(Await([&] { return Pending(*store) == 0; }));
  const auto published = store->Published();
  EXPECT_EQ(published->ids.size(), 4u);
  const auto at = std::find(published->ids.begin(), published->ids.end(), "obj_3");
  ASSERT_NE(at, published->ids.end());
  EXPECT_EQ(ModelOfFake(*published->snapshot.objects[at - published->ids.begin()]).display_name,
            "renamed");
  EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
}

TEST_F(PreparedBeside, WhatCannotBePreparedIsLeftOutWithTheReason) {
  ObjectPreparer preparer = FakePreparer(1);
  preparer.prepare = [](ObjectModel model) -> absl::StatusOr<ObjectPreparer::Prepared> {
    if (model.id == "obj_1") return absl::InvalidArgumentError("edges: no usable edge");
    return PrepareFake(std::move(model));
  };
  const auto store = Open(std::move(preparer));
  ASSERT_TRUE(Await([&] { return Pending(*store) == 0; }));
  EXPECT_EQ(store->Published()->ids.size(), 4u);
  EXPECT_NE(store->Published()->unusable.at("obj_1").find("no usable edge"), std::string::npos);
}

TEST_F(CatalogStoreTest, ARestoredCatalogIsPublishedWithNewKeys) {
  const Counted opened = OpenCounted(path_);
  ASSERT_TRUE(opened.store->catalog().Backup(dir_.File("copy.db")).ok());
  ASSERT_TRUE(opened.store->Delete("obj_1").ok());
  const auto before = opened.store->Published();
  ASSERT_TRUE(opened.store->Restore(dir_.File("copy.db")).ok());
  const auto after = opened.store->Published();
  EXPECT_EQ(before->ids.size(), 4u);
  EXPECT_EQ(after->ids.size(), 5u);
  EXPECT_GT(after->snapshot.generation, before->snapshot.generation);
  EXPECT_TRUE(opened.store->CheckIndex().ok()) << opened.store->CheckIndex();
  ASSERT_TRUE(opened.store->Create(SampleRecord("new", 12)).ok());
  EXPECT_TRUE(opened.store->CheckIndex().ok()) << opened.store->CheckIndex();
}

TEST_F(CatalogStoreTest, TheGenerationCountsEveryWriteAndGoesOnAfterARestart) {
  const auto generation = [](const Counted& opened) {
    return opened.store->Published()->snapshot.generation;
  };
  long before = 0;
  {
    const Counted opened = OpenCounted(path_);
    const long first = generation(opened);
    EXPECT_GE(first, 5);  // objects enrolled before
    const auto rename = [](CatalogRecord current) -> absl::StatusOr<CatalogRecord> {
      current.model.display_name = "other";
      return current;
    };
    ASSERT_TRUE(opened.store->Update("obj_1", {.display_name = true}, rename).ok());
    EXPECT_EQ(generation(opened), first + 1);
    ASSERT_TRUE(opened.store->Delete("obj_2").ok());
    before = generation(opened);
    EXPECT_EQ(before, first + 2);
  }
  const Counted opened = OpenCounted(path_);
  EXPECT_EQ(generation(opened), before);
  ASSERT_TRUE(opened.store->Create(SampleRecord("obj_2", 3)).ok());
  EXPECT_EQ(generation(opened), before + 1);
}

TEST_F(CatalogStoreTest, AnAnswerThatCannotBeMadeEndsTheWriteAndNothingHasChanged) {
  const Counted opened = OpenCounted(path_);
  CatalogStore& store = *opened.store;
  const auto before = store.Published();
  const auto refuse = [](const CatalogRecord&) { return absl::ResourceExhaustedError("no room"); };
  EXPECT_EQ(store.Create({SampleRecord("new")}, {}, refuse).code(),
            absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(store.catalog().GetSummary("new").status().code(), absl::StatusCode::kNotFound);
  const auto rename = [](CatalogRecord current) -> absl::StatusOr<CatalogRecord> {
    current.model.display_name = "other";
    return current;
  };
  EXPECT_FALSE(store.Update("obj_1", {.display_name = true}, rename, refuse).ok());
  EXPECT_NE(store.catalog().GetSummary("obj_1")->record.model.display_name, "other");
  EXPECT_FALSE(store.Delete("obj_1", refuse).ok());
  EXPECT_TRUE(store.catalog().GetSummary("obj_1").ok());
  EXPECT_EQ(store.Published(), before);
  EXPECT_TRUE(store.CheckIndex().ok());
}

// A catalog larger than what is held in memory.
class StoredCatalogTest : public CatalogStoreTest {
 protected:
  std::unique_ptr<CatalogStore> OpenStored(int max_resident = 2) {
    auto store = CatalogStore::Load(
        Catalog::Open(path_).value(), FakePreparer(), {.max_resident = max_resident});
    EXPECT_TRUE(store.ok()) << store.status();
    return *std::move(store);
  }
  static bool Await(const std::function<bool()>& condition) {
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    while (!condition() && std::chrono::steady_clock::now() < until)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return condition();
  }
  static double DiameterAt(const PublishedCatalog& published, int i) {
    const auto object = ObjectAt(published.snapshot, i);
    EXPECT_TRUE(object.ok()) << object.status();
    return ModelOfFake(**object).diameter_m;
  }
};

TEST_F(StoredCatalogTest, HasTheSameObjectsAsOneInMemoryAndNoIndex) {
  std::vector<double> diameters;
  {
    const auto store = OpenStored(5);
    EXPECT_TRUE(store->load_report().resident);
    EXPECT_GT(store->Published()->snapshot.keys.size(), 0);
    for (int i = 0; i < 5; ++i) diameters.push_back(DiameterAt(*store->Published(), i));
  }
  const auto store = OpenStored();
  EXPECT_FALSE(store->load_report().resident);
  EXPECT_EQ(store->load_report().restored, 5);
  const auto published = store->Published();
  EXPECT_TRUE(published->snapshot.objects.empty());
  EXPECT_EQ(published->snapshot.keys.size(), 0);
  EXPECT_TRUE(published->snapshot.slots.empty());
  EXPECT_EQ(published->addresses.size(), 5u);
  for (int i = 0; i < 5; ++i) EXPECT_EQ(DiameterAt(*published, i), diameters[i]);
  EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
}

TEST_F(StoredCatalogTest, ASnapshotKeepsWhatItShowedWhenTheObjectChangesOrGoes) {
  const auto store = OpenStored();
  const auto before = store->Published();
  const CatalogRecord changed = SampleRecord("obj_2", 77);
  const double old_diameter = store->catalog().GetObject("obj_2").value().model.diameter_m;
  ASSERT_NE(old_diameter, changed.model.diameter_m);
  ASSERT_TRUE(store
                  ->Update("obj_2",
                           {.geometry = true},
                           [&](CatalogRecord) -> absl::StatusOr<CatalogRecord> { return changed; })
                  .ok());
  ASSERT_TRUE(store->Delete("obj_4").ok());
  ASSERT_TRUE(store->Create(SampleRecord("obj_9", 9)).ok());
  EXPECT_EQ(DiameterAt(*before, 2), old_diameter);
  EXPECT_TRUE(ObjectAt(before->snapshot, 4).ok());
  const auto after = store->Published();
  EXPECT_EQ(after->ids, (std::vector<std::string>{"obj_0", "obj_1", "obj_2", "obj_3", "obj_9"}));
  EXPECT_EQ(DiameterAt(*after, 2), changed.model.diameter_m);
  EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
}

TEST_F(StoredCatalogTest, DamagedOrMissingKeysAreMadeAnewAndStored) {
  {
    auto catalog = Catalog::Open(path_).value();
    ASSERT_TRUE(catalog->StoreDerived({{"obj_1", {1, "damaged", "keys"}}, {"obj_3", {}}}).ok());
  }
  {
    // What is missing is made before anything is served, what is damaged when it is looked at.
    const auto store = OpenStored();
    EXPECT_EQ(store->load_report().prepared, 1);
    ASSERT_TRUE(store->LookAlikeCandidates(*store->Published(), "obj_0", 5).ok());
    ASSERT_TRUE(Await([&] { return store->CheckDerived("obj_1", true).ok(); }));
    EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
  }
  const auto store = OpenStored();
  EXPECT_EQ(store->load_report().prepared, 0);
  EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
}

TEST_F(StoredCatalogTest, AnObjectWhoseDataAreDamagedIsPreparedWhenAskedForAndCanBeRemoved) {
  const auto store = OpenStored();
  const auto good = store->catalog().GetDerived("obj_1").value();
  ASSERT_TRUE(store->catalog().StoreDerived({{"obj_1", {1, "damaged", good.keys}}}).ok());
  EXPECT_GT(DiameterAt(*store->Published(), 1), 0.0);
  ASSERT_TRUE(store->Delete("obj_1").ok());
  EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
}

TEST_F(StoredCatalogTest, LookAlikesAreSoughtAmongThoseThatShareKeys) {
  {
    const auto store = OpenStored();
    ASSERT_TRUE(store->Create(SampleRecord("twin", 3)).ok());  // the geometry of obj_2
    const auto published = store->Published();
    const auto candidates = store->LookAlikeCandidates(*published, "twin", 3);
    ASSERT_TRUE(candidates.ok()) << candidates.status();
    ASSERT_FALSE(candidates->empty());
    EXPECT_LE(candidates->size(), 3u);
    EXPECT_EQ(published->ids[candidates->front()], "obj_2");
  }
  const auto in_memory = OpenStored(100);
  EXPECT_EQ(in_memory->LookAlikeCandidates(*in_memory->Published(), "twin", 1)->size(), 5u);
}

}  // namespace
}  // namespace horopter
