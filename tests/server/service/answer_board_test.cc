#include "server/service/answer_board.h"

#include <grpcpp/impl/codegen/proto_utils.h>
#include <gtest/gtest.h>

#include <chrono>
#include <condition_variable>
#include <future>
#include <optional>
#include <vector>

#include "horopter/v1/answers.pb.h"

namespace horopter {
namespace {

struct Call {
  explicit Call(size_t image_bytes) {
    request.add_images()->set_content(std::string(image_bytes, 'x'));
    record.method = "RecognizeScene";
    record.request = &request;
    record.response = &response;
  }
  v1::RecognizeSceneRequest request;
  v1::RecognizeSceneResponse response;
  RequestRecord record;
};

std::optional<v1::WatchedAnswer> Message(AnswerBoard::Step step) {
  auto* const bytes = std::get_if<grpc::ByteBuffer>(&step);
  if (bytes == nullptr) return std::nullopt;
  v1::WatchedAnswer answer;
  EXPECT_TRUE(grpc::SerializationTraits<v1::WatchedAnswer>::Deserialize(bytes, &answer).ok());
  return answer;
}

TEST(AnswerBoard, MemoryIsBoundedWhateverWatchersHoldBack) {
  AnswerBoardOptions options;
  options.memory_mb = 8;
  AnswerBoard board(options);
  std::vector<AnswerBoard::Step> on_their_way;
  std::vector<absl::StatusOr<grpc::ByteBuffer>> asked_for;
  std::vector<std::shared_ptr<Watch>> watches;
  for (int i = 0; i < 100; ++i) {
    watches.push_back(*board.Open({}));
    board.Next(*watches.back());
  }
  const Call call(700'000);
  for (int i = 0; i < 100; ++i) {
    board.Post(call.record);
    // Each watcher holds another answer back.
    on_their_way.push_back(board.Next(*watches[static_cast<size_t>(i)]));
    asked_for.push_back(board.Get(i + 1));
    EXPECT_LE(board.held_bytes(), int64_t{options.memory_mb} << 20);
  }
  EXPECT_GT(board.held_bytes(), 3'000'000);
  on_their_way.clear();
  asked_for.clear();
  EXPECT_LE(board.held_bytes(), (int64_t{options.memory_mb} << 20) / 2);
}

TEST(AnswerBoard, WhoIsSlowIsToldHowManyHeLost) {
  AnswerBoard board({});
  const std::shared_ptr<Watch> watch = *board.Open({});
  EXPECT_EQ(Message(board.Next(*watch))->number(), 0);
  const Call call(10);
  for (int i = 0; i < 3 * kMostHeldAnswers; ++i) board.Post(call.record);
  const auto first = Message(board.Next(*watch));
  EXPECT_EQ(first->number(), 2 * kMostHeldAnswers + 1);
  EXPECT_EQ(first->lost(), 2 * kMostHeldAnswers);
  int64_t told = 1;
  while (const auto next = Message(board.Next(*watch))) {
    EXPECT_EQ(next->lost(), 0);
    ++told;
  }
  EXPECT_EQ(told, kMostHeldAnswers);
}

TEST(AnswerBoard, NoCallWaitsForAWatcher) {
  AnswerBoard board({});
  const std::shared_ptr<Watch> watch = *board.Open({});
  board.Next(*watch);
  std::promise<void> woken, released;
  auto release = released.get_future().share();
  std::once_flag once;
  watch->Attach(
      [&] {
        std::call_once(once, [&] { woken.set_value(); });
        release.wait();
      },
      [] {});
  const Call call(10);
  board.Post(call.record);
  woken.get_future().wait();
  // While the watcher is being told, and takes for ever, others are answered.
  for (int i = 0; i < 10; ++i) board.Post(call.record);
  EXPECT_EQ(Message(*board.Get(11))->number(), 11);
  released.set_value();
  watch->Detach();
}

TEST(AnswerBoard, ImagesThatAreTooLargeAreLeftOutAndToldSo) {
  AnswerBoardOptions options;
  options.memory_mb = 4;
  AnswerBoard board(options);
  const std::shared_ptr<Watch> watch = *board.Open({});
  board.Next(*watch);
  board.Post(Call(1'200'000).record);
  EXPECT_TRUE(Message(board.Next(*watch))->images_left_out());
  EXPECT_EQ(Message(*board.Get(1))->images_size(), 0);
}

TEST(AnswerBoard, RefusedCallsAreCountedAndDriveNoAnswerOut) {
  AnswerBoard board({});
  board.Post(Call(10).record);
  RequestRecord refused;
  refused.method = "RecognizeScene";
  refused.status = absl::UnauthenticatedError("who?");
  for (int i = 0; i < 1000; ++i) board.Post(refused);
  EXPECT_EQ(Message(*board.Get(1))->refused(), 1000);
  RequestRecord other;
  other.method = "ListObjects";
  board.Post(other);
  EXPECT_FALSE(board.Get(2).ok());
}

TEST(AnswerBoard, PicturesOfWhatIsNoImageAreEmpty) {
  AnswerBoard board({});
  WatchOptions options;
  options.previews = true;
  const std::shared_ptr<Watch> watch = *board.Open(options);
  board.Next(*watch);
  std::promise<void> made;
  std::once_flag once;
  std::optional<v1::WatchedAnswer> told;
  watch->Attach(
      [&] {
        const auto next = Message(board.Next(*watch));
        if (!next) return;
        told = next;
        std::call_once(once, [&] { made.set_value(); });
      },
      [] {});
  board.Post(Call(10).record);
  made.get_future().wait();
  watch->Detach();
  ASSERT_EQ(told->previews_size(), 1);
  EXPECT_EQ(told->previews(0).jpeg(), "");
}

}  // namespace
}  // namespace horopter
