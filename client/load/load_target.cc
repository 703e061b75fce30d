#include "client/load/load_target.h"

#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <chrono>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <utility>

#include "client/answer_text.h"

namespace horopter {
namespace {

constexpr char kMethod[] = "/horopter.v1.RecognitionService/RecognizeScene";

// Lives until its completion is taken from the queue.
struct Call {
  size_t item = 0;
  std::function<void(LoadReply)> done;
  grpc::ClientContext context;
  grpc::ByteBuffer response;
  grpc::Status status;
  std::unique_ptr<grpc::GenericClientAsyncResponseReader> reader;
};

std::string BytesOf(const grpc::ByteBuffer& buffer) {
  std::vector<grpc::Slice> slices;
  std::string bytes;
  if (!buffer.Dump(&slices).ok()) return bytes;
  bytes.reserve(buffer.Length());
  for (const grpc::Slice& slice : slices) {
    bytes.append(reinterpret_cast<const char*>(slice.begin()), slice.size());
  }
  return bytes;
}

// What is the same in two answers to one request of a deterministic server; parts of the message in
// its own order, no map among them.
std::string Fingerprint(v1::RecognizeSceneResponse response) {
  response.clear_stages();
  response.clear_request_id();
  response.clear_catalog_generation();
  return response.SerializeAsString();
}

}  // namespace

struct ServerTarget::State {
  explicit State(const HoropterClient& c) : timeout_s(c.timeout_s()), stub(c.channel()) {
    receiver = std::thread([this] { Receive(); });
  }
  // All calls are over by then.
  ~State() {
    queue.Shutdown();
    receiver.join();
  }

  double timeout_s;
  grpc::GenericStub stub;
  // One thread takes all completions: the callback API has a pool of them, which costs more in
  // wake-ups than the calls themselves.
  grpc::CompletionQueue queue;
  std::thread receiver;
  std::vector<grpc::ByteBuffer> requests;
  std::mutex mutex;
  std::set<Call*> under_way;  // guarded by mutex, as all below
  std::vector<std::map<std::string, int>> known;
  std::vector<std::vector<v1::RecognizeSceneResponse>> answers;

  LoadReply Read(size_t item, const grpc::Status& status, const grpc::ByteBuffer& response) {
    LoadReply reply;
    reply.code = static_cast<absl::StatusCode>(status.error_code());  // numbered alike
    reply.bytes_sent = static_cast<int64_t>(requests[item].Length());
    if (!status.ok()) return reply;
    reply.bytes_received = static_cast<int64_t>(response.Length());
    v1::RecognizeSceneResponse answer;
    if (!answer.ParseFromString(BytesOf(response))) {
      reply.code = absl::StatusCode::kDataLoss;
      return reply;
    }
    reply.state = OutcomeText(answer);
    for (const v1::StageReport& s : answer.stages()) {
      reply.stages.emplace_back(
          s.stage(), static_cast<double>(s.elapsed().seconds()) + 1e-9 * s.elapsed().nanos());
    }
    const std::string fingerprint = Fingerprint(answer);
    const std::lock_guard lock(mutex);
    const auto [at, is_new] =
        known[item].emplace(fingerprint, static_cast<int>(answers[item].size()));
    if (is_new) answers[item].push_back(std::move(answer));
    reply.answer = at->second;
    return reply;
  }

  void Start(size_t item, std::function<void(LoadReply)> done) {
    auto* call = new Call;
    call->item = item;
    call->done = std::move(done);
    call->context.set_deadline(std::chrono::system_clock::now() +
                               std::chrono::milliseconds(static_cast<int64_t>(timeout_s * 1e3)));
    {
      const std::lock_guard lock(mutex);
      under_way.insert(call);
    }
    call->reader = stub.PrepareUnaryCall(&call->context, kMethod, requests[item], &queue);
    call->reader->StartCall();
    call->reader->Finish(&call->response, &call->status, call);
  }

  void Receive() {
    void* tag = nullptr;
    bool ok = false;
    while (queue.Next(&tag, &ok)) {
      const std::unique_ptr<Call> call(static_cast<Call*>(tag));
      const auto arrived = std::chrono::steady_clock::now();
      {
        const std::lock_guard lock(mutex);
        under_way.erase(call.get());
      }
      LoadReply reply = Read(call->item, call->status, call->response);
      reply.arrived = arrived;
      call->done(std::move(reply));
    }
  }
};

ServerTarget::ServerTarget(const HoropterClient& client, const std::vector<LoadItem>& items)
    : state_(std::make_unique<State>(client)) {
  for (const LoadItem& item : items) {
    const grpc::Slice slice(item.request.SerializeAsString());
    state_->requests.emplace_back(&slice, 1);
  }
  state_->known.resize(items.size());
  state_->answers.resize(items.size());
}

ServerTarget::~ServerTarget() = default;

LoadTarget ServerTarget::target() {
  State* state = state_.get();
  return {[state](int item, std::function<void(LoadReply)> done) {
            state->Start(static_cast<size_t>(item), std::move(done));
          },
          [state] {
            const std::lock_guard lock(state->mutex);
            for (Call* call : state->under_way) call->context.TryCancel();
          }};
}

const std::vector<std::vector<v1::RecognizeSceneResponse>>& ServerTarget::answers() const {
  return state_->answers;
}

}  // namespace horopter
