#include "db/open_database.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>

#include "absl/strings/str_cat.h"
#include "db/catalog.h"
#include "db/migrations.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

using absl::StatusCode;
using testing::HasSubstr;

std::string Bytes(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void Write(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

// Makes a database with the given statements and none of our settings.
void MakeForeign(const std::string& path, const std::string& sql) {
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &db), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(db, sql.c_str(), nullptr, nullptr, nullptr), SQLITE_OK)
      << sqlite3_errmsg(db);
  sqlite3_close(db);
}

// Refused with the code, a message that names the file, and the file as it was.
void ExpectRefused(const std::string& path, StatusCode code, const std::string& says) {
  const std::string before = Bytes(path);
  const absl::Status status = Catalog::Open(path, {.busy_timeout_ms = 10}).status();
  EXPECT_EQ(status.code(), code) << status;
  EXPECT_THAT(std::string(status.message()), HasSubstr(path));
  EXPECT_THAT(std::string(status.message()), HasSubstr(says));
  EXPECT_EQ(Bytes(path), before);
}

TEST(OpenDatabase, MakesANewFileWithOurSettings) {
  const ScratchDir dir;
  const auto handle = OpenDatabase(dir.File("new.db"), 10, CatalogMigrations());
  ASSERT_TRUE(handle.ok()) << handle.status();
  sqlite3* db = handle->get();
  EXPECT_EQ(*QueryInt(db, "PRAGMA application_id"), kCatalogApplicationId);
  EXPECT_EQ(*QueryInt(db, "PRAGMA user_version"), static_cast<int>(CatalogMigrations().size()));
  EXPECT_EQ(*QueryText(db, "PRAGMA journal_mode"), "wal");
  EXPECT_EQ(*QueryInt(db, "PRAGMA synchronous"), 2);
  EXPECT_EQ(*QueryInt(db, "PRAGMA foreign_keys"), 1);
  EXPECT_EQ(
      *QueryInt(db,
                "SELECT count(*) FROM pragma_table_list WHERE schema = 'main' AND type = 'table' "
                "AND name NOT LIKE 'sqlite_%' AND NOT strict"),
      0);
}

TEST(OpenDatabase, EachMigrationFollowsItsPredecessorAndKeepsItsRows) {
  const std::vector<std::string> all = CatalogMigrations();
  const ScratchDir dir;
  for (size_t version = 0; version < all.size(); ++version) {
    const std::string path = dir.File(absl::StrCat("v", version, ".db"));
    const std::vector<std::string> older(all.begin(), all.begin() + version);
    ASSERT_TRUE(OpenDatabase(path, 10, older).ok());
    const auto handle = OpenDatabase(path, 10, all);
    ASSERT_TRUE(handle.ok()) << handle.status();
    EXPECT_EQ(*QueryInt(handle->get(), "PRAGMA user_version"), static_cast<int>(all.size()));
  }
}

// Before version 8 a base had no deviations, and whether it was learnt only an event told.
TEST(OpenDatabase, LearntBasesOfAnOlderSchemaAreKnownAsSuch) {
  const std::vector<std::string> all = CatalogMigrations();
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  {
    const auto handle = OpenDatabase(path, 10, {all.begin(), all.begin() + 7});
    ASSERT_TRUE(handle.ok()) << handle.status();
    ASSERT_TRUE(
        Execute(
            handle->get(),
            "INSERT INTO station VALUES ('cell', '', '', '', 1, '', '', x'00');"
            "INSERT INTO station_hand_eye VALUES ('cell', 'left', 1,0,0, 0,1,0, 0,0,1, 1,2,3);"
            "INSERT INTO station_hand_eye VALUES ('cell', 'lef', 1,0,0, 0,1,0, 0,0,1, 4,5,6);"
            "INSERT INTO station_event (station_id, kind, time, request_id, camera_ids, detail) "
            "VALUES ('cell', 7, '', '', 'top left', ''), ('cell', 3, '', '', 'lef', '')")
            .ok());
  }
  const auto handle = OpenDatabase(path, 10, all);
  ASSERT_TRUE(handle.ok()) << handle.status();
  sqlite3* const db = handle->get();
  EXPECT_EQ(*QueryInt(db, "SELECT learnt FROM station_hand_eye WHERE camera_id = 'left'"), 1);
  EXPECT_EQ(*QueryInt(db, "SELECT requests FROM station_hand_eye WHERE camera_id = 'left'"), 1);
  EXPECT_EQ(*QueryInt(db, "SELECT learnt FROM station_hand_eye WHERE camera_id = 'lef'"), 0);
  EXPECT_EQ(*QueryInt(db,
                      "SELECT count(*) FROM station_hand_eye WHERE rotation_sigma_rad = 0.01 AND "
                      "position_sigma_m = 0.005"),
            2);
}

