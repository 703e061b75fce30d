#include "tests/e2e/program.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <fstream>
#include <sstream>
#include <thread>

namespace horopter {
namespace {

// Starts a program with stdout and stderr on `fd`; nothing but exec happens in the child.
int Spawn(const std::string& program, const std::vector<std::string>& arguments, int fd) {
  std::vector<char*> argv{const_cast<char*>(program.c_str())};
  for (const std::string& a : arguments) argv.push_back(const_cast<char*>(a.c_str()));
  argv.push_back(nullptr);
  const int pid = ::fork();
  if (pid == 0) {
    ::dup2(fd, STDOUT_FILENO);
    ::dup2(fd, STDERR_FILENO);
    ::execv(program.c_str(), argv.data());
    ::_exit(127);
  }
  return pid;
}

}  // namespace

Outcome RunHoropter(const std::vector<std::string>& arguments) {
  int ends[2];
  Outcome outcome;
  if (::pipe2(ends, O_CLOEXEC) != 0) return outcome;
  const int pid = Spawn(HOROPTER_PROGRAM, arguments, ends[1]);
  ::close(ends[1]);
  std::array<char, 4096> buffer;
  for (ssize_t n; (n = ::read(ends[0], buffer.data(), buffer.size())) > 0;) {
    outcome.out.append(buffer.data(), static_cast<size_t>(n));
  }
  ::close(ends[0]);
  int status = 0;
  ::waitpid(pid, &status, 0);
  outcome.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  return outcome;
}

Server::Server(const std::string& db_path, const std::string& log_path) : log_path_(log_path) {
  const int fd = ::open(log_path.c_str(), O_CREAT | O_WRONLY | O_TRUNC | O_CLOEXEC, 0600);
  pid_ = Spawn(HOROPTERD_PROGRAM, {"--db", db_path, "--listen", "127.0.0.1:0"}, fd);
  ::close(fd);
  const std::string mark = "listening on ";
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(30);
  while (std::chrono::steady_clock::now() < deadline && Alive()) {
    const std::string log = Log();
    const size_t at = log.find(mark), end = log.find('\n', at);
    if (at != std::string::npos && end != std::string::npos) {
      address_ = log.substr(at + mark.size(), end - at - mark.size());
      return;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
}

Server::~Server() {
  Kill();
}

std::string Server::Log() const {
  std::ostringstream text;
  text << std::ifstream(log_path_).rdbuf();
  return text.str();
}

bool Server::Alive() const {
  return pid_ > 0 && ::kill(pid_, 0) == 0 && ::waitpid(pid_, nullptr, WNOHANG) == 0;
}

int Server::Wait() {
  int status = 0;
  ::waitpid(pid_, &status, 0);
  pid_ = -1;
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

void Server::Kill() {
  if (pid_ <= 0) return;
  ::kill(pid_, SIGKILL);
  Wait();
}

int Server::Terminate() {
  ::kill(pid_, SIGTERM);
  return Wait();
}

}  // namespace horopter
