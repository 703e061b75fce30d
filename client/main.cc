// horopter: the operator's program. See `horopter --help`.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <string>

#include "client/cli.h"
#include "client/interrupt.h"
#include "client/output.h"
#include "client/shown.h"
#include "client/token.h"

namespace horopter {
namespace {

constexpr char kExitCodes[] =
    "Exit codes:\n"
    "  0    done\n"
    "  1    the server or this program failed\n"
    "  2    wrong usage\n"
    "  3    the input or the caller was refused\n"
    "  4    the server cannot be reached, is too busy or did not answer in time\n"
    "  5    of the parts expected (recognize --expect) not all are present\n"
    "  130  interrupted";

int ExitCode(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kOk:
      return 0;
    case absl::StatusCode::kInvalidArgument:
    case absl::StatusCode::kNotFound:
    case absl::StatusCode::kAlreadyExists:
    case absl::StatusCode::kFailedPrecondition:
    case absl::StatusCode::kPermissionDenied:
    case absl::StatusCode::kUnauthenticated:
      return 3;
    case absl::StatusCode::kUnavailable:
    case absl::StatusCode::kDeadlineExceeded:
    case absl::StatusCode::kResourceExhausted:
      return 4;
    case absl::StatusCode::kOutOfRange:
      return 5;
    case absl::StatusCode::kCancelled:
      return Interrupted() ? 130 : 1;
    default:
      return 1;
  }
}

// One line on stderr; with --json an object.
void ReportError(const absl::Status& status) {
  const std::string code = absl::StatusCodeToString(status.code());
  const std::string message(status.message());
  if (!JsonOutput()) {
    std::fprintf(stderr, "horopter: %s: %s\n", code.c_str(), Shown(message).c_str());
    return;
  }
  nlohmann::json error = {{"code", code}, {"message", message}};
  if (const std::string id = RequestIdOf(status); !id.empty()) error["request_id"] = id;
  if (const std::string field = ErrorFieldOf(status); !field.empty()) error["field"] = field;
  if (const auto ms = RetryAfterMsOf(status)) error["retry_after_ms"] = *ms;
  const nlohmann::json line = {{"error", error}};
  std::fprintf(
      stderr, "%s\n", line.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace).c_str());
}

void AddSecurityOptions(CLI::App& app, ChannelSecurity& security, std::string& token_file) {
  app.add_flag("--tls", security.tls, "encrypted, with the system's authorities");
  app.add_option("--tls-ca", security.ca_file, "PEM of the authority that vouches for the server")
      ->envname("HOROPTER_TLS_CA");
  app.add_option("--tls-cert", security.cert_file, "PEM of this client's certificate")
      ->envname("HOROPTER_TLS_CERT");
  app.add_option("--tls-key", security.key_file, "PEM of its key")->envname("HOROPTER_TLS_KEY");
  app.add_option("--tls-server-name",
                 security.server_name,
                 "name in the server's certificate, where it is not the host of --server");
  app.add_flag(
      "!--no-proxy",
      security.proxy,
      "do not use the proxy that the environment names; this machine, and what no_proxy or "
      "NO_PROXY names, is reached without it anyway");
  app.add_option("--token-file",
                 token_file,
                 "file with the token that says who asks; or HOROPTER_TOKEN is the token")
      ->envname("HOROPTER_TOKEN_FILE");
}

// Of the file, or of the environment; empty: none.
absl::StatusOr<std::string> ReadToken(const std::string& path) {
  if (!path.empty()) return ReadTokenFile(path);
  const char* const token = std::getenv("HOROPTER_TOKEN");
  return CleanToken(token == nullptr ? "" : token, "HOROPTER_TOKEN");
}

// gRPC ends the program where a call's metadata are anything else.
std::string Printable(const std::string& text) {
  const bool good = std::all_of(text.begin(), text.end(), [](char c) { return c > 32 && c < 127; });
  return good ? "" : "holds characters other than printable ASCII";
}

int Main(int argc, char** argv) {
  CLI::App app{"Recognises known parts in images from uncalibrated cameras.", "horopter"};
  std::string server = "localhost:50051";
  ClientOptions options;
  options.max_retries = 5;
  bool json = false;
  std::string token_file;
  Command command;
  app.require_subcommand(1);
  app.set_version_flag("--version", "horopter " HOROPTER_VERSION);
  app.add_option("--server", server, "HOST:PORT or unix:PATH")
      ->capture_default_str()
      ->envname("HOROPTER_SERVER");
  app.add_option("--timeout", options.timeout_s, "seconds for one call, with its retries")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  app.add_option("--retries",
                 options.max_retries,
                 "tries again when the server is busy, after the time it asks for")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
  AddSecurityOptions(app, options.security, token_file);
  app.add_option("--variants",
                 options.variants,
                 "NAME=VALUE,..: variants of the methods, for measuring; the server names them and "
                 "takes them with --allow-variants")
      ->check(Printable);
  app.add_option("--min-generation",
                 options.min_generation,
                 "of servers that share a catalog: scenes are answered by what was written up to "
                 "this revision, which another server acknowledged")
      ->check(CLI::NonNegativeNumber);
  app.add_flag("--json", json, "print JSON, one value a line, errors too");
  app.footer(kExitCodes);
  AddRecognizeCommand(app, &command);
  AddExplainCommand(app, &command);
  AddObjectCommands(app, &command);
  AddCatalogCommands(app, &command);
  AddDatasetCommands(app, &command);
  AddStationCommands(app, &command);
  AddToolCommands(app, &command);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  SetJsonOutput(json);
  CatchInterrupts();
  options.interrupted = Interrupted;
  options.on_retry = [](int ms) {
    std::fprintf(stderr, "the server is busy; trying again in %.1f s\n", ms / 1e3);
  };
  absl::StatusOr<std::string> token = ReadToken(token_file);
  absl::Status status = token.status();
  if (token.ok()) {
    if (!token->empty()) KeepTokensOutOfCoreDumps();
    options.security.token = *std::move(token);
    HoropterClient client(server, options);
    status = command(client);
  }
  if (!status.ok()) ReportError(status);
  return ExitCode(status);
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
