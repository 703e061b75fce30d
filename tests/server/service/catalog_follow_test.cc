// Servers that share a catalog: what one writes the others publish, and no write is lost.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "server/service/catalog_store.h"
#include "tests/support/catalog_contract.h"
#include "tests/support/fake_objects.h"
#include "tests/support/sample_record.h"

namespace horopter {
namespace {

using absl::StatusCode;
using testing::ElementsAre;

constexpr double kLongS = 60.0;  // far beyond what it takes

class PostgresReplicas : public testing::Test {
 protected:
  void SetUp() override {
    server_ = PostgresServer::OfProcess();
    if (server_ == nullptr)
      GTEST_SKIP() << "PostgreSQL 15 is not installed (package postgresql-15)";
    place_ = server_->NewCatalog();
  }
  std::unique_ptr<CatalogStore> Start(const StoreOptions& options = {}, int version = 1) {
    return CatalogStore::Load(Catalog::Open(place_).value(), FakePreparer(version), options)
        .value();
  }
  static absl::Status Rename(CatalogStore& store, const std::string& id, const std::string& name) {
    UpdateParts parts;
    parts.display_name = true;
    return store.Update(id, parts, [&](CatalogRecord current) -> absl::StatusOr<CatalogRecord> {
      current.model.display_name = name;
      return current;
    });
  }
  static int64_t GenerationOf(const CatalogStore& store) {
    return store.Published()->snapshot.generation;
  }
  // Whether the two publish the same objects with the same content.
  static void ExpectSame(const CatalogStore& a, const CatalogStore& b) {
    EXPECT_EQ(a.Published()->ids, b.Published()->ids);
    EXPECT_TRUE(a.CheckIndex().ok());
    EXPECT_TRUE(b.CheckIndex().ok());
    for (size_t i = 0; i < a.Published()->ids.size(); ++i) {
      const auto& x = a.Published()->snapshot;
      const auto& y = b.Published()->snapshot;
      EXPECT_EQ(a.ModelOf(*ObjectAt(x, static_cast<int>(i)).value()).diameter_m,
                b.ModelOf(*ObjectAt(y, static_cast<int>(i)).value()).diameter_m);
    }
  }

