// The least that a client of gRPC can do: one thread, one request over and over at a constant rate,
// answers not read. What the load tool is measured against: what it takes beyond this is its own,
// and its percentiles must be those that this one finds at the same time.
//
//   bare_client --server HOST:PORT --image FILE [--rate 100] [--seconds 10] [--csv FILE]
//
// Prints the share of a core that it took; the CSV has a latency a line, milliseconds.
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "horopter/v1/recognition.pb.h"

namespace horopter {
namespace {

using Clock = std::chrono::steady_clock;

double CpuSeconds() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

class BareClient {
 public:
  BareClient(const std::string& server, const std::string& image)
      : stub_(grpc::CreateChannel(server, grpc::InsecureChannelCredentials())) {
    v1::RecognizeSceneRequest request;
    request.add_images()->set_content(image);
    const grpc::Slice slice(request.SerializeAsString());
    request_ = grpc::ByteBuffer(&slice, 1);
  }
  ~BareClient() {
    queue_.Shutdown();
    void* tag = nullptr;
    bool ok = false;
    while (queue_.Next(&tag, &ok)) delete static_cast<Call*>(tag);
  }

  void Send(Clock::time_point due) {
    auto* call = new Call;
    call->due = due;
    call->context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(60));
    call->reader = stub_.PrepareUnaryCall(
        &call->context, "/horopter.v1.RecognitionService/RecognizeScene", request_, &queue_);
    call->reader->StartCall();
    call->reader->Finish(&call->response, &call->status, call);
    ++open_;
  }

  // Takes answers until then.
  void TakeUntil(Clock::time_point until) {
    while (true) {
      void* tag = nullptr;
      bool ok = false;
      const auto left = std::chrono::duration_cast<std::chrono::microseconds>(until - Clock::now());
      const auto next = queue_.AsyncNext(&tag, &ok, std::chrono::system_clock::now() + left);
      if (next != grpc::CompletionQueue::GOT_EVENT) return;
      const auto now = Clock::now();
      const std::unique_ptr<Call> call(static_cast<Call*>(tag));
      --open_;
      if (call->status.ok()) {
        latencies_ms.push_back(std::chrono::duration<double, std::milli>(now - call->due).count());
      }
    }
  }

  int open() const { return open_; }
  std::vector<double> latencies_ms;  // of answers, from when they were due

 private:
  // Lives until its completion is taken.
  struct Call {
    Clock::time_point due;
    grpc::ClientContext context;
    grpc::ByteBuffer response;
    grpc::Status status;
    std::unique_ptr<grpc::GenericClientAsyncResponseReader> reader;
  };

  grpc::GenericStub stub_;
  grpc::CompletionQueue queue_;
  grpc::ByteBuffer request_;
  int open_ = 0;
};

int Main(int argc, char** argv) {
  CLI::App app("bare_client");
  std::string server, image, csv;
  double rate_hz = 100.0, seconds = 10.0;
  app.add_option("--server", server)->required();
  app.add_option("--image", image)->required();
  app.add_option("--rate", rate_hz)->check(CLI::PositiveNumber);
  app.add_option("--seconds", seconds)->check(CLI::PositiveNumber);
  app.add_option("--csv", csv);
  CLI11_PARSE(app, argc, argv);
  std::ostringstream bytes;
  bytes << std::ifstream(image, std::ios::binary).rdbuf();
  BareClient client(server, bytes.str());
  constexpr int kWarmUp = 20;
  for (int i = 0; i < kWarmUp; ++i) {
    client.Send(Clock::now());
    client.TakeUntil(Clock::now() + std::chrono::milliseconds(10));
  }
  while (client.open() > 0) client.TakeUntil(Clock::now() + std::chrono::milliseconds(10));
  client.latencies_ms.clear();
  const double cpu_s = CpuSeconds();
  const auto start = Clock::now();
  const auto count = static_cast<int64_t>(rate_hz * seconds);
  for (int64_t i = 0; i < count; ++i) {
    const std::chrono::duration<double> at(static_cast<double>(i) / rate_hz);
    const auto due = start + std::chrono::duration_cast<Clock::duration>(at);
    client.TakeUntil(due);
    client.Send(due);
  }
  while (client.open() > 0) client.TakeUntil(Clock::now() + std::chrono::milliseconds(10));
  const std::chrono::duration<double> elapsed = Clock::now() - start;
  std::printf("%.3f %% of a core, %zu of %lld answered\n",
              100.0 * (CpuSeconds() - cpu_s) / elapsed.count(),
              client.latencies_ms.size(),
              static_cast<long long>(count));
  if (!csv.empty()) {
    std::ofstream out(csv);
    for (const double ms : client.latencies_ms) out << ms << "\n";
    if (!out.flush()) return std::fprintf(stderr, "%s: cannot be written\n", csv.c_str()), 1;
  }
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
