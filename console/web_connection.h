// A browser's connection: HTTP/1.1, one request after the other.
#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/context.hpp>
#include <functional>
#include <memory>
#include <string>

#include "console/console_state.h"

namespace horopter {

// What the listener may do to a connection; the object lives as long as the connection.
class WebConnection {
 public:
  virtual ~WebConnection() = default;
  virtual void Start() = 0;
  // Calls are cancelled and the socket is closed.
  virtual void Close() = 0;
};

// Without `tls` in the clear. `closed` runs once, when the connection is gone.
std::shared_ptr<WebConnection> MakeWebConnection(boost::asio::ip::tcp::socket socket,
                                                 const std::string& peer,
                                                 std::shared_ptr<boost::asio::ssl::context> tls,
                                                 ConsoleState& state,
                                                 std::function<void()> closed);

}  // namespace horopter
