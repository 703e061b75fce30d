// horopterd: flags, wiring, shutdown.
#include <pthread.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <csignal>
#include <iostream>
#include <mutex>
#include <string>
#include <thread>

#include "db/catalog.h"
#include "server/pipeline/pipeline.h"
#include "server/pipeline/process_cores.h"
#include "server/service/log_format.h"
#include "server/service/server.h"

namespace horopter {
namespace {

struct Flags {
  std::string db;
  std::string log_level = "info";
  int cores = 1;
  double drain_seconds = 30.0;
  ServerOptions server;
};

void AddTrustFlags(CLI::App& app, ServerOptions& server) {
  app.add_option("--tls-cert", server.tls.certificate, "Certificate chain of the server, PEM");
  app.add_option("--tls-key", server.tls.key, "Its private key, PEM");
  app.add_option("--tls-client-ca",
                 server.tls.client_ca,
                 "Clients need a certificate of this authority, PEM (default: they need none)");
  app.add_option("--tls-reload-seconds",
                 server.tls.reload_seconds,
                 "Time between two looks at these files for changes")
      ->capture_default_str();
  app.add_option(
      "--access-file",
      server.access_file,
      "Hashed tokens and certificates with roles, one a line; read again when it changes "
      "(default: all may do all)");
  app.add_flag(
      "--insecure", server.insecure, "Listen without TLS where other machines can read along");
  app.add_option("--admin-listen",
                 server.admin_listen,
                 "unix:PATH or HOST:PORT of a second listener that alone serves writes, "
                 "verification, backups and reflection");
  app.add_flag("--admin-calls,!--no-admin-calls",
               server.admin_calls,
               "Serve writes, verification and backups on --listen")
      ->capture_default_str();
  app.add_flag("--reflection,!--no-reflection",
               server.reflection,
               "Serve gRPC's reflection, which tells the messages' fields to anybody")
      ->capture_default_str();
}

// What is kept in memory and what a message may hold.
void AddLimitFlags(CLI::App& app, ServerOptions& server) {
  app.add_option("--max-resident",
                 server.max_resident,
                 "Objects held in memory; of a larger catalog only the keys are")
      ->capture_default_str();
  app.add_option("--max-objects",
                 server.max_objects,
                 "Objects in the catalog; above 5000 requests have to name candidates")
      ->check(CLI::Range(1, 10'000'000))
      ->capture_default_str();
  app.add_option("--max-message-mb", server.max_message_mb, "Largest request for recognition, MiB")
      ->check(CLI::Range(1, 2047))
      ->capture_default_str();
  app.add_option("--max-object-mb", server.max_object_mb, "Largest object with its CAD file, MiB")
      ->check(CLI::Range(1, 2047))
      ->capture_default_str();
  app.add_option(
         "--memory-mb", server.memory_mb, "Requests, images and working memory of all calls, MiB")
      ->check(CLI::Range(16, 1'000'000))
      ->capture_default_str();
  app.add_option("--max-image-pixels", server.images.max_pixels, "Largest image")
      ->capture_default_str();
  app.add_flag("--tiff-and-pnm",
               server.images.tiff_and_pnm,
               "Also read TIFF and PNM images; only for clients that are trusted");
}

void AddFlags(CLI::App& app, Flags& flags) {
  app.set_config("--config", "", "Read options from a TOML or INI file; the command line wins");
  app.add_option("--db", flags.db, "Catalog file, created when it is not there")->required();
  app.add_option("--listen", flags.server.listen, "HOST:PORT; port 0 takes a free one")
      ->capture_default_str();
  AddTrustFlags(app, flags.server);
  app.add_option("--workers", flags.server.workers, "Scenes recognised at the same time")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  app.add_option("--cores", flags.cores, "Cores to use: one pool for all scenes and the start")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  app.add_option("--threads-per-request",
                 flags.server.threads_per_request,
                 "Cores that work on one scene, of --cores")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  app.add_option("--queue", flags.server.queue, "Scenes that may wait before new ones are refused")
      ->check(CLI::Range(0, 10000))
      ->capture_default_str();
  app.add_option("--max-wait",
                 flags.server.max_wait,
                 "Refuse scenes that would wait longer than this share of a scene's mean time; 0: "
                 "only the queue bounds it")
      ->check(CLI::Range(0.0, 1e4))
      ->capture_default_str();
  AddLimitFlags(app, flags.server);
  app.add_flag("--allow-variants",
               flags.server.allow_variants,
               "Requests may choose variants of the methods in metadata, horopter-variants; for "
               "operators");
  app.add_option("--drain-seconds", flags.drain_seconds, "Time for running requests after SIGTERM")
      ->check(CLI::Range(0.0, 3600.0))
      ->capture_default_str();
  app.add_option("--log-level", flags.log_level, "debug, info, warning, error")
      ->check(CLI::IsMember({"debug", "info", "warning", "error"}))
      ->capture_default_str();
}

void AddTelemetryFlags(CLI::App& app, TelemetryOptions& telemetry) {
  app.add_option("--metrics-listen",
                 telemetry.metrics_listen,
                 "ADDRESS:PORT for Prometheus, e.g. 127.0.0.1:9464; /metrics (default: none)");
  app.add_option("--request-log",
                 telemetry.request_log,
                 "File with one JSON line a request, - for stdout (default: none)");
  app.add_option("--audit-log",
                 telemetry.audit_log,
                 "File with one JSON line per write, verification or backup, refused ones too "
                 "(default: none)");
  app.add_option("--trace-file",
                 telemetry.trace_file,
                 "File with spans in OTLP/JSON, one line a request (default: none)");
  RecorderOptions& recorder = telemetry.recorder;
  app.add_option("--record-dir",
                 recorder.folder,
                 "Folder that keeps requests with images and answers (default: nothing is kept)");
  app.add_option(
         "--record-failed", recorder.failed, "Keep those that failed or found nothing: true, false")
      ->capture_default_str();
  app.add_option("--record-sample", recorder.sample, "Share of the others that is kept; 1: all")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--record-max-mb", recorder.max_mb, "Size of the folder; the oldest go first")
      ->check(CLI::Range(1, 10'000'000))
      ->capture_default_str();
  app.add_option("--record-max-age-hours", recorder.max_age_hours, "Older ones go")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
}

// Takes SIGTERM and SIGINT from the start on: the first asks to stop, also while the catalog is
// loaded; the second ends at once, for whoever asks twice does not want to wait, and what was
// acknowledged is on disk.
class StopSignals {
 public:
  explicit StopSignals(const sigset_t& signals) {
    std::thread([this, signals] {
      Take(signals);
      const int signal = Next(signals);
      spdlog::warn("signal {} again: ending at once", signal);
      ::_exit(128 + signal);
    }).detach();
  }

