#include "server/service/recorder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "horopter/v1/recognition.pb.h"
#include "server/base/recording_file.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;

class RecorderTest : public testing::Test {
 protected:
  RecorderTest() {
    request_.add_images()->set_content(std::string(300'000, 'i'));
    response_.set_completeness(v1::COMPLETENESS_COMPLETE);
    record_.request = &request_;
    record_.response = &response_;
    record_.objects = 1;
    record_.state = "RECOGNIZED";
    options_.folder = dir_.File("recordings");
  }

  std::unique_ptr<Recorder> Open() {
    auto recorder = Recorder::Open(options_, "1.2.3", "cores=2");
    EXPECT_TRUE(recorder.ok()) << recorder.status();
    return *std::move(recorder);
  }
  Recorder::Outcome Record(Recorder& recorder) {
    record_.request_id = absl::StrCat("id-", ++number_);
    record_.arrival = std::chrono::system_clock::time_point(std::chrono::seconds(number_));
    return recorder.Record(record_);
  }
  std::vector<fs::path> Files() const {
    std::vector<fs::path> files;
    for (const auto& entry : fs::directory_iterator(options_.folder)) files.push_back(entry.path());
    std::sort(files.begin(), files.end());
    return files;
  }
  static std::string Bytes(const fs::path& path) {
    std::ostringstream bytes;
    bytes << std::ifstream(path, std::ios::binary).rdbuf();
    return bytes.str();
  }

  const ScratchDir dir_;
  RecorderOptions options_;
  v1::RecognizeSceneRequest request_;
  v1::RecognizeSceneResponse response_;
  RequestRecord record_;
  int number_ = 0;
};

TEST_F(RecorderTest, AFileHoldsRequestAnswerAndServer) {
  options_.sample = 1.0;
  const auto recorder = Open();
  ASSERT_EQ(Record(*recorder), Recorder::Outcome::kWritten);
  ASSERT_EQ(Files().size(), 1u);
  const auto file = DecodeRecording(Bytes(Files()[0]));
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->request, request_.SerializeAsString());
  EXPECT_EQ(file->response, response_.SerializeAsString());
  const auto about = nlohmann::json::parse(file->about);
  EXPECT_EQ(about["request_id"], "id-1");
  EXPECT_EQ(about["server_version"], "1.2.3");
  EXPECT_EQ(about["settings"], "cores=2");
  EXPECT_EQ(about["code"], "OK");
}

TEST_F(RecorderTest, ByDefaultOnlyWhatFailedIsKept) {
  const auto recorder = Open();
  EXPECT_EQ(Record(*recorder), Recorder::Outcome::kNotWanted);
  record_.objects = 0;
  EXPECT_EQ(Record(*recorder), Recorder::Outcome::kWritten);
  record_.status = absl::InvalidArgumentError("bad");
  EXPECT_EQ(Record(*recorder), Recorder::Outcome::kWritten);
  EXPECT_EQ(DecodeRecording(Bytes(Files()[1]))->response, "");
  record_.status = absl::ResourceExhaustedError("full");
  record_.busy = true;
  EXPECT_EQ(Record(*recorder), Recorder::Outcome::kNotWanted);
  record_.request = nullptr;  // a call of the catalog
  EXPECT_EQ(Record(*recorder), Recorder::Outcome::kNotWanted);
}

TEST_F(RecorderTest, ASampleIsAboutItsShare) {
  request_.clear_images();
  options_.sample = 0.3;
  const auto recorder = Open();
  int written = 0;
  for (int i = 0; i < 300; ++i) written += Record(*recorder) == Recorder::Outcome::kWritten;
  EXPECT_GT(written, 50);
  EXPECT_LT(written, 140);
}

TEST_F(RecorderTest, TheFolderStaysBelowItsSizeAndTheOldestGo) {
  options_.sample = 1.0;
  options_.max_mb = 1;
  const auto recorder = Open();
  for (int i = 0; i < 10; ++i) EXPECT_EQ(Record(*recorder), Recorder::Outcome::kWritten);
  const auto files = Files();
  EXPECT_EQ(files.size(), 3u);
  EXPECT_THAT(files.back().string(), testing::HasSubstr("id-10"));
  // What is larger than all is not kept, and costs nobody else his place.
  request_.mutable_images(0)->set_content(std::string(2'000'000, 'i'));
  EXPECT_EQ(Record(*recorder), Recorder::Outcome::kFailed);
  EXPECT_EQ(Files().size(), 3u);
}

TEST_F(RecorderTest, WhatIsTooOldGoes) {
  options_.sample = 1.0;
  options_.max_age_hours = 1.0;
  const auto recorder = Open();
  Record(*recorder);
  fs::last_write_time(Files()[0], fs::file_time_type::clock::now() - std::chrono::hours(2));
  Record(*recorder);
  ASSERT_EQ(Files().size(), 1u);
  EXPECT_THAT(Files()[0].string(), testing::HasSubstr("id-2"));
}

TEST_F(RecorderTest, AClockThatWasSetBackDrivesOutNoNewRecording) {
  options_.sample = 1.0;
  options_.max_mb = 1;
  const auto recorder = Open();
  for (int i = 0; i < 2; ++i) Record(*recorder);
  const auto now = fs::file_time_type::clock::now();
  for (const fs::path& file : Files())
    fs::last_write_time(file, now + std::chrono::hours(24 * 365));
  for (int i = 0; i < 4; ++i) Record(*recorder);
  ASSERT_EQ(Files().size(), 3u);
  for (const char* id : {"id-4.", "id-5.", "id-6."}) {
    const auto files = Files();
    EXPECT_TRUE(std::any_of(files.begin(), files.end(), [&](const fs::path& file) {
      return file.string().find(id) != std::string::npos;
    })) << id;
  }
  // What is left of the future hides nothing from age.
  options_.max_age_hours = 1.0;
  fs::last_write_time(Files()[0], now + std::chrono::hours(24));
  fs::last_write_time(Files()[1], now - std::chrono::hours(2));
  const fs::path old = Files()[1];
  record_.request = &response_;  // small
  Record(*Open());
  EXPECT_FALSE(fs::exists(old));
}

TEST_F(RecorderTest, AFullDiskLosesTheRecordingAndLeavesNoPart) {
  options_.sample = 1.0;
  const auto recorder = Open();
  ::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  ::getrlimit(RLIMIT_FSIZE, &before);
  rlimit tight = before;
  tight.rlim_cur = 100'000;
  ::setrlimit(RLIMIT_FSIZE, &tight);
  const Recorder::Outcome full = Record(*recorder);
  ::setrlimit(RLIMIT_FSIZE, &before);
  EXPECT_EQ(full, Recorder::Outcome::kFailed);
  EXPECT_TRUE(Files().empty());
  EXPECT_EQ(Record(*recorder), Recorder::Outcome::kWritten);
}

TEST_F(RecorderTest, OptionsThatMakeNoSenseAreRefused) {
  options_.sample = 1.5;
  EXPECT_TRUE(absl::IsInvalidArgument(Recorder::Open(options_, "", "").status()));
  options_.sample = 0.5;
  options_.max_mb = 0;
  EXPECT_TRUE(absl::IsInvalidArgument(Recorder::Open(options_, "", "").status()));
  options_.max_mb = 10;
  options_.folder = "/proc/nowhere";
  EXPECT_TRUE(absl::IsPermissionDenied(Recorder::Open(options_, "", "").status()));
}

TEST(RecordingFileTest, AnyDamageIsNoticed) {
  const std::string bytes = EncodeRecording({"{}", "request", "response"});
  const auto whole = DecodeRecording(bytes);
  ASSERT_TRUE(whole.ok());
  EXPECT_EQ(whole->request, "request");
  for (size_t n = 0; n < bytes.size(); ++n) {
    EXPECT_FALSE(DecodeRecording(bytes.substr(0, n)).ok()) << n;
    std::string flipped = bytes;
    flipped[n] = static_cast<char>(flipped[n] ^ 1);
    EXPECT_FALSE(DecodeRecording(flipped).ok()) << n;
  }
  EXPECT_FALSE(DecodeRecording(bytes + "x").ok());
  std::string newer = bytes;
  newer[7] = '2';
  EXPECT_THAT(std::string(DecodeRecording(newer).status().message()),
              testing::HasSubstr("another version"));
}

}  // namespace
}  // namespace horopter
