#include "client/address.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>

namespace horopter {
namespace {

using testing::HasSubstr;

TEST(Address, IsHostAndPortOrWhatGrpcResolves) {
  for (const char* good : {"localhost:50051",
                           "10.0.0.7:1",
                           "[::1]:50051",
                           "unix:/run/h.sock",
                           "unix:///run/h.sock",
                           "dns:///host:50051",
                           "ipv4:127.0.0.1:50051"}) {
    EXPECT_TRUE(CheckAddress(good).ok()) << CheckAddress(good);
  }
  for (const auto& [bad, says] : {std::pair("http://localhost:50051", "'localhost:50051'"),
                                  std::pair("https://cell:50051/", "--tls"),
                                  std::pair("grpc://cell:50051", "URL"),
                                  std::pair("localhost", "PORT"),
                                  std::pair("localhost:", "PORT"),
                                  std::pair("", "PORT"),
                                  std::pair("localhost:http", "PORT"),
                                  std::pair("localhost:50051/", "PORT"),
                                  std::pair("::1:50051", "PORT"),
                                  std::pair(":50051", "PORT"),
                                  std::pair("host:70000", "PORT"),
                                  std::pair("dns:///host", "PORT")}) {
    const absl::Status status = CheckAddress(bad);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << bad;
    EXPECT_THAT(std::string(status.message()), HasSubstr(says)) << bad;
  }
}

TEST(Address, OfThisMachineIsKnownByNameAndByInterface) {
  char name[256] = "";
  ASSERT_EQ(gethostname(name, sizeof(name) - 1), 0);
  for (const std::string here : {std::string("localhost:1"),
                                 std::string("LOCALHOST.:1"),
                                 std::string("127.0.0.1:1"),
                                 std::string("127.8.9.10:1"),
                                 std::string("[::ffff:127.0.0.1]:1"),
                                 std::string("unix:/x"),
                                 std::string("0.0.0.0:1"),
                                 std::string("dns:///localhost:1"),
                                 std::string("ipv4:127.0.0.1:1"),
                                 std::string(name) + ":1"}) {
    EXPECT_TRUE(IsThisMachine(here)) << here;
    EXPECT_FALSE(MayUseProxy(here)) << here;
  }
  for (const char* other :
       {"robot.example:1", "203.0.113.7:1", "localhost.example:1", "12.7.0.1:1"}) {
    EXPECT_FALSE(IsThisMachine(other)) << other;
  }
}

TEST(Address, NoProxyNamesDomainsAddressesAndNetworks) {
  for (const char* entries : {"*",
                              "example",
                              ".example",
                              "a, robot.example ",
                              "robot.example:50051",
                              "*.example",
                              "ROBOT.Example"}) {
    EXPECT_TRUE(MatchesNoProxy("robot.example:50051", entries)) << entries;
  }
  for (const char* entries : {"", "ample", "robot.example:1", "bot.example", "10.0.0.0/8", ","}) {
    EXPECT_FALSE(MatchesNoProxy("robot.example:50051", entries)) << entries;
  }
  for (const char* entries : {"203.0.113.0/24", "203.0.113.7", "203.0.113.7:50051", "0.0.0.0/0"}) {
    EXPECT_TRUE(MatchesNoProxy("203.0.113.7:50051", entries)) << entries;
  }
  for (const char* entries : {"203.0.114.0/24", "3.7", "203.0.113.7/33", "203.0.113.7/x", "::/0"}) {
    EXPECT_FALSE(MatchesNoProxy("203.0.113.7:50051", entries)) << entries;
  }
  EXPECT_TRUE(MatchesNoProxy("[2001:db8::7]:50051", "2001:db8::/32"));
  EXPECT_TRUE(MatchesNoProxy("[2001:db8::7]:50051", "[2001:db8:0::7]:50051"));
  EXPECT_FALSE(MatchesNoProxy("[2001:db8::7]:50051", "2001:db9::/32"));
}

TEST(Address, BothSpellingsOfNoProxyAreRead) {
  for (const char* name : {"no_proxy", "NO_PROXY", "no_grpc_proxy"}) {
    ::unsetenv("no_proxy"), ::unsetenv("NO_PROXY"), ::unsetenv("no_grpc_proxy");
    EXPECT_TRUE(MayUseProxy("robot.example:1"));
    ::setenv(name, "other, robot.example", 1);
    EXPECT_FALSE(MayUseProxy("robot.example:1")) << name;
    ::unsetenv(name);
  }
}

}  // namespace
}  // namespace horopter
