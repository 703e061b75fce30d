#include "console/console_server.h"

#include <openssl/ssl.h>

#include <algorithm>
#include <chrono>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/address.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;

struct HostAndPort {
  std::string host, port;
};

absl::StatusOr<HostAndPort> SplitAddress(const std::string& address) {
  const size_t colon = address.rfind(':');
  std::string host = address.substr(0, colon);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  }
  const std::string port = colon == address.npos ? "" : address.substr(colon + 1);
  if (host.empty() || port.empty() || port.size() > 5 ||
      port.find_first_not_of("0123456789") != port.npos) {
    return absl::InvalidArgumentError(absl::StrCat("--listen ", address, ": expected HOST:PORT"));
  }
  return HostAndPort{host, port};
}

// Where tokens would travel in the clear.
absl::Status CheckServerSecurity(const ConsoleOptions& options) {
  const ChannelSecurity& security = options.security;
  const bool tls = security.tls || !security.ca_file.empty() || !security.cert_file.empty();
  HOROPTER_RETURN_IF_ERROR(CheckAddress(options.server));
  if (tls || options.insecure || options.server.starts_with("unix:") ||
      IsThisMachine(options.server)) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "tokens would travel to ", options.server, " without TLS: --server-ca, or --insecure"));
}

// As sockets of both families show an address of version 4.
std::string PeerOf(const tcp::socket& socket) {
  boost::system::error_code error;
  const tcp::endpoint end = socket.remote_endpoint(error);
  if (error) return "?";
  const asio::ip::address address = end.address();
  if (address.is_v6() && address.to_v6().is_v4_mapped()) {
    return asio::ip::make_address_v4(asio::ip::v4_mapped, address.to_v6()).to_string();
  }
  return address.to_string();
}

absl::StatusOr<PageFiles> LoadPage(const std::string& named) {
  const std::string folder = named == "auto" ? FindPageFolder() : named;
  if (!folder.empty()) return PageFiles::Load(folder);
  return PageFiles::Missing(
      "This horopter-console was built where node or npm was not there, or its page lies "
      "elsewhere: "
      "name the folder with --page.");
}

}  // namespace

absl::StatusOr<std::unique_ptr<ConsoleServer>> ConsoleServer::Start(asio::io_context& context,
                                                                    const ConsoleOptions& options) {
  HOROPTER_RETURN_IF_ERROR(CheckServerSecurity(options));
  ChannelSecurity security = options.security;
  security.token.clear();
  HOROPTER_ASSIGN_OR_RETURN(std::shared_ptr<grpc::Channel> channel,
                            MakeChannel(options.server, security));
  std::unique_ptr<ConsoleServer> server(
      new ConsoleServer(context, std::make_unique<ConsoleState>(options, std::move(channel))));
  HOROPTER_ASSIGN_OR_RETURN(server->state_->page, LoadPage(options.page));
  HOROPTER_RETURN_IF_ERROR(server->LoadCertificate());
  HOROPTER_RETURN_IF_ERROR(server->Listen());
  server->Accept();
  return server;
}

absl::Status ConsoleServer::LoadCertificate() {
  const ConsoleOptions& options = state_->options;
  if (options.certificate.empty() != options.key.empty()) {
    return absl::InvalidArgumentError("--tls-cert needs --tls-key and the reverse");
  }
  if (options.certificate.empty()) return absl::OkStatus();
  auto tls = std::make_shared<asio::ssl::context>(asio::ssl::context::tls_server);
  boost::system::error_code error;
  tls->set_options(asio::ssl::context::default_workarounds | asio::ssl::context::no_sslv2 |
                   asio::ssl::context::no_sslv3 | asio::ssl::context::no_tlsv1 |
                   asio::ssl::context::no_tlsv1_1);
  // The page speaks HTTP/1.1 alone.
  SSL_CTX_set_options(tls->native_handle(), SSL_OP_NO_RENEGOTIATION);
  tls->use_certificate_chain_file(options.certificate, error);
  if (error) {
    return absl::FailedPreconditionError(absl::StrCat(options.certificate, ": ", error.message()));
  }
  tls->use_private_key_file(options.key, asio::ssl::context::pem, error);
  if (error) {
    return absl::FailedPreconditionError(absl::StrCat(options.key, ": ", error.message()));
  }
  tls_ = std::move(tls);
  return absl::OkStatus();
}

