#include "client/bop_json.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string_view>

#include "server/base/utf8.h"

namespace horopter::bop {
namespace {

namespace fs = std::filesystem;

// Outside of strings.
void ReplaceNotNumbers(std::string* text) {
  static constexpr std::string_view kWords[] = {
      "-Infinity", "Infinity", "-NaN", "NaN", "-nan", "nan", "-inf", "inf"};
  bool in_string = false;
  std::string out;
  for (size_t i = 0; i < text->size(); ++i) {
    const char c = (*text)[i];
    if (in_string && c == '\\' && i + 1 < text->size()) {
      out += c;
      out += (*text)[++i];
      continue;
    }
    if (c == '"') in_string = !in_string;
    const auto word = std::find_if(std::begin(kWords), std::end(kWords), [&](std::string_view w) {
      return !in_string && text->compare(i, w.size(), w) == 0;
    });
    if (word == std::end(kWords)) {
      out += c;
      continue;
    }
    out += "null";
    i += word->size() - 1;
  }
  *text = std::move(out);
}

}  // namespace

absl::StatusOr<nlohmann::json> ReadJson(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  std::string text{std::istreambuf_iterator<char>(file), {}};
  text = ToUtf8(text);  // names may be in another encoding
  ReplaceNotNumbers(&text);
  try {
    return nlohmann::json::parse(text);
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": not JSON: ", e.what()));
  }
}

std::vector<double> Numbers(const nlohmann::json& value, size_t count, const std::string& what) {
  std::vector<double> numbers;
  for (const nlohmann::json& x : value) {
    numbers.push_back(x.is_null() ? std::nan("") : x.get<double>());
  }
  if (numbers.size() != count) {
    throw std::runtime_error(absl::StrCat(what, " has ", numbers.size(), " numbers, not ", count));
  }
  for (const double x : numbers) {
    if (!std::isfinite(x)) throw std::runtime_error(absl::StrCat(what, " is not finite"));
  }
  return numbers;
}

Eigen::Matrix3d Matrix3(const nlohmann::json& value, const std::string& what) {
  const std::vector<double> n = Numbers(value, 9, what);
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(n.data());
}

Rigid3 RigidFromMm(const nlohmann::json& R, const nlohmann::json& t, const std::string& what) {
  const std::vector<double> n = Numbers(t, 3, what);
  return {Matrix3(R, what), kMetresPerMm * Eigen::Vector3d(n[0], n[1], n[2])};
}

std::optional<int> IdOf(const fs::path& path, const std::string& prefix) {
  const std::string stem = path.stem().string();
  if (stem.rfind(prefix, 0) != 0) return std::nullopt;
  const std::string digits = stem.substr(prefix.size());
  if (digits.empty() || digits.size() > 9 ||
      digits.find_first_not_of("0123456789") != std::string::npos) {
    return std::nullopt;
  }
  return std::stoi(digits);
}

std::string ExistingFile(std::initializer_list<std::string> candidates) {
  std::error_code error;
  for (const std::string& path : candidates) {
    if (fs::is_regular_file(path, error)) return path;
  }
  return "";
}

std::vector<fs::path> SortedEntries(const fs::path& folder) {
  std::vector<fs::path> paths;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    paths.push_back(it->path());
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

}  // namespace horopter::bop
