#include "server/service/answer_board.h"

#include <grpcpp/support/slice.h>
#include <spdlog/spdlog.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/pipeline/exception_status.h"
#include "server/service/watched_answer.h"

namespace horopter {
namespace {

constexpr char kRecognizeScene[] = "RecognizeScene";
// Below what answers robots.
constexpr int kNiceness = 10;
constexpr int64_t kAboutBytesWhenCrowded = 16 << 10;
constexpr auto kLookForSlowOnes = std::chrono::seconds(1);

int64_t NowMs() {
  return std::chrono::duration_cast<std::chrono::milliseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

// Bytes that are sent to many and counted until the last of them has them.
struct Counted {
  std::string bytes;
  std::shared_ptr<std::atomic<int64_t>> held;
};

grpc::Slice Share(std::string bytes, const std::shared_ptr<std::atomic<int64_t>>& held) {
  if (bytes.empty()) return {};
  bytes.shrink_to_fit();
  auto* const counted = new Counted{std::move(bytes), held};
  *held += static_cast<int64_t>(counted->bytes.size());
  return grpc::Slice(
      counted->bytes.data(),
      counted->bytes.size(),
      [](void* owner) {
        auto* const gone = static_cast<Counted*>(owner);
        *gone->held -= static_cast<int64_t>(gone->bytes.size());
        delete gone;
      },
      counted);
}

grpc::ByteBuffer Joined(const std::vector<grpc::Slice>& pieces) {
  return grpc::ByteBuffer(pieces.data(), pieces.size());
}

int64_t SizeOf(const grpc::Slice& slice) {
  return static_cast<int64_t>(slice.size());
}

// Refused for what the caller or the server is, not for what was asked.
bool IsRefusal(const RequestRecord& record) {
  return record.busy || absl::IsUnavailable(record.status) ||
         absl::IsUnauthenticated(record.status) || absl::IsPermissionDenied(record.status) ||
         absl::IsResourceExhausted(record.status) || absl::IsCancelled(record.status);
}

}  // namespace

struct AnswerBoard::Answer {
  int64_t number = 0;
  std::string station;
  grpc::Slice about, images, previews;
  bool images_left_out = false;
  enum class Previews { kNone, kWanted, kMade } state = Previews::kNone;

