// A server that looks whether it can still be reached: what cannot must end, so that it is started
// again.
#pragma once

#include <condition_variable>
#include <functional>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"

namespace horopter {

struct WatchedPort {
  std::string address;  // HOST:PORT with the port that was bound, or unix:PATH
  bool tls = false;
};

// Connects, greets as a client does and waits for the first byte of an answer, or for the end of
// the connection, which is one too. Errors: UNAVAILABLE (nothing comes), RESOURCE_EXHAUSTED (no
// descriptor is left), UNKNOWN (the address is not this machine's now, which says nothing).
absl::Status ProbePort(const WatchedPort& port, double timeout_seconds);

struct PortWatchOptions {
  double every_seconds = 10.0;
  double timeout_seconds = 20.0;  // of one look: longer than a busy machine keeps a client waiting
  int failures = 3;               // in a row, of one port
};

// Looks from construction to destruction, on a thread of its own.
class PortWatch {
 public:
  // `reached`: after each round in which no port failed. `lost`: once, when one failed as often as
  // the options say; the watch then ends.
  PortWatch(std::vector<WatchedPort> ports,
            const PortWatchOptions& options,
            std::function<void()> reached,
            std::function<void(const std::string& why)> lost);
  ~PortWatch();

 private:
  void Run();
  bool Wait(double seconds);  // false: the watch ends

  const std::vector<WatchedPort> ports_;
  const PortWatchOptions options_;
  const std::function<void()> reached_;
  const std::function<void(const std::string&)> lost_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool ending_ = false;  // guarded by mutex_
  std::thread thread_;
};

}  // namespace horopter