// Before version 10 an object had derived data of one version.
TEST(OpenDatabase, DerivedDataOfAnOlderSchemaKeepTheirVersionAndTheirKeys) {
  const std::vector<std::string> all = CatalogMigrations();
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  {
    const auto handle = OpenDatabase(path, 10, {all.begin(), all.begin() + 9});
    ASSERT_TRUE(handle.ok()) << handle.status();
    const std::string object = " 'name', 0.1, '', '', 0, 0, 0, 1, '');";
    ASSERT_TRUE(Execute(handle->get(),
                        "INSERT INTO object VALUES ('a'," + object +
                            "INSERT INTO object VALUES ('b'," + object +
                            "INSERT INTO derived VALUES ('a', 8, x'01'), ('b', 7, x'02');"
                            "INSERT INTO derived_keys VALUES ('b', x'03')")
                    .ok());
  }
  const auto handle = OpenDatabase(path, 10, all);
  ASSERT_TRUE(handle.ok()) << handle.status();
  sqlite3* const db = handle->get();
  EXPECT_EQ(*QueryText(db,
                       "SELECT group_concat(d.object_id || d.version || d.address || hex(d.data) "
                       "|| ifnull(hex(k.data), ''), ' ') FROM derived d LEFT JOIN derived_keys k "
                       "USING (object_id, version)"),
            "a801 b70203");
  ASSERT_TRUE(Execute(db, "DELETE FROM object WHERE object_id = 'b'").ok());
  EXPECT_EQ(*QueryInt(db, "SELECT count(*) FROM derived_keys"), 0);
}

TEST(OpenDatabase, AFailingMigrationLeavesTheFormerVersion) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  const std::vector<std::string> good = {
      "CREATE TABLE a (x INTEGER) STRICT; INSERT INTO a VALUES (42);"};
  ASSERT_TRUE(OpenDatabase(path, 10, good).ok());
  std::vector<std::string> bad = good;
  bad.push_back(
      "CREATE TABLE b (x INTEGER) STRICT; DELETE FROM a; INSERT INTO nowhere VALUES (1);");
  const absl::Status status = OpenDatabase(path, 10, bad).status();
  EXPECT_EQ(status.code(), StatusCode::kInternal) << status;
  const auto handle = OpenDatabase(path, 10, good);
  ASSERT_TRUE(handle.ok()) << handle.status();
  EXPECT_EQ(*QueryInt(handle->get(), "SELECT x FROM a"), 42);
  EXPECT_EQ(*QueryInt(handle->get(), "SELECT count(*) FROM sqlite_schema WHERE name = 'b'"), 0);
}

TEST(OpenDatabase, ATransactionThatFailsIsRolledBack) {
  const ScratchDir dir;
  const auto handle =
      OpenDatabase(dir.File("a.db"), 10, {"CREATE TABLE a (x INTEGER PRIMARY KEY) STRICT;"});
  ASSERT_TRUE(handle.ok());
  sqlite3* db = handle->get();
  const absl::Status status = RunInTransaction(db, [&]() -> absl::Status {
    EXPECT_TRUE(Execute(db, "INSERT INTO a VALUES (1)").ok());
    return absl::InvalidArgumentError("changed my mind");
  });
  EXPECT_EQ(status.code(), StatusCode::kInvalidArgument);
  EXPECT_EQ(*QueryInt(db, "SELECT count(*) FROM a"), 0);
  // The connection is usable again, also after an error of SQLite itself.
  EXPECT_FALSE(
      RunInTransaction(db, [&] { return Execute(db, "INSERT INTO a VALUES (1), (1)"); }).ok());
  EXPECT_TRUE(RunInTransaction(db, [&] { return Execute(db, "INSERT INTO a VALUES (2)"); }).ok());
  EXPECT_EQ(*QueryInt(db, "SELECT sum(x) FROM a"), 2);
}

TEST(OpenDatabase, AFileThatIsNoDatabaseIsRefused) {
  const ScratchDir dir;
  Write(dir.File("text.db"), std::string(5000, 'x'));
  ExpectRefused(dir.File("text.db"), StatusCode::kFailedPrecondition, "not a database");
  EXPECT_EQ(Catalog::Open(dir.path().string()).status().code(), StatusCode::kFailedPrecondition);
  EXPECT_EQ(Catalog::Open(dir.File("missing/a.db")).status().code(),
            StatusCode::kFailedPrecondition);
}

