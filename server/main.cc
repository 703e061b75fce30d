// horopterd: flags, wiring, shutdown.
#include <pthread.h>
#include <spdlog/spdlog.h>
#include <sys/resource.h>
#include <systemd/sd-daemon.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <functional>
#include <iostream>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_replace.h"
#include "db/catalog.h"
#include "server/flags.h"
#include "server/pipeline/pipeline.h"
#include "server/pipeline/process_cores.h"
#include "server/service/grpc_log.h"
#include "server/service/listen_address.h"
#include "server/service/log_format.h"
#include "server/service/server.h"
#include "server/service/transport_security.h"
#include "server/service/waiting_listener.h"

namespace horopter {
namespace {

constexpr int kUnreachable = 3;  // exit code

// Takes SIGTERM, SIGINT and SIGHUP from the start on: the first asks to stop, also while the
// catalog is loaded; a second one ends at once, for whoever asks twice does not want to wait, and
// what was acknowledged is on disk. SIGHUP never ends anything: files are opened anew once there is
// a server.
class Signals {
 public:
  explicit Signals(const sigset_t& signals) {
    std::thread([this, signals] {
      for (;;) Take(Next(signals));
    }).detach();
  }

  bool asked() const { return asked_; }
  // To stop, as a signal does; the server's exit code.
  void Ask(int exit_code) {
    const std::lock_guard lock(mutex_);
    asked_ = true;
    exit_code_ = exit_code;
    changed_.notify_all();
  }
  // Returns the exit code once somebody has asked to stop; `reload` at each SIGHUP until then.
  int Wait(const std::function<void()>& reload) {
    std::unique_lock lock(mutex_);
    for (;;) {
      changed_.wait(lock, [this] { return asked_.load() || reload_; });
      if (asked_) return exit_code_;
      reload_ = false;
      lock.unlock();
      reload();
      lock.lock();
    }
  }

