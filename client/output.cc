#include "client/output.h"

#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "client/shown.h"

namespace horopter {
namespace {

bool json_output = false;

}  // namespace

void SetJsonOutput(bool json) {
  json_output = json;
}

bool JsonOutput() {
  return json_output;
}

void Say(const char* format, ...) {
  if (json_output) return;
  va_list arguments;
  va_start(arguments, format);
  char* text = nullptr;
  const int length = ::vasprintf(&text, format, arguments);
  va_end(arguments);
  if (length < 0) return;
  // Names come from files and servers.
  const std::string shown = Shown(std::string_view(text, static_cast<std::size_t>(length)));
  std::free(text);
  std::fwrite(shown.data(), 1, shown.size(), stdout);
  std::fflush(stdout);
}

void SayJson(const nlohmann::json& value) {
  if (!json_output) return;
  // Names come from files and servers: what is no UTF-8 must not end the program.
  const std::string text = value.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  std::printf("%s\n", text.c_str());
  std::fflush(stdout);
}

}  // namespace horopter
