#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "db/catalog.h"
#include "db/open_database.h"
#include "db/sqlite.h"
#include "tests/support/catalog_contract.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

class StationRows : public CatalogContract {};

StationRecord Sample(int requests = 0) {
  StationRecord record;
  record.display_name = "press 4";
  record.create_time = record.update_time = "2026-01-01T00:00:00.000Z";
  CameraBase& base = record.bases["left"];
  base.base_from_camera.t = {1, 2, 3};
  base.rotation_sigma_rad = 0.002;
  base.position_sigma_m = 0.003;
  base.learnt = true;
  base.requests = 7;
  StationCamera camera;
  camera.id = "left";
  camera.camera = {640, 480, 900.0, 320.0, 240.0, 0.01};
  record.state.cameras = {camera};
  record.state.covariance = Eigen::MatrixXd::Identity(10, 10);
  record.state.requests = requests;
  return record;
}

// Adds one to the requests of a station, which it makes when it is not there.
absl::StatusOr<StationRecord> Teach(Catalog& catalog, const std::string& id, int events = 0) {
  return catalog.WriteStation(
      id,
      [&](const StationRecord* current,
          std::vector<StationEventRecord>* out) -> absl::StatusOr<StationRecord> {
        StationRecord next = current == nullptr ? Sample() : *current;
        ++next.state.requests;
        for (int i = 0; i < events; ++i)
          out->push_back({1, "t", "r" + std::to_string(i), {"left"}, "moved"});
        return next;
      });
}

TEST_P(StationRows, SurviveReopeningWithAllTheyHold) {
  const std::string place = NewPlace();
  for (const bool create : {true, false}) {
    auto catalog = Open(place);
    if (create) {
      ASSERT_TRUE(Teach(*catalog, "cell", 2).ok());
    }
    const auto read = catalog->GetStation("cell");
    ASSERT_TRUE(read.ok()) << read.status();
    EXPECT_EQ(read->display_name, "press 4");
    EXPECT_EQ(read->state.requests, 1);
    EXPECT_EQ(read->state.covariance, Eigen::MatrixXd::Identity(10, 10));
    const CameraBase& base = read->bases.at("left");
    EXPECT_EQ(base.base_from_camera.t.y(), 2.0);
    EXPECT_EQ(base.rotation_sigma_rad, 0.002);
    EXPECT_EQ(base.position_sigma_m, 0.003);
    EXPECT_TRUE(base.learnt);
    EXPECT_EQ(base.requests, 7);
    const auto events = catalog->StationEvents("cell").value();
    ASSERT_EQ(events.size(), 2u);
    EXPECT_EQ(events[0].request_id, "r1");  // the latest first
    EXPECT_EQ(events[0].camera_ids, std::vector<std::string>{"left"});
  }
}

