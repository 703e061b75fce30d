#include "console/sessions.h"

#include <sys/random.h>

#include <algorithm>
#include <array>
#include <utility>

#include "absl/strings/escaping.h"
#include "server/base/sha256.h"

namespace horopter {

std::string ConsoleSessions::Open(std::string token, ConsoleTime now) {
  std::array<char, 32> bytes{};
  if (::getrandom(bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size())) return "";
  MakeRoom(now);
  const std::string id = absl::BytesToHexString({bytes.data(), bytes.size()});
  sessions_[Sha256Hex(id)] = {std::move(token), now, now};
  return id;
}

const std::string* ConsoleSessions::Use(std::string_view id, ConsoleTime now) {
  if (id.empty()) return nullptr;
  const auto found = sessions_.find(Sha256Hex(id));
  if (found == sessions_.end()) return nullptr;
  if (IsOver(found->second, now)) {
    sessions_.erase(found);
    return nullptr;
  }
  found->second.used = now;
  return &found->second.token;
}

void ConsoleSessions::Close(std::string_view id) {
  sessions_.erase(Sha256Hex(id));
}

bool ConsoleSessions::IsOver(const Entry& entry, ConsoleTime now) const {
  return now - entry.used >= std::chrono::duration<double>(60.0 * options_.idle_minutes) ||
         now - entry.begun >= std::chrono::duration<double>(3600.0 * options_.lifetime_hours);
}

void ConsoleSessions::MakeRoom(ConsoleTime now) {
  std::erase_if(sessions_, [&](const auto& entry) { return IsOver(entry.second, now); });
  while (!sessions_.empty() && sessions_.size() >= options_.most) {
    sessions_.erase(
        std::min_element(sessions_.begin(), sessions_.end(), [](const auto& a, const auto& b) {
          return a.second.used < b.second.used;
        }));
  }
}

}  // namespace horopter
