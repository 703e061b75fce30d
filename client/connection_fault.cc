#include "client/connection_fault.h"

#include <algorithm>
#include <cctype>

namespace horopter {
namespace {

struct FaultWords {
  const char* sign;  // in the message, lower case
  const char* words;
};

// The first that is found counts: what is nearer to the cause stands first.
constexpr FaultWords kFaultWords[] = {
    {"wrong version number", "it does not speak TLS: call it without --tls and --tls-ca"},
    {"packet length too long", "it does not speak TLS: call it without --tls and --tls-ca"},
    {"certificate verify failed",
     "the authority that is given does not vouch for its certificate: --tls-ca"},
    {"is not in peer certificate", "its certificate is for another name: --tls-server-name"},
    {"hostname verification", "its certificate is for another name: --tls-server-name"},
    {"certificate required", "it wants a client certificate: --tls-cert and --tls-key"},
    {"bad certificate", "it does not take the client certificate: --tls-cert"},
    {"unknown ca", "it does not know the authority of the client certificate: --tls-cert"},
    {"connection refused", "nothing listens there"},
    {"no such file", "there is no such socket"},
    {"dns resolution failed", "the name of the host is not known"},
    {"domain name not found", "the name of the host is not known"},
    {"network is unreachable", "no network leads there"},
    {"no route to host", "no network leads there"},
    {"socket closed",
     "it closed the connection: it may want TLS (--tls-ca), be stopping, or be no horopterd"},
    {"connection reset",
     "it closed the connection: it may want TLS (--tls-ca), be stopping, or be no horopterd"},
    {"timed out", "it does not answer"},
};

}  // namespace

std::string ConnectionFault(std::string_view message) {
  std::string plain(message);
  std::transform(plain.begin(), plain.end(), plain.begin(), [](unsigned char c) {
    return c == '_' ? ' ' : static_cast<char>(std::tolower(c));
  });
  for (const FaultWords& w : kFaultWords) {
    if (plain.find(w.sign) != std::string::npos) return w.words;
  }
  return "";
}

}  // namespace horopter
