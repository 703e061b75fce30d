#include "server/service/acceptor.h"

#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <exception>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/service/log_limiter.h"

namespace horopter {
namespace {

// Of the descriptors of the process, for the catalog, logs, metrics and gRPC itself.
constexpr int kKeptDescriptors = 96;
constexpr auto kAcceptAgain = std::chrono::seconds(1);  // for those that were closed
constexpr auto kPauseAfterAnError = std::chrono::milliseconds(50);

uint64_t SocketOf(int fd) {
  struct stat info = {};
  return ::fstat(fd, &info) == 0 && S_ISSOCK(info.st_mode) ? info.st_ino : 0;
}

// Whose connection it is: an address, of IPv6 the network's half; empty: a Unix socket's.
std::string PeerOf(const sockaddr_storage& address) {
  if (address.ss_family == AF_INET) {
    const auto& v4 = reinterpret_cast<const sockaddr_in&>(address);
    return {reinterpret_cast<const char*>(&v4.sin_addr), sizeof v4.sin_addr};
  }
  if (address.ss_family != AF_INET6) return "";
  const auto& v6 = reinterpret_cast<const sockaddr_in6&>(address);
  const char* const bytes = reinterpret_cast<const char*>(&v6.sin6_addr);
  return IN6_IS_ADDR_V4MAPPED(&v6.sin6_addr) ? std::string(bytes + 12, 4) : std::string(bytes, 8);
}

ConnectionLimits WithinDescriptors(ConnectionLimits limits) {
  rlimit descriptors = {};
  if (::getrlimit(RLIMIT_NOFILE, &descriptors) != 0) return limits;
  const rlim_t few = std::min<rlim_t>(descriptors.rlim_cur, 1 << 30);
  const int room = std::max(16, static_cast<int>(few) - kKeptDescriptors);
  limits.max_connections = std::min(limits.max_connections, room);
  limits.max_silent = std::min(limits.max_silent, std::max(8, room / 4));
  return limits;
}

void Warn(const std::string& kind, const std::string& text) {
  static LogLimiter& limiter = *new LogLimiter(5);
  const LogLimiter::Verdict verdict = limiter.Ask(kind);
  for (const auto& [what, lines] : verdict.left_out) {
    spdlog::warn("connections: {} more lines like '{}' were left out", lines, what);
  }
  if (verdict.write) spdlog::warn("{}: {}", kind, text);
}

}  // namespace

absl::StatusOr<std::unique_ptr<Acceptor>> Acceptor::Create(const std::string& address,
                                                           const ConnectionLimits& limits) {
  HOROPTER_ASSIGN_OR_RETURN(const ListenAddress parsed, ParseListenAddress("listen", address));
  HOROPTER_ASSIGN_OR_RETURN(ListeningSockets sockets, Listen(address, parsed));
  std::unique_ptr<Acceptor> acceptor(
      new Acceptor(std::move(sockets), parsed, WithinDescriptors(limits)));
  if (acceptor->wake_ < 0) return absl::ResourceExhaustedError("no file descriptor is left");
  return acceptor;
}

Acceptor::Acceptor(ListeningSockets sockets,
                   const ListenAddress& address,
                   const ConnectionLimits& limits)
    : limits_(limits),
      parsed_(address),
      sockets_(std::move(sockets)),
      wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)),
      spare_(::open("/dev/null", O_RDONLY | O_CLOEXEC)) {
  struct stat info = {};
  if (parsed_.kind == ListenAddress::Kind::kUnix && ::stat(parsed_.path.c_str(), &info) == 0) {
    file_ = info.st_ino;
  }
}

Acceptor::~Acceptor() {
  Stop();
  for (const int fd : {wake_, spare_}) {
    if (fd >= 0) ::close(fd);
  }
}

void Acceptor::Start(HandOver hand_over) {
  hand_over_ = std::move(hand_over);
  thread_ = std::thread([this] { Run(); });
}

void Acceptor::Stop() {
  const uint64_t one = 1;
  if (thread_.joinable()) {
    while (::write(wake_, &one, sizeof one) < 0 && errno == EINTR) {
    }
    thread_.join();
  }
  for (const int fd : sockets_.descriptors) ::close(fd);
  sockets_.descriptors.clear();
  while (!silent_.empty()) CloseSilent(0);
  struct stat info = {};
  if (file_ != 0 && ::stat(parsed_.path.c_str(), &info) == 0 && info.st_ino == file_) {
    ::unlink(parsed_.path.c_str());
  }
  file_ = 0;
}

ConnectionCounts Acceptor::counts() const {
  const std::lock_guard lock(mutex_);
  return counts_;
}