absl::Status ConsoleServer::Listen() {
  const ConsoleOptions& options = state_->options;
  HOROPTER_ASSIGN_OR_RETURN(const HostAndPort where, SplitAddress(options.listen));
  boost::system::error_code error;
  const auto found = tcp::resolver(acceptor_.get_executor())
                         .resolve(where.host, where.port, tcp::resolver::passive, error);
  if (error || found.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("--listen ", options.listen, ": ", error.message()));
  }
  tcp::endpoint end = found.begin()->endpoint();
  for (const auto& entry : found) {
    if (entry.endpoint().address().is_v4()) end = entry.endpoint();
  }
  if (!end.address().is_loopback() && tls_ == nullptr && !options.insecure) {
    return absl::InvalidArgumentError(
        absl::StrCat("others can read along on ",
                     options.listen,
                     " without TLS: --tls-cert and --tls-key, or --insecure"));
  }
  acceptor_.open(end.protocol(), error);
  if (!error) acceptor_.set_option(tcp::acceptor::reuse_address(true), error);
  if (!error) acceptor_.bind(end, error);
  if (!error) acceptor_.listen(asio::socket_base::max_listen_connections, error);
  if (error) {
    return absl::UnavailableError(
        absl::StrCat("cannot listen on ", options.listen, ": ", error.message()));
  }
  return absl::OkStatus();
}

std::string ConsoleServer::address() const {
  boost::system::error_code error;
  const tcp::endpoint end = acceptor_.local_endpoint(error);
  const std::string host = end.address().to_string();
  return absl::StrCat(end.address().is_v6() ? "[" + host + "]" : host, ":", end.port());
}

void ConsoleServer::Accept() {
  acceptor_.async_accept([this](boost::system::error_code error, tcp::socket socket) {
    if (error == asio::error::operation_aborted || !acceptor_.is_open()) return;
    if (error) {  // no descriptor is free: some will be
      pause_.expires_after(std::chrono::milliseconds(100));
      pause_.async_wait([this](boost::system::error_code stopped) {
        if (!stopped) Accept();
      });
      return;
    }
    OnAccepted(std::move(socket));
    Accept();
  });
}

void ConsoleServer::OnAccepted(tcp::socket socket) {
  const ConsoleOptions& options = state_->options;
  const std::string peer = PeerOf(socket);
  if (static_cast<int>(connections_.size()) >= options.max_connections ||
      by_peer_[peer] >= options.max_connections_per_peer) {
    if (by_peer_[peer] == 0) by_peer_.erase(peer);
    state_->metrics.CountRefusal("connections");
    return;  // closed
  }
  boost::system::error_code ignored;
  socket.set_option(tcp::no_delay(true), ignored);
  socket.set_option(asio::socket_base::keep_alive(true), ignored);
  const uint64_t number = ++last_connection_;
  ++by_peer_[peer];
  auto connection = MakeWebConnection(std::move(socket), peer, tls_, *state_, [this, number, peer] {
    connections_.erase(number);
    if (--by_peer_[peer] == 0) by_peer_.erase(peer);
    state_->metrics.connections().Set(static_cast<double>(connections_.size()));
  });
  connections_[number] = connection;
  state_->metrics.connections().Set(static_cast<double>(connections_.size()));
  connection->Start();
}

absl::Status ConsoleServer::Reload() {
  HOROPTER_ASSIGN_OR_RETURN(PageFiles page, LoadPage(state_->options.page));
  HOROPTER_RETURN_IF_ERROR(LoadCertificate());
  state_->page = std::move(page);
  return absl::OkStatus();
}

void ConsoleServer::Stop() {
  const bool again = !acceptor_.is_open();
  boost::system::error_code ignored;
  acceptor_.close(ignored);
  pause_.cancel();
  if (again) return CloseAll();
  constexpr double kRoundSeconds = 0.1;
  CloseWhenIdle(static_cast<int>(state_->options.stop_seconds / kRoundSeconds));
}

void ConsoleServer::CloseWhenIdle(int rounds) {
  if (state_->calls == 0 || rounds <= 0) return CloseAll();
  stopping_.expires_after(std::chrono::milliseconds(100));
  stopping_.async_wait([this, rounds](boost::system::error_code error) {
    if (!error) CloseWhenIdle(rounds - 1);
  });
}

void ConsoleServer::CloseAll() {
  stopping_.cancel();
  std::vector<std::shared_ptr<WebConnection>> open;
  for (const auto& [number, connection] : connections_) {
    if (auto held = connection.lock()) open.push_back(std::move(held));
  }
  for (const auto& connection : open) connection->Close();
}

}  // namespace horopter
