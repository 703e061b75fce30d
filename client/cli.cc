#include "client/cli.h"

#include <CLI/CLI.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"

namespace horopter {
namespace {

std::string Names(const CLI::App& app, const std::string& prefix) {
  std::string names;
  for (const CLI::App* sub : app.get_subcommands({})) {
    absl::StrAppend(&names, names.empty() ? "" : " ", sub->get_name());
  }
  for (const CLI::Option* option : app.get_options()) {
    for (const std::string& name : option->get_lnames()) {
      absl::StrAppend(&names, names.empty() ? "" : " ", prefix, name);
    }
  }
  return names;
}

void AppendCases(const CLI::App& app, const std::string& path, std::string* out) {
  absl::StrAppend(out, "    '", path, "') words='", Names(app, "--"), "' ;;\n");
  for (const CLI::App* sub : app.get_subcommands({})) {
    AppendCases(*sub, absl::StrCat(path, " ", sub->get_name()), out);
  }
}

std::string Roff(const std::string& text) {
  return absl::StrReplaceAll(text, {{"\\", "\\e"}, {"-", "\\-"}, {"\n.", "\n\\&."}});
}

void AppendManual(const CLI::App& app, const std::string& path, std::string* out) {
  if (app.get_subcommands({}).empty()) {
    absl::StrAppend(out, ".SS \"", Roff(path), "\"\n", Roff(app.get_description()), "\n");
    for (const CLI::Option* option : app.get_options()) {
      if (option->get_lnames().size() == 1 && option->get_lnames()[0] == "help") continue;
      absl::StrAppend(
          out,
          ".TP\n.B ",
          Roff(option->get_name(false, true)),
          "\n",
          Roff(option->get_description().empty() ? "Required." : option->get_description()),
          "\n");
    }
    absl::StrAppend(out, ".PP\n.nf\n", Roff(app.get_footer()), "\n.fi\n");
  }
  for (const CLI::App* sub : app.get_subcommands({})) {
    AppendManual(*sub, absl::StrCat(path, " ", sub->get_name()), out);
  }
}

}  // namespace

CLI::App* AddCommand(CLI::App& parent,
                     const std::string& name,
                     const std::string& what,
                     const std::string& example) {
  CLI::App* command = parent.add_subcommand(name, what)->fallthrough();
  command->footer(absl::StrCat("Example:\n  ", example));
  return command;
}

std::string BashCompletion(const CLI::App& app) {
  std::string cases;
  AppendCases(app, "horopter", &cases);
  return absl::StrCat(
      "# bash completion of horopter: put into /usr/share/bash-completion/completions/horopter\n"
      "_horopter() {\n"
      "  local current=${COMP_WORDS[COMP_CWORD]} path=horopter words word\n"
      "  for word in \"${COMP_WORDS[@]:1:COMP_CWORD-1}\"; do\n"
      "    [[ $word == -* ]] || path+=\" $word\"\n"
      "  done\n"
      "  # Arguments are no commands: the longest beginning that is one counts.\n"
      "  while :; do\n"
      "    case $path in\n",
      absl::StrReplaceAll(cases, {{"\n    ", "\n      "}}),
      "      *) path=${path% *}; continue ;;\n"
      "    esac\n"
      "    break\n"
      "  done\n"
      "  COMPREPLY=($(compgen -W \"$words\" -- \"$current\"))\n"
      "}\n"
      "complete -o default -F _horopter horopter\n");
}

std::string ManPage(const CLI::App& app) {
  std::string out = absl::StrCat(
      ".TH HOROPTER 1\n.SH NAME\nhoropter \\- ",
      Roff(app.get_description()),
      "\n.SH SYNOPSIS\n.B horopter\n[OPTIONS] COMMAND ...\n.SH OPTIONS OF ALL COMMANDS\n");
  for (const CLI::Option* option : app.get_options()) {
    absl::StrAppend(&out,
                    ".TP\n.B ",
                    Roff(option->get_name(false, true)),
                    "\n",
                    Roff(option->get_description()),
                    "\n");
  }
  absl::StrAppend(&out, ".SH COMMANDS\n");
  AppendManual(app, "horopter", &out);
  absl::StrAppend(&out, ".SH EXIT STATUS\n.nf\n", Roff(app.get_footer()), "\n.fi\n");
  return out;
}

}  // namespace horopter
