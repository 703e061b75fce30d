// Verification with progress, backups that are read on, restoring: over the wire.
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <sqlite3.h>

#include <filesystem>
#include <fstream>

#include "server/base/sha256.h"
#include "tests/support/sample_record.h"
#include "tests/support/scratch_dir.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

class CatalogStreams : public testing::Test {
 protected:
  void SetUp() override {
    Open();
    for (const char* id : {"a", "b", "c"}) ASSERT_TRUE(server_->Enrol(id));
  }
  void Open() { server_ = std::make_unique<TestServer>(Recognizer(), ServerOptions(), path_); }

  struct Verified {
    grpc::Status status;
    v1::VerifyCatalogResponse all;
    std::vector<double> progress;
  };
  Verified Verify() {
    Verified out;
    grpc::ClientContext context;
    v1::VerifyCatalogResponse message;
    const auto reader = server_->catalog().VerifyCatalog(&context, {});
    while (reader->Read(&message)) {
      out.all.MergeFrom(message);
      out.progress.push_back(message.progress());
    }
    out.status = reader->Finish();
    return out;
  }

  struct Copy {
    grpc::Status status;
    std::string bytes, id, sha256;
    int64_t total = 0;
  };
  // At most `most` messages are read, then the call is cancelled.
  Copy Backup(const std::string& id = "", int64_t offset = 0, int most = 1 << 20) {
    Copy out;
    grpc::ClientContext context;
    v1::BackupCatalogRequest request;
    request.set_backup_id(id);
    request.set_offset(offset);
    v1::BackupCatalogResponse message;
    const auto reader = server_->catalog().BackupCatalog(&context, request);
    while (most-- > 0 && reader->Read(&message)) {
      out.bytes += message.chunk();
      out.id = message.backup_id();
      out.sha256 = message.sha256();
      out.total = message.total_bytes();
    }
    if (most < 0) context.TryCancel();
    out.status = reader->Finish();
    return out;
  }

