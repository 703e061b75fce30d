// A connection of a browser, with or without TLS: a stream as Beast's functions want it.
#pragma once

#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/stream.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/ssl/ssl_stream.hpp>
#include <memory>
#include <utility>

namespace horopter {

class WebStream {
 public:
  using Plain = boost::beast::tcp_stream;
  using Tls = boost::beast::ssl_stream<boost::beast::tcp_stream>;
  using executor_type = Plain::executor_type;

  // tls: null: none.
  WebStream(boost::asio::ip::tcp::socket socket, std::shared_ptr<boost::asio::ssl::context> tls)
      : context_(std::move(tls)) {
    if (context_ != nullptr) {
      tls_ = std::make_unique<Tls>(std::move(socket), *context_);
    } else {
      plain_ = std::make_unique<Plain>(std::move(socket));
    }
  }

  bool is_tls() const { return tls_ != nullptr; }
  Plain& lowest() { return is_tls() ? tls_->next_layer() : *plain_; }
  executor_type get_executor() { return lowest().get_executor(); }

  // Without TLS nothing is shaken.
  template <typename Handler>
  void async_handshake(Handler&& handler) {
    tls_->async_handshake(boost::asio::ssl::stream_base::server, std::forward<Handler>(handler));
  }
  template <typename Buffers, typename Token>
  auto async_read_some(const Buffers& buffers, Token&& token) {
    if (is_tls()) return tls_->async_read_some(buffers, std::forward<Token>(token));
    return plain_->async_read_some(buffers, std::forward<Token>(token));
  }
  template <typename Buffers, typename Token>
  auto async_write_some(const Buffers& buffers, Token&& token) {
    if (is_tls()) return tls_->async_write_some(buffers, std::forward<Token>(token));
    return plain_->async_write_some(buffers, std::forward<Token>(token));
  }

 private:
  const std::shared_ptr<boost::asio::ssl::context> context_;  // outlives what is made of it
  std::unique_ptr<Plain> plain_;
  std::unique_ptr<Tls> tls_;
};

}  // namespace horopter
