// A PostgreSQL of our own in a temporary folder, which goes with the test.
#pragma once

#include <sys/types.h>

#include <memory>
#include <string>

#include "tests/support/scratch_dir.h"

namespace horopter {

class PostgresServer {
 public:
  // Null where PostgreSQL 15 is not installed or cannot be started; `why` says it.
  static std::unique_ptr<PostgresServer> Start(std::string* why);
  ~PostgresServer();
  PostgresServer(const PostgresServer&) = delete;
  PostgresServer& operator=(const PostgresServer&) = delete;

  // The one of this process, made when it is asked for first; null as Start.
  static PostgresServer* OfProcess();

  // The address of a catalog in a new empty schema. `more`: further parameters, "&name=value".
  std::string NewCatalog(const std::string& more = "");
  // Carries out SQL in the schema of that address; the first column of the first row.
  std::string Run(const std::string& address, const std::string& sql);

  // As a power cut: what is not on disk is lost.
  void Kill();
  // Ends connections at once, and is gone until Begin.
  void Stop();
  bool Begin();

 private:
  PostgresServer() = default;
  ScratchDir dir_;
  pid_t pid_ = -1;
  pid_t owner_ = -1;  // the process that ends it: a forked child does not
  int schemas_ = 0;
};

}  // namespace horopter
