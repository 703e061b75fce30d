// The cores of a request, and what throws on them, through the whole pipeline.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <mutex>
#include <new>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <set>
#include <stdexcept>
#include <thread>

#include "client/bop_dataset.h"
#include "client/cad_import.h"
#include "server/base/parallel_for.h"
#include "server/pipeline/pipeline.h"

namespace horopter {
namespace {

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";
constexpr int kScene = 5;
constexpr int kThreads = 3;  // of a request, where more than one
const bool sized = SetPoolThreads(4);

class RequestThreads : public testing::Test {
 protected:
  // The images of a scene and the parts in it.
  static void SetUpTestSuite() {
    ASSERT_TRUE(sized);
    const BopDataset dataset = ReadBopDataset(kDataset).value();
    const BopScene scene = ReadBopScene(kDataset, "val", kScene).value();
    for (const BopObject& object : dataset.objects) {
      if (object.obj_id != scene.images[0].instances[0].obj_id) continue;
      CadImport cad = ImportCad(object.cad_path).value();
      cad.model.id = "part";
      catalog_.objects.push_back(PrepareCatalogObject(std::move(cad.model)).value());
    }
    for (const BopImage& image : scene.images) {
      request_.images.push_back(cv::imread(image.path, cv::IMREAD_COLOR));
      ASSERT_FALSE(request_.images.back().empty());
    }
  }
  static void TearDownTestSuite() {
    catalog_ = {};
    request_ = {};
  }

  static absl::StatusOr<PipelineResult> Recognize(int threads,
                                                  const StopRequested& stop = {},
                                                  double effort = 0.0) {
    PipelineOptions options;
    options.threads = threads;
    options.recognition.effort = effort;
    return RecognizeScene(request_, catalog_, options, stop);
  }

  // Status of a request on several threads whose stop callback throws `error` from its `first` call
  // on, or, if `helpers_only`, from the first later one outside of the caller's thread.
  template <typename Error>
  static absl::Status Failing(const Error& error, int first, bool helpers_only = false) {
    const std::thread::id caller = std::this_thread::get_id();
    std::atomic<int> calls{0};
    return Recognize(kThreads,
                     [&] {
                       const bool mine = std::this_thread::get_id() == caller;
                       if (++calls >= first && !(helpers_only && mine)) throw error;
                       return false;
                     })
        .status();
  }

