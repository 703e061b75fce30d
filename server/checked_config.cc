#include "server/checked_config.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cctype>
#include <iostream>
#include <memory>
#include <numeric>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace horopter {
namespace {

size_t EditDistance(const std::string& a, const std::string& b) {
  std::vector<size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), size_t{0});
  for (size_t i = 1; i <= a.size(); ++i) {
    size_t diagonal = std::exchange(row[0], i);
    for (size_t j = 1; j <= b.size(); ++j) {
      const size_t replaced = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({replaced, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row.back();
}

// A key that is left aside without a word would leave everybody an admin for `access_file`.
class CheckedConfig final : public CLI::ConfigTOML {
 public:
  explicit CheckedConfig(const CLI::App& app) : app_(app) {}

  std::vector<CLI::ConfigItem> from_config(std::istream& input) const override {
    std::vector<CLI::ConfigItem> found = CLI::ConfigTOML::from_config(input);
    std::set<std::string> seen;
    for (const CLI::ConfigItem& item : found) {
      if (!item.parents.empty()) {
        Refuse("section [" + item.parents.front() + "]: the configuration has no sections");
      }
      const CLI::Option* const option = app_.get_option_no_throw("--" + item.name);
      if (option == nullptr || !option->get_configurable()) Refuse(Unknown(item.name));
      if (!seen.insert(item.name).second || item.inputs.size() > 1) {
        Refuse("'" + item.name + "' has more than one value");
      }
    }
    return found;
  }

 private:
  [[noreturn]] static void Refuse(const std::string& why) {
    throw CLI::ConfigError("configuration: " + why, CLI::ExitCodes::ConfigError);
  }
  std::string Unknown(const std::string& key) const {
    std::string nearest;
    size_t distance = std::max<size_t>(2, key.size() / 3) + 1;
    for (const CLI::Option* option : app_.get_options()) {
      if (!option->get_configurable() || option->get_lnames().empty()) continue;
      const std::string& name = option->get_lnames().front();
      const size_t d = EditDistance(key, name);
      if (d < distance) {
        distance = d;
        nearest = name;
      }
    }
    return "'" + key + "' is no option" +
           (nearest.empty() ? std::string() : "; did you mean '" + nearest + "'?");
  }

  const CLI::App& app_;
};

}  // namespace

void AddCheckedConfig(CLI::App& app) {
  app.config_formatter(std::make_shared<CheckedConfig>(app));
  app.set_config("--config", "", "Read options from a TOML file; the command line wins");
  app.add_flag_callback(
         "--print-config",
         [&app] {
           std::cout << app.config_to_str(true, true);
           throw CLI::Success();
         },
         "Print a configuration file with every option, its default and what it does")
      ->configurable(false);
}

}  // namespace horopter
