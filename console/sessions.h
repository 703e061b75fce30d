// Who is signed in. Tokens are kept here and nowhere else: a browser has the session's id alone.
#pragma once

#include <chrono>
#include <map>
#include <string>
#include <string_view>

namespace horopter {

using ConsoleTime = std::chrono::steady_clock::time_point;

struct SessionOptions {
  double idle_minutes = 60.0;    // without a request
  double lifetime_hours = 12.0;  // since it began, whatever happens
  size_t most = 1000;            // at once; the one that is idle for longest makes room
};

// Of one thread.
class ConsoleSessions {
 public:
  explicit ConsoleSessions(const SessionOptions& options) : options_(options) {}

  // A new session's id, 64 hex digits that nobody can guess; empty: the system has no random bytes.
  std::string Open(std::string token, ConsoleTime now);

  // The token of the session, which is thereby used; null: there is none, or it is over. Valid
  // until the next call.
  const std::string* Use(std::string_view id, ConsoleTime now);

  void Close(std::string_view id);
  size_t size() const { return sessions_.size(); }

 private:
  struct Entry {
    std::string token;
    ConsoleTime begun, used;
  };
  bool IsOver(const Entry& entry, ConsoleTime now) const;
  void MakeRoom(ConsoleTime now);

  const SessionOptions options_;
  // By the SHA-256 of the id: what a look-up takes says nothing of the id.
  std::map<std::string, Entry, std::less<>> sessions_;
};

}  // namespace horopter
