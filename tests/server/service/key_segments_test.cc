#include "server/service/key_segments.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "server/service/catalog_store.h"
#include "tests/support/fake_objects.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

// The keys of more objects than stay in memory loose: 300 of five shapes.
class SegmentedCatalogTest : public testing::Test {
 protected:
  void SetUp() override {
    auto store = OpenStored(1000);
    for (int i = 0; i < 5; ++i)
      ASSERT_TRUE(store->Create(SampleRecord("obj_" + std::to_string(i), i + 1)).ok());
    std::vector<CatalogRecord> records;
    for (int i = 0; i < kLeastMembers + 40; ++i) {
      CatalogRecord record = SampleRecord("part_" + std::to_string(1000 + i), 100 + i);
      // Shapes of their own, down to the last digits.
      record.model.mesh.vertices[0].x() += 1e-7 * i;
      records.push_back(std::move(record));
    }
    ASSERT_TRUE(store->Create(std::move(records)).ok());
  }
  std::unique_ptr<CatalogStore> OpenStored(int max_resident = 2) {
    auto store = CatalogStore::Load(
        Catalog::Open(path_).value(), FakePreparer(), {.max_resident = max_resident});
    EXPECT_TRUE(store.ok()) << store.status();
    return *std::move(store);
  }
  std::string Folder() const { return path_ + "-keys"; }
  std::vector<std::string> Files() const {
    std::vector<std::string> files;
    for (const auto& entry : std::filesystem::directory_iterator(Folder())) {
      if (entry.path().extension() == ".keys") files.push_back(entry.path().string());
    }
    return files;
  }

  const ScratchDir dir_;
  const std::string path_ = dir_.File("a.db");
};

TEST_F(SegmentedCatalogTest, SegmentsAreMadeOnceAndTheNextStartTakesThem) {
  std::vector<int> first;
  {
    const auto store = OpenStored();
    ASSERT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
    EXPECT_EQ(store->segment_figures().files, 1);
    EXPECT_EQ(store->segment_figures().members, kLeastMembers + 45);
    first = store->LookAlikeCandidates(*store->Published(), "obj_2", 50).value();
    EXPECT_FALSE(first.empty());
  }
  const std::vector<std::string> made = Files();
  ASSERT_EQ(made.size(), 1u);
  {
    // Without any keys in the catalog they are what the file says.
    auto catalog = Catalog::Open(path_).value();
    auto all = catalog->ListDerived("", 1000).value();
    for (const DerivedEntry& entry : all) {
      DerivedData data = catalog->GetDerived(entry.id).value();
      data.keys = "damaged";
      ASSERT_TRUE(catalog->StoreDerived({{entry.id, data}}).ok());
    }
  }
  const auto store = OpenStored();
  EXPECT_EQ(store->load_report().restored, kLeastMembers + 45);
  EXPECT_EQ(store->LookAlikeCandidates(*store->Published(), "obj_2", 50).value(), first);
  EXPECT_EQ(Files(), made);
}

TEST_F(SegmentedCatalogTest, ADamagedSegmentIsPutIntoQuarantineAndMadeAnew) {
  {
    const auto store = OpenStored();
    ASSERT_TRUE(store->CheckIndex().ok());
  }
  const std::vector<std::string> made = Files();
  for (const bool cut : {false, true}) {
    if (cut) {
      std::filesystem::resize_file(made[0], 1000);
    } else {
      std::fstream file(made[0], std::ios::in | std::ios::out | std::ios::binary);
      file.seekp(-2000, std::ios::end);
      file.put('!');
    }
    const auto store = OpenStored();
    EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
    EXPECT_EQ(store->segment_figures().files, 1);
    EXPECT_EQ(Files(), made);
    EXPECT_TRUE(std::filesystem::exists(Folder() + "/quarantine/" +
                                        std::filesystem::path(made[0]).filename().string()));
  }
  // And one that goes while it is used.
  const auto store = OpenStored();
  ASSERT_TRUE(store->CheckIndex().ok());
  std::filesystem::remove(made[0]);
  EXPECT_TRUE(store->LookAlikeCandidates(*store->Published(), "obj_2", 50).ok());
  EXPECT_FALSE(store->LookAlikeCandidates(*store->Published(), "obj_2", 50)->empty());
  EXPECT_EQ(Files(), made);
}

TEST_F(SegmentedCatalogTest, WhereNoFolderCanBeMadeSegmentsStayInMemory) {
  std::ofstream(Folder()) << "a file in its place";
  const auto store = OpenStored();
  EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
  EXPECT_EQ(store->segment_figures().files, 0);
  EXPECT_EQ(store->segment_figures().segments, 1);
  EXPECT_FALSE(store->LookAlikeCandidates(*store->Published(), "obj_2", 50)->empty());
}

TEST_F(SegmentedCatalogTest, WritesAreFoundWithoutNewSegments) {
  const auto store = OpenStored();
  ASSERT_TRUE(store->CheckIndex().ok());
  const CatalogRecord changed = SampleRecord("obj_2", 9999);
  ASSERT_TRUE(store
                  ->Update("obj_2",
                           {.geometry = true},
                           [&](CatalogRecord) -> absl::StatusOr<CatalogRecord> { return changed; })
                  .ok());
  ASSERT_TRUE(store->Delete("part_1003").ok());
  CatalogRecord twin = SampleRecord("twin", 9999);
  ASSERT_TRUE(store->Create(twin).ok());
  EXPECT_TRUE(store->CheckIndex().ok()) << store->CheckIndex();
  const auto published = store->Published();
  const auto candidates = store->LookAlikeCandidates(*published, "twin", 3).value();
  ASSERT_FALSE(candidates.empty());
  EXPECT_EQ(published->ids[candidates[0]], "obj_2");
  EXPECT_EQ(store->segment_figures().files, 1);
  EXPECT_GT(store->segment_figures().loose, 0);
}

}  // namespace
}  // namespace horopter