  int64_t bytes() const { return SizeOf(about) + SizeOf(images) + SizeOf(previews); }
};

void Watch::Attach(std::function<void()> wake, std::function<void()> cut) {
  const std::lock_guard lock(mutex_);
  wake_ = std::move(wake);
  cut_ = std::move(cut);
}

void Watch::Detach() {
  Attach({}, {});
}

void Watch::SetSending(bool sending) {
  sending_since_ms_ = sending ? NowMs() : 0;
}

void Watch::Wake() {
  const std::lock_guard lock(mutex_);
  if (wake_) wake_();
}

bool Watch::IsTooSlow(std::chrono::milliseconds patience) const {
  const int64_t since = sending_since_ms_;
  return since != 0 && NowMs() - since > patience.count();
}

void Watch::Cut() {
  const std::lock_guard lock(mutex_);
  if (cut_) cut_();
}

AnswerBoard::AnswerBoard(const AnswerBoardOptions& options)
    : options_(options), held_bytes_(std::make_shared<std::atomic<int64_t>>(0)) {
  if (is_on()) thread_ = std::thread([this] { Run(); });
}

AnswerBoard::~AnswerBoard() {
  Close();
  {
    const std::lock_guard lock(mutex_);
    ending_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void AnswerBoard::Post(const RequestRecord& record) {
  if (!is_on() || record.method != kRecognizeScene) return;
  if (record.request == nullptr && IsRefusal(record)) {
    const std::lock_guard lock(mutex_);
    ++refused_;
    return;
  }
  const int64_t most = (int64_t{options_.memory_mb} << 20) / 2;
  int64_t number = 0;
  {
    const std::lock_guard lock(mutex_);
    number = ++posted_;
  }
  // What slow watchers hold back may take the other half, and no more.
  const bool crowded = *held_bytes_ > most;
  AnswerPieces pieces = PiecesOf(
      record, number, crowded ? kAboutBytesWhenCrowded : most / 16, crowded ? 0 : most / 2);
  const auto answer = std::make_shared<Answer>();
  answer->number = number;
  answer->station = std::move(pieces.station);
  answer->images_left_out = pieces.images_left_out;
  answer->about = Share(std::move(pieces.about), held_bytes_);
  answer->images = Share(std::move(pieces.images), held_bytes_);
  {
    const std::lock_guard lock(mutex_);
    // Of two that were counted at once the later may be here first.
    auto at = answers_.end();
    while (at != answers_.begin() && (*std::prev(at))->number > number) --at;
    answers_.insert(at, answer);
    MakeRoom();
    news_ = true;
  }
  changed_.notify_all();
}

// Images go before answers: the oldest first. Needs the mutex.
void AnswerBoard::MakeRoom() {
  const int64_t most = (int64_t{options_.memory_mb} << 20) / 2;
  int64_t bytes = 0;
  for (const auto& answer : answers_) bytes += answer->bytes();
  for (auto& answer : answers_) {
    if (bytes <= most) break;
    if (answer->images.size() == 0) continue;
    bytes -= SizeOf(answer->images) + SizeOf(answer->previews);
    answer->images = answer->previews = {};
    answer->images_left_out = true;
  }
  while (!answers_.empty() && (answers_.size() > kMostHeldAnswers || bytes > most)) {
    bytes -= answers_.front()->bytes();
    answers_.pop_front();
  }
}

absl::StatusOr<std::shared_ptr<Watch>> AnswerBoard::Open(const WatchOptions& options) {
  if (!is_on()) {
    return absl::FailedPreconditionError("the operator lets nobody watch (--max-watchers)");
  }
  const std::lock_guard lock(mutex_);
  if (closed_) return absl::UnavailableError("the server is stopping");
  if (watches_.size() >= static_cast<size_t>(options_.max_watchers)) {
    return absl::ResourceExhaustedError(
        absl::StrCat("there are ", watches_.size(), " watchers, as many as may be"));
  }
  std::shared_ptr<Watch> watch(new Watch(options));
  watch->live_after_ = watch->seen_ = posted_;
  const auto count = std::min(answers_.size(), static_cast<size_t>(std::max(0, options.last)));
  if (count > 0) watch->seen_ = (*(answers_.end() - static_cast<int64_t>(count)))->number - 1;
  if (options.after <= posted_) watch->seen_ = std::max(watch->seen_, options.after);
  watches_.push_back(watch);
  return watch;
}

void AnswerBoard::Leave(const std::shared_ptr<Watch>& watch) {
  const std::lock_guard lock(mutex_);
  std::erase(watches_, watch);
}

AnswerBoard::Step AnswerBoard::Next(Watch& watch) {
  const std::lock_guard lock(mutex_);
  if (closed_) return absl::UnavailableError("the server is stopping");
  AnswerTail tail;
  tail.refused = refused_;
  if (!watch.begun_) {
    watch.begun_ = true;
    return Joined({grpc::Slice(TailPiece(tail))});
  }
  for (const auto& answer : answers_) {
    if (answer->number <= watch.seen_) continue;
    if (!watch.options_.station.empty() && watch.options_.station != answer->station) {
      tail.lost += answer->number - watch.seen_ - 1;
      watch.seen_ = answer->number;
      continue;
    }
    if (watch.options_.previews && answer->state != Answer::Previews::kMade &&
        answer->images.size() > 0) {
      answer->state = Answer::Previews::kWanted;
      news_ = true;
      changed_.notify_all();
      return std::monostate();
    }
    tail.lost += answer->number - watch.seen_ - 1;
    tail.earlier = answer->number <= watch.live_after_;
    tail.images_left_out = answer->images_left_out;
    watch.seen_ = answer->number;
    std::vector<grpc::Slice> pieces{answer->about};
    if (watch.options_.previews && answer->previews.size() > 0) pieces.push_back(answer->previews);
    pieces.emplace_back(TailPiece(tail));
    return Joined(pieces);
  }
  return std::monostate();
}

absl::StatusOr<grpc::ByteBuffer> AnswerBoard::Get(int64_t number) const {
  if (!is_on()) {
    return absl::FailedPreconditionError("the operator lets nobody watch (--max-watchers)");
  }
  const std::lock_guard lock(mutex_);
  for (const auto& answer : answers_) {
    if (answer->number != number) continue;
    AnswerTail tail;
    tail.refused = refused_;
    tail.earlier = true;
    tail.images_left_out = answer->images_left_out;
    std::vector<grpc::Slice> pieces{answer->about};
    if (answer->images.size() > 0) pieces.push_back(answer->images);
    pieces.emplace_back(TailPiece(tail));
    return Joined(pieces);
  }
  return absl::NotFoundError(absl::StrCat("number: answer ", number, " is no longer held"));
}

void AnswerBoard::Close() {
  {
    const std::lock_guard lock(mutex_);
    closed_ = news_ = true;
  }
  changed_.notify_all();
}

int AnswerBoard::watchers() const {
  const std::lock_guard lock(mutex_);
  return static_cast<int>(watches_.size());
}

void AnswerBoard::MakePreviews() {
  while (true) {
    std::shared_ptr<Answer> wanted;
    grpc::Slice images;
    {
      const std::lock_guard lock(mutex_);
      for (const auto& answer : answers_) {
        if (answer->state != Answer::Previews::kWanted) continue;
        wanted = answer;
        images = answer->images;
        break;
      }
    }
    if (wanted == nullptr) return;
    grpc::Slice made;
    // Without them where memory is short: the watchers go on.
    const absl::Status status = CatchExceptions([&] {
      const std::string bytes(reinterpret_cast<const char*>(images.begin()), images.size());
      made = Share(PreviewPiece(bytes, options_.images), held_bytes_);
      return absl::OkStatus();
    });
    if (!status.ok()) spdlog::error("previews: {}", std::string(status.message()));
    const std::lock_guard lock(mutex_);
    wanted->state = Answer::Previews::kMade;
    if (wanted->images.size() > 0) wanted->previews = std::move(made);
    MakeRoom();
  }
}

void AnswerBoard::Run() {
  ::setpriority(PRIO_PROCESS, static_cast<id_t>(::gettid()), kNiceness);
  while (true) {
    std::vector<std::shared_ptr<Watch>> watches;
    bool news = false;
    {
      std::unique_lock lock(mutex_);
      const auto is_due = [this] { return news_ || ending_; };
      if (watches_.empty()) {
        changed_.wait(lock, is_due);
      } else {
        changed_.wait_for(lock, kLookForSlowOnes, is_due);
      }
      if (ending_) return;
      news = std::exchange(news_, false);
      watches = watches_;
    }
    if (news) MakePreviews();
    for (const auto& watch : watches) {
      if (watch->IsTooSlow(options_.patience)) {
        watch->Cut();
      } else if (news) {
        watch->Wake();
      }
    }
  }
}

void PostingSink::OnRequest(const RequestRecord& record) {
  next_.OnRequest(record);
  const absl::Status posted = CatchExceptions([&] {
    board_.Post(record);
    return absl::OkStatus();
  });
  if (!posted.ok()) spdlog::error("watchers are not told: {}", std::string(posted.message()));
}

}  // namespace horopter