void Acceptor::Run() {
  std::vector<pollfd> polled;
  std::vector<short> events;
  for (;;) {
    const auto now = Clock::now();
    while (!silent_.empty() && silent_.front().until <= now) {
      CloseSilent(0);
      const std::lock_guard lock(mutex_);
      ++counts_.said_nothing;
    }
    polled.assign(1, {wake_, POLLIN, 0});
    const short listens = now < pause_until_ ? 0 : POLLIN;
    for (const int fd : sockets_.descriptors) polled.push_back({fd, listens, 0});
    for (const Silent& s : silent_) polled.push_back({s.connection, POLLIN, 0});
    const int wait_ms = listens == 0 ? 20 : open_.empty() && silent_.empty() ? -1 : 1000;
    ::poll(polled.data(), polled.size(), wait_ms);
    if (polled[0].revents != 0) return;
    try {
      if (now >= look_again_) {
        ForgetClosed();
        look_again_ = now + kAcceptAgain;
      }
      const size_t first = 1 + sockets_.descriptors.size();
      events.clear();
      for (size_t i = first; i < polled.size(); ++i) events.push_back(polled[i].revents);
      HearSilent(events);
      for (size_t i = 1; i < first; ++i) {
        if (polled[i].revents != 0) AcceptFrom(polled[i].fd);
      }
    } catch (const std::exception& e) {  // no memory: goes on when there is some
      pause_until_ = Clock::now() + kPauseAfterAnError;
      Warn("connections cannot be taken", e.what());
    }
  }
}

// Until none waits, but not for ever: those that were taken are heard in between.
void Acceptor::AcceptFrom(int listening) {
  for (int i = 0; i < limits_.max_silent; ++i) {
    sockaddr_storage address = {};
    socklen_t size = sizeof address;
    const int fd = ::accept4(
        listening, reinterpret_cast<sockaddr*>(&address), &size, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (fd < 0) {
      if (errno == EAGAIN || errno == EWOULDBLOCK) return;
      if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM) {
        const std::string why = ::strerror(errno);
        if (MakeRoom()) continue;
        Warn("connections cannot be taken", why);
        pause_until_ = Clock::now() + kPauseAfterAnError;
        return;
      }
      continue;  // of that connection alone: it was broken off, its network is down
    }
    const int on = 1;
    if (address.ss_family != AF_UNIX) ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    if (silent_.size() >= static_cast<size_t>(limits_.max_silent)) {
      CloseSilent(0);
      const std::lock_guard lock(mutex_);
      ++counts_.said_nothing;
    }
    const auto patience = std::chrono::duration_cast<Clock::duration>(
        std::chrono::duration<double>(limits_.silent_seconds));
    silent_.push_back({listening, fd, PeerOf(address), Clock::now() + patience});
    const std::lock_guard lock(mutex_);
    ++counts_.accepted;
    counts_.open = static_cast<int64_t>(open_.size() + silent_.size());
  }
}

// No descriptor is left: one that says nothing goes, or the next in the queue is told by closing
// it, for which the spare descriptor makes room. False: neither helps.
bool Acceptor::MakeRoom() {
  if (!silent_.empty()) {
    CloseSilent(0);
    const std::lock_guard lock(mutex_);
    ++counts_.said_nothing;
    return true;
  }
  if (spare_ < 0) return false;
  ::close(spare_);
  for (const int fd : sockets_.descriptors) {
    const int refused = ::accept4(fd, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (refused < 0) continue;
    ::close(refused);
    const std::lock_guard lock(mutex_);
    ++counts_.refused;
  }
  spare_ = ::open("/dev/null", O_RDONLY | O_CLOEXEC);
  return false;
}

void Acceptor::HearSilent(const std::vector<short>& events) {
  for (size_t i = events.size(); i-- > 0;) {
    if (events[i] == 0) continue;
    char byte = 0;
    const ssize_t read = ::recv(silent_[i].connection, &byte, 1, MSG_PEEK | MSG_DONTWAIT);
    if (read < 0 && (errno == EAGAIN || errno == EINTR)) continue;
    if (read > 0) {
      const Silent first = std::move(silent_[i]);
      silent_.erase(silent_.begin() + static_cast<std::ptrdiff_t>(i));
      Pass(first);
    } else {
      CloseSilent(i);
    }
  }
}

void Acceptor::Pass(const Silent& first) {
  if (!MayOpen(first.peer)) {
    ::close(first.connection);
    const std::lock_guard lock(mutex_);
    ++counts_.refused;
    return;
  }
  open_.push_back({first.connection, SocketOf(first.connection), first.peer});
  hand_over_(first.listening, first.connection);
}

bool Acceptor::MayOpen(const std::string& peer) {
  const auto within = [&](bool* all) {
    *all = open_.size() < static_cast<size_t>(limits_.max_connections);
    if (peer.empty()) return *all;
    const auto of_peer = std::count_if(
        open_.begin(), open_.end(), [&](const Open& open) { return open.peer == peer; });
    return *all && of_peer < limits_.max_per_peer;
  };
  bool all = true;
  if (within(&all)) return true;
  ForgetClosed();
  if (within(&all)) return true;
  Warn(all ? "connection refused, its peer has too many" : "connection refused, too many are open",
       absl::StrCat("at most ", all ? limits_.max_per_peer : limits_.max_connections));
  return false;
}

void Acceptor::ForgetClosed() {
  std::erase_if(open_, [](const Open& open) { return SocketOf(open.connection) != open.socket; });
  const std::lock_guard lock(mutex_);
  counts_.open = static_cast<int64_t>(open_.size() + silent_.size());
}

void Acceptor::CloseSilent(size_t index) {
  ::close(silent_[index].connection);
  silent_.erase(silent_.begin() + static_cast<std::ptrdiff_t>(index));
}

}  // namespace horopter
