// A disk that fills up and pages that rot.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>
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

// A whole disk of 2 MiB; skips where nobody may mount one.
class SmallDisk {
 public:
  SmallDisk() : folder_(dir_.File("small")) {
    std::filesystem::create_directory(folder_);
    mounted_ = mount("tmpfs", folder_.c_str(), "tmpfs", 0, "size=2m") == 0;
  }
  ~SmallDisk() {
    if (mounted_) umount2(folder_.c_str(), MNT_DETACH);
  }
  bool mounted() const { return mounted_; }
  std::string File(const std::string& name) const { return folder_ + "/" + name; }

  // What is left goes to another file, to the last byte.
  void FillUp() const {
    std::ofstream other(File("other"), std::ios::binary | std::ios::app);
    while (other.put('x') && other.flush()) continue;
  }

 private:
  const ScratchDir dir_;
  const std::string folder_;
  bool mounted_ = false;
};

TEST(CatalogDiskTest, AFullDiskLetsObjectsBeRemovedAndOthersTakeTheirPlace) {
  const SmallDisk disk;
  if (!disk.mounted()) GTEST_SKIP() << "needs the right to mount a small file system";
  int written = 0;
  {
    auto catalog = Catalog::Open(disk.File("a.db")).value();
    while (written < 1000 && catalog->CreateObject(BigRecord(written)).ok()) ++written;
    ASSERT_GT(written, 4);
    disk.FillUp();
    for (int n = 0; n < 2; ++n) {
      const absl::Status removed = catalog->DeleteObject(IdOf(n));
      EXPECT_TRUE(removed.ok()) << n << ": " << removed;
    }
    EXPECT_EQ(catalog->CountObjects().value(), written - 2);
  }
  // The next server finds the disk full from its start.
  disk.FillUp();
  auto catalog = Catalog::Open(disk.File("a.db"));
  ASSERT_TRUE(catalog.ok()) << catalog.status();
  EXPECT_EQ((*catalog)->CountObjects().value(), written - 2);
  EXPECT_TRUE((*catalog)->Verify().value().empty());
  EXPECT_TRUE((*catalog)->DeleteObject(IdOf(3)).ok());
}

TEST(CatalogDiskTest, TheReserveLeavesNothingBehindWhereThereIsRoom) {
  const ScratchDir dir;
  {
    auto catalog = Catalog::Open(dir.File("a.db")).value();
    EXPECT_TRUE(std::filesystem::exists(dir.File("a.db-reserve")));
  }
  EXPECT_FALSE(std::filesystem::exists(dir.File("a.db-reserve")));
}

TEST(FileStateTest, ACopyWithoutItsLogIsNoticed) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db"), copy = dir.File("copy.db");
  auto catalog = Catalog::Open(path).value();
  ASSERT_TRUE(catalog->CreateObject(BigRecord(1)).ok());
  std::filesystem::copy_file(path, copy);
  const absl::Status refused = Catalog::Open(copy).status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kDataLoss) << refused;
  for (const char* says : {"copy.db-wal", "backup", "--accept-unclosed-db"}) {
    EXPECT_THAT(std::string(refused.message()), HasSubstr(says));
  }
  EXPECT_EQ(Catalog::Open(copy).status().code(), absl::StatusCode::kDataLoss) << "asked again";
  EXPECT_EQ(catalog->Restore(copy).code(), absl::StatusCode::kDataLoss);
  // With its log it is whole.
  const std::string both = dir.File("both.db");
  for (const char* suffix : {"", "-wal"}) std::filesystem::copy_file(path + suffix, both + suffix);
  EXPECT_EQ(Catalog::Open(both).value()->CountObjects().value(), 1);
  // Once accepted it is a catalog like any other.
  EXPECT_TRUE(Catalog::Open(copy, {.accept_unclosed = true}).ok());
  EXPECT_TRUE(Catalog::Open(copy).ok());
}

TEST(FileStateTest, FilesThatWereClosedAndBackupsAreCopiedFreely) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  {
    auto catalog = Catalog::Open(path).value();
    ASSERT_TRUE(catalog->CreateObject(BigRecord(1)).ok());
    ASSERT_TRUE(catalog->Backup(dir.File("backup.db")).ok());
    ASSERT_TRUE(catalog->Restore(dir.File("backup.db")).ok());
    // After a restore the file is one that is open.
    std::filesystem::copy_file(path, dir.File("restored.db"));
    EXPECT_EQ(Catalog::Open(dir.File("restored.db")).status().code(), absl::StatusCode::kDataLoss);
  }
  std::filesystem::copy_file(path, dir.File("copy.db"));
  for (const char* name : {"a.db", "copy.db", "backup.db"}) {
    const auto catalog = Catalog::Open(dir.File(name));
    ASSERT_TRUE(catalog.ok()) << catalog.status();
    EXPECT_EQ((*catalog)->CountObjects().value(), 1);
  }
}

TEST(FileStateTest, ObjectsThatAreGoneWithoutARemovalAreMissed) {
  const ScratchDir dir;
  const std::string path = dir.File("a.db");
  {
    auto catalog = Catalog::Open(path).value();
    for (int n = 0; n < 3; ++n) ASSERT_TRUE(catalog->CreateObject(BigRecord(n)).ok());
    ASSERT_TRUE(catalog->DeleteObject(IdOf(0)).ok());
  }
  EXPECT_TRUE(Catalog::Open(path).ok());
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &db), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(db, "UPDATE file_state SET object_count = 3", nullptr, nullptr, nullptr),
            SQLITE_OK);
  sqlite3_close(db);
  const absl::Status refused = Catalog::Open(path).status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(std::string(refused.message()), HasSubstr("holds 2 objects where 3 were written"));
  EXPECT_TRUE(Catalog::Open(path, {.accept_unclosed = true}).ok());
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
  // Tables of derived data, of former versions, of prints, of remembered requests and of stations,
  // their indexes.
  EXPECT_LE(harmless, 17);
}

}  // namespace
}  // namespace horopter
