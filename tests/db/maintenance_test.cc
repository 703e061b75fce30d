#include <gtest/gtest.h>
#include <sqlite3.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <thread>
#include <vector>

#include "db/catalog.h"
#include "server/vision/geometry/grasp_kind.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

std::string IdOf(int number) {
  return "obj_" + std::to_string(number);
}

void Enrol(Catalog& catalog, int first, int count) {
  for (int n = first; n < first + count; ++n) {
    ASSERT_TRUE(catalog.CreateObject(SampleRecord(IdOf(n), n)).ok());
  }
}

// Statement by another connection, for damage that no call of the catalog can do.
void Tamper(const std::string& path, const std::string& sql) {
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &db), SQLITE_OK);
  char* error = nullptr;
  EXPECT_EQ(sqlite3_exec(db, sql.c_str(), nullptr, nullptr, &error), SQLITE_OK) << error;
  sqlite3_close(db);
}

TEST(BackupTest, CopyHoldsEveryObject) {
  const ScratchDir dir;
  auto catalog = Catalog::Open(dir.File("a.db")).value();
  Enrol(*catalog, 0, 20);
  ASSERT_TRUE(catalog->Backup(dir.File("b.db")).ok());
  auto copy = Catalog::Open(dir.File("b.db")).value();
  EXPECT_EQ(copy->CountObjects().value(), 20);
  for (int n = 0; n < 20; ++n) {
    EXPECT_EQ(FirstDifference(copy->GetObject(IdOf(n)).value(), SampleRecord(IdOf(n), n)), "");
  }
  EXPECT_TRUE(copy->Verify().value().empty());
}

TEST(BackupTest, IsOfOneMomentWhileObjectsAreEnrolled) {
  const ScratchDir dir;
  auto catalog = Catalog::Open(dir.File("a.db")).value();
  Enrol(*catalog, 0, 30);
  std::thread writer([&] { Enrol(*catalog, 30, 60); });
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(catalog->Backup(dir.File("b" + std::to_string(i))).ok());
  }
  writer.join();
  for (int i = 0; i < 5; ++i) {
    auto copy = Catalog::Open(dir.File("b" + std::to_string(i))).value();
    const int count = copy->CountObjects().value();
    EXPECT_GE(count, 30);
    EXPECT_TRUE(copy->GetObject(IdOf(count - 1)).ok());  // ids 0 .. count - 1, nothing between
    EXPECT_TRUE(copy->Verify().value().empty());
  }
}

TEST(BackupTest, NeverReplacesAFileAndLeavesNoRest) {
  const ScratchDir dir;
  auto catalog = Catalog::Open(dir.File("a.db")).value();
  Enrol(*catalog, 0, 1);
  ASSERT_TRUE(catalog->Backup(dir.File("b.db")).ok());
  EXPECT_EQ(catalog->Backup(dir.File("b.db")).code(), absl::StatusCode::kAlreadyExists);
  EXPECT_FALSE(catalog->Backup(dir.File("none/b.db")).ok());
  for (const auto& entry :
       std::filesystem::directory_iterator(std::filesystem::path(dir.File("a.db")).parent_path())) {
    EXPECT_EQ(entry.path().string().find("unfinished"), std::string::npos) << entry.path();
  }
}

TEST(VerifyTest, FindsDamageThatSqliteDoesNot) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  {
    auto catalog = Catalog::Open(path).value();
    Enrol(*catalog, 0, 4);
    EXPECT_TRUE(catalog->Verify().value().empty());
  }
  Tamper(path, "UPDATE mesh SET data = x'484d534801' WHERE object_id = 'obj_1'");
  Tamper(path, "UPDATE cad_source SET content = x'00' WHERE object_id = 'obj_2'");
  Tamper(path, "UPDATE object SET vertex_count = 99 WHERE object_id = 'obj_3'");
  auto catalog = Catalog::Open(path).value();
  const auto problems = catalog->Verify().value();
  ASSERT_EQ(problems.size(), 3u);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(problems[i].object_id, IdOf(i + 1)) << problems[i].what;
}