  static SceneRequest request_;
  static CatalogSnapshot catalog_;
};

SceneRequest RequestThreads::request_;
CatalogSnapshot RequestThreads::catalog_;

// Where the parts and cameras are, to the last bit.
std::vector<double> Numbers(const SceneAnswer& answer) {
  std::vector<double> numbers;
  const auto add = [&](const Rigid3& pose) {
    numbers.insert(numbers.end(), pose.R.data(), pose.R.data() + 9);
    numbers.insert(numbers.end(), pose.t.data(), pose.t.data() + 3);
  };
  for (const auto& object : answer.objects) {
    add(object.scene_from_object);
    numbers.push_back(object.score);
  }
  for (const auto& camera : answer.cameras) {
    numbers.push_back(camera ? camera->camera.focal_px : 0.0);
    if (camera) add(camera->camera_from_scene);
  }
  return numbers;
}

TEST_F(RequestThreads, OneThreadIsTheCallersInEveryStage) {
  std::mutex mutex;
  std::set<std::thread::id> threads;
  const auto result = Recognize(1, [&] {
    const std::lock_guard lock(mutex);
    threads.insert(std::this_thread::get_id());
    return false;
  });
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_FALSE(result->answer.objects.empty()) << ReasonsText(result->answer);
  EXPECT_EQ(threads, std::set{std::this_thread::get_id()});
}

TEST_F(RequestThreads, AreUsedAndNeverExceededAndTheAnswerIsTheSame) {
  const auto one = Recognize(1);
  ASSERT_TRUE(one.ok()) << one.status();
  ASSERT_FALSE(one->answer.objects.empty()) << ReasonsText(one->answer);
  for (const int threads : {2, 4}) {
    std::atomic<int> now{0}, most{0}, helped{0};
    const std::thread::id caller = std::this_thread::get_id();
    const auto several = Recognize(threads, [&] {
      const int inside = ++now;
      int known = most;
      while (inside > known && !most.compare_exchange_weak(known, inside)) {
      }
      helped += std::this_thread::get_id() != caller;
      std::this_thread::yield();
      --now;
      return false;
    });
    ASSERT_TRUE(several.ok()) << several.status();
    EXPECT_LE(most, threads);
    EXPECT_GT(helped, 0);
    EXPECT_EQ(Numbers(several->answer), Numbers(one->answer)) << threads << " threads";
  }
}

// Less than what it takes: what was found by then, told to be that, and the same on any machine.
TEST_F(RequestThreads, LimitedEffortGivesTheSameAnswerAndSaysSo) {
  const auto one = Recognize(1, {}, 2.0);
  ASSERT_TRUE(one.ok()) << one.status();
  EXPECT_TRUE(one->answer.time_limited);
  ASSERT_EQ(one->answer.unsearched.size(), 1u);
  EXPECT_EQ(one->answer.unsearched[0].step, "aspect_search");
  const auto four = Recognize(4, {}, 2.0);
  ASSERT_TRUE(four.ok()) << four.status();
  EXPECT_EQ(Numbers(four->answer), Numbers(one->answer));
  const auto whole = Recognize(4, {}, 1e6);
  ASSERT_TRUE(whole.ok()) << whole.status();
  EXPECT_FALSE(whole->answer.time_limited);
  EXPECT_EQ(Numbers(whole->answer), Numbers(Recognize(4)->answer));
  EXPECT_EQ(Recognize(1, {}, -1.0).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST_F(RequestThreads, OneValueReachesEveryStage) {
  PipelineOptions options;
  options.threads = 7;
  options.recognition.threads = options.matching.threads = options.euclidean.threads = 3;
  options.recognition.focal_start_widths = 1.1;
  const PipelineOptions resolved = ResolveOptions(options);
  EXPECT_EQ(resolved.threads, 7);
  EXPECT_EQ(resolved.matching.threads, 7);
  EXPECT_EQ(resolved.recognition.threads, 7);
  EXPECT_EQ(resolved.euclidean.threads, 7);
  EXPECT_EQ(resolved.euclidean.focal_start_widths, 1.1);
  const absl::Status none = Recognize(0).status();
  EXPECT_EQ(none.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(none.message()), testing::HasSubstr("threads"));
}

// A prior that nothing moves: the euclidean stage begins where recognition was told to.
TEST_F(RequestThreads, TheStartOfTheFocalLengthReachesTheLastStage) {
  PipelineOptions options;
  options.recognition.focal_start_widths = 1000.0 / request_.images[0].cols;
  options.euclidean.focal_log_sigma = 1e-6;
  const auto result = RecognizeScene(request_, catalog_, options);
  ASSERT_TRUE(result.ok()) << result.status();
  ASSERT_FALSE(result->answer.objects.empty()) << ReasonsText(result->answer);
  for (const auto& camera : result->answer.cameras) {
    ASSERT_TRUE(camera);
    EXPECT_NEAR(camera->camera.focal_px, 1000.0, 1.0);
  }
}

// Without them focal lengths and depths are worse, though the answer looks as good.
TEST_F(RequestThreads, MatchesOfThePlaneReachTheLastStage) {
  const auto result = Recognize(kThreads);
  ASSERT_TRUE(result.ok()) << result.status();
  ASSERT_TRUE(result->trace.metric);
  EXPECT_GT(result->trace.metric->counts.at("plane_cells"), 0.0);
}

TEST_F(RequestThreads, WhatIsThrownAnywhereIsTheStatusOfTheRequest) {
  std::atomic<int> calls{0};
  const auto before = Recognize(kThreads, [&] {
    ++calls;
    return false;
  });
  ASSERT_TRUE(before.ok()) << before.status();
  // From the first loop to the last stage; fewer calls are made when some are left out.
  for (const double share : {0.0, 0.1, 0.4, 0.7, 0.95}) {
    SCOPED_TRACE(share);
    const absl::Status status = Failing(std::bad_alloc(), 1 + static_cast<int>(share * calls));
    EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted) << status;
  }
  EXPECT_EQ(Failing(std::bad_alloc(), 1, true).code(), absl::StatusCode::kResourceExhausted);
  const auto after = Recognize(kThreads);
  ASSERT_TRUE(after.ok()) << after.status();
  EXPECT_EQ(Numbers(after->answer), Numbers(before->answer));
}

TEST_F(RequestThreads, ExceptionsOfLibrariesAreTold) {
  const absl::Status memory =
      Failing(cv::Exception(cv::Error::StsNoMem, "Failed to allocate", "f", "alloc.cpp", 1), 1);
  EXPECT_EQ(memory.code(), absl::StatusCode::kResourceExhausted) << memory;
  const absl::Status argument =
      Failing(cv::Exception(cv::Error::StsBadArg, "odd kernel", "f", "filter.cpp", 1), 1);
  EXPECT_EQ(argument.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(argument.message()), testing::HasSubstr("odd kernel"));
  const absl::Status other = Failing(std::runtime_error("boom"), 1);
  EXPECT_EQ(other.code(), absl::StatusCode::kInternal);
  EXPECT_EQ(other.message(), "boom");
  EXPECT_EQ(Failing(42, 1).code(), absl::StatusCode::kInternal);
}

}  // namespace
}  // namespace horopter
