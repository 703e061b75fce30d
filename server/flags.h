// What can be said to horopterd, on the command line and in a file.
#pragma once

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <string>

#include "server/service/server.h"

namespace horopter {

struct Flags {
  std::string db;  // empty: DefaultCatalog()
  bool accept_unclosed_db = false;
  std::string copy_catalog_to;  // nothing is served: the catalog is copied there
  std::string log_level = "info";
  int cores = 0;  // 0: all of the machine, at most 64
  double drain_seconds = 30.0;
  double self_check_seconds = 10.0;  // 0: never
  ServerOptions server;
};

// Every option with its default and what it does; --config, whose keys have to be options, each
// once and none in a section; --print-config, which prints such a file and is done.
void AddFlags(CLI::App& app, Flags& flags);

// parts.db in the state directory that systemd names, else in /var/lib/horopter.
std::string DefaultCatalog();

}  // namespace horopter