// One statement per thing that a robot uses.
const char* const kDamage[] = {
    "UPDATE object SET diameter_m = diameter_m * 1.0000001 WHERE object_id = 'obj_1'",
    "UPDATE vertex SET x = x + 1e-6 WHERE object_id = 'obj_1' AND idx = 0",
    "UPDATE edge SET dihedral_rad = 0.5 WHERE object_id = 'obj_1' AND idx = 0",
    "UPDATE mesh SET data = (SELECT data FROM mesh WHERE object_id = 'obj_2') WHERE object_id = "
    "'obj_1'",
    "UPDATE symmetry SET tx = tx + 1e-6 WHERE object_id = 'obj_1' AND idx = 0",
    "DELETE FROM symmetry WHERE object_id = 'obj_1'",
    "UPDATE grasp SET tz = tz + 0.001 WHERE object_id = 'obj_1' AND idx = 0",
    "UPDATE grasp SET jaw_opening_m = 0.2 WHERE object_id = 'obj_1' AND idx = 0",
    "UPDATE grasp SET name = 'other' WHERE object_id = 'obj_1' AND idx = 0",
    "UPDATE grasp SET kind = 1, cup_radius_m = 0.01 WHERE object_id = 'obj_1' AND idx = 0",
    "DELETE FROM object_digest WHERE object_id = 'obj_1'",
    "UPDATE object_digest SET sha256 = (SELECT sha256 FROM object_digest WHERE object_id = "
    "'obj_2') "
    "WHERE object_id = 'obj_1'",
};

TEST(DigestTest, AnythingThatARobotUsesAndThatChangedIsDataLossOfThatObjectAlone) {
  for (const char* damage : kDamage) {
    const ScratchDir dir;
    const std::string path = dir.File("a.db");
    Enrol(*Catalog::Open(path).value(), 0, 3);
    Tamper(path, damage);
    auto catalog = Catalog::Open(path).value();
    EXPECT_EQ(catalog->GetObject("obj_1").status().code(), absl::StatusCode::kDataLoss) << damage;
    EXPECT_EQ(catalog->LoadObject("obj_1").status().code(), absl::StatusCode::kDataLoss) << damage;
    EXPECT_TRUE(catalog->GetObject("obj_0").ok());
    const auto loaded = catalog->LoadObjects("", 10).value();
    ASSERT_EQ(loaded.size(), 3u);
    EXPECT_TRUE(loaded[0].damage.ok());
    EXPECT_EQ(loaded[1].damage.code(), absl::StatusCode::kDataLoss) << damage;
    EXPECT_EQ(loaded[1].model.id, "obj_1");
    EXPECT_TRUE(loaded[1].model.mesh.triangles.empty());
    EXPECT_TRUE(loaded[2].damage.ok());
    const auto problems = catalog->Verify().value();
    ASSERT_FALSE(problems.empty()) << damage;
    EXPECT_EQ(problems[0].object_id, "obj_1");
    // An update does not make damaged rows right.
    const CatalogRecord record = SampleRecord("obj_1", 1);
    EXPECT_EQ(catalog->UpdateObject(record, {.grasps = true}).code(), absl::StatusCode::kDataLoss);
    EXPECT_TRUE(catalog->DeleteObject("obj_1").ok());
    EXPECT_TRUE(catalog->CreateObject(record).ok());
    EXPECT_TRUE(catalog->GetObject("obj_1").ok());
  }
}

TEST(DigestTest, TheCupOfASuctionGraspIsPartOfIt) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  CatalogRecord record = SampleRecord("obj_1", 1);
  SetSuction(0.008, &record.model.grasps[0]);
  {
    auto catalog = Catalog::Open(path).value();
    ASSERT_TRUE(catalog->CreateObject(record).ok());
    EXPECT_EQ(FirstDifference(catalog->GetObject("obj_1").value(), record), "");
  }
  for (const char* damage : {"UPDATE grasp SET cup_radius_m = 0.009 WHERE idx = 0",
                             "UPDATE grasp SET cup_radius_m = 0.008, kind = 0 WHERE idx = 0"}) {
    Tamper(path, damage);
    EXPECT_EQ(Catalog::Open(path).value()->GetObject("obj_1").status().code(),
              absl::StatusCode::kDataLoss)
        << damage;
  }
  Tamper(path, "UPDATE grasp SET kind = 1 WHERE idx = 0");
  EXPECT_TRUE(Catalog::Open(path).value()->GetObject("obj_1").ok());
}

