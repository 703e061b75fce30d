// Runs the built programs as a user would.
#pragma once

#include <string>
#include <vector>

namespace horopter {

struct Outcome {
  int exit_code = -1;
  std::string out;  // stdout and stderr as they came
};

// Runs `horopter` with the arguments and waits for it.
Outcome RunHoropter(const std::vector<std::string>& arguments);

// A horopterd on a free port of the loopback interface, with the given database file. Killed with
// the object.
class Server {
 public:
  explicit Server(const std::string& db_path, const std::string& log_path);
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  // HOST:PORT; empty when the server did not come up within 30 s (the log says why).
  const std::string& address() const { return address_; }
  std::string Log() const;
  bool Alive() const;

  void Kill();      // SIGKILL, as a power cut
  int Terminate();  // SIGTERM; exit code after the drain

 private:
  int Wait();
  int pid_ = -1;
  std::string log_path_;
  std::string address_;
};

}  // namespace horopter