  grpc::Status Restore(const std::string& bytes, const std::string& sha256, int64_t total) {
    grpc::ClientContext context;
    const auto writer = server_->catalog().RestoreCatalog(&context, &restored_);
    v1::RestoreCatalogRequest message;
    message.set_total_bytes(total);
    message.set_sha256(sha256);
    for (size_t at = 0; at < bytes.size(); at += 100'000) {
      message.set_chunk(bytes.substr(at, 100'000));
      if (!writer->Write(message)) break;
      message.Clear();
    }
    writer->WritesDone();
    return writer->Finish();
  }

  int Files() const {
    int count = 0;
    for (const auto& entry : std::filesystem::directory_iterator(dir_.path())) {
      count += entry.exists();
    }
    return count;
  }
  // More than one chunk.
  void EnrolLarge() {
    grpc::ClientContext context;
    v1::CreateObjectRequest request;
    request.set_object_id("large");
    *request.mutable_object() = SampleObject("large");
    request.mutable_object()->mutable_source()->set_content(std::string(3'000'000, 'x'));
    request.mutable_object()->mutable_source()->clear_sha256();
    v1::Object answer;
    ASSERT_TRUE(server_->catalog().CreateObject(&context, request, &answer).ok());
  }

  const ScratchDir dir_;
  const std::string path_ = dir_.File("a.db");
  std::unique_ptr<TestServer> server_;
  v1::RestoreCatalogResponse restored_;
};

TEST_F(CatalogStreams, VerificationTellsProgressToTheEnd) {
  const Verified verified = Verify();
  EXPECT_TRUE(verified.status.ok()) << verified.status.error_message();
  EXPECT_EQ(verified.all.problems_size(), 0);
  EXPECT_EQ(verified.all.objects(), 3);
  ASSERT_FALSE(verified.progress.empty());
  EXPECT_EQ(verified.progress.back(), 1.0);
}

TEST_F(CatalogStreams, DamageIsToldAtTheStartAndByVerification) {
  server_.reset();
  sqlite3* db = nullptr;
  ASSERT_EQ(sqlite3_open(path_.c_str(), &db), SQLITE_OK);
  sqlite3_exec(
      db, "UPDATE vertex SET y = y + 1e-6 WHERE object_id = 'b'", nullptr, nullptr, nullptr);
  sqlite3_close(db);
  Open();
  const Verified verified = Verify();
  EXPECT_TRUE(verified.status.ok());
  ASSERT_EQ(verified.all.problems_size(), 2);  // the file, and that recognition leaves it out
  for (const auto& problem : verified.all.problems()) EXPECT_EQ(problem.name(), "objects/b");
  grpc::ClientContext context;
  v1::GetObjectRequest request;
  request.set_name("objects/b");
  v1::Object object;
  EXPECT_EQ(server_->catalog().GetObject(&context, request, &object).error_code(),
            grpc::StatusCode::DATA_LOSS);
}

TEST_F(CatalogStreams, ACancelledVerificationGivesItsThreadBack) {
  for (int i = 0; i < 10; ++i) {  // more than there are threads and places
    grpc::ClientContext context;
    const auto reader = server_->catalog().VerifyCatalog(&context, {});
    v1::VerifyCatalogResponse message;
    reader->Read(&message);
    context.TryCancel();
    EXPECT_EQ(reader->Finish().error_code(), grpc::StatusCode::CANCELLED);
  }
  EXPECT_TRUE(Verify().status.ok());
}

TEST_F(CatalogStreams, ABackupSaysItsDigestAndLeavesNothingBehind) {
  const int files = Files();
  const Copy copy = Backup();
  EXPECT_TRUE(copy.status.ok()) << copy.status.error_message();
  EXPECT_EQ(static_cast<int64_t>(copy.bytes.size()), copy.total);
  EXPECT_EQ(Sha256Hex(copy.bytes), copy.sha256);
  EXPECT_EQ(Files(), files);
  EXPECT_EQ(Backup(copy.id, 0).status.error_code(), grpc::StatusCode::NOT_FOUND);
}

TEST_F(CatalogStreams, ABrokenOffBackupIsReadOnThoughTheCatalogChanged) {
  EnrolLarge();
  const Copy first = Backup("", 0, 1);
  ASSERT_FALSE(first.bytes.empty());
  ASSERT_LT(static_cast<int64_t>(first.bytes.size()), first.total);
  ASSERT_TRUE(server_->Enrol("d"));
  const Copy rest = Backup(first.id, static_cast<int64_t>(first.bytes.size()));
  EXPECT_TRUE(rest.status.ok()) << rest.status.error_message();
  EXPECT_EQ(Sha256Hex(first.bytes + rest.bytes), first.sha256);
  EXPECT_EQ(Backup("nobody", 0).status.error_code(), grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(Backup("", 7).status.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
}

TEST_F(CatalogStreams, ARestoredCatalogIsWhatWasBackedUp) {
  EnrolLarge();
  const Copy copy = Backup();
  grpc::ClientContext context;
  v1::DeleteObjectRequest request;
  request.set_name("objects/a");
  google::protobuf::Empty empty;
  ASSERT_TRUE(server_->catalog().DeleteObject(&context, request, &empty).ok());
  const grpc::Status status = Restore(copy.bytes, copy.sha256, copy.total);
  EXPECT_TRUE(status.ok()) << status.error_message();
  EXPECT_EQ(restored_.objects(), 4);
  EXPECT_EQ(server_->server().store().Published()->ids.size(), 4u);
  EXPECT_EQ(Verify().all.problems_size(), 0);
  EXPECT_TRUE(server_->Enrol("after"));
}

TEST_F(CatalogStreams, WhatIsNoWholeCatalogIsRefusedAndChangesNothing) {
  const Copy copy = Backup();
  const int files = Files();
  using Code = grpc::StatusCode;
  EXPECT_EQ(Restore(copy.bytes, std::string(64, '0'), copy.total).error_code(),
            Code::INVALID_ARGUMENT);
  EXPECT_EQ(Restore(copy.bytes, copy.sha256, copy.total + 1).error_code(), Code::INVALID_ARGUMENT);
  EXPECT_EQ(Restore(copy.bytes, copy.sha256, 10).error_code(), Code::INVALID_ARGUMENT);
  EXPECT_EQ(Restore("", copy.sha256, 0).error_code(), Code::INVALID_ARGUMENT);
  const std::string text(5000, 'x');
  EXPECT_EQ(Restore(text, Sha256Hex(text), 5000).error_code(), Code::FAILED_PRECONDITION);
  EXPECT_EQ(server_->server().store().Published()->ids.size(), 3u);
  EXPECT_EQ(Files(), files);
}

}  // namespace
}  // namespace horopter
