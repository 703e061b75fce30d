#include "console/flags.h"

#include <CLI/CLI.hpp>

#include "server/checked_config.h"

namespace horopter {
namespace {

void AddListeningFlags(CLI::App& app, ConsoleOptions& console) {
  app.add_option("--listen", console.listen, "HOST:PORT for browsers; port 0 takes a free one")
      ->capture_default_str();
  app.add_option("--tls-cert", console.certificate, "Certificate chain for browsers, PEM");
  app.add_option("--tls-key", console.key, "Its private key, PEM");
  app.add_option("--name",
                 console.names,
                 "A host name that browsers may call it by, besides addresses and localhost; may "
                 "be given several times")
      ->allow_extra_args(false);
  app.add_flag("--insecure",
               console.insecure,
               "Listen, or send tokens to the server, without TLS where others can read along");
  app.add_option("--page",
                 console.page,
                 "Folder of the page; auto: beside the program or where packages have it")
      ->capture_default_str();
}

void AddServerFlags(CLI::App& app, ConsoleOptions& console) {
  app.add_option("--server", console.server, "HOST:PORT or unix:PATH of horopterd")
      ->capture_default_str()
      ->envname("HOROPTER_SERVER");
  app.add_flag("--server-tls",
               console.security.tls,
               "The server is reached with TLS and the system's authorities");
  app.add_option("--server-ca",
                 console.security.ca_file,
                 "PEM of the authority that vouches for the server")
      ->envname("HOROPTER_TLS_CA");
  app.add_option(
      "--server-cert", console.security.cert_file, "PEM of the console's own certificate");
  app.add_option("--server-key", console.security.key_file, "PEM of its key");
  app.add_option("--server-name",
                 console.security.server_name,
                 "Name in the server's certificate, where it is not the host of --server");
}

void AddBounds(CLI::App& app, ConsoleOptions& console) {
  app.add_option("--max-connections", console.max_connections, "Connections at once")
      ->check(CLI::Range(1, 100'000))
      ->capture_default_str();
  app.add_option("--max-connections-per-peer",
                 console.max_connections_per_peer,
                 "Connections of one address at once")
      ->check(CLI::Range(1, 100'000))
      ->capture_default_str();
  app.add_option("--max-calls", console.max_calls, "Calls of the server at once")
      ->check(CLI::Range(1, 100'000))
      ->capture_default_str();
  app.add_option("--max-watches", console.max_watches, "Pages at once that watch answers (Live)")
      ->check(CLI::Range(1, 10'000))
      ->capture_default_str();
  app.add_option("--max-body-mb", console.max_body_mb, "Largest request, MiB")
      ->check(CLI::Range(1, 2047))
      ->capture_default_str();
  app.add_option("--memory-mb", console.memory_mb, "Requests on their way to the server, MiB")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app.add_option("--requests-per-second",
                 console.rate.per_second,
                 "Of one address in the long run; ten times as many at once")
      ->check(CLI::Range(0.1, 1e6))
      ->capture_default_str();
  app.add_option("--sign-ins-per-minute",
                 console.sign_ins_per_minute,
                 "Of one address, good or bad, in the long run; ten at once and as many more")
      ->check(CLI::Range(0.1, 1e7))
      ->capture_default_str();
  app.add_option("--session-idle-minutes",
                 console.session.idle_minutes,
                 "Who asks nothing for so long signs in again")
      ->check(CLI::Range(0.01, 1e5))
      ->capture_default_str();
  app.add_option("--session-hours",
                 console.session.lifetime_hours,
                 "Everybody signs in again after so long")
      ->check(CLI::Range(0.01, 1e4))
      ->capture_default_str();
  app.add_option("--stop-seconds", console.stop_seconds, "Time for running calls after SIGTERM")
      ->check(CLI::Range(0.0, 3600.0))
      ->capture_default_str();
}

}  // namespace

void AddConsoleFlags(CLI::App& app, ConsoleFlags& flags) {
  AddCheckedConfig(app);
  AddListeningFlags(app, flags.console);
  AddServerFlags(app, flags.console);
  AddBounds(app, flags.console);
  app.add_option("--log-level", flags.log_level, "debug, info, warning, error")
      ->check(CLI::IsMember({"debug", "info", "warning", "error"}))
      ->capture_default_str();
}

}  // namespace horopter
