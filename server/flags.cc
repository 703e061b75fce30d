#include "server/flags.h"

#include <CLI/CLI.hpp>
#include <cstdlib>

#include "server/checked_config.h"

namespace horopter {
namespace {

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
      "--insecure",
      server.insecure,
      "Listen without TLS where other machines can read along, and without an access file");
  app.add_flag("--open-access",
               server.open_access,
               "With TLS, but without an access file: whoever connects may do everything");
  app.add_option("--admin-listen",
                 server.admin_listen,
                 "unix:PATH or HOST:PORT of a second listener that alone serves writes, "
                 "verification, backups and reflection");
  app.add_flag("--admin-calls,!--no-admin-calls",
               server.admin_calls,
               "Serve writes, verification and backups on --listen")
      ->default_str("true");
  app.add_flag("--reflection,!--no-reflection",
               server.reflection,
               "Serve gRPC's reflection, which tells the messages' fields to anybody")
      ->default_str("true");
}

void AddConnectionFlags(CLI::App& app, Flags& flags) {
  ConnectionLimits& connections = flags.server.connections;
  app.add_option("--max-connections",
                 connections.max_connections,
                 "Connections of a listener at once; fewer where the process may have fewer files")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app.add_option("--max-connections-per-peer",
                 connections.max_per_peer,
                 "Connections of one address at once; of IPv6, of a /64")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app.add_option(
         "--max-connection-age-seconds",
         flags.server.max_connection_age_seconds,
         "Age at which a connection is asked to end and its client connects anew: lower where "
         "several servers share one name")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app.add_option(
         "--self-check-seconds",
         flags.self_check_seconds,
         "Time between two looks whether the listeners' own ports answer; three in vain end "
         "the server (exit code 3); 0: nobody looks")
      ->check(CLI::Range(0.0, 3600.0))
      ->capture_default_str();
}

// What is kept in memory and what a message may hold.
void AddLimitFlags(CLI::App& app, ServerOptions& server) {
  app.add_option("--max-resident",
                 server.max_resident,
                 "Objects held in memory; of a larger catalog so many of those used last are")
      ->capture_default_str();
  app.add_option("--derived-cache",
                 server.derived_cache,
                 "Folder that keeps what is derived of objects, so that a database is asked for it "
                 "once; none unless given");
  app.add_option("--derived-cache-mb",
                 server.derived_cache_mb,
                 "Largest size of it, MiB; what was used least lately goes")
      ->check(CLI::Range(1, 100'000'000))
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
  app.add_option(
         "--max-watchers",
         server.watch.max_watchers,
         "Observers and admins who watch answers as they come; 0: none, and no answer is held")
      ->check(CLI::Range(0, 10'000))
      ->capture_default_str();
  app.add_option(
         "--watch-memory-mb",
         server.watch.memory_mb,
         "Beside --memory-mb: the last answers with their images, and those on their way to "
         "watchers, MiB")
      ->check(CLI::Range(1, 100'000))
      ->capture_default_str();
  app.add_option("--cad-reader",
                 server.cad.program,
                 "Program that reads CAD files that clients send; auto: horopter-cad-reader beside "
                 "this one or in ../libexec/horopter; none: such files are refused")
      ->capture_default_str();
  app.add_option("--cad-memory-mb", server.cad.memory_mb, "Memory for reading one of them, MiB")
      ->check(CLI::Range(64, 1'000'000))
      ->capture_default_str();
  app.add_option(
         "--cad-seconds", server.cad.seconds, "Processor time for reading one of them, seconds")
      ->check(CLI::Range(1, 3600))
      ->capture_default_str();
  app.add_flag("--tiff-and-pnm",
               server.images.tiff_and_pnm,
               "Also read TIFF and PNM images; only for clients that are trusted");
}

// Parts of a very large catalog are ranked by processes of their own.
void AddRankingFlags(CLI::App& app, ServerOptions& server) {
  app.add_option(
         "--role",
         server.role,
         "server; ranker: holds the keys of a share of the catalog and says to other servers "
         "which parts images may show")
      ->check(CLI::IsMember({"server", "ranker"}))
      ->capture_default_str();
  app.add_option("--shard", server.shard, "Of a ranker: which share it holds, NUMBER/COUNT")
      ->capture_default_str();
  app.add_option("--rankers",
                 server.rankers.addresses,
                 "HOST:PORT of the ranker of each shard, in their order, with commas between "
                 "(default: none)")
      ->delimiter(',');
  app.add_option("--ranker-ca",
                 server.rankers.ca,
                 "Authority of the rankers' certificates, PEM (default: they have no TLS)");
  app.add_option(
      "--ranker-token", server.rankers.token_file, "File with the token that the rankers want");
  app.add_option("--rank-above",
                 server.rankers.above,
                 "Requests without candidates ask the rankers in catalogs of more objects")
      ->check(CLI::Range(0, 10'000'000))
      ->capture_default_str();
  app.add_option("--ranker-seconds",
                 server.rankers.seconds,
                 "How long the rankers' answers are waited for, at most a quarter of a request's "
                 "time; parts of those that are late are not looked for")
      ->check(CLI::Range(0.01, 3600.0))
      ->capture_default_str();
}

void AddServingFlags(CLI::App& app, Flags& flags) {
  app.add_option("--db",
                 flags.db,
                 "Catalog file, created when it is not there, or postgresql://USER@HOST/NAME of a "
                 "database that several servers share; passwords belong in a passfile (default: "
                 "parts.db in $STATE_DIRECTORY, else in /var/lib/horopter)");
  app.add_option("--copy-catalog-to",
                 flags.copy_catalog_to,
                 "Serve nothing: copy all of --db into another empty catalog, a file or "
                 "postgresql://...; a copy that was broken off is gone on with")
      ->configurable(false);
  app.add_flag(
      "--accept-unclosed-db",
      flags.accept_unclosed_db,
      "Take a catalog file that was copied without its log (FILE-wal) while a server had it "
      "open: what was written last may be missing");
  app.add_flag("--prepare-first",
               flags.server.prepare_first,
               "Prepare the objects of a catalog of another version before serving anything, not "
               "beside it");
  app.add_option("--listen", flags.server.listen, "HOST:PORT; port 0 takes a free one")
      ->capture_default_str();
  AddTrustFlags(app, flags.server);
  AddConnectionFlags(app, flags);
  app.add_option("--workers", flags.server.workers, "Scenes recognised at the same time")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  app.add_option("--cores",
                 flags.cores,
                 "Cores to use: one pool for all scenes and the start; 0: all, at most 64")
      ->check(CLI::Range(0, 256))
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
  AddRankingFlags(app, flags.server);
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
  app.add_flag("--audit-required",
               telemetry.audit_required,
               "Refuse writes, verification and backups while the audit log cannot be written");
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

}  // namespace

void AddFlags(CLI::App& app, Flags& flags) {
  AddCheckedConfig(app);
  AddServingFlags(app, flags);
  AddTelemetryFlags(app, flags.server.telemetry);
}

std::string DefaultCatalog() {
  // Of several, separated by colons, the first is ours.
  const char* const state = std::getenv("STATE_DIRECTORY");
  const std::string folders = state == nullptr ? "" : state;
  const std::string folder = folders.substr(0, folders.find(':'));
  return (folder.empty() ? std::string("/var/lib/horopter") : folder) + "/parts.db";
}

}  // namespace horopter