 private:
  static int Next(const sigset_t& signals) {
    int signal = 0;
    sigwait(&signals, &signal);
    return signal;
  }
  void Take(int signal) {
    if (signal == SIGHUP) {
      const std::lock_guard lock(mutex_);
      reload_ = true;
      changed_.notify_all();
      return;
    }
    if (asked_) {
      spdlog::warn("signal {} again: ending at once", signal);
      ::_exit(128 + signal);
    }
    spdlog::info("signal {}: stopping", signal);
    Ask(0);
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  std::atomic<bool> asked_{false};
  int exit_code_ = 0;    // guarded by mutex_
  bool reload_ = false;  // the same
};

// A thousand connections are more than the 1,024 descriptors that processes begin with.
void RaiseDescriptorLimit() {
  rlimit descriptors = {};
  if (::getrlimit(RLIMIT_NOFILE, &descriptors) != 0) return;
  descriptors.rlim_cur = descriptors.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &descriptors);
}

int Fail(const absl::Status& status) {
  std::cerr << "horopterd: " << status.message() << std::endl;
  return 1;
}

// What systemd is told, when it has started us.
void TellSystemd(const char* state) {
  ::sd_notify(0, state);
}

void WatchPorts(HoropterServer& server, const Flags& flags, Signals& signals) {
  uint64_t watchdog_us = 0;
  const bool watchdog = ::sd_watchdog_enabled(0, &watchdog_us) > 0;
  PortWatchOptions options;
  options.every_seconds = flags.self_check_seconds;
  if (options.every_seconds <= 0.0) {
    if (watchdog)
      spdlog::warn("systemd's watchdog waits for the self-check, which is switched off");
    return;
  }
  server.WatchPorts(
      options,
      [] { TellSystemd("WATCHDOG=1"); },
      [&signals](const std::string& why) {
        spdlog::error("the server cannot be reached any more and ends: {}", why);
        signals.Ask(kUnreachable);
      });
}

// What is told where the server's address is while its database cannot be reached; null where the
// address is not known yet, or not to be had.
std::unique_ptr<WaitingListener> ListenWaiting(const ServerOptions& options) {
  const absl::StatusOr<ListenAddress> address = ParseListenAddress("listen", options.listen);
  const bool any_port =
      address.ok() && address->kind == ListenAddress::Kind::kTcp && address->port == 0;
  if (!address.ok() || any_port) return nullptr;
  auto listener =
      WaitingListener::Start(options.listen,
                             options.tls,
                             options.connections,
                             "this server waits for the database of its catalog, which it cannot "
                             "reach; it is tried again every second");
  if (listener.ok()) return *std::move(listener);
  spdlog::error("{}", std::string(listener.status().message()));
  return nullptr;
}

// Of a database that cannot be reached it is tried again until somebody asks to stop: CANCELLED.
absl::StatusOr<std::unique_ptr<Catalog>> OpenCatalog(const Flags& flags, const Signals& signals) {
  constexpr auto kStep = std::chrono::milliseconds(100);
  constexpr int kStepsBetween = 10, kTellEvery = 30;  // attempts
  std::unique_ptr<WaitingListener> waiting;
  for (int attempt = 0;; ++attempt) {
    absl::StatusOr<std::unique_ptr<Catalog>> catalog =
        Catalog::Open(flags.db, {.accept_unclosed = flags.accept_unclosed_db});
    if (catalog.ok() || !absl::IsUnavailable(catalog.status()) || !Catalog::IsSharedPath(flags.db))
      return catalog;
    if (waiting == nullptr) waiting = ListenWaiting(flags.server);
    if (attempt % kTellEvery == 0) {
      spdlog::error("{}; it is tried again every second, and nothing is served until then",
                    std::string(catalog.status().message()));
    }
    for (int i = 0; i < kStepsBetween; ++i) {
      if (signals.asked()) return absl::CancelledError("stopped");
      std::this_thread::sleep_for(kStep);
    }
  }
}

int CopyCatalog(const Flags& flags, const Signals& signals) {
  const auto copied = Catalog::Migrate(
      flags.db,
      flags.copy_catalog_to,
      [&] { return signals.asked(); },
      [told = std::chrono::steady_clock::now()](int done, int total) mutable {
        const auto now = std::chrono::steady_clock::now();
        if (done < total && now - told < std::chrono::seconds(2)) return;
        told = now;
        spdlog::info("{} of {} objects", done, total);
      });
  if (!copied.ok()) return Fail(copied.status());
  std::cout << copied->objects << " objects, " << copied->copied
            << " of them copied now; both have "
            << "digest " << copied->digest << "\n";
  return 0;
}

// Opens the catalog and loads it. A database that goes away while it is loaded is waited for again.
absl::StatusOr<std::unique_ptr<HoropterServer>> StartServer(const Flags& flags,
                                                            const Signals& signals) {
  constexpr int kMostStarts = 5;
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
  for (int start = 1;; ++start) {
    absl::StatusOr<std::unique_ptr<Catalog>> catalog = OpenCatalog(flags, signals);
    if (!catalog.ok()) return catalog.status();
    absl::StatusOr<std::unique_ptr<HoropterServer>> server = HoropterServer::Start(
        *std::move(catalog), CatalogPreparer(), recognizer, flags.server, [&] {
          return signals.asked();
        });
    if (server.ok() || !absl::IsUnavailable(server.status()) || start == kMostStarts ||
        !Catalog::IsSharedPath(flags.db)) {
      return server;
    }
    spdlog::error("{}; it is begun anew", std::string(server.status().message()));
  }
}

int Serve(const Flags& flags, Signals& signals) {
  if (const absl::Status valid = Validate(flags.server); !valid.ok()) return Fail(valid);
  // A server that will not serve has not brought its catalog to another version, either.
  if (const auto tls = CheckTlsFiles(flags.server.tls); !tls.ok()) return Fail(tls.status());
  spdlog::info("loading catalog {}", Catalog::ShownPath(flags.db));
  const absl::StatusOr<std::unique_ptr<HoropterServer>> server = StartServer(flags, signals);
  if (!server.ok() && signals.asked()) {
    spdlog::info("stopped while the catalog was loaded");
    return 0;
  }
  if (!server.ok()) return Fail(server.status());

  const auto published = (*server)->store().Published();
  spdlog::info("catalog {}: {} objects ready{}",
               Catalog::ShownPath(flags.db),
               published->ids.size(),
               published->pending.empty()
                   ? std::string()
                   : ", " + std::to_string(published->pending.size()) + " to be prepared");
  if (const int port = (*server)->metrics_port(); port != 0) {
    spdlog::info("metrics on port {}", port);
  }
  if (!(*server)->admin_address().empty()) {
    spdlog::info("admin calls on {}", (*server)->admin_address());
  }
  spdlog::info("listening on {}", (*server)->address());
  WatchPorts(**server, flags, signals);
  TellSystemd("READY=1");
  const int exit_code = signals.Wait([&server] {
    spdlog::info("signal {}: logs, access file and certificates are opened anew", SIGHUP);
    (*server)->Reload();
  });
  TellSystemd("STOPPING=1");
  spdlog::info("draining for at most {} s", flags.drain_seconds);
  (*server)->Stop(flags.drain_seconds);
  spdlog::info("stopped");
  return exit_code;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  // Before any thread exists, so that all of them inherit the mask and sigwait gets the signal.
  sigset_t signals;
  sigemptyset(&signals);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP}) sigaddset(&signals, signal);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);

  horopter::Flags flags;
  flags.server.listen = "localhost:50051";
  flags.server.cad.program = "auto";
  CLI::App app("horopterd: recognises known parts in images from uncalibrated cameras");
  app.set_version_flag("--version", "horopterd " HOROPTER_VERSION);
  horopter::AddFlags(app, flags);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  if (flags.db.empty()) flags.db = horopter::DefaultCatalog();
  std::string& cad_reader = flags.server.cad.program;
  if (cad_reader == "auto") cad_reader = horopter::FindCadReader();
  if (cad_reader == "none") cad_reader.clear();
  if (flags.cores == 0) {
    flags.cores = static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1u, 64u));
  }
  flags.server.load_threads = flags.cores;
  flags.server.rankers.threads = flags.server.threads_per_request;
  // A configuration that names none has an empty one.
  std::erase(flags.server.rankers.addresses, "");
  flags.server.telemetry.version = HOROPTER_VERSION;
  flags.server.telemetry.settings = absl::StrReplaceAll(
      app.config_to_str(true, false), {{flags.db, horopter::Catalog::ShownPath(flags.db)}});
  horopter::RaiseDescriptorLimit();
  horopter::SetProcessCores(flags.cores);
  horopter::KeepFreedMemory();
  spdlog::set_formatter(horopter::OneLineFormatter());
  spdlog::set_level(spdlog::level::from_str(flags.log_level));
  spdlog::flush_on(spdlog::level::info);
  horopter::LogGrpcMessages();
  // Its thread waits as long as the process lives.
  static horopter::Signals* const taken = new horopter::Signals(signals);
  if (!flags.copy_catalog_to.empty()) return horopter::CopyCatalog(flags, *taken);
  return horopter::Serve(flags, *taken);
}
