// A kill at any moment loses no acknowledged write and leaves nothing half-written.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <set>

#include "db/catalog.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

std::string IdOf(int number) {
  return "obj_" + std::to_string(number);
}

// Writes object after object and acknowledges each through the pipe: n after object n was created.
// Never returns.
[[noreturn]] void WriteUntilKilled(const std::string& path, int first, int acknowledge) {
  auto catalog = Catalog::Open(path);
  if (!catalog.ok()) _exit(3);
  for (int n = first;; ++n) {
    if (!(*catalog)->CreateObject(SampleRecord(IdOf(n), n)).ok()) _exit(4);
    if (write(acknowledge, &n, sizeof(n)) != sizeof(n)) _exit(5);
  }
}

TEST(CatalogCrash, EveryAcknowledgedWriteIsThereAfterAKill) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  std::set<int> acknowledged;
  int next = 0;
  for (int round = 0; round < 8; ++round) {
    int ends[2];
    ASSERT_EQ(pipe(ends), 0);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      close(ends[0]);
      WriteUntilKilled(path, next, ends[1]);
    }
    close(ends[1]);
    // After a few acknowledgements the child is somewhere in its next write; the pauses differ from
    // round to round.
    int n = 0;
    for (int i = 0; i <= round; ++i) {
      ASSERT_EQ(read(ends[0], &n, sizeof(n)), static_cast<ssize_t>(sizeof(n)));
      acknowledged.insert(n);
    }
    usleep(400 * round);
    kill(child, SIGKILL);
    while (read(ends[0], &n, sizeof(n)) == static_cast<ssize_t>(sizeof(n))) acknowledged.insert(n);
    close(ends[0]);
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status)) << "child ended by itself: " << WEXITSTATUS(status);

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

}  // namespace
}  // namespace horopter
