// horopter-console: the operator's page, a client of horopterd like any other.
#include <spdlog/spdlog.h>
#include <systemd/sd-daemon.h>

#include <CLI/CLI.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/signal_set.hpp>
#include <csignal>
#include <functional>
#include <iostream>
#include <string>

#include "client/token.h"
#include "console/console_server.h"
#include "console/flags.h"

namespace horopter {
namespace {

constexpr char kExitCodes[] =
    "Exit codes:\n"
    "  0    stopped as it was told\n"
    "  1    could not start: the port is taken, a file cannot be read\n"
    "  2    wrong usage or configuration";

int Serve(const ConsoleFlags& flags) {
  boost::asio::io_context context(1);
  auto server = ConsoleServer::Start(context, flags.console);
  if (!server.ok()) {
    std::cerr << "horopter-console: " << server.status().message() << std::endl;
    return server.status().code() == absl::StatusCode::kInvalidArgument ? 2 : 1;
  }
  boost::asio::signal_set signals(context, SIGTERM, SIGINT, SIGHUP);
  bool stopping = false;
  const std::function<void()> wait = [&] {
    signals.async_wait([&](boost::system::error_code error, int signal) {
      if (error) return;
      if (signal == SIGHUP) {
        const absl::Status read = (*server)->Reload();
        spdlog::info("signal {}: page and certificate are read anew{}",
                     signal,
                     read.ok() ? "" : ": " + std::string(read.message()));
        return wait();
      }
      ::sd_notify(0, "STOPPING=1");
      spdlog::info("signal {}: stopping", signal);
      (*server)->Stop();
      if (!stopping) {
        stopping = true;
        wait();
      }
    });
  };
  wait();
  if (!(*server)->has_page()) spdlog::warn("the page is not installed: only calls are served");
  spdlog::info(
      "serving browsers on {}, calls go to {}", (*server)->address(), flags.console.server);
  ::sd_notify(0, "READY=1");
  // The signals alone would keep it running.
  while (!context.stopped()) {
    if (stopping && (*server)->idle()) break;
    context.run_one();
  }
  spdlog::info("stopped");
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  std::signal(SIGPIPE, SIG_IGN);
  horopter::KeepTokensOutOfCoreDumps();
  horopter::ConsoleFlags flags;
  flags.console.page = "auto";
  CLI::App app("horopter-console: the operator's page of Horopter, for browsers");
  app.set_version_flag("--version", "horopter-console " HOROPTER_VERSION);
  app.footer(horopter::kExitCodes);
  horopter::AddConsoleFlags(app, flags);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  flags.console.rate.burst = 10.0 * flags.console.rate.per_second;
  spdlog::set_level(spdlog::level::from_str(flags.log_level));
  spdlog::flush_on(spdlog::level::info);
  return horopter::Serve(flags);
}
