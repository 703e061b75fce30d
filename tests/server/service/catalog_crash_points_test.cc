// SIGKILL at every named point of a write, again and again on one file: what was acknowledged is
// there, nothing is there by half, and what recognition would use equals the file.
#include <gtest/gtest.h>

#include <cstring>
#include <map>
#include <random>
#include <string>

#include "server/base/crash_point.h"
#include "server/service/catalog_store.h"
#include "tests/support/catalog_contract.h"
#include "tests/support/fake_objects.h"
#include "tests/support/killed_writer.h"
#include "tests/support/sample_record.h"

namespace horopter {
namespace {

constexpr const char* kPoints[] = {"transaction.begun",
                                   "transaction.before_commit",
                                   "transaction.after_commit",
                                   "store.before_publish",
                                   "store.after_publish"};

const char* kill_at = nullptr;
int kill_after = 0;  // times the point is passed before the kill

void KillAtPoint(const char* point) {
  if (std::strcmp(point, kill_at) == 0 && kill_after-- == 0) kill(getpid(), SIGKILL);
}

enum class Write : int { kCreate, kUpdate, kDelete };

struct Operation {
  Write write = Write::kCreate;
  int object = 0;
  int seed = 0;  // of the content written
};

std::string IdOf(int object) {
  return "obj_" + std::to_string(object);
}

// The same sequence in parent and child: object n is created, then changed or removed later on.
Operation OperationAt(int index) {
  const int object = index / 3;
  if (index % 3 == 0) return {Write::kCreate, object, 1000 + index};
  if (index % 3 == 1) return {Write::kUpdate, object, 2000 + index};
  return object % 2 == 0 ? Operation{Write::kDelete, object, 0}
                         : Operation{Write::kUpdate, object, 3000 + index};
}

absl::Status Apply(CatalogStore& store, const Operation& op) {
  const CatalogRecord record = SampleRecord(IdOf(op.object), op.seed);
  switch (op.write) {
    case Write::kCreate:
      return store.Create(record);
    case Write::kUpdate:
      return store.Update(record.model.id,
                          {true, true, true, true, true, true},
                          [&](CatalogRecord) -> absl::StatusOr<CatalogRecord> { return record; });
    case Write::kDelete:
      return store.Delete(record.model.id);
  }
  return absl::InternalError("no such write");
}

absl::StatusOr<std::unique_ptr<CatalogStore>> OpenStore(const std::string& path) {
  absl::StatusOr<std::unique_ptr<Catalog>> catalog = Catalog::Open(path);
  if (!catalog.ok()) return catalog.status();
  return CatalogStore::Load(*std::move(catalog), FakePreparer());
}

int WriteUntilKilled(const std::string& path,
                     int first,
                     const KilledWriter::Acknowledge& acknowledge) {
  auto store = OpenStore(path);
  if (!store.ok()) return kWriterCannotOpen;
  crash_hook = KillAtPoint;
  for (int index = first; index < first + 40; ++index) {
    if (!Apply(**store, OperationAt(index)).ok()) return kWriterRefused;
    acknowledge(index);
  }
  return kWriterFinished;  // the point was never passed
}

class CatalogCrashPoints : public CatalogContract {};

TEST_P(CatalogCrashPoints, KillsLoseNothing) {
  const std::string path = NewPlace();
  // A process with a connection to make costs more than one with a file.
  const int rounds = GetParam() == CatalogKind::kSqlite ? 210 : 15;
  std::mt19937 rng(1);
  std::map<std::string, int> expected;  // id -> seed of its content
  int next = 0, kills = 0;
  const auto perform = [&](int index) {
    const Operation op = OperationAt(index);
    if (op.write == Write::kDelete) {
      expected.erase(IdOf(op.object));
    } else {
      expected[IdOf(op.object)] = op.seed;
    }
  };
  for (int round = 0; round < rounds; ++round) {
    kill_at = kPoints[round % std::size(kPoints)];
    kill_after = static_cast<int>(rng() % 4);
    KilledWriter writer([&](const KilledWriter::Acknowledge& acknowledge) {
      return WriteUntilKilled(path, next, acknowledge);
    });
    while (const std::optional<int> acknowledged = writer.Next()) {
      perform(*acknowledged);
      next = *acknowledged + 1;
    }
    ASSERT_TRUE(writer.AwaitKilled()) << kill_at;
    ++kills;

    auto store = OpenStore(path);
    ASSERT_TRUE(store.ok()) << kill_at << ": " << store.status();
    Catalog& catalog = (*store)->catalog();
    // The write under way may be there too, as a whole; then it counts as done.
    const Operation op = OperationAt(next);
    const auto last = catalog.GetObject(IdOf(op.object));
    const bool done =
        op.write == Write::kDelete
            ? !last.ok()
            : last.ok() && FirstDifference(*last, SampleRecord(IdOf(op.object), op.seed)).empty();
    const bool committed = std::string(kill_at).rfind("store.", 0) == 0 ||
                           std::string(kill_at) == "transaction.after_commit";
    EXPECT_EQ(done, committed) << kill_at;
    if (done) perform(next++);

    ASSERT_EQ(catalog.CountObjects().value(), static_cast<int>(expected.size())) << kill_at;
    for (const auto& [id, seed] : expected) {
      if (round % 10 != 0 && id != IdOf(op.object)) continue;  // all of them now and then
      const auto record = catalog.GetObject(id);
      ASSERT_TRUE(record.ok()) << kill_at << ": " << record.status();
      EXPECT_EQ(FirstDifference(*record, SampleRecord(id, seed)), "") << kill_at;
    }
    if (round % 10 == 0) {
      EXPECT_TRUE(catalog.Verify().value().empty()) << kill_at;
    }
    const auto published = (*store)->Published();
    ASSERT_EQ(published->ids.size(), expected.size());
    for (const std::string& id : published->ids) EXPECT_EQ(expected.count(id), 1u) << id;
    EXPECT_EQ((*store)->load_report().prepared, 0) << kill_at << ": derived data lost";
    EXPECT_TRUE((*store)->CheckIndex().ok()) << kill_at;
  }
  EXPECT_EQ(kills, rounds);
}

INSTANTIATE_TEST_SUITE_P(Stores, CatalogCrashPoints, EveryStore(), NameOfStore);

}  // namespace
}  // namespace horopter
