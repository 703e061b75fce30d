// The JSON files of a dataset in BOP layout: how they are opened, and the values they share.
#pragma once

#include <Eigen/Core>
#include <exception>
#include <filesystem>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "client/units.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter::bop {

// NaN and Infinity, which Python writes and JSON does not have, become null. Errors: NOT_FOUND,
// INVALID_ARGUMENT (not JSON), both naming the file.
absl::StatusOr<nlohmann::json> ReadJson(const std::string& path);

// Runs `body` and turns the JSON library's exceptions into a status that names the file.
template <typename Body>
absl::Status Guarded(const std::string& path, Body body) {
  try {
    return body();
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", e.what()));
  }
}

// The next three throw std::exception on what they cannot read, for Guarded.
std::vector<double> Numbers(const nlohmann::json& value, size_t count, const std::string& what);
Eigen::Matrix3d Matrix3(const nlohmann::json& value, const std::string& what);
Rigid3 RigidFromMm(const nlohmann::json& R, const nlohmann::json& t, const std::string& what);

// The number in "obj_000012.ply" or "000012.png", whatever the number of digits.
std::optional<int> IdOf(const std::filesystem::path& path, const std::string& prefix);

// The first that is there, or empty.
std::string ExistingFile(std::initializer_list<std::string> candidates);

// Names in a folder in their order; none where it is not there.
std::vector<std::filesystem::path> SortedEntries(const std::filesystem::path& folder);

}  // namespace horopter::bop
