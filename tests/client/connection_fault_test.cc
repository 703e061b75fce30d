#include "client/connection_fault.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/shown.h"

namespace horopter {
namespace {

using testing::HasSubstr;

TEST(ConnectionFault, WhatGrpcSaysIsSaidInOurWords) {
  const std::pair<const char*, const char*> cases[] = {
      {"Socket closed", "want TLS"},
      {"recvmsg:Connection reset by peer", "want TLS"},
      {"failed to connect to all addresses; last error: UNKNOWN: ipv4:127.0.0.1:1: Failed to "
       "connect "
       "to remote host: Connection refused",
       "nothing listens"},
      {"failed to connect to all addresses; last error: UNKNOWN: ipv4:127.0.0.1:5: Ssl handshake "
       "failed: SSL_ERROR_SSL: error:0A00010B:SSL routines::wrong version number",
       "does not speak TLS"},
      {"Ssl handshake failed: SSL_ERROR_SSL: error:1000007d:SSL "
       "routines:OPENSSL_internal:CERTIFICATE_VERIFY_FAILED",
       "--tls-ca"},
      {"Peer name cell-pc is not in peer certificate", "--tls-server-name"},
      {"DNS resolution failed for nowhere:1: C-ares status is not ARES_SUCCESS",
       "name of the host"},
  };
  for (const auto& [said, words] : cases)
    EXPECT_THAT(ConnectionFault(said), HasSubstr(words)) << said;
  EXPECT_EQ(ConnectionFault("the server is stopping"), "");
  EXPECT_EQ(ConnectionFault(""), "");
}

// A name may come from anybody's file: no terminal must obey it.
TEST(Shown, ControlCharactersAreShownAndNothingElse) {
  EXPECT_EQ(Shown("l\xC3\xA4nge\t1\n"), "l\xC3\xA4nge\t1\n");
  EXPECT_EQ(Shown("\x1B[31mred\x07"), "\\x1b[31mred\\x07");
  EXPECT_EQ(Shown("a\rb\x7F"), "a\\x0db\\x7f");
  EXPECT_EQ(Shown("\xC2\x9B"), "\\u009b");                  // CSI of eight bits
  EXPECT_EQ(Shown("exe\xE2\x80\xAEgnp"), "exe\\u202egnp");  // right to left from here
  EXPECT_EQ(Shown("\xE2\x81\xA6x\xE2\x80\xB0"), "\\u2066x\xE2\x80\xB0");
  EXPECT_EQ(Shown("\xC2"), "\xC2");  // cut off
  EXPECT_EQ(Shown(std::string(1, '\0')), "\\x00");
}

}  // namespace
}  // namespace horopter
