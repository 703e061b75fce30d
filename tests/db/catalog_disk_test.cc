// A disk that fills up and pages that rot.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mount.h>

#include <filesystem>
#include <fstream>

#include "db/catalog.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

using testing::HasSubstr;

std::string IdOf(int number) {
  return "obj_" + std::to_string(number);
}

CatalogRecord BigRecord(int n) {
  CatalogRecord record = SampleRecord(IdOf(n), n);
  record.source.content.assign(50'000, static_cast<char>('a' + n % 26));
  record.source.sha256.clear();
  return record;
}

// Enrols until a write fails, then checks that exactly the acknowledged ones are there.
void Fill(const std::string& path) {
  auto catalog = Catalog::Open(path);
  ASSERT_TRUE(catalog.ok()) << catalog.status();
  int written = 0;
  absl::Status status;
  while (written < 1000) {
    status = (*catalog)->CreateObject(BigRecord(written));
    if (!status.ok()) break;
    ++written;
  }
  ASSERT_GT(written, 0);
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted) << status;
  EXPECT_EQ((*catalog)->CountObjects().value(), written);
  EXPECT_FALSE((*catalog)->GetObject(IdOf(written)).ok());
  EXPECT_TRUE((*catalog)->GetObject(IdOf(written - 1)).ok());
}

TEST(CatalogDiskTest, AFullDiskRefusesTheWriteAndKeepsTheRest) {
  const ScratchDir dir;
  const std::string folder = dir.File("small");
  std::filesystem::create_directory(folder);
  if (mount("tmpfs", folder.c_str(), "tmpfs", 0, "size=2m") != 0) {
    GTEST_SKIP() << "needs the right to mount a small file system";
  }
  Fill(folder + "/a.db");
  umount2(folder.c_str(), MNT_DETACH);
}

TEST(CatalogDiskTest, AFullDiskNeverLeavesHalfAnObject) {
  const ScratchDir dir;
  const std::string folder = dir.File("small");
  std::filesystem::create_directory(folder);
  if (mount("tmpfs", folder.c_str(), "tmpfs", 0, "size=2m") != 0) {
    GTEST_SKIP() << "needs the right to mount a small file system";
  }
  int written = 0;
  {
    auto catalog = Catalog::Open(folder + "/a.db").value();
    while (written < 1000 && catalog->CreateObject(BigRecord(written)).ok()) ++written;
  }
  {
    // With its log, which a full disk may have kept from being merged.
    for (const char* suffix : {"", "-wal"}) {
      if (std::filesystem::exists(folder + "/a.db" + suffix)) {
        std::filesystem::copy_file(folder + "/a.db" + suffix, dir.File("copy.db") + suffix);
      }
    }
    auto catalog = Catalog::Open(dir.File("copy.db"));
    ASSERT_TRUE(catalog.ok()) << catalog.status();
    EXPECT_EQ((*catalog)->CountObjects().value(), written);
    EXPECT_TRUE((*catalog)->Verify().value().empty());
  }
  umount2(folder.c_str(), MNT_DETACH);
}

TEST(CatalogDiskTest, RottenPagesAreFoundAtStartWithAdviceOrServeTheRest) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  std::vector<CatalogRecord> stored;
  {
    auto catalog = Catalog::Open(path).value();
    for (int n = 0; n < 10; ++n) {
      ASSERT_TRUE(catalog->CreateObject(BigRecord(n)).ok());
      stored.push_back(catalog->GetObject(IdOf(n)).value());
    }
  }
  const auto pages = std::filesystem::file_size(path) / 4096;
  int refused = 0, found = 0, harmless = 0;
  for (size_t page = 0; page < pages; ++page) {
    const std::string damaged = dir.File("damaged.db");
    std::filesystem::copy_file(path, damaged, std::filesystem::copy_options::overwrite_existing);
    {
      std::fstream file(damaged, std::ios::in | std::ios::out | std::ios::binary);
      file.seekp(static_cast<std::streamoff>(page * 4096 + 8));
      file << std::string(4000, '\x5a');
    }
    auto catalog = Catalog::Open(damaged);
    if (!catalog.ok()) {
      ++refused;
      const std::string message(catalog.status().message());
      EXPECT_THAT(message, HasSubstr(damaged));
      if (absl::IsDataLoss(catalog.status())) {
        EXPECT_THAT(message, HasSubstr("backup"));
      }
      continue;
    }
    // Inside a blob SQLite cannot see it; verification does, by hash and layout.
    const auto problems = (*catalog)->Verify();
    if (!problems.ok() || !problems->empty()) {
      ++found;
      continue;
    }
    // Only pages that hold nothing (of empty tables) may go unnoticed.
    ++harmless;
    for (int n = 0; n < 10; ++n) {
      const auto record = (*catalog)->GetObject(IdOf(n));
      ASSERT_TRUE(record.ok()) << "page " << page << ": " << record.status();
      EXPECT_EQ(FirstDifference(*record, stored[n]), "") << "page " << page;
      EXPECT_EQ((*catalog)->GetCadFile(IdOf(n)).value(), BigRecord(n).source.content);
    }
  }
  std::printf("%zu pages: %d refused at start, %d found by verify, %d hold nothing\n",
              static_cast<size_t>(pages),
              refused,
              found,
              harmless);
  EXPECT_GT(refused, 0);
  EXPECT_GT(found, 0);
  // Tables of derived data, of remembered requests and of stations, their indexes.
  EXPECT_LE(harmless, 11);
}

}  // namespace
}  // namespace horopter