TEST(OpenDatabase, ADatabaseOfAnotherProgramIsRefused) {
  const ScratchDir dir;
  MakeForeign(dir.File("tables.db"), "CREATE TABLE mine (x)");
  ExpectRefused(dir.File("tables.db"), StatusCode::kFailedPrecondition, "not a horopter catalog");
  MakeForeign(dir.File("app.db"), "PRAGMA application_id=7");
  ExpectRefused(dir.File("app.db"), StatusCode::kFailedPrecondition, "application_id 7");
}

TEST(OpenDatabase, ANewerSchemaIsRefusedAndTheMessageSaysBothVersions) {
  const ScratchDir dir;
  const std::string path = dir.File("newer.db");
  ASSERT_TRUE(Catalog::Open(path).ok());
  MakeForeign(path, "PRAGMA user_version=999");
  ExpectRefused(path, StatusCode::kFailedPrecondition, "schema version 999");
  ExpectRefused(
      path, StatusCode::kFailedPrecondition, "up to " + std::to_string(CatalogMigrations().size()));
}

TEST(OpenDatabase, AnEmptyFileBecomesACatalog) {
  const ScratchDir dir;
  Write(dir.File("empty.db"), "");
  EXPECT_TRUE(Catalog::Open(dir.File("empty.db")).ok());
}

TEST(OpenDatabase, ADamagedFileIsDataLossOrNoDatabase) {
  const ScratchDir dir;
  const std::string path = dir.File("damaged.db");
  ASSERT_TRUE(Catalog::Open(path).ok());
  std::string bytes = Bytes(path);
  ASSERT_GT(bytes.size(), 8192u);
  // Everything behind the first page: the schema is readable, the tables are not.
  for (size_t i = 4096; i < bytes.size(); ++i) bytes[i] = '\x5a';
  Write(path, bytes);
  ExpectRefused(path, StatusCode::kDataLoss, "damaged");
}

TEST(OpenDatabase, ASecondServerOnTheSameFileIsRefusedUntilTheFirstIsGone) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  auto first = Catalog::Open(path);
  ASSERT_TRUE(first.ok()) << first.status();
  const absl::Status status = Catalog::Open(path, {.busy_timeout_ms = 10}).status();
  EXPECT_EQ(status.code(), StatusCode::kUnavailable) << status;
  EXPECT_THAT(std::string(status.message()), HasSubstr(path));
  EXPECT_THAT(std::string(status.message()), HasSubstr("another process"));
  first->reset();
  EXPECT_TRUE(Catalog::Open(path).ok());
}

TEST(OpenDatabase, AFileLockedByAnotherProgramIsUnavailable) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  ASSERT_TRUE(Catalog::Open(path).ok());
  sqlite3* other = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &other), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(
                other, "PRAGMA locking_mode=EXCLUSIVE; BEGIN EXCLUSIVE", nullptr, nullptr, nullptr),
            SQLITE_OK);
  EXPECT_EQ(Catalog::Open(path, {.busy_timeout_ms = 10}).status().code(), StatusCode::kUnavailable);
  sqlite3_close(other);
}

// Opens the file as a user that may not write it (root may write everything) and says whether that
// was PERMISSION_DENIED with the file's name.
bool IsDeniedToNobody(const std::string& path) {
  const pid_t child = fork();
  if (child == 0) {
    constexpr uid_t kNobody = 65534;
    if (geteuid() == 0 && seteuid(kNobody) != 0) _exit(2);
    const absl::Status status = Catalog::Open(path).status();
    const bool named = std::string(status.message()).find(path) != std::string::npos;
    _exit(status.code() == StatusCode::kPermissionDenied && named ? 0 : 1);
  }
  int result = 0;
  return child > 0 && waitpid(child, &result, 0) == child && WIFEXITED(result) &&
         WEXITSTATUS(result) == 0;
}

TEST(OpenDatabase, AReadOnlyFileOrFolderIsPermissionDenied) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  ASSERT_TRUE(Catalog::Open(path).ok());
  ASSERT_EQ(chmod(path.c_str(), 0444), 0);
  ASSERT_EQ(chmod(dir.path().c_str(), 0777), 0);
  EXPECT_TRUE(IsDeniedToNobody(path)) << "read-only file";
  ASSERT_EQ(chmod(path.c_str(), 0666), 0);
  ASSERT_EQ(chmod(dir.path().c_str(), 0555), 0);
  EXPECT_TRUE(IsDeniedToNobody(path)) << "read-only folder";
  EXPECT_TRUE(IsDeniedToNobody(dir.File("new.db"))) << "new file in a read-only folder";
  chmod(dir.path().c_str(), 0755);
}

}  // namespace
}  // namespace horopter
