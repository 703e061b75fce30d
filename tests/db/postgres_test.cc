// What is PostgreSQL's own in the catalog: several writers, connections that break, its schema.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <set>
#include <thread>

#include "db/catalog.h"
#include "db/copy_rows.h"
#include "db/migrations.h"
#include "db/postgres_database.h"
#include "db/sqlite_database.h"
#include "server/base/crash_point.h"
#include "tests/support/catalog_contract.h"
#include "tests/support/killed_writer.h"
#include "tests/support/sample_record.h"

namespace horopter {
namespace {

using absl::StatusCode;
using testing::HasSubstr;
using testing::Not;

class PostgresCatalog : public testing::Test {
 protected:
  void SetUp() override {
    server_ = PostgresServer::OfProcess();
    if (server_ == nullptr)
      GTEST_SKIP() << "PostgreSQL 15 is not installed (package postgresql-15)";
    place_ = server_->NewCatalog();
  }
  void TearDown() override { crash_hook = nullptr; }
  std::unique_ptr<Catalog> Open() { return Catalog::Open(place_).value(); }

  PostgresServer* server_ = nullptr;
  std::string place_;
};

std::string IdOf(int number) {
  return "obj_" + std::to_string(number);
}

std::set<std::string> ColumnsOf(Database* db, const std::string& sql) {
  std::set<std::string> columns;
  Statement select(db, sql);
  while (select.Step().value()) columns.insert(select.Text(0));
  return columns;
}

TEST_F(PostgresCatalog, HasTheTablesAndColumnsOfSqliteInTheirOrder) {
  const auto shared = PostgresDatabase::Open(place_, PostgresMigrations()).value();
  const auto file = SqliteDatabase::Open(":memory:", {}).value();
  auto ours = ColumnsOf(shared.get(),
                        "SELECT table_name || '.' || ordinal_position || '.' || column_name FROM "
                        "information_schema.columns WHERE table_schema = current_schema() AND "
                        "table_name <> 'catalog_schema'");
  auto theirs = ColumnsOf(file.get(),
                          "SELECT m.name || '.' || (c.cid + 1) || '.' || c.name FROM sqlite_schema "
                          "m, pragma_table_info(m.name) c WHERE m.type = 'table' AND m.name <> "
                          "'file_state'");
  EXPECT_EQ(ours, theirs);
  // What is copied is all there is.
  std::set<std::string> tables, copied;
  for (const std::string& column : theirs) tables.insert(column.substr(0, column.find('.')));
  for (const CatalogTable& table : CatalogTables()) copied.insert(table.name);
  copied.insert("catalog_write");  // a copy has a history of its own
  EXPECT_EQ(copied, tables);
}

TEST_F(PostgresCatalog, EachMigrationFollowsItsPredecessorAndAFailedOneLeavesIt) {
  const std::vector<std::string> first{"CREATE TABLE a (x BIGINT); INSERT INTO a VALUES (7)"};
  std::vector<std::string> both = first, bad = first;
  both.push_back("ALTER TABLE a ADD COLUMN y BIGINT NOT NULL DEFAULT 5");
  bad.push_back("ALTER TABLE a ADD COLUMN y BIGINT; SELECT no_such_thing");
  ASSERT_TRUE(PostgresDatabase::Open(place_, first).ok());
  EXPECT_EQ(PostgresDatabase::Open(place_, bad).status().code(), StatusCode::kInternal);
  EXPECT_EQ(server_->Run(place_, "SELECT version FROM catalog_schema"), "1");
  const auto older = PostgresDatabase::Open(place_, first).value();
  const auto newer = PostgresDatabase::Open(place_, both).value();
  EXPECT_EQ(QueryInt(newer.get(), "SELECT x + y FROM a").value(), 12);
  EXPECT_EQ(newer->ReadSchemaVersion()->version, 2);
  // The one beside it goes on.
  EXPECT_TRUE(
      older->RunInTransaction([&] { return Execute(older.get(), "INSERT INTO a VALUES (8)"); })
          .ok());
  EXPECT_EQ(QueryInt(newer.get(), "SELECT sum(x)::bigint FROM a").value(), 15);
}

TEST_F(PostgresCatalog, DerivedDataOfAnOlderSchemaKeepTheirVersionAndTheirKeys) {
  const std::vector<std::string> all = PostgresMigrations();
  ASSERT_TRUE(PostgresDatabase::Open(place_, {all.begin(), all.begin() + 1}).ok());
  for (const char* id : {"a", "b"}) {
    server_->Run(place_,
                 std::string("INSERT INTO object VALUES ('") + id +
                     "', 'name', 0.1, '', '', 0, 0, 0, 1, '')");
  }
  server_->Run(place_, "INSERT INTO derived VALUES ('a', 8, '1'), ('b', 7, '2')");
  server_->Run(place_, "INSERT INTO derived_keys VALUES ('b', '3')");
  const auto database = PostgresDatabase::Open(place_, all);
  ASSERT_TRUE(database.ok()) << database.status();
  EXPECT_EQ(server_->Run(place_,
                         "SELECT string_agg(d.object_id || d.version || d.address || "
                         "encode(d.data, 'escape') || coalesce(encode(k.data, 'escape'), ''), ' ' "
                         "ORDER BY d.object_id) FROM derived d LEFT JOIN derived_keys k USING "
                         "(object_id, version)"),
            "a81 b723");
  // A server of before does not write into it.
  EXPECT_EQ(PostgresDatabase::Open(place_, {all.begin(), all.begin() + 1}).status().code(),
            StatusCode::kFailedPrecondition);
}

TEST(PostgresAddress, IsShownWithoutItsPassword) {
  EXPECT_TRUE(IsPostgresAddress("postgresql://db/parts"));
  EXPECT_FALSE(IsPostgresAddress("parts.db"));
  EXPECT_EQ(ShownPostgresAddress("postgresql://u:secret@db:6543/parts?password=other"),
            "postgresql://u@db:6543/parts");
  EXPECT_THAT(ShownPostgresAddress("postgresql://u:sec ret@%zz"), Not(HasSubstr("sec")));
  const absl::Status malformed = Catalog::Open("postgresql://u:secret@db/x?no=such").status();
  EXPECT_EQ(malformed.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(malformed.message()), Not(HasSubstr("secret")));
}

TEST(PostgresAddress, OfNobodyIsOutOfReachAndSaysSo) {
  const absl::Status status =
      Catalog::Open("postgresql://u:secret@127.0.0.1:1/parts?connect_timeout=2").status();
  EXPECT_EQ(status.code(), StatusCode::kUnavailable);
  EXPECT_THAT(std::string(status.message()), HasSubstr("127.0.0.1:1/parts"));
  EXPECT_THAT(std::string(status.message()), Not(HasSubstr("secret")));
}

TEST_F(PostgresCatalog, OfSomebodyElseOrOfANewerVersionIsRefused) {
  server_->Run(place_, "CREATE TABLE object (x INT)");
  const absl::Status foreign = Catalog::Open(place_).status();
  EXPECT_EQ(foreign.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(foreign.message()), HasSubstr("is not a horopter catalog"));
  server_->Run(place_, "DROP TABLE object");
  ASSERT_TRUE(Catalog::Open(place_).ok());
  // A newer program has been here; its schema still serves this one.
  server_->Run(place_, "UPDATE catalog_schema SET version = 1000");
  ASSERT_TRUE(Catalog::Open(place_).ok());
  EXPECT_EQ(server_->Run(place_, "SELECT version FROM catalog_schema"), "1000");
  server_->Run(place_, "UPDATE catalog_schema SET usable_from = 1000");
  const absl::Status newer = Catalog::Open(place_).status();
  EXPECT_EQ(newer.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(newer.message()), HasSubstr("use a newer horopterd"));
  const absl::Status missing = Catalog::Open(place_ + "_not").status();
  EXPECT_EQ(missing.code(), StatusCode::kFailedPrecondition) << missing;
  const absl::Status nobody =
      Catalog::Open(server_->NewCatalog("&user=nobody_of_that_name")).status();
  EXPECT_EQ(nobody.code(), StatusCode::kPermissionDenied) << nobody;
}

TEST_F(PostgresCatalog, IsFilledByManyServersAndNoWriteOrNumberIsLost) {
  constexpr int kServers = 3, kWrites = 12;
  std::vector<std::thread> servers;
  for (int s = 0; s < kServers; ++s) {
    servers.emplace_back([&, s] {
      const auto catalog = Open();  // the first of them makes the tables
      for (int i = 0; i < kWrites; ++i) {
        EXPECT_TRUE(catalog->CreateObject(SampleRecord(IdOf(100 * s + i), i)).ok());
      }
    });
  }
  for (std::thread& server : servers) server.join();
  const auto catalog = Open();
  EXPECT_EQ(catalog->CountObjects().value(), kServers * kWrites);
  EXPECT_EQ(catalog->Generation().value(), kServers * kWrites);
  std::set<int64_t> revisions;
  const auto all = catalog->ListObjects("", 1000).value();
  for (const ObjectSummary& summary : all) revisions.insert(summary.record.revision);
  EXPECT_EQ(revisions.size(), static_cast<size_t>(kServers * kWrites));
}

TEST_F(PostgresCatalog, GoesOnAfterItsConnectionsBroke) {
  const auto catalog = Open();
  ASSERT_TRUE(catalog->CreateObject(SampleRecord("a", 1)).ok());
  const auto break_all = [&] {
    server_->Run(place_,
                 "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity WHERE "
                 "application_name = 'horopterd'");
  };
  break_all();
  EXPECT_TRUE(catalog->GetObject("a").ok());
  break_all();
  EXPECT_TRUE(catalog->CreateObject(SampleRecord("b", 2)).ok());
  server_->Stop();
  EXPECT_EQ(catalog->GetObject("a").status().code(), StatusCode::kUnavailable);
  EXPECT_EQ(catalog->CreateObject(SampleRecord("c", 3)).code(), StatusCode::kUnavailable);
  ASSERT_TRUE(server_->Begin());
  EXPECT_TRUE(catalog->CreateObject(SampleRecord("c", 3)).ok());
  EXPECT_EQ(catalog->CountObjects().value(), 3);
}

PostgresServer* hook_server = nullptr;
std::string hook_place;
std::atomic<int> hooks_left{0};

void BreakBeforeCommit(const char* point) {
  if (std::string(point) != "transaction.before_commit" || hooks_left-- <= 0) return;
  hook_server->Run(hook_place,
                   "SELECT count(pg_terminate_backend(pid, 5000)) FROM pg_stat_activity WHERE "
                   "application_name = 'horopterd'");
}

TEST_F(PostgresCatalog, ACommitWhoseConnectionBreaksIsFoundOutAndMadeOnce) {
  const auto catalog = Open();
  hook_server = server_;
  hook_place = place_;
  hooks_left = 1;
  crash_hook = BreakBeforeCommit;
  EXPECT_TRUE(catalog->CreateObject(SampleRecord("a", 1)).ok());
  EXPECT_LT(hooks_left, 1);
  EXPECT_EQ(catalog->Generation().value(), 1);
  EXPECT_EQ(FirstDifference(catalog->GetObject("a").value(), SampleRecord("a", 1)), "");
}

TEST_F(PostgresCatalog, SerialisationFailuresAreTriedAgain) {
  const auto catalog = Open();
  server_->Run(place_,
               "CREATE SEQUENCE tried; CREATE FUNCTION fail() RETURNS trigger LANGUAGE plpgsql AS "
               "$$BEGIN IF nextval('tried') <= 3 THEN RAISE EXCEPTION 'again' USING ERRCODE = "
               "'40001'; END IF; RETURN NEW; END$$; CREATE TRIGGER failing BEFORE INSERT ON mesh "
               "FOR EACH ROW EXECUTE FUNCTION fail()");
  EXPECT_TRUE(catalog->CreateObject(SampleRecord("a", 1)).ok());
  EXPECT_EQ(server_->Run(place_, "SELECT last_value FROM tried"), "4");
  // One that does not end is told.
  server_->Run(place_,
               "SELECT setval('tried', 1); ALTER SEQUENCE tried INCREMENT BY -1 MINVALUE -99");
  EXPECT_EQ(catalog->CreateObject(SampleRecord("b", 1)).code(), StatusCode::kUnavailable);
  EXPECT_EQ(catalog->CountObjects().value(), 1);
}

TEST_F(PostgresCatalog, AcknowledgesWhatIsOnDiskWhateverTheAddressSays) {
  for (const auto& [given, kept] :
       {std::pair{"off", "on"}, {"local", "on"}, {"remote_apply", "remote_apply"}}) {
    PostgresConnection connection(place_ + "%20-csynchronous_commit%3D" + given);
    ASSERT_TRUE(connection.Connect().ok());
    const auto shown = connection.Query("SELECT current_setting('synchronous_commit')", {});
    ASSERT_TRUE(shown.ok()) << shown.status();
    EXPECT_STREQ(PQgetvalue(shown->get(), 0, 0), kept) << given;
  }
}

TEST_F(PostgresCatalog, TextThatItCannotHoldIsRefusedAndNotCut) {
  const auto catalog = Open();
  CatalogRecord record = SampleRecord("a", 1);
  record.model.display_name = std::string("a\0b", 3);
  EXPECT_EQ(catalog->CreateObject(record).code(), StatusCode::kInvalidArgument);
  EXPECT_EQ(catalog->CountObjects().value(), 0);
  EXPECT_TRUE(catalog->CreateObject(SampleRecord("a", 1)).ok());
}

TEST_F(PostgresCatalog, KilledAgainAndAgainHoldsEveryAcknowledgedWrite) {
  std::set<int> acknowledged;
  { Open(); }
  int next = 0;
  for (int round = 0; round < 2; ++round) {
    std::atomic<bool> stop = false;
    std::thread writer([&] {
      const auto catalog = Open();
      while (!stop) {
        const int n = next++;
        if (catalog->CreateObject(SampleRecord(IdOf(n), n)).ok()) acknowledged.insert(n);
      }
    });
    usleep(300'000);
    server_->Kill();
    // Its children give the memory free a moment later. The writer asks meanwhile what became of
    // its last write.
    bool begun = false;
    for (int i = 0; i < 40 && !begun; ++i) {
      begun = server_->Begin();
      if (!begun) usleep(100'000);
    }
    stop = true;
    writer.join();
    ASSERT_TRUE(begun);
    const auto catalog = Open();
    for (const int n : acknowledged) {
      const auto record = catalog->GetObject(IdOf(n));
      ASSERT_TRUE(record.ok()) << record.status();
      EXPECT_EQ(FirstDifference(*record, SampleRecord(IdOf(n), n)), "");
    }
    EXPECT_LE(catalog->CountObjects().value(), static_cast<int>(acknowledged.size()) + round + 1);
  }
  EXPECT_GT(acknowledged.size(), 10u);
}

}  // namespace
}  // namespace horopter
