#include "server/service/rankers.h"

#include <grpcpp/grpcpp.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <iterator>
#include <mutex>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/pipeline/select_objects.h"
#include "server/service/derived_cache.h"
#include "server/service/listen_address.h"
#include "server/service/ranking_convert.h"
#include "server/service/rpc_status.h"

namespace horopter {
namespace {

constexpr int kReconnectMs = 1000;         // at most, between two tries: a restart is noticed soon
constexpr double kShareOfDeadline = 0.25;  // of the time that a request has

// One question to all shards; every call is over before it goes.
struct Question {
  struct Call {
    grpc::ClientContext context;
    v1::RankPartsResponse response;
    grpc::Status status;
  };

  std::mutex mutex;
  std::condition_variable answered;
  int open = 0;  // guarded by mutex
  std::vector<std::unique_ptr<Call>> calls;

  void Await(const StopRequested& stop) {
    constexpr auto kLook = std::chrono::milliseconds(20);
    std::unique_lock lock(mutex);
    bool cancelled = false;
    while (open > 0) {
      answered.wait_for(lock, kLook);
      if (cancelled || !IsStopRequested(stop)) continue;
      cancelled = true;
      for (const auto& call : calls) call->context.TryCancel();
    }
  }
};

// What a shard answered, if it is the shard that was asked.
absl::StatusOr<std::vector<RankedPart>> PartsOf(const Question::Call& call,
                                                int shard,
                                                int shards,
                                                int images) {
  if (!call.status.ok()) return absl::UnavailableError(absl::StrCat(call.status.error_message()));
  if (call.response.shard() != shard || call.response.shard_count() != shards) {
    return absl::FailedPreconditionError(
        absl::StrCat("it is shard ", call.response.shard(), " of ", call.response.shard_count()));
  }
  return RankedPartsFromProto(call.response, images);
}

absl::StatusOr<std::string> FirstLineOf(const std::string& path) {
  const absl::StatusOr<std::string> text = ReadWholeFile(path);
  const std::string line =
      text.ok() ? std::string(absl::StripAsciiWhitespace(text->substr(0, text->find('\n')))) : "";
  if (!line.empty()) return line;
  return absl::FailedPreconditionError(absl::StrCat("ranker-token: ", path, " cannot be read"));
}

}  // namespace

absl::Status Validate(const RankerOptions& options) {
  for (const std::string& address : options.addresses) {
    HOROPTER_ASSIGN_OR_RETURN(const ListenAddress parsed, ParseListenAddress("rankers", address));
    if (parsed.kind == ListenAddress::Kind::kTcp && parsed.port == 0)
      return absl::InvalidArgumentError(absl::StrCat("rankers: ", address, " names no port"));
  }
  if (options.above < 0)
    return absl::InvalidArgumentError(absl::StrCat("rank-above: ", options.above, " is negative"));
  if (!(options.seconds > 0.0 && options.seconds <= 3600.0)) {
    return absl::InvalidArgumentError(
        absl::StrCat("ranker-seconds: ", options.seconds, " is not between 0 and 3600"));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<Rankers>> Rankers::Create(const RankerOptions& options) {
  HOROPTER_RETURN_IF_ERROR(Validate(options));
  std::shared_ptr<Rankers> rankers(new Rankers(options));
  if (!options.token_file.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(rankers->token_, FirstLineOf(options.token_file));
  }
  std::shared_ptr<grpc::ChannelCredentials> credentials = grpc::InsecureChannelCredentials();
  if (!options.ca.empty()) {
    const absl::StatusOr<std::string> ca = ReadWholeFile(options.ca);
    if (!ca.ok()) {
      return absl::FailedPreconditionError(
          absl::StrCat("ranker-ca: ", options.ca, " cannot be read"));
    }
    grpc::SslCredentialsOptions tls;
    tls.pem_root_certs = *ca;
    credentials = grpc::SslCredentials(tls);
  }
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(-1);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, kReconnectMs);
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, kReconnectMs / 4);
  for (const std::string& address : options.addresses) {
    rankers->stubs_.push_back(
        v1::RankingService::NewStub(grpc::CreateCustomChannel(address, credentials, arguments)));
  }
  return rankers;
}

absl::StatusOr<RankedCatalog> Rankers::Rank(std::span<const RankingImage> images,
                                            const CallLimits& limits) {
  const v1::RankPartsRequest request = RankingQuestionToProto(images);
  double seconds = options_.seconds;
  if (limits.allowed_s > 0) seconds = std::min(seconds, kShareOfDeadline * limits.allowed_s);
  const auto deadline = std::chrono::system_clock::now() +
                        std::chrono::microseconds(static_cast<int64_t>(1e6 * seconds));
  Question question;
  question.open = static_cast<int>(stubs_.size());
  for (const auto& stub : stubs_) {
    Question::Call* const call =
        question.calls.emplace_back(std::make_unique<Question::Call>()).get();
    call->context.set_deadline(deadline);
    if (!token_.empty()) call->context.AddMetadata("authorization", "Bearer " + token_);
    stub->async()->RankParts(
        &call->context, &request, &call->response, [&question, call](grpc::Status status) {
          const std::lock_guard lock(question.mutex);
          call->status = std::move(status);
          --question.open;
          question.answered.notify_all();
        });
  }
  question.Await(limits.stop);
  if (IsStopRequested(limits.stop)) return absl::CancelledError("stopped while parts were ranked");
  RankedCatalog out;
  out.shards = static_cast<int>(stubs_.size());
  std::vector<RankedPart> parts;
  for (int shard = 1; shard <= out.shards; ++shard) {
    absl::StatusOr<std::vector<RankedPart>> found =
        PartsOf(*question.calls[shard - 1], shard, out.shards, static_cast<int>(images.size()));
    if (!found.ok()) {
      out.lost[shard] = found.status();
      continue;
    }
    std::move(found->begin(), found->end(), std::back_inserter(parts));
  }
  if (static_cast<int>(out.lost.size()) == out.shards) {
    return absl::UnavailableError(
        absl::StrCat("no ranker answers, and without them requests have "
                     "to name candidates; the first: ",
                     std::string(out.lost.begin()->second.message())));
  }
  out.ids = BestParts(std::move(parts), static_cast<int>(images.size()));
  return out;
}

Recognizer RankedRecognizer(Recognizer recognizer, std::shared_ptr<Rankers> rankers) {
  return [recognizer = std::move(recognizer), rankers = std::move(rankers)](
             const SceneRequest& request,
             const CatalogSnapshot& catalog,
             const CallLimits& limits) -> absl::StatusOr<PipelineResult> {
    const RankerOptions& options = rankers->options();
    if (!request.candidates.empty() || ObjectCount(catalog) <= options.above)
      return recognizer(request, catalog, limits);
    const auto start = std::chrono::steady_clock::now();
    HOROPTER_ASSIGN_OR_RETURN(
        const RankedCatalog ranked,
        rankers->Rank(RankingQuestion(request.images, options.threads, request.searched), limits));
    SceneRequest narrowed = request;
    // A ranker may be ahead of what this request works on, or behind it.
    std::copy_if(ranked.ids.begin(),
                 ranked.ids.end(),
                 std::back_inserter(narrowed.candidates),
                 [&](const std::string& id) { return FindObject(catalog, id) >= 0; });
    // Images that show no edge of any part: whatever is looked for, the answer says so.
    if (narrowed.candidates.empty()) narrowed.candidates.push_back(IdAt(catalog, 0));
    StageReport report;
    report.stage = "ranking";
    report.seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    report.counts = {{"rankers", ranked.shards},
                     {"rankers_lost", static_cast<double>(ranked.lost.size())},
                     {"parts_listed", static_cast<double>(narrowed.candidates.size())}};
    HOROPTER_ASSIGN_OR_RETURN(PipelineResult result, recognizer(narrowed, catalog, limits));
    result.answer.stages.insert(result.answer.stages.begin(), std::move(report));
    for (const auto& [shard, why] : ranked.lost) {
      const std::string step = absl::StrCat("ranker ", shard, " of ", ranked.shards);
      spdlog::warn("{} is done without: {}", step, EscapeControls(std::string(why.message())));
      result.answer.unsearched.push_back({UnsearchedCause::kUnavailable, step});
      result.answer.time_limited = true;
    }
    return result;
  };
}

}  // namespace horopter
