// The last answers of RecognizeScene, held in memory, and who watches them come.
#pragma once

#include <grpcpp/support/byte_buffer.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/service/image_decode.h"
#include "server/service/request_record.h"

namespace horopter {

struct AnswerBoardOptions {
  int max_watchers = 128;  // at once; 0: nothing is held and nobody may watch
  // Half for the answers that are held, half for those that are on their way to slow watchers.
  // Raising it holds the images of more answers.
  int memory_mb = 128;
  // A watcher that takes no message for so long is cut off.
  std::chrono::milliseconds patience = std::chrono::seconds(30);
  ImageLimits images;
};

inline constexpr int kMostHeldAnswers = 50;

struct WatchOptions {
  int last = 0;       // of the answers that are held, so many are told first
  int64_t after = 0;  // only those with a larger number
  bool previews = false;
  std::string station;  // `stations/{station}`; empty: all
};

class AnswerBoard;

// One watcher's place among the answers.
class Watch {
 public:
  // From now on `wake` is called, by a thread of the board, when there may be something to take,
  // and `cut` when the watcher is too slow; neither after Detach has returned.
  void Attach(std::function<void()> wake, std::function<void()> cut);
  void Detach();
  // A message is on its way to the watcher, or has arrived.
  void SetSending(bool sending);

 private:
  friend class AnswerBoard;
  explicit Watch(WatchOptions options) : options_(std::move(options)) {}
  void Wake();
  bool IsTooSlow(std::chrono::milliseconds patience) const;
  void Cut();

  const WatchOptions options_;
  bool begun_ = false;      // guarded by the board's mutex, as the next two
  int64_t seen_ = 0;        // number of the last answer that was taken or left out
  int64_t live_after_ = 0;  // later ones came while it watched
  std::atomic<int64_t> sending_since_ms_{0};  // steady clock; 0: nothing is on its way
  std::mutex mutex_;
  std::function<void()> wake_, cut_;  // guarded by mutex_
};

// Thread-safe. Post copies a call's messages, a millisecond or two, and leaves all else (previews,
// telling the watchers) to a thread of its own with low priority: whoever watches, and however
// slowly, no call waits for it. Answers are held once, whoever takes them; a watcher who does not
// keep up loses those that are no longer held.
class AnswerBoard {
 public:
  explicit AnswerBoard(const AnswerBoardOptions& options);
  ~AnswerBoard();

  bool is_on() const { return options_.max_watchers > 0; }

  // Of calls other than RecognizeScene nothing is held; those that were refused before they were
  // read are counted. record: within RequestSink::OnRequest.
  void Post(const RequestRecord& record);

  // Errors: FAILED_PRECONDITION (nobody may watch), RESOURCE_EXHAUSTED (too many do), UNAVAILABLE
  // (closed).
  absl::StatusOr<std::shared_ptr<Watch>> Open(const WatchOptions& options);
  void Leave(const std::shared_ptr<Watch>& watch);

  // What the watcher gets next: nothing yet (monostate), a serialized WatchedAnswer, or the end.
  using Step = std::variant<std::monostate, grpc::ByteBuffer, absl::Status>;
  Step Next(Watch& watch);

  // A serialized WatchedAnswer with its images. Errors: FAILED_PRECONDITION, NOT_FOUND.
  absl::StatusOr<grpc::ByteBuffer> Get(int64_t number) const;

  // Ends all watches with UNAVAILABLE.
  void Close();

  int watchers() const;
  // Of all answers that are held or on their way.
  int64_t held_bytes() const { return *held_bytes_; }

 private:
  struct Answer;
  void Run();
  void MakePreviews();
  void MakeRoom();

  const AnswerBoardOptions options_;
  const std::shared_ptr<std::atomic<int64_t>> held_bytes_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<std::shared_ptr<Answer>> answers_;  // guarded by mutex_, as all below; oldest first
  std::vector<std::shared_ptr<Watch>> watches_;
  int64_t posted_ = 0, refused_ = 0;
  bool news_ = false, closed_ = false, ending_ = false;
  std::thread thread_;
};

// Posts what it hears, and passes it on.
class PostingSink final : public RequestSink {
 public:
  PostingSink(RequestSink& next, AnswerBoard& board) : next_(next), board_(board) {}
  void OnRequest(const RequestRecord& record) override;
  absl::Status BeforeAdminCall(const RequestRecord& record) override {
    return next_.BeforeAdminCall(record);
  }
  bool KeepsMessages() const override { return board_.is_on() || next_.KeepsMessages(); }

 private:
  RequestSink& next_;
  AnswerBoard& board_;
};

}  // namespace horopter