// A catalog as the version before revisions left it: its objects stay as they are, each gets an
// etag, and the digests made then still hold.
TEST(DigestTest, ObjectsOfTheSchemaBeforeRevisionsKeepTheirDigestsAndGetRevisions) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  int64_t before = 0;
  {
    auto catalog = Catalog::Open(path).value();
    Enrol(*catalog, 0, 3);
    before = catalog->Generation().value();
  }
  Tamper(path,
         "DROP TRIGGER object_added; DROP TRIGGER object_removed; DROP TABLE file_state; "
         "DROP TRIGGER print_of_mesh; DROP TRIGGER print_of_symmetry; DROP TRIGGER "
         "print_of_new_symmetry; DROP TABLE surface_print; "
         "DROP TRIGGER catalog_write_named; DROP TRIGGER catalog_write_named_anew; DROP TABLE "
         "catalog_write; "
         "DROP TABLE station_event; DROP TABLE station_hand_eye; DROP TABLE station; "
         "DROP TABLE station_writes; DROP TABLE label; DROP TABLE create_request; "
         "DROP TABLE object_version; ALTER TABLE object DROP COLUMN changed_by; "
         "ALTER TABLE object DROP COLUMN revision; ALTER TABLE grasp DROP COLUMN kind; "
         "ALTER TABLE grasp DROP COLUMN cup_radius_m; PRAGMA user_version=4");
  Tamper(path, "UPDATE grasp SET jaw_opening_m = 0.2 WHERE object_id = 'obj_2' AND idx = 0");
  auto catalog = Catalog::Open(path).value();
  EXPECT_TRUE(std::filesystem::exists(path + ".schema-4.bak"));
  for (int n = 0; n < 2; ++n) {
    CatalogRecord expected = SampleRecord(IdOf(n), n);
    expected.labels.clear();  // there were none
    const CatalogRecord migrated = catalog->GetObject(IdOf(n)).value();
    EXPECT_EQ(FirstDifference(migrated, expected), "");
    EXPECT_EQ(migrated.revision, before + 1);
  }
  // What was damaged before is not made right by the migration.
  EXPECT_EQ(catalog->GetObject("obj_2").status().code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(catalog->Generation().value(), before + 1);
  CatalogRecord next = SampleRecord("obj_0", 7);
  ASSERT_TRUE(catalog->UpdateObject(next, {.grasps = true, .labels = true}).ok());
  EXPECT_EQ(catalog->GetObject("obj_0").value().revision, before + 2);
  EXPECT_EQ(catalog->GetObject("obj_0").value().labels, next.labels);
}

TEST(DigestTest, ObjectsOfAnOlderSchemaGetTheirDigestsAndTheFileIsCopiedBefore) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  Enrol(*Catalog::Open(path).value(), 0, 3);
  // As the schema before digests left it.
  Tamper(path,
         "DROP TRIGGER object_added; DROP TRIGGER object_removed; DROP TABLE file_state; "
         "DROP TRIGGER print_of_mesh; DROP TRIGGER print_of_symmetry; DROP TRIGGER "
         "print_of_new_symmetry; DROP TABLE surface_print; "
         "DROP TRIGGER catalog_write_named; DROP TRIGGER catalog_write_named_anew; DROP TABLE "
         "catalog_write; "
         "DROP TABLE station_event; DROP TABLE station_hand_eye; DROP TABLE station; "
         "DROP TABLE station_writes; DROP TABLE object_digest; DROP TABLE label; DROP TABLE "
         "create_request; "
         "DROP TABLE object_version; ALTER TABLE object DROP COLUMN changed_by; "
         "ALTER TABLE object DROP COLUMN revision; ALTER TABLE grasp DROP COLUMN kind; "
         "ALTER TABLE grasp DROP COLUMN cup_radius_m; PRAGMA user_version=3");
  {
    auto catalog = Catalog::Open(path).value();
    EXPECT_TRUE(catalog->Verify().value().empty());
    EXPECT_TRUE(catalog->GetObject("obj_1").ok());
  }
  EXPECT_TRUE(std::filesystem::exists(path + ".schema-3.bak"));
  Tamper(path, kDamage[0]);
  EXPECT_FALSE(Catalog::Open(path).value()->GetObject("obj_1").ok());
  // The copy is of the schema before, and a catalog.
  EXPECT_EQ(Catalog::Open(path + ".schema-3.bak").value()->CountObjects().value(), 3);
}