TEST_P(StationRows, RevisionsAreNeverUsedTwiceAndDoNotCountForTheCatalog) {
  auto catalog = Open(NewPlace());
  const int64_t generation = *catalog->Generation();
  const int64_t first = Teach(*catalog, "cell")->revision;
  const int64_t second = Teach(*catalog, "cell")->revision;
  EXPECT_GT(second, first);
  ASSERT_TRUE(catalog->DeleteStation("cell").ok());
  EXPECT_EQ(catalog->GetStation("cell").status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(catalog->DeleteStation("cell").code(), absl::StatusCode::kNotFound);
  EXPECT_TRUE(catalog->StationEvents("cell")->empty());
  EXPECT_GT(Teach(*catalog, "cell")->revision, second);
  EXPECT_EQ(*catalog->Generation(), generation);
}

TEST_P(StationRows, AFailedChangeChangesNothing) {
  auto catalog = Open(NewPlace());
  const int64_t revision = Teach(*catalog, "cell")->revision;
  const auto failed = catalog->WriteStation(
      "cell",
      [](const StationRecord*,
         std::vector<StationEventRecord>* events) -> absl::StatusOr<StationRecord> {
        events->push_back({});
        return absl::AbortedError("no");
      });
  EXPECT_EQ(failed.status().code(), absl::StatusCode::kAborted);
  EXPECT_EQ(catalog->GetStation("cell")->revision, revision);
  EXPECT_TRUE(catalog->StationEvents("cell")->empty());
  EXPECT_EQ(
      catalog->DeleteStation("cell", [](const auto&) { return absl::AbortedError("no"); }).code(),
      absl::StatusCode::kAborted);
  EXPECT_TRUE(catalog->GetStation("cell").ok());
}

TEST_P(StationRows, OnlyTheLatestEventsAreKept) {
  auto catalog = Open(NewPlace());
  ASSERT_TRUE(Teach(*catalog, "other", 1).ok());
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(Teach(*catalog, "cell", 90).ok());
  EXPECT_EQ(catalog->StationEvents("cell")->size(), static_cast<size_t>(kKeptStationEvents));
  EXPECT_EQ(catalog->StationEvents("other")->size(), 1u);
}

TEST_P(StationRows, AreListedById) {
  auto catalog = Open(NewPlace());
  for (const char* id : {"b", "a", "c"}) ASSERT_TRUE(Teach(*catalog, id).ok());
  const auto page = catalog->ListStations("a", 1);
  ASSERT_EQ(page->size(), 1u);
  EXPECT_EQ((*page)[0].id, "b");
  EXPECT_EQ(catalog->ListStations("", 0).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST_P(StationRows, ConcurrentRequestsAllCount) {
  auto catalog = Open(NewPlace());
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&] {
      for (int i = 0; i < 25; ++i) EXPECT_TRUE(Teach(*catalog, "cell").ok());
    });
  }
  for (std::thread& t : threads) t.join();
  EXPECT_EQ(catalog->GetStation("cell")->state.requests, 100);
}

TEST_P(StationRows, GoWithBackupsAndRestoringMakesTheirRevisionsNew) {
  auto catalog = Open(NewPlace());
  const int64_t before = Teach(*catalog, "cell")->revision;
  ASSERT_TRUE(catalog->Backup(File("copy.db")).ok());
  ASSERT_TRUE(Teach(*catalog, "cell").ok());
  ASSERT_TRUE(catalog->Restore(File("copy.db")).ok());
  const auto restored = catalog->GetStation("cell");
  ASSERT_TRUE(restored.ok());
  EXPECT_EQ(restored->state.requests, 1);
  EXPECT_GT(restored->revision, before + 1);
}

TEST(Stations, DamagedStatesAreFound) {
  const ScratchDir dir;
  {
    auto catalog = Catalog::Open(dir.File("a.db")).value();
    ASSERT_TRUE(Teach(*catalog, "cell").ok());
    EXPECT_TRUE(catalog->Verify()->empty());
  }
  {
    sqlite3* raw = nullptr;
    ASSERT_EQ(sqlite3_open(dir.File("a.db").c_str(), &raw), SQLITE_OK);
    const SqliteHandle db(raw);
    ASSERT_TRUE(Execute(raw, "UPDATE station SET state = x'00'").ok());
  }
  auto catalog = Catalog::Open(dir.File("a.db")).value();
  EXPECT_EQ(catalog->GetStation("cell").status().code(), absl::StatusCode::kDataLoss);
  const auto problems = catalog->Verify();
  ASSERT_EQ(problems->size(), 1u);
  EXPECT_THAT((*problems)[0].what, testing::HasSubstr("station cell"));
  EXPECT_EQ(Teach(*catalog, "cell").status().code(), absl::StatusCode::kDataLoss);
  // It can be removed and made again.
  EXPECT_TRUE(catalog->DeleteStation("cell").ok());
  EXPECT_TRUE(Teach(*catalog, "cell").ok());
}

INSTANTIATE_TEST_SUITE_P(Stores, StationRows, EveryStore(), NameOfStore);

}  // namespace
}  // namespace horopter