  bool asked() const { return asked_; }
  void Wait() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return asked_.load(); });
  }

 private:
  static int Next(const sigset_t& signals) {
    int signal = 0;
    sigwait(&signals, &signal);
    return signal;
  }
  void Take(const sigset_t& signals) {
    const int signal = Next(signals);
    spdlog::info("signal {}: stopping", signal);
    const std::lock_guard lock(mutex_);
    asked_ = true;
    changed_.notify_all();
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  std::atomic<bool> asked_{false};
};

int Fail(const absl::Status& status) {
  std::cerr << "horopterd: " << status.message() << std::endl;
  return 1;
}

int Serve(const Flags& flags, StopSignals& signals) {
  if (const absl::Status valid = Validate(flags.server); !valid.ok()) return Fail(valid);
  spdlog::info("loading catalog {}", flags.db);
  absl::StatusOr<std::unique_ptr<Catalog>> catalog = Catalog::Open(flags.db);
  if (!catalog.ok()) return Fail(catalog.status());

  PipelineOptions options;
  options.threads = flags.server.threads_per_request;
  const Recognizer recognizer = [options](const SceneRequest& request,
                                          const CatalogSnapshot& snapshot,
                                          const CallLimits& limits) {
    PipelineOptions of_call = options;
    of_call.recognition.hurry = limits.hurry;
    of_call.recognition.allowed_s = limits.allowed_s;
    return RecognizeScene(request, snapshot, of_call, limits.stop);
  };
  absl::StatusOr<std::unique_ptr<HoropterServer>> server =
      HoropterServer::Start(*std::move(catalog), CatalogPreparer(), recognizer, flags.server, [&] {
        return signals.asked();
      });
  if (!server.ok() && signals.asked()) {
    spdlog::info("stopped while the catalog was loaded");
    return 0;
  }
  if (!server.ok()) return Fail(server.status());

  spdlog::info(
      "catalog {}: {} objects ready", flags.db, (*server)->store().Published()->ids.size());
  if (const int port = (*server)->metrics_port(); port != 0) {
    spdlog::info("metrics on port {}", port);
  }
  if (!(*server)->admin_address().empty()) {
    spdlog::info("admin calls on {}", (*server)->admin_address());
  }
  spdlog::info("listening on {}", (*server)->address());
  signals.Wait();
  spdlog::info("draining for at most {} s", flags.drain_seconds);
  (*server)->Stop(flags.drain_seconds);
  spdlog::info("stopped");
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  // Before any thread exists, so that all of them inherit the mask and sigwait gets the signal.
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);

  horopter::Flags flags;
  flags.server.listen = "localhost:50051";
  flags.cores = static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1u, 64u));
  CLI::App app("horopterd: recognises known parts in images from uncalibrated cameras");
  app.set_version_flag("--version", "horopterd " HOROPTER_VERSION);
  horopter::AddFlags(app, flags);
  horopter::AddTelemetryFlags(app, flags.server.telemetry);
  app.add_flag_callback(
         "--print-config",
         [&app] {
           std::cout << app.config_to_str(true, true);
           throw CLI::Success();
         },
         "Print a configuration file with every option, its default and what it does")
      ->configurable(false);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  flags.server.load_threads = flags.cores;
  flags.server.telemetry.version = HOROPTER_VERSION;
  flags.server.telemetry.settings = app.config_to_str(true, false);
  horopter::SetProcessCores(flags.cores);
  horopter::KeepFreedMemory();
  spdlog::set_formatter(horopter::OneLineFormatter());
  spdlog::set_level(spdlog::level::from_str(flags.log_level));
  spdlog::flush_on(spdlog::level::info);
  // Its thread waits as long as the process lives.
  static horopter::StopSignals* const stop_signals = new horopter::StopSignals(signals);
  return horopter::Serve(flags, *stop_signals);
}
