#include <gtest/gtest.h>
#include <sqlite3.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <thread>

#include "db/catalog.h"
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

}  // namespace
}  // namespace horopter
