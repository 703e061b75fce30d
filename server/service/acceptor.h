// Accepts the connections of a listener. gRPC's own acceptor ends for good when descriptors run
// out, knows no bound of connections, and holds those that say nothing (server/adr/0068).
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "server/service/listen_address.h"

namespace horopter {

struct ConnectionLimits {
  int max_connections = 4096;  // open at once; less where the process may have fewer descriptors
  int max_per_peer = 512;      // of one address (IPv6: of a /64); Unix sockets have no bound
  int max_silent = 256;        // that have not sent a byte: with one more, the oldest goes
  double silent_seconds = 10;  // after which they go anyway
};

struct ConnectionCounts {
  int64_t open = 0;      // now, with those that have not sent anything yet
  int64_t accepted = 0;  // since the start, as all below
  int64_t refused = 0;   // beyond a bound, or without a descriptor left
  int64_t said_nothing = 0;
};

// Listens from Create on, accepts between Start and Stop, on a thread of its own.
class Acceptor {
 public:
  // Takes over the connection, which has sent something.
  using HandOver = std::function<void(int listening, int connection)>;

  // Errors: those of Listen and ParseListenAddress.
  static absl::StatusOr<std::unique_ptr<Acceptor>> Create(const std::string& address,
                                                          const ConnectionLimits& limits);
  ~Acceptor();

  void Start(HandOver hand_over);
  // Closes the listening sockets; connections that were handed over go on. More than once is fine.
  void Stop();

  // With the port that was bound.
  const std::string& address() const { return sockets_.address; }
  ConnectionCounts counts() const;

 private:
  using Clock = std::chrono::steady_clock;
  struct Silent {
    int listening = -1, connection = -1;
    std::string peer;
    Clock::time_point until;
  };
  // What was handed over is closed by others: it is open as long as its descriptor is that socket.
  struct Open {
    int connection = -1;
    uint64_t socket = 0;
    std::string peer;
  };

  Acceptor(ListeningSockets sockets, const ListenAddress& address, const ConnectionLimits& limits);
  void Run();
  void AcceptFrom(int listening);
  bool MakeRoom();
  void HearSilent(const std::vector<short>& events);
  void Pass(const Silent& first);
  bool MayOpen(const std::string& peer);
  void ForgetClosed();
  void CloseSilent(size_t index);

  const ConnectionLimits limits_;
  const ListenAddress parsed_;
  ListeningSockets sockets_;
  uint64_t file_ = 0;  // inode of a Unix socket's file
  HandOver hand_over_;
  int wake_ = -1, spare_ = -1;
  std::deque<Silent> silent_;  // the oldest first; of the thread alone
  std::vector<Open> open_;     // the same
  Clock::time_point pause_until_, look_again_;
  mutable std::mutex mutex_;
  ConnectionCounts counts_;  // guarded by mutex_
  std::thread thread_;
};

}  // namespace horopter
