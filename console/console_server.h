// The console's listener and all that belongs to it, on one thread.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <map>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "console/console_state.h"
#include "console/web_connection.h"

namespace horopter {

class ConsoleServer {
 public:
  // Listens; serves once somebody runs `context`, which outlives the server. Errors:
  // INVALID_ARGUMENT (the address, a certificate without its key, listening or a token's way in the
  // clear without `insecure`), FAILED_PRECONDITION (a file cannot be read), UNAVAILABLE (the port
  // is taken).
  static absl::StatusOr<std::unique_ptr<ConsoleServer>> Start(boost::asio::io_context& context,
                                                              const ConsoleOptions& options);

  // HOST:PORT that was bound.
  std::string address() const;
  // No connection is left.
  bool idle() const { return connections_.empty(); }
  bool has_page() const { return state_->page.complete(); }

  // Page and certificate are read again; what cannot be read stays as it was.
  absl::Status Reload();

  // No new connections; running calls may end for a while, then all is closed and `context` runs
  // out of work. A second time: at once.
  void Stop();

 private:
  ConsoleServer(boost::asio::io_context& context, std::unique_ptr<ConsoleState> state)
      : state_(std::move(state)), acceptor_(context), pause_(context), stopping_(context) {}
  absl::Status Listen();
  absl::Status LoadCertificate();
  void Accept();
  void OnAccepted(boost::asio::ip::tcp::socket socket);
  void CloseAll();
  void CloseWhenIdle(int rounds);

  const std::unique_ptr<ConsoleState> state_;
  boost::asio::ip::tcp::acceptor acceptor_;
  boost::asio::steady_timer pause_;  // after an error of accept
  boost::asio::steady_timer stopping_;
  std::shared_ptr<boost::asio::ssl::context> tls_;
  std::map<uint64_t, std::weak_ptr<WebConnection>> connections_;
  std::map<std::string, int> by_peer_;
  uint64_t last_connection_ = 0;
};

}  // namespace horopter
