// Derived data: stored with the object, used at the next start, made anew when they are not right.
#include "server/service/catalog_store.h"

#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"
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
  auto store = CatalogStore::Load(Catalog::Open(path).value(), preparer, 1);
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

TEST_F(CatalogStoreTest, DataOfAnotherVersionAreMadeAnewOnceAndStored) {
  EXPECT_EQ(OpenCounted(path_, 2).prepared, 5);
  EXPECT_EQ(OpenCounted(path_, 2).prepared, 0);
  EXPECT_EQ(OpenCounted(path_, 1).prepared, 5);  // an older program knows the newer ones as little
}

TEST_F(CatalogStoreTest, MissingAndDamagedDataAreMadeAnew) {
  {
    auto catalog = Catalog::Open(path_).value();
    ASSERT_TRUE(catalog->StoreDerived({{"obj_1", {1, "damaged"}}, {"obj_3", {}}}).ok());
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
  ASSERT_TRUE(store.catalog().StoreDerived({{"obj_0", {1, "wrong"}}, {"obj_1", {}}}).ok());
  EXPECT_EQ(store.CheckDerived("obj_0", false).code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(store.CheckDerived("obj_1", false).code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_TRUE(*store.Rebuild("obj_0"));
  EXPECT_TRUE(*store.Rebuild("obj_1"));
  EXPECT_TRUE(store.CheckDerived("obj_0", true).ok());
  EXPECT_TRUE(store.CheckDerived("obj_1", true).ok());
  EXPECT_EQ(store.Rebuild("obj_9").status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(store.Published()->ids.size(), 5u);
}

}  // namespace
}  // namespace horopter
