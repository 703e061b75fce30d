// The calls of AnswerService that read the folder of recordings.
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "server/base/recording_file.h"
#include "server/base/status_macros.h"
#include "server/service/answer_service.h"
#include "server/service/page_sizes.h"
#include "server/service/rpc_status.h"
#include "server/service/stream_call.h"

namespace horopter {
namespace {

namespace fs = std::filesystem;

constexpr char kRecordingPrefix[] = "recordings/";
constexpr size_t kMostRecordingIdBytes = 63;
constexpr size_t kTimeDigits = 13;  // of milliseconds, as the recorder writes them
constexpr size_t kRecordingChunkBytes = size_t{1} << 20;

absl::Status NothingIsRecorded() {
  return absl::FailedPreconditionError("this server records nothing (--record-dir)");
}

bool IsRecordingId(const std::string& id) {
  return !id.empty() && id.size() <= kMostRecordingIdBytes &&
         std::all_of(id.begin(), id.end(), [](char c) {
           return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f') || c == '-';
         });
}

absl::StatusOr<std::string> RecordingIdOf(const std::string& name) {
  constexpr size_t kLength = sizeof(kRecordingPrefix) - 1;
  const std::string id = name.size() > kLength ? name.substr(kLength) : "";
  if (name.compare(0, kLength, kRecordingPrefix) != 0 || !IsRecordingId(id)) {
    return InvalidField("name", "not recordings/{recording}");
  }
  return id;
}

// Ids, the latest first: they begin with the time.
std::vector<std::string> LatestFirst(const std::string& folder) {
  std::vector<std::string> ids;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    const std::string id = it->path().stem().string();
    if (it->path().extension() == kRecordingExtension && IsRecordingId(id)) ids.push_back(id);
  }
  std::sort(ids.begin(), ids.end(), std::greater<>());
  return ids;
}

void FillRecording(const std::string& folder, const std::string& id, v1::Recording* recording) {
  recording->set_name(kRecordingPrefix + id);
  std::error_code gone;
  const auto bytes = fs::file_size(fs::path(folder) / (id + kRecordingExtension), gone);
  recording->set_size_bytes(gone ? 0 : static_cast<int64_t>(bytes));
  int64_t ms = 0;
  if (id.size() > kTimeDigits + 1 && absl::SimpleAtoi(id.substr(0, kTimeDigits), &ms)) {
    recording->mutable_time()->set_seconds(ms / 1000);
    recording->mutable_time()->set_nanos(static_cast<int32_t>(ms % 1000) * 1'000'000);
    recording->set_request_id(id.substr(kTimeDigits + 1));
  }
}

absl::Status ListRecordingsIn(const std::string& folder,
                              const v1::ListRecordingsRequest& request,
                              v1::ListRecordingsResponse* response) {
  if (folder.empty()) return NothingIsRecorded();
  if (request.page_size() < 0) return InvalidField("page_size", "negative");
  if (!request.page_token().empty() && !IsRecordingId(request.page_token())) {
    return InvalidField("page_token", "not a token of this method");
  }
  const int size =
      request.page_size() == 0 ? kDefaultPageSize : std::min(request.page_size(), kMaxPageSize);
  for (const std::string& id : LatestFirst(folder)) {
    if (!request.page_token().empty() && id >= request.page_token()) continue;
    if (response->recordings_size() == size) {
      const std::string& last = response->recordings(size - 1).name();
      response->set_next_page_token(last.substr(sizeof(kRecordingPrefix) - 1));
      break;
    }
    FillRecording(folder, id, response->add_recordings());
  }
  return absl::OkStatus();
}

class RecordingReactor final : public StreamReactor<v1::GetRecordingResponse> {
 public:
  RecordingReactor(std::string folder,
                   std::string name,
                   const CallGate& gate,
                   grpc::CallbackServerContext* context)
      : StreamReactor({.name = "GetRecording", .needs = Role::kObserver}, gate, context),
        folder_(std::move(folder)),
        name_(std::move(name)) {}
  ~RecordingReactor() override {
    if (file_ >= 0) ::close(file_);
  }

 private:
  bool PostsByItself() const override { return false; }

  absl::Status Begin() override {
    if (folder_.empty()) return NothingIsRecorded();
    HOROPTER_ASSIGN_OR_RETURN(const std::string id, RecordingIdOf(name_));
    const std::string path = (fs::path(folder_) / (id + kRecordingExtension)).string();
    file_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    struct stat about = {};
    if (file_ < 0 || ::fstat(file_, &about) != 0 || !S_ISREG(about.st_mode)) {
      return absl::NotFoundError(absl::StrCat("name: '", name_, "' is not there (any more)"));
    }
    bytes_ = about.st_size;
    record().resource = name_;
    return OnSent();
  }

  absl::Status OnSent() override {
    v1::GetRecordingResponse message;
    std::string& chunk = *message.mutable_chunk();
    chunk.resize(kRecordingChunkBytes);
    const ssize_t read = ::pread(file_, chunk.data(), chunk.size(), offset_);
    if (read < 0) return absl::InternalError(absl::StrCat(name_, ": cannot be read"));
    if (read == 0) {
      Complete(absl::OkStatus());
      return absl::OkStatus();
    }
    chunk.resize(static_cast<size_t>(read));
    offset_ += read;
    message.set_total_bytes(bytes_);
    Post(message);
    return absl::OkStatus();
  }

  const std::string folder_, name_;
  int file_ = -1;
  int64_t bytes_ = 0, offset_ = 0;
};

}  // namespace

grpc::ServerUnaryReactor* AnswerService::ListRecordings(grpc::CallbackServerContext* context,
                                                        const grpc::ByteBuffer* request,
                                                        grpc::ByteBuffer* response) {
  return RunUnaryCall<v1::ListRecordingsRequest, v1::ListRecordingsResponse>(
      gate_,
      context,
      request,
      response,
      {{.name = "ListRecordings", .needs = Role::kObserver},
       [this](const auto& message, const CallInfo&, auto* answer) {
         return ListRecordingsIn(recordings_, message, answer);
       }});
}

grpc::ServerWriteReactor<v1::GetRecordingResponse>* AnswerService::GetRecording(
    grpc::CallbackServerContext* context, const v1::GetRecordingRequest* request) {
  auto* const reactor = new RecordingReactor(recordings_, request->name(), gate_, context);
  reactor->Start();
  return reactor;
}

}  // namespace horopter
