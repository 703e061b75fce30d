// A kill at any moment loses no acknowledged write and leaves nothing half-written.
#include <gtest/gtest.h>
#include <unistd.h>

#include <set>

#include "db/catalog.h"
#include "tests/support/catalog_contract.h"
#include "tests/support/killed_writer.h"
#include "tests/support/sample_record.h"

namespace horopter {
namespace {

std::string IdOf(int number) {
  return "obj_" + std::to_string(number);
}

// Writes object after object and acknowledges n after object n was created. Ends by a kill only.
int WriteUntilKilled(const std::string& path,
                     int first,
                     const KilledWriter::Acknowledge& acknowledge) {
  auto catalog = Catalog::Open(path);
  if (!catalog.ok()) return kWriterCannotOpen;
  for (int n = first;; ++n) {
    if (!(*catalog)->CreateObject(SampleRecord(IdOf(n), n)).ok()) return kWriterRefused;
    acknowledge(n);
  }
}

class CatalogCrash : public CatalogContract {};

TEST_P(CatalogCrash, EveryAcknowledgedWriteIsThereAfterAKill) {
  const std::string path = NewPlace();
  std::set<int> acknowledged;
  int next = 0;
  for (int round = 0; round < 8; ++round) {
    KilledWriter writer([&](const KilledWriter::Acknowledge& acknowledge) {
      return WriteUntilKilled(path, next, acknowledge);
    });
    // After a few acknowledgements the child is somewhere in its next write; the pauses differ from
    // round to round.
    for (int i = 0; i <= round; ++i) {
      const std::optional<int> n = writer.Next();
      ASSERT_TRUE(n.has_value());
      acknowledged.insert(*n);
    }
    usleep(400 * round);
    writer.Kill();
    while (const std::optional<int> n = writer.Next()) acknowledged.insert(*n);
    ASSERT_TRUE(writer.AwaitKilled());

    auto catalog = Catalog::Open(path);
    ASSERT_TRUE(catalog.ok()) << catalog.status();
    for (const int written : acknowledged) {
      const auto record = (*catalog)->GetObject(IdOf(written));
      ASSERT_TRUE(record.ok()) << record.status();
      EXPECT_EQ(FirstDifference(*record, SampleRecord(IdOf(written), written)), "");
    }
    // At most the one write that was under way may be there besides, and then whole.
    const int count = *(*catalog)->CountObjects();
    const int last = *acknowledged.rbegin();
    EXPECT_GE(count, static_cast<int>(acknowledged.size()));
    EXPECT_LE(count, static_cast<int>(acknowledged.size()) + 1);
    next = last + 1;
    if (const auto extra = (*catalog)->GetObject(IdOf(next)); extra.ok()) {
      EXPECT_EQ(FirstDifference(*extra, SampleRecord(IdOf(next), next)), "");
      acknowledged.insert(next);
      ++next;
    }
  }
  EXPECT_GE(acknowledged.size(), 36u);
}

INSTANTIATE_TEST_SUITE_P(Stores, CatalogCrash, EveryStore(), NameOfStore);

}  // namespace
}  // namespace horopter