  PostgresServer* server_ = nullptr;
  std::string place_;
};

TEST_F(PostgresReplicas, PublishWhatOneOfThemWrites) {
  const auto one = Start(), two = Start();
  ASSERT_TRUE(one->Create(SampleRecord("a", 1)).ok());
  ASSERT_TRUE(one->Create(SampleRecord("b", 2)).ok());
  ASSERT_TRUE(two->AwaitGeneration(2, kLongS, {}).ok());
  EXPECT_THAT(two->Published()->ids, ElementsAre("a", "b"));
  ASSERT_TRUE(two->Delete("a").ok());
  const CatalogRecord other = SampleRecord("b", 7);
  ASSERT_TRUE(two->Update("b",
                          {true, true, true, true, true, true},
                          [&](CatalogRecord) -> absl::StatusOr<CatalogRecord> { return other; })
                  .ok());
  ASSERT_TRUE(one->AwaitGeneration(4, kLongS, {}).ok());
  EXPECT_THAT(one->Published()->ids, ElementsAre("b"));
  ExpectSame(*one, *two);
  EXPECT_LT(one->SecondsBehind(), kLongS);
  // Nobody has prepared what the other had prepared and stored.
  EXPECT_EQ(one->load_report().prepared + two->load_report().prepared, 0);
}

TEST_F(PostgresReplicas, AWriteRestsOnAllThatCameBefore) {
  const auto one = Start(), two = Start();
  ASSERT_TRUE(one->Create(SampleRecord("a", 1)).ok());
  // At once, without waiting for the other to follow.
  EXPECT_EQ(two->Create(SampleRecord("a", 2)).code(), StatusCode::kAlreadyExists);
  ASSERT_TRUE(Rename(*two, "a", "named").ok());
  EXPECT_EQ(GenerationOf(*two), 2);
  EXPECT_EQ(one->catalog().GetSummary("a")->record.model.display_name, "named");
}

TEST_F(PostgresReplicas, ManyWritersLoseNothingAndAgreeInTheEnd) {
  constexpr int kServers = 3, kWrites = 12;
  std::vector<std::unique_ptr<CatalogStore>> servers;
  for (int s = 0; s < kServers; ++s) servers.push_back(Start());
  ASSERT_TRUE(servers[0]->Create(SampleRecord("counted", 1)).ok());
  std::vector<std::thread> writers;
  std::atomic<int> told{0};
  for (int s = 0; s < kServers; ++s) {
    writers.emplace_back([&, s] {
      int64_t before = 0;
      for (int i = 0; i < kWrites; ++i) {
        EXPECT_TRUE(servers[s]
                        ->Create(SampleRecord("o" + std::to_string(s) + "_" + std::to_string(i), i))
                        .ok());
        // Each adds one to a number in the same object: none may write over another's.
        UpdateParts parts;
        parts.labels = true;
        EXPECT_TRUE(servers[s]
                        ->Update("counted",
                                 parts,
                                 [&](CatalogRecord now) -> absl::StatusOr<CatalogRecord> {
                                   std::string& n = now.labels["n"];
                                   n = std::to_string(n.empty() ? 1 : std::stoi(n) + 1);
                                   return now;
                                 })
                        .ok());
        EXPECT_GT(GenerationOf(*servers[s]), before);
        before = GenerationOf(*servers[s]);
        ++told;
      }
    });
  }
  for (std::thread& writer : writers) writer.join();
  const int64_t last = 1 + 2 * kServers * kWrites;
  for (const auto& server : servers) {
    ASSERT_TRUE(server->AwaitGeneration(last, kLongS, {}).ok());
    EXPECT_EQ(GenerationOf(*server), last);
    ExpectSame(*servers[0], *server);
  }
  EXPECT_EQ(servers[0]->catalog().GetObject("counted")->labels.at("n"),
            std::to_string(kServers * kWrites));
}

TEST_F(PostgresReplicas, TakeOverABurstAndOneThatWasAwayForLong) {
  const auto one = Start();
  const auto two = Start();
  std::vector<CatalogRecord> burst;
  for (int i = 0; i < 150; ++i) burst.push_back(SampleRecord("b" + std::to_string(i), i));
  ASSERT_TRUE(one->Create(std::move(burst)).ok());
  for (int i = 0; i < 150; i += 3) ASSERT_TRUE(one->Delete("b" + std::to_string(i)).ok());
  ASSERT_TRUE(two->AwaitGeneration(51, kLongS, {}).ok());
  EXPECT_EQ(two->Published()->ids.size(), 100u);
  ExpectSame(*one, *two);
}

TEST_F(PostgresReplicas, TakeOverACatalogThatIsNotHeldInMemory) {
  StoreOptions small;
  small.max_resident = 2;
  {
    const auto first = Start();
    for (const char* id : {"a", "b", "c", "d"})
      ASSERT_TRUE(first->Create(SampleRecord(id, 1)).ok());
  }
  const auto one = Start(small), two = Start(small);
  ASSERT_FALSE(two->load_report().resident);
  ASSERT_TRUE(one->Delete("b").ok());
  ASSERT_TRUE(one->Create(SampleRecord("e", 5)).ok());
  ASSERT_TRUE(two->AwaitGeneration(6, kLongS, {}).ok());
  EXPECT_THAT(two->Published()->ids, ElementsAre("a", "c", "d", "e"));
  ExpectSame(*one, *two);
}

TEST_F(PostgresReplicas, HoldACatalogInMemoryNoMoreThatOthersMakeTooLarge) {
  StoreOptions small;
  small.max_resident = 3;
  const auto one = Start(), two = Start(small);
  for (const char* id : {"a", "b", "c"}) ASSERT_TRUE(one->Create(SampleRecord(id, 1)).ok());
  ASSERT_TRUE(one->Delete("a").ok());
  ASSERT_TRUE(two->AwaitGeneration(4, kLongS, {}).ok());
  EXPECT_TRUE(two->Published()->addresses.empty());
  std::vector<CatalogRecord> burst;
  for (const char* id : {"d", "e"}) burst.push_back(SampleRecord(id, 2));
  ASSERT_TRUE(one->Create(std::move(burst)).ok());
  ASSERT_TRUE(two->AwaitGeneration(5, kLongS, {}).ok());
  EXPECT_THAT(two->Published()->ids, ElementsAre("b", "c", "d", "e"));
  EXPECT_EQ(two->Published()->addresses.size(), 4u);
  ASSERT_TRUE(two->Create(SampleRecord("f", 3)).ok());
  ASSERT_TRUE(one->AwaitGeneration(6, kLongS, {}).ok());
  ExpectSame(*one, *two);
}

TEST_F(PostgresReplicas, KeepWhatTheyHaveWhileTheDatabaseIsGoneAndSayHowOldItIs) {
  const auto one = Start(), two = Start();
  ASSERT_TRUE(one->Create(SampleRecord("a", 1)).ok());
  ASSERT_TRUE(two->AwaitGeneration(1, kLongS, {}).ok());
  server_->Stop();
  EXPECT_EQ(one->Create(SampleRecord("b", 2)).code(), StatusCode::kUnavailable);
  EXPECT_THAT(two->Published()->ids, ElementsAre("a"));
  const double then = two->SecondsBehind();
  usleep(700'000);
  EXPECT_GT(two->SecondsBehind(), then + 0.3);
  EXPECT_EQ(two->AwaitGeneration(2, 0.05, {}).code(), StatusCode::kUnavailable);
  ASSERT_TRUE(server_->Begin());
  ASSERT_TRUE(one->Create(SampleRecord("b", 2)).ok());
  ASSERT_TRUE(two->AwaitGeneration(2, kLongS, {}).ok());
  EXPECT_THAT(two->Published()->ids, ElementsAre("a", "b"));
}

TEST_F(PostgresReplicas, FollowARestoredCatalogForwardsAndADatabaseThatWentBack) {
  const auto one = Start(), two = Start();
  const ScratchDir dir;
  ASSERT_TRUE(one->Create(SampleRecord("a", 1)).ok());
  ASSERT_TRUE(one->catalog().Backup(dir.File("copy.db")).ok());
  ASSERT_TRUE(one->Create(SampleRecord("b", 2)).ok());
  ASSERT_TRUE(one->Restore(dir.File("copy.db")).ok());
  ASSERT_TRUE(two->AwaitGeneration(GenerationOf(*one), kLongS, {}).ok());
  EXPECT_THAT(two->Published()->ids, ElementsAre("a"));
  // As after a restore to a point in time: the number is lower than any that was seen.
  server_->Run(place_, "UPDATE object SET revision = 1; UPDATE catalog_state SET generation = 1");
  ASSERT_TRUE(two->Create(SampleRecord("c", 3)).ok());
  EXPECT_EQ(GenerationOf(*two), 2);
  EXPECT_THAT(two->Published()->ids, ElementsAre("a", "c"));
}

// As a restore of the database to generation 1, and three writes that came before anybody looked.
TEST_F(PostgresReplicas, SeeThatAsMuchWasWrittenAgainAsWasLost) {
  const auto kept = Start();
  ASSERT_TRUE(kept->Create(SampleRecord("first", 1)).ok());
  server_->Run(place_, "CREATE TABLE kept_write AS SELECT * FROM catalog_write");
  ASSERT_TRUE(kept->Create(SampleRecord("lost", 2)).ok());
  ASSERT_TRUE(kept->Delete("first").ok());
  const auto late = Start();
  EXPECT_THAT(late->Published()->ids, ElementsAre("lost"));
  // One transaction.
  server_->Run(place_,
               "DELETE FROM object; "
               "UPDATE catalog_state SET generation = 1; "
               "DELETE FROM catalog_write; INSERT INTO catalog_write SELECT * FROM kept_write; "
               "INSERT INTO object VALUES ('again', 'name', 0.1, '', '', 0, 0, 0, 2, ''); "
               "UPDATE catalog_state SET generation = 2; UPDATE catalog_state SET generation = 3; "
               "UPDATE catalog_state SET generation = 4; DROP TABLE kept_write");
  ASSERT_TRUE(late->AwaitGeneration(4, kLongS, {}).ok());
  ASSERT_TRUE(kept->AwaitGeneration(4, kLongS, {}).ok());
  for (const auto* server : {&kept, &late}) {
    // What was written again has no geometry here, and is known for that.
    EXPECT_TRUE((*server)->Published()->ids.empty());
    EXPECT_EQ((*server)->Published()->unusable.count("again"), 1u);
  }
}

TEST_F(PostgresReplicas, OfTwoVersionsServeSideBySide) {
  const auto older = Start({}, 1);
  ASSERT_TRUE(older->Create(SampleRecord("a", 1)).ok());
  const auto newer = Start({.prepare_beside = true}, 2);
  ASSERT_TRUE(newer->Create(SampleRecord("b", 2)).ok());
  ASSERT_TRUE(older->Create(SampleRecord("c", 3)).ok());
  for (int i = 0; i < 600 && newer->Published()->ids.size() < 3; ++i) usleep(100'000);
  EXPECT_THAT(newer->Published()->ids, ElementsAre("a", "b", "c"));
  ASSERT_TRUE(older->AwaitGeneration(GenerationOf(*newer), kLongS, {}).ok());
  EXPECT_THAT(older->Published()->ids, ElementsAre("a", "b", "c"));
  EXPECT_EQ(older->catalog().CountObjects().value(), 3);
}

}  // namespace
}  // namespace horopter