TEST(VerifyTest, TellsProgressAndStopsWhenItIsAskedTo) {
  const ScratchDir dir;
  auto catalog = Catalog::Open(dir.File("a.db")).value();
  Enrol(*catalog, 0, 30);
  std::vector<int> told;
  EXPECT_TRUE(catalog
                  ->Verify({},
                           [&](int done, int total) {
                             EXPECT_EQ(total, 30);
                             told.push_back(done);
                           })
                  .value()
                  .empty());
  EXPECT_EQ(told.front(), 0);
  EXPECT_EQ(told.back(), 30);
  EXPECT_TRUE(std::is_sorted(told.begin(), told.end()));
  // At any look: the first, in the middle, the last but one.
  int looks = 0;
  EXPECT_TRUE(catalog->Verify([&] { return ++looks < 0; }).ok());
  ASSERT_GT(looks, 60);
  for (const int at : {1, looks / 3, looks / 2, looks - 1}) {
    int seen = 0;
    EXPECT_TRUE(absl::IsCancelled(catalog->Verify([&] { return ++seen >= at; }).status())) << at;
    EXPECT_LE(seen, at + 5);
  }
  int backup_looks = 0;
  EXPECT_TRUE(
      absl::IsCancelled(catalog->Backup(dir.File("b.db"), [&] { return ++backup_looks >= 1; })));
  EXPECT_FALSE(std::filesystem::exists(dir.File("b.db")));
}

TEST(VerifyTest, WritesGoOnMeanwhile) {
  const ScratchDir dir;
  auto catalog = Catalog::Open(dir.File("a.db")).value();
  Enrol(*catalog, 0, 10);
  bool written = false;
  const auto problems = catalog->Verify({}, [&](int, int) {
    // From within: with one connection and its lock this would never return.
    if (!written) written = catalog->CreateObject(SampleRecord("late", 99)).ok();
  });
  EXPECT_TRUE(problems.value().empty());
  EXPECT_TRUE(written);
  EXPECT_EQ(catalog->CountObjects().value(), 11);
}

TEST(RestoreTest, ReplacesEverythingAndKeepsWhatWasThere) {
  const ScratchDir dir;
  auto catalog = Catalog::Open(dir.File("a.db")).value();
  Enrol(*catalog, 0, 5);
  ASSERT_TRUE(catalog->Backup(dir.File("copy.db")).ok());
  ASSERT_TRUE(catalog->DeleteObject("obj_3").ok());
  Enrol(*catalog, 7, 2);
  ASSERT_TRUE(catalog->Restore(dir.File("copy.db")).ok());
  EXPECT_EQ(catalog->CountObjects().value(), 5);
  EXPECT_EQ(FirstDifference(catalog->GetObject("obj_3").value(), SampleRecord("obj_3", 3)), "");
  EXPECT_TRUE(catalog->Verify().value().empty());
  EXPECT_TRUE(catalog->CreateObject(SampleRecord("obj_9", 9)).ok());
  catalog.reset();
  EXPECT_EQ(Catalog::Open(dir.File("a.db")).value()->CountObjects().value(), 6);
  EXPECT_EQ(Catalog::Open(dir.File("a.db.before-restore.bak")).value()->CountObjects().value(), 6);
}

TEST(RestoreTest, RefusesWhatIsDamagedOrNoCatalogAndChangesNothing) {
  const ScratchDir dir;
  auto catalog = Catalog::Open(dir.File("a.db")).value();
  Enrol(*catalog, 0, 3);
  ASSERT_TRUE(catalog->Backup(dir.File("copy.db")).ok());
  ASSERT_TRUE(catalog->DeleteObject("obj_0").ok());
  Tamper(dir.File("copy.db"), kDamage[1]);
  const absl::Status damaged = catalog->Restore(dir.File("copy.db"));
  EXPECT_EQ(damaged.code(), absl::StatusCode::kDataLoss) << damaged;
  Tamper(dir.File("other.db"), "CREATE TABLE mine (x)");
  EXPECT_EQ(catalog->Restore(dir.File("other.db")).code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(catalog->CountObjects().value(), 2);
}

}  // namespace
}  // namespace horopter
