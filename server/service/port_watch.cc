#include "server/service/port_watch.h"

#include <openssl/ssl.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <memory>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/service/listen_address.h"

namespace horopter {
namespace {

// The beginning of every HTTP/2 connection, with empty settings.
std::string PlainGreeting() {
  return std::string("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n") + std::string("\0\0\0\4\0\0\0\0\0", 9);
}

// A ClientHello; empty: it cannot be made.
std::string TlsGreeting() {
  const std::unique_ptr<SSL_CTX, decltype(&::SSL_CTX_free)> context(
      ::SSL_CTX_new(::TLS_client_method()), &::SSL_CTX_free);
  if (context == nullptr) return "";
  const std::unique_ptr<SSL, decltype(&::SSL_free)> session(::SSL_new(context.get()), &::SSL_free);
  BIO* const in = ::BIO_new(::BIO_s_mem());
  BIO* const out = ::BIO_new(::BIO_s_mem());
  if (session == nullptr || in == nullptr || out == nullptr) {
    ::BIO_free(in);
    ::BIO_free(out);
    return "";
  }
  ::SSL_set_bio(session.get(), in, out);  // owns both
  const unsigned char h2[] = {2, 'h', '2'};
  ::SSL_set_alpn_protos(session.get(), h2, sizeof h2);
  ::SSL_connect(session.get());  // stops for want of an answer
  char* bytes = nullptr;
  const long size = BIO_get_mem_data(out, &bytes);
  return size > 0 ? std::string(bytes, static_cast<size_t>(size)) : std::string();
}

class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() { ::close(fd_); }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return fd_; }

 private:
  const int fd_;
};

}  // namespace

absl::Status ProbePort(const WatchedPort& port, double timeout_seconds) {
  const auto until =
      std::chrono::steady_clock::now() + std::chrono::duration<double>(timeout_seconds);
  HOROPTER_ASSIGN_OR_RETURN(const ListenAddress address,
                            ParseListenAddress("self_check", port.address));
  HOROPTER_ASSIGN_OR_RETURN(const int connection,
                            ConnectToOwn(address, static_cast<int>(timeout_seconds * 1e3)));
  const Descriptor closed(connection);
  const std::string greeting = port.tls ? TlsGreeting() : PlainGreeting();
  if (greeting.empty()) return absl::UnknownError("no greeting can be made");
  if (::send(closed.get(), greeting.data(), greeting.size(), MSG_NOSIGNAL) < 0) {
    return absl::OkStatus();  // the server has ended the connection: somebody is there
  }
  for (;;) {
    const std::chrono::duration<double, std::milli> left = until - std::chrono::steady_clock::now();
    pollfd readable = {closed.get(), POLLIN, 0};
    const int ready =
        left.count() <= 0.0 ? 0 : ::poll(&readable, 1, static_cast<int>(left.count()) + 1);
    if (ready > 0) return absl::OkStatus();
    if (ready < 0 && errno == EINTR) continue;
    return absl::UnavailableError("connections are not answered");
  }
}

PortWatch::PortWatch(std::vector<WatchedPort> ports,
                     const PortWatchOptions& options,
                     std::function<void()> reached,
                     std::function<void(const std::string& why)> lost)
    : ports_(std::move(ports)),
      options_(options),
      reached_(std::move(reached)),
      lost_(std::move(lost)),
      thread_([this] { Run(); }) {}

PortWatch::~PortWatch() {
  {
    const std::lock_guard lock(mutex_);
    ending_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

bool PortWatch::Wait(double seconds) {
  std::unique_lock lock(mutex_);
  return !changed_.wait_for(
      lock, std::chrono::duration<double>(seconds), [this] { return ending_; });
}

void PortWatch::Run() {
  std::vector<int> failures(ports_.size(), 0);
  while (Wait(options_.every_seconds)) {
    bool all = true;
    for (size_t i = 0; i < ports_.size(); ++i) {
      const absl::Status found = ProbePort(ports_[i], options_.timeout_seconds);
      const bool failed = absl::IsUnavailable(found) || absl::IsResourceExhausted(found);
      failures[i] = failed ? failures[i] + 1 : 0;
      if (!failed) continue;
      all = false;
      const std::string why = absl::StrCat(ports_[i].address, ": ", std::string(found.message()));
      spdlog::warn(
          "the server does not reach itself at {} ({} of {})", why, failures[i], options_.failures);
      if (failures[i] < options_.failures) continue;
      lost_(why);
      return;
    }
    if (all) reached_();
  }
}

}  // namespace horopter
