// Memory that runs out anywhere in a request is a status of that request.
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <new>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "horopter/v1/recognition.pb.h"
#include "server/pipeline/exception_status.h"
#include "server/service/recognition_service.h"
#include "tests/support/fake_objects.h"
#include "tests/support/sample_record.h"

namespace {

// Allocations of the process, on any thread, until the one that fails; negative: none does.
std::atomic<int64_t> allocations_left{-1};
// Smaller ones neither count nor fail.
std::atomic<std::size_t> smallest{0};

void* Allocate(std::size_t size) {
  if (size >= smallest.load(std::memory_order_relaxed) &&
      allocations_left.load(std::memory_order_relaxed) >= 0 &&
      allocations_left.fetch_sub(1, std::memory_order_relaxed) == 0) {
    throw std::bad_alloc();
  }
  if (void* memory = std::malloc(size == 0 ? 1 : size)) return memory;
  throw std::bad_alloc();
}

}  // namespace

void* operator new(std::size_t size) {
  return Allocate(size);
}
void* operator new[](std::size_t size) {
  return Allocate(size);
}
// The sanitizers' own ones do not call those above.
void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  try {
    return Allocate(size);
  } catch (const std::bad_alloc&) {
    return nullptr;
  }
}
void* operator new[](std::size_t size, const std::nothrow_t& nothrow) noexcept {
  return operator new(size, nothrow);
}
void operator delete(void* memory) noexcept {
  std::free(memory);
}
void operator delete[](void* memory) noexcept {
  std::free(memory);
}
void operator delete(void* memory, std::size_t) noexcept {
  std::free(memory);
}
void operator delete[](void* memory, std::size_t) noexcept {
  std::free(memory);
}

namespace horopter {
namespace {

std::string TurnedSquares(double turn_deg) {
  cv::Mat image(120, 160, CV_8UC3, cv::Scalar(60, 60, 60));
  for (int i = 0; i < 3; ++i) {
    const cv::RotatedRect square(
        cv::Point2f(40.f + 40.f * i, 60.f), cv::Size2f(25.f, 25.f), static_cast<float>(turn_deg));
    cv::Point2f corners[4];
    square.points(corners);
    std::vector<cv::Point> polygon(corners, corners + 4);
    cv::fillConvexPoly(image, polygon, cv::Scalar(80 * i, 200, 250 - 60 * i));
  }
  std::vector<unsigned char> bytes;
  cv::imencode(".png", image, bytes);
  return {bytes.begin(), bytes.end()};
}

// Fails the allocations of a request one after the other: all of the first, then ever wider apart.
void FailOneByOne(const Recognizer& recognizer, int64_t all_of_the_first) {
  auto store = CatalogStore::Load(*Catalog::Open(":memory:"), CatalogPreparer());
  ASSERT_TRUE(store.ok()) << store.status();
  ASSERT_TRUE((*store)->Create(SampleRecord("box")).ok());
  const RecognitionService service(**store, {}, recognizer, {});
  v1::RecognizeSceneRequest sent;
  for (const double turn : {0.0, 20.0, 45.0}) sent.add_images()->set_content(TurnedSquares(turn));
  sent.add_candidate_objects("objects/box");
  const std::string bytes = sent.SerializeAsString();
  CallInfo call;
  RequestRecord record;
  call.record = &record;
  call.limits.stop = [] { return false; };
  const auto run = [&]() -> absl::Status {
    return CatchExceptions([&]() -> absl::Status {
      v1::RecognizeSceneRequest request;
      v1::RecognizeSceneResponse response;
      if (!request.ParseFromString(bytes)) return absl::InvalidArgumentError("parse");
      HOROPTER_RETURN_IF_ERROR(service.Demand(request).status());
      HOROPTER_RETURN_IF_ERROR(service.Handle(request, call, &response));
      (void)response.SerializeAsString();
      return absl::OkStatus();
    });
  };
  ASSERT_TRUE(run().ok()) << run();
  constexpr int64_t kMany = int64_t{1} << 40;
  allocations_left = kMany;
  ASSERT_TRUE(run().ok());
  const int64_t allocations = kMany - allocations_left.exchange(-1);
  ASSERT_GT(allocations, 10);
  int failed = 0, tried = 0;
  for (int64_t at = 0; at < allocations; at += at < all_of_the_first ? 1 : 1 + at / 10, ++tried) {
    allocations_left = at;
    const absl::Status status = run();
    allocations_left = -1;
    if (status.ok()) continue;  // a library did without
    ++failed;
    EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted) << at << ": " << status;
  }
  EXPECT_GT(failed, tried / 2);
  EXPECT_TRUE(run().ok());
}

// Reading, checking, decoding, converting and answering. Protobuf's maps (3.21, StageReport.counts)
// do not survive the failure of their nodes and first tables, which are smaller.
TEST(AllocationFailure, OfAllButTheSmallestOutsideOfTheStagesIsAStatusOfTheRequest) {
  smallest = 128;
  FailOneByOne(
      [](const SceneRequest& request,
         const CatalogSnapshot&,
         const CallLimits&) -> absl::StatusOr<PipelineResult> {
        PipelineResult result;
        result.answer.cameras.resize(request.images.size());
        result.answer.objects.emplace_back().object_id = "box";
        return result;
      },
      2000);
}

// A write that is on disk is answered with OK and published; one that is not has left nothing.
TEST(AllocationFailure, AnywhereInAWriteNeverSplitsFileAndAnswers) {
  smallest = 0;
  auto store = CatalogStore::Load(*Catalog::Open(":memory:"), FakePreparer());
  ASSERT_TRUE(store.ok()) << store.status();
  ASSERT_TRUE((*store)->Create(SampleRecord("known")).ok());
  constexpr int64_t kMany = int64_t{1} << 40;
  int failed = 0, done = 0;
  // Once a write needs no more than `at` allocations, it and all later ones succeed.
  for (int64_t at = 0; done < 3; at += 1 + at / 50) {
    ASSERT_LT(at, kMany);
    const std::string id = "obj_" + std::to_string(at);
    const CatalogRecord record = SampleRecord(id, 1 + at % 7);
    std::string answered;
    answered.reserve(64);
    allocations_left = at;
    const absl::Status status = CatchExceptions([&] {
      return (*store)->Create({record}, {}, [&](const CatalogRecord& written) {
        answered = written.model.id;
        return absl::OkStatus();
      });
    });
    allocations_left = -1;
    status.ok() ? ++done : ++failed;
    const bool stored = (*store)->catalog().GetSummary(id).ok();
    EXPECT_EQ(stored, status.ok()) << at << ": " << status;
    EXPECT_EQ((*store)->Published()->Contains(id), status.ok()) << at;
    if (status.ok()) {
      EXPECT_EQ(answered, id);
    } else {
      EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted) << status;
    }
    ASSERT_TRUE((*store)->CheckIndex().ok()) << at;
  }
  EXPECT_GT(failed, 100);
}

// Large allocations: some of OpenCV's destructors throw when a small one failed before (4.6,
// BufferArea), which nobody can catch.
TEST(AllocationFailure, OfSomeSizeAnywhereInTheStagesIsAStatusOfTheRequest) {
  smallest = 4096;
  FailOneByOne(
      [](const SceneRequest& request, const CatalogSnapshot& snapshot, const CallLimits& limits) {
        PipelineOptions options;
        options.threads = 2;
        return RecognizeScene(request, snapshot, options, limits.stop);
      },
      20);
}

}  // namespace
}  // namespace horopter
