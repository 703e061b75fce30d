// A server whose recognition is a stand-in: every catalog object stands at a known place, after a
// chosen time. For tests of what is around recognition, and to measure clients by.
//
//   mock_horopterd [--delay-ms MS] [--delay-spread-ms MS] [--workers N] [--queue N]
//   [--max-wait SHARE] [--listen HOST:PORT] [--metrics-listen ..] [--version-name NAME]
//
// The options of telemetry, TLS and access are those of horopterd.
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <thread>

#include "server/pipeline/process_cores.h"
#include "server/service/grpc_log.h"
#include "server/service/log_format.h"
#include "server/service/server.h"
#include "tests/support/fake_objects.h"

namespace horopter {
namespace {

// The first object of the catalog (or of the candidates) 0.5 m in front of every camera, turned by
// 90 degrees about z; one grasp above it.
// An object to be explained has one edge without support.
PipelineResult MockAnswer(const SceneRequest& request, const std::string& id) {
  PipelineResult result;
  SceneAnswer& answer = result.answer;
  for (const cv::Mat& image : request.images) {
    PosedCamera camera;
    camera.camera = CenteredCamera(image.cols, image.rows, image.cols);
    camera.focal_log_sigma = 0.01;
    answer.cameras.push_back(camera);
  }
  answer.stages.push_back({"features", 0.001, {{"edges", 12.0}}});
  if (!request.explained.empty()) {
    Explanation found;
    found.failed = AcceptanceTest::kSupport;
    found.value = 0.25;
    found.needed = 0.5;
    found.detail = request.explained + " has too few of its edges in the images: 0.25, need 0.50";
    for (const auto& camera : answer.cameras) {
      ExplainedView& view = found.views.emplace_back().emplace();
      view.camera = camera->camera;
      view.camera_from_object.t = {0, 0, 0.5};
      view.edges.runs = {{0, EdgeState::kUnsupported, {{10, 10}, {50, 10}}}};
      view.edges.visible_px = 40.0;
    }
    answer.explanation = AnswerExplanation{request.explained, "", std::move(found)};
  }
  if (id.empty()) return result;
  AnswerObject object;
  object.object_id = id;
  object.score = 0.9;
  object.scene_from_object.R << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  object.scene_from_object.t = {0.01, 0.02, 0.5};
  for (int i = 0; i < 6; ++i) object.covariance(i, i) = 1e-6 * (i + 1);
  SceneGrasp grasp;
  grasp.name = "above";
  grasp.scene_from_gripper = object.scene_from_object;
  grasp.scene_from_pregrasp = object.scene_from_object;
  grasp.scene_from_pregrasp.t.z() -= 0.1;
  grasp.jaw_opening_m = 0.04;
  grasp.grip_width_m = 0.02;
  grasp.quality = 0.8;
  grasp.success = 0.95;
  object.grasps.push_back(grasp);
  object.grasp_counts.considered = 1;
  object.view_scores.assign(request.images.size(), 0.9);
  object.camera_covariances.assign(request.images.size(), object.covariance);
  AnswerAlternative alternative;
  alternative.kind = AlternativeKind::kMirrorImage;
  alternative.object_id = id;
  alternative.probability = request.unknown_share;
  alternative.scene_from_object = object.scene_from_object;
  alternative.scene_from_camera = object.scene_from_object;
  alternative.differing_px = 30.0;
  object.left_open.push_back(alternative);
  answer.joint_covariance = object.covariance;
  if (request.reference) answer.base_from_scene = request.reference->base_from_object;
  answer.objects.push_back(object);
  return result;
}

// What is expected of such an answer.
void JudgeMock(const SceneRequest& request, SceneAnswer* answer) {
  if (request.expected_parts.empty()) return;
  ExpectedScene scene;
  scene.base_from_scene = answer->base_from_scene;
  for (const AnswerObject& o : answer->objects)
    scene.parts.push_back({o.object_id, o.score, o.scene_from_object, {}, false});
  for (const auto& camera : answer->cameras)
    scene.cameras.push_back({camera->camera, camera->camera_from_scene});
  answer->expected = JudgeExpected(request.expected_parts, scene);
}

int Main(int argc, char** argv) {
  CLI::App app("mock_horopterd");
  double delay_ms = 0.0, spread_ms = 0.0;
  std::atomic<uint64_t> calls = 0;
  std::string db = ":memory:";
  ServerOptions options;
  options.listen = "127.0.0.1:0";
  options.workers = 2;
  app.add_option("--delay-ms", delay_ms);
  app.add_option("--delay-spread-ms", spread_ms, "up to so much longer, differently each call");
  app.add_option("--workers", options.workers);
  app.add_option("--queue", options.queue);
  app.add_option("--max-wait", options.max_wait);
  app.add_option("--listen", options.listen);
  app.add_option("--tls-cert", options.tls.certificate);
  app.add_option("--tls-key", options.tls.key);
  app.add_option("--tls-client-ca", options.tls.client_ca);
  app.add_option("--tls-reload-seconds", options.tls.reload_seconds);
  app.add_option("--access-file", options.access_file);
  app.add_option("--db", db);
  app.add_option("--cad-reader", options.cad.program);
  app.add_option("--cad-memory-mb", options.cad.memory_mb);
  app.add_option("--cad-seconds", options.cad.seconds);
  app.add_option("--admin-listen", options.admin_listen);
  app.add_flag("--open-access", options.open_access);
  app.add_option("--max-connections", options.connections.max_connections);
  app.add_option("--max-connections-per-peer", options.connections.max_per_peer);
  app.add_option("--audit-log", options.telemetry.audit_log);
  app.add_flag("--audit-required", options.telemetry.audit_required);
  app.add_option("--metrics-listen", options.telemetry.metrics_listen);
  app.add_option("--request-log", options.telemetry.request_log);
  app.add_option("--trace-file", options.telemetry.trace_file);
  app.add_option("--record-dir", options.telemetry.recorder.folder);
  app.add_option("--record-sample", options.telemetry.recorder.sample);
  options.telemetry.version = "mock";
  app.add_option("--version-name", options.telemetry.version);
  CLI11_PARSE(app, argc, argv);
  KeepFreedMemory();
  LogGrpcMessages();
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  const Recognizer recognizer = [&, delay_ms, spread_ms](
                                    const SceneRequest& request,
                                    const CatalogSnapshot& catalog,
                                    const CallLimits& limits) -> absl::StatusOr<PipelineResult> {
    // The golden ratio's multiples are spread evenly.
    const double whole = 0.6180339887498949 * static_cast<double>(++calls);
    const std::chrono::duration<double, std::milli> delay(delay_ms +
                                                          spread_ms * (whole - std::floor(whole)));
    const auto until = std::chrono::steady_clock::now() + delay;
    while (std::chrono::steady_clock::now() < until) {
      if (limits.stop()) return absl::CancelledError("stopped");
      std::this_thread::sleep_until(
          std::min<std::chrono::time_point<std::chrono::steady_clock,
                                           std::chrono::duration<double, std::nano>>>(
              until, std::chrono::steady_clock::now() + std::chrono::milliseconds(5)));
    }
    std::string id;
    if (!request.candidates.empty()) {
      id = request.candidates[0];
    } else if (!catalog.objects.empty()) {
      id = ModelOfFake(*catalog.objects[0]).id;
    }
    PipelineResult result = MockAnswer(request, id);
    JudgeMock(request, &result.answer);
    return result;
  };
  auto catalog = Catalog::Open(db);
  if (!catalog.ok()) return 1;
  auto server = HoropterServer::Start(*std::move(catalog), FakePreparer(), recognizer, options);
  if (!server.ok()) {
    spdlog::error("{}", std::string(server.status().message()));
    return 1;
  }
  spdlog::set_formatter(OneLineFormatter());
  spdlog::set_level(spdlog::level::info);
  spdlog::flush_on(spdlog::level::info);
  spdlog::info("metrics on port {}", (*server)->metrics_port());
  spdlog::info("listening on {}", (*server)->address());
  int signal = 0;
  sigwait(&signals, &signal);
  (*server)->Stop(5.0);
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
