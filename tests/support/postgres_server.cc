#include "tests/support/postgres_server.h"

#include <fcntl.h>
#include <libpq-fe.h>
#include <pwd.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <vector>

namespace horopter {
namespace {

std::string Program(const std::string& name) {
  std::string path = "/usr/lib/postgresql/15/bin/";
  path += name;
  return path;
}

// PostgreSQL refuses to run as root.
const passwd* Owner() {
  const passwd* const postgres = getpwnam("postgres");
  return postgres != nullptr ? postgres : getpwnam("nobody");
}

pid_t Spawn(const std::vector<std::string>& words, const std::string& log) {
  std::string user, group;
  std::vector<const char*> arguments;
  if (geteuid() == 0) {
    user = "--reuid=" + std::to_string(Owner()->pw_uid);
    group = "--regid=" + std::to_string(Owner()->pw_gid);
    arguments = {"setpriv", user.c_str(), group.c_str(), "--clear-groups", "--"};
  }
  for (const std::string& word : words) arguments.push_back(word.c_str());
  arguments.push_back(nullptr);
  const pid_t pid = fork();
  if (pid != 0) return pid;
  setsid();
  const int out = open(log.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0666);
  dup2(out, 1);
  dup2(out, 2);
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  execvp(arguments[0], const_cast<char* const*>(arguments.data()));
  _exit(127);
}

}  // namespace

std::unique_ptr<PostgresServer> PostgresServer::Start(std::string* why) {
  if (access(Program("initdb").c_str(), X_OK) != 0) {
    *why = "PostgreSQL 15 is not installed (package postgresql-15)";
    return nullptr;
  }
  std::unique_ptr<PostgresServer> server(new PostgresServer);
  server->owner_ = getpid();
  if (geteuid() == 0 && chown(server->dir_.path().c_str(), Owner()->pw_uid, Owner()->pw_gid) != 0) {
    *why = "the folder cannot be given away";
    return nullptr;
  }
  int status = 0;
  const pid_t made = Spawn({Program("initdb"),
                            "-D",
                            server->dir_.File("data"),
                            "-U",
                            "horopter",
                            "-A",
                            "trust",
                            "-E",
                            "UTF8",
                            "--locale=C.UTF-8",
                            "--no-sync"},
                           server->dir_.File("initdb.log"));
  if (made < 0 || waitpid(made, &status, 0) != made || status != 0 || !server->Begin()) {
    *why = "PostgreSQL 15 cannot be started";
    return nullptr;
  }
  return server;
}

PostgresServer* PostgresServer::OfProcess() {
  static std::string why;
  static const std::unique_ptr<PostgresServer> server = Start(&why);
  return server.get();
}

PostgresServer::~PostgresServer() {
  if (getpid() == owner_) Stop();
}

bool PostgresServer::Begin() {
  pid_ = Spawn({Program("postgres"),
                "-D",
                dir_.File("data"),
                "-k",
                dir_.path().string(),
                "-c",
                "listen_addresses=",
                "-c",
                "shared_buffers=16MB",
                "-c",
                "recovery_init_sync_method=syncfs",
                "-c",
                "max_connections=40"},
               dir_.File("postgres.log"));
  const std::string address = "postgresql:///postgres?user=horopter&host=" + dir_.path().string();
  for (int i = 0; i < 1200; ++i) {
    if (PQping(address.c_str()) == PQPING_OK) return true;
    if (waitpid(pid_, nullptr, WNOHANG) == pid_) break;
    usleep(50'000);
  }
  return false;
}

void PostgresServer::Kill() {
  if (pid_ <= 0) return;
  // The postmaster's children end when they notice that it is gone.
  kill(pid_, SIGKILL);
  waitpid(pid_, nullptr, 0);
  pid_ = -1;
}

void PostgresServer::Stop() {
  if (pid_ <= 0) return;
  kill(pid_, SIGINT);  // "fast": connections are ended
  waitpid(pid_, nullptr, 0);
  pid_ = -1;
}

std::string PostgresServer::NewCatalog(const std::string& more) {
  const std::string schema = "t" + std::to_string(getpid()) + "_" + std::to_string(++schemas_);
  const std::string base = "postgresql:///postgres?user=horopter&host=" + dir_.path().string();
  Run(base, "CREATE SCHEMA " + schema);
  return base + "&options=-csearch_path%3D" + schema + more;
}

std::string PostgresServer::Run(const std::string& address, const std::string& sql) {
  PGconn* const connection = PQconnectdb(address.c_str());
  PGresult* const result = PQexec(connection, sql.c_str());
  std::string first = PQresultStatus(result) == PGRES_FATAL_ERROR ? PQresultErrorMessage(result)
                      : PQntuples(result) > 0                     ? PQgetvalue(result, 0, 0)
                                                                  : "";
  PQclear(result);
  PQfinish(connection);
  return first;
}

}  // namespace horopter
