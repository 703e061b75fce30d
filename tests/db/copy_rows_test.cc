// Catalogs that move from one kind of database to the other.
#include "db/copy_rows.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "db/catalog.h"
#include "tests/support/catalog_contract.h"
#include "tests/support/sample_record.h"

namespace horopter {
namespace {

using absl::StatusCode;

// From the kind of the test's parameter to the other and back.
class CatalogCopies : public CatalogContract {
 protected:
  std::string OtherPlace() {
    if (GetParam() == CatalogKind::kSqlite) return File("other" + std::to_string(++others_));
    return File("other" + std::to_string(++others_));
  }
  static void Enrol(Catalog& catalog, int first, int last) {
    for (int i = first; i < last; ++i) {
      const CatalogRecord record = SampleRecord("obj_" + std::to_string(i), i);
      ASSERT_TRUE(catalog
                      .CreateObjects({{record, {7, "data" + std::to_string(i), "keys"}}},
                                     {"request-" + std::to_string(i), "digest"})
                      .ok());
    }
  }

 private:
  int others_ = 0;
};

TEST_P(CatalogCopies, ARoundTripKeepsEveryRow) {
  const std::string first = NewPlace(), second = OtherPlace(), third = NewPlace();
  {
    auto catalog = Open(first);
    Enrol(*catalog, 0, 40);
    ASSERT_TRUE(catalog->DeleteObject("obj_7").ok());
    const auto station = catalog->WriteStation(
        "cell", [](const StationRecord*, std::vector<StationEventRecord>* events) {
          events->push_back({1, "t", "r", {"left"}, "moved"});
          StationRecord record;
          record.bases["left"].base_from_camera.t = {1, -0.0, 3};
          return absl::StatusOr<StationRecord>(record);
        });
    ASSERT_TRUE(station.ok()) << station.status();
  }
  const auto there = Catalog::Migrate(first, second);
  ASSERT_TRUE(there.ok()) << there.status();
  EXPECT_EQ(there->objects, 39);
  EXPECT_EQ(there->copied, 39);
  const auto back = Catalog::Migrate(second, third);
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(back->digest, there->digest);

  auto catalog = Open(third);
  EXPECT_EQ(catalog->Generation().value(), 41);
  EXPECT_EQ(FirstDifference(catalog->GetObject("obj_9").value(), SampleRecord("obj_9", 9)), "");
  EXPECT_EQ(catalog->GetCadFile("obj_9").value(), SampleRecord("obj_9", 9).source.content);
  EXPECT_EQ(catalog->GetDerived("obj_9")->data, "data9");
  EXPECT_EQ(catalog->FindRequest("request-9")->object_ids, std::vector<std::string>{"obj_9"});
  EXPECT_EQ(catalog->StationEvents("cell")->size(), 1u);
  EXPECT_TRUE(catalog->Verify()->empty());
  // It is a catalog like any other: what counts up goes on.
  Enrol(*catalog, 50, 51);
  EXPECT_EQ(catalog->FindRequest("request-50")->object_ids, std::vector<std::string>{"obj_50"});
  EXPECT_EQ(catalog->GetObject("obj_50")->revision, 42);
}

TEST_P(CatalogCopies, ABrokenOffCopyServesNobodyAndIsGoneOnWith) {
  const std::string from = File("from.db"), to = NewPlace();
  Enrol(*Open(from), 0, 80);
  int looks = 0;
  const auto broken = Catalog::Migrate(from, to, [&] { return ++looks > 4; });
  ASSERT_EQ(broken.status().code(), StatusCode::kCancelled) << broken.status();
  const absl::Status half = Catalog::Open(to).status();
  EXPECT_EQ(half.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(half.message()), testing::HasSubstr("half filled"));
  // Meanwhile the original goes on, also in what was copied already.
  {
    auto catalog = Open(from);
    ASSERT_TRUE(catalog->DeleteObject("obj_0").ok());
    Enrol(*catalog, 80, 81);
  }
  int done = 0;
  const auto whole = Catalog::Migrate(from, to, {}, [&](int now, int) { done = now; });
  ASSERT_TRUE(whole.ok()) << whole.status();
  EXPECT_EQ(done, 80);
  EXPECT_EQ(whole->objects, 80);
  EXPECT_LT(whole->copied, 70) << "nothing was taken up";
  EXPECT_EQ(Open(to)->CountObjects().value(), 80);
  EXPECT_EQ(Open(to)->GetObject("obj_0").status().code(), StatusCode::kNotFound);
}

TEST_P(CatalogCopies, WhatHoldsSomethingElseIsNotOverwritten) {
  const std::string from = File("from.db"), to = NewPlace();
  Enrol(*Open(from), 0, 2);
  Enrol(*Open(to), 5, 6);
  EXPECT_EQ(Catalog::Migrate(from, to).status().code(), StatusCode::kAlreadyExists);
  EXPECT_EQ(Open(to)->CountObjects().value(), 1);
}

TEST_P(CatalogCopies, AFileThatIsNotThereIsNotCopiedAsAnEmptyCatalog) {
  const std::string from = File("mistyped.db"), to = NewPlace();
  EXPECT_EQ(Catalog::Migrate(from, to).status().code(), StatusCode::kNotFound);
  EXPECT_FALSE(std::filesystem::exists(from));
}

TEST_P(CatalogCopies, ABackupIsAFileAndIsRestoredFromOne) {
  auto catalog = Open(NewPlace());
  Enrol(*catalog, 0, 20);
  ASSERT_TRUE(catalog->Backup(File("copy.db")).ok());
  EXPECT_EQ(catalog->Backup(File("copy.db")).code(), StatusCode::kAlreadyExists);
  const int64_t before = catalog->Generation().value();
  ASSERT_TRUE(catalog->DeleteObject("obj_3").ok());
  Enrol(*catalog, 30, 31);
  ASSERT_TRUE(catalog->Restore(File("copy.db")).ok());
  EXPECT_EQ(catalog->CountObjects().value(), 20);
  EXPECT_GT(catalog->Generation().value(), before + 2);
  EXPECT_EQ(FirstDifference(catalog->GetObject("obj_3").value(), SampleRecord("obj_3", 3)), "");
  EXPECT_EQ(Open(File("copy.db"))->CountObjects().value(), 20);
  const StopRequested stop = [] { return true; };
  EXPECT_EQ(catalog->Backup(File("stopped.db"), stop).code(), StatusCode::kCancelled);
  // Nothing is left beside them.
  int files = 0;
  for (const auto& entry :
       std::filesystem::directory_iterator(std::filesystem::path(File("copy.db")).parent_path())) {
    if (entry.path().filename().string().find("unfinished") != std::string::npos) ++files;
  }
  EXPECT_EQ(files, 0);
}

INSTANTIATE_TEST_SUITE_P(Stores, CatalogCopies, EveryStore(), NameOfStore);

}  // namespace
}  // namespace horopter
