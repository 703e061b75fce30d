// The command line of `horopter`: every family of commands adds itself to the program.
#pragma once

#include <functional>
#include <string>

#include "absl/status/status.h"
#include "client/api.h"

namespace CLI {
class App;
}

namespace horopter {

// What the parsed command line asks for.
using Command = std::function<absl::Status(HoropterClient&)>;

// Each sub-command's callback sets *command, which must outlive `app`. Every sub-command's help
// ends with examples; lines that begin with "  horopter " are run by a test.
void AddObjectCommands(CLI::App& app, Command* command);
void AddCatalogCommands(CLI::App& app, Command* command);
void AddDatasetCommands(CLI::App& app, Command* command);
void AddRecognizeCommand(CLI::App& app, Command* command);
void AddExplainCommand(CLI::App& app, Command* command);
void AddStationCommands(CLI::App& app, Command* command);
void AddToolCommands(CLI::App& app, Command* command);

// Adds a sub-command with the example of its help.
CLI::App* AddCommand(CLI::App& parent,
                     const std::string& name,
                     const std::string& what,
                     const std::string& example);

// A script for bash that completes commands and options of `app`.
std::string BashCompletion(const CLI::App& app);

// A manual page (roff) of all commands.
std::string ManPage(const CLI::App& app);

}  // namespace horopter
