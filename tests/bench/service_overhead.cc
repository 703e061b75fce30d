// What the service adds to a recognition: round trips of four VGA JPEGs over the loopback
// interface, less what decoding takes, with a recognition that takes no time.
//
//   service_overhead [--requests 2000] [--tls-cert F --tls-key F --tls-ca F --access-file F --token
//   T]
//
// The rest is gRPC, admission, conversion, log and, where given, TLS and the token.
#include <grpcpp/grpcpp.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "client/api.h"
#include "server/pipeline/process_cores.h"
#include "tests/support/service_fixture.h"

namespace horopter {
namespace {

v1::RecognizeSceneRequest FourPhotographs() {
  v1::RecognizeSceneRequest request;
  for (int i = 0; i < 4; ++i) {
    cv::Mat image(480, 640, CV_8UC3), noise(480, 640, CV_8UC3);
    cv::randu(noise, 0, 255);
    cv::GaussianBlur(noise, image, {0, 0}, 3.0 + i);
    std::vector<unsigned char> bytes;
    cv::imencode(".jpg", image, bytes);
    request.add_images()->set_content(bytes.data(), bytes.size());
  }
  return request;
}

double At(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values[static_cast<size_t>(share * static_cast<double>(values.size() - 1) + 0.5)];
}

int Main(int argc, char** argv) {
  CLI::App app("service_overhead");
  int requests = 2000;
  ServerOptions options;
  ClientOptions client_options;
  options.listen = "127.0.0.1:0";
  app.add_option("--requests", requests);
  app.add_option("--tls-cert", options.tls.certificate);
  app.add_option("--tls-key", options.tls.key);
  app.add_option("--tls-ca", client_options.security.ca_file);
  app.add_option("--access-file", options.access_file);
  app.add_option("--token", client_options.security.token);
  CLI11_PARSE(app, argc, argv);
  KeepFreedMemory();  // as horopterd does
  TestServer server(
      [](const SceneRequest& request, const auto&, const auto&) -> absl::StatusOr<PipelineResult> {
        PipelineResult result;
        result.answer.cameras.resize(request.images.size());
        return result;
      },
      options);
  HoropterClient client(server.server().address(), client_options);
  const v1::RecognizeSceneRequest request = FourPhotographs();
  std::vector<double> whole_ms, overhead_ms;
  for (int i = 0; i < requests + requests / 10; ++i) {
    const auto start = std::chrono::steady_clock::now();
    const auto answer = client.RecognizeScene(request);
    const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - start;
    if (!answer.ok()) return std::fprintf(stderr, "%s\n", answer.status().ToString().c_str()), 1;
    if (i < requests / 10) continue;  // warming up
    const auto& decode = answer->stages(0).elapsed();
    const double decode_ms = 1e3 * static_cast<double>(decode.seconds()) + 1e-6 * decode.nanos();
    whole_ms.push_back(took.count());
    overhead_ms.push_back(took.count() - decode_ms);
  }
  std::printf(
      "%d requests of %zu bytes: whole %.2f / %.2f ms, without decoding %.2f / %.2f ms (p50 / "
      "p99)\n",
      requests,
      request.ByteSizeLong(),
      At(whole_ms, 0.5),
      At(whole_ms, 0.99),
      At(overhead_ms, 0.5),
      At(overhead_ms, 0.99));
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
