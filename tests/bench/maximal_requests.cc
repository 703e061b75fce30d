// Sends requests as large as a server takes, all at once, and fails when the server's memory rises
// above its ceiling: what it had before, ServerLimits.memory_bytes and stage_bytes, and the four
// largest messages that gRPC may hold of those that are on their way; a twentieth of that, which
// the allocator keeps between blocks; and 16 MB of code, tables and stacks that the first requests
// touch.
//
//   maximal_requests --server HOST:PORT --pid PID [--calls 24] [--timeout S]
//
// Two raw frames of dense random blocks, so that the stages have as many edges as there can be.
// Refusals with a time to try again are answers, too; memory is the peak of resident pages.
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <cstdio>
#include <fstream>
#include <map>
#include <mutex>
#include <random>
#include <string>

#include "absl/status/status.h"
#include "horopter/v1/recognition.pb.h"
#include "horopter/v1/server.grpc.pb.h"

namespace horopter {
namespace {

constexpr int64_t kMb = 1 << 20;

// A line of /proc/PID/status, bytes.
int64_t MemoryOf(int pid, const std::string& key) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/status");
  for (std::string line; std::getline(file, line);) {
    if (line.rfind(key + ":", 0) == 0) return std::stoll(line.substr(key.size() + 1)) * 1024;
  }
  return -1;
}

std::string RandomBlocks(int width, int height) {
  constexpr int kBlock = 6;
  std::mt19937_64 random(1);
  std::string pixels(static_cast<size_t>(width) * height * 3, '\0');
  std::string row(static_cast<size_t>(width) * 3, '\0');
  for (int y = 0; y < height; ++y) {
    for (int x = 0; y % kBlock == 0 && x < width * 3; x += 3 * kBlock) {
      const char value = static_cast<char>(random());
      std::fill_n(row.begin() + x, std::min(3 * kBlock, width * 3 - x), value);
    }
    pixels.replace(static_cast<size_t>(y) * width * 3, row.size(), row);
  }
  return pixels;
}

v1::RecognizeSceneRequest Largest(const v1::ServerLimits& limits) {
  constexpr int kFrames = 2;
  constexpr int64_t kHeaders = 1024;
  const int64_t pixels = std::min({limits.max_image_pixels(),
                                   limits.max_total_pixels() / kFrames,
                                   (limits.max_recognize_bytes() - kHeaders) / (3 * kFrames)});
  const int side = static_cast<int>(std::sqrt(static_cast<double>(pixels)));
  v1::RecognizeSceneRequest request;
  for (int i = 0; i < kFrames; ++i) {
    v1::RawFrame* frame = request.add_images()->mutable_raw();
    frame->set_format(v1::RawFrame::PIXEL_FORMAT_BGR8);
    frame->set_width_px(side);
    frame->set_height_px(side);
    frame->set_data(RandomBlocks(side, side));
  }
  return request;
}

struct Outcomes {
  std::mutex mutex;
  std::condition_variable done;
  int open = 0;  // guarded by mutex, as below
  std::map<std::string, int> codes, messages;
};

// All at once. One copy of the bytes serves all calls.
void SendAll(const std::shared_ptr<grpc::Channel>& channel,
             const std::string& bytes,
             int calls,
             double timeout_s,
             Outcomes* outcomes) {
  struct Call {
    grpc::ClientContext context;
    grpc::ByteBuffer request, response;
  };
  grpc::GenericStub stub(channel);
  const grpc::Slice slice(bytes.data(), bytes.size(), grpc::Slice::STATIC_SLICE);
  std::vector<Call> all(static_cast<size_t>(calls));
  outcomes->open = calls;
  for (Call& call : all) {
    call.context.set_deadline(std::chrono::system_clock::now() +
                              std::chrono::milliseconds(static_cast<int64_t>(1e3 * timeout_s)));
    call.request = grpc::ByteBuffer(&slice, 1);
    stub.UnaryCall(&call.context,
                   "/horopter.v1.RecognitionService/RecognizeScene",
                   {},
                   &call.request,
                   &call.response,
                   [outcomes](const grpc::Status& status) {
                     const auto code = static_cast<absl::StatusCode>(status.error_code());
                     const std::lock_guard lock(outcomes->mutex);
                     ++outcomes->codes[absl::StatusCodeToString(code)];
                     if (!status.ok()) ++outcomes->messages[status.error_message()];
                     --outcomes->open;
                     outcomes->done.notify_all();
                   });
  }
  std::unique_lock lock(outcomes->mutex);
  outcomes->done.wait(lock, [&] { return outcomes->open == 0; });
}

int Main(int argc, char** argv) {
  CLI::App app("maximal_requests");
  std::string server;
  int pid = 0, calls = 24;
  double timeout_s = 120.0;
  app.add_option("--server", server)->required();
  app.add_option("--pid", pid)->required();
  app.add_option("--calls", calls);
  app.add_option("--timeout", timeout_s);
  CLI11_PARSE(app, argc, argv);
  grpc::ChannelArguments arguments;
  arguments.SetMaxSendMessageSize(-1);
  const auto channel =
      grpc::CreateCustomChannel(server, grpc::InsecureChannelCredentials(), arguments);
  v1::ServerInfo info;
  grpc::ClientContext context;
  const grpc::Status known =
      v1::ServerService::NewStub(channel)->GetServerInfo(&context, {}, &info);
  if (!known.ok()) return std::fprintf(stderr, "%s\n", known.error_message().c_str()), 1;
  const std::string bytes = Largest(info.limits()).SerializeAsString();
  const int64_t before = MemoryOf(pid, "VmRSS");
  // The peak counts from here.
  std::ofstream("/proc/" + std::to_string(pid) + "/clear_refs") << "5" << std::flush;
  Outcomes outcomes;
  SendAll(channel, bytes, calls, timeout_s, &outcomes);
  const int64_t peak = MemoryOf(pid, "VmHWM");
  const int64_t message =
      std::max(info.limits().max_recognize_bytes(), info.limits().max_object_bytes());
  const int64_t held =
      before + info.limits().memory_bytes() + info.limits().stage_bytes() + 4 * message;
  const int64_t ceiling = held + held / 20 + 16 * kMb;
  for (const auto& [code, times] : outcomes.codes) std::printf("%8d  %s\n", times, code.c_str());
  for (const auto& [text, times] : outcomes.messages) {
    std::printf("%8d  %s\n", times, text.c_str());
  }
  std::printf("%d requests of %.1f MB at once: %.0f MB before, peak %.0f MB, ceiling %.0f MB\n",
              calls,
              static_cast<double>(bytes.size()) / kMb,
              static_cast<double>(before) / kMb,
              static_cast<double>(peak) / kMb,
              static_cast<double>(ceiling) / kMb);
  for (const auto& [code, times] : outcomes.codes) {
    if (code != "OK" && code != "RESOURCE_EXHAUSTED" && code != "DEADLINE_EXCEEDED") return 1;
  }
  return before > 0 && peak > 0 && peak <= ceiling ? 0 : 1;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
