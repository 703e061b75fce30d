#include "server/service/listen_address.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "server/service/port_watch.h"
#include "tests/support/scratch_dir.h"

namespace horopter {
namespace {

using Kind = ListenAddress::Kind;

std::string Refusal(const std::string& text) {
  const auto parsed = ParseListenAddress("listen", text);
  if (parsed.ok()) return "";
  EXPECT_EQ(parsed.status().code(), absl::StatusCode::kInvalidArgument);
  return std::string(parsed.status().message());
}

TEST(ListenAddress, IsReadInAllItsForms) {
  const auto named = ParseListenAddress("listen", "cell-pc:50051");
  ASSERT_TRUE(named.ok());
  EXPECT_EQ(named->host, "cell-pc");
  EXPECT_EQ(named->port, 50051);
  EXPECT_EQ(ParseListenAddress("listen", "[::1]:0")->host, "::1");
  EXPECT_EQ(ParseListenAddress("listen", "unix:/run/admin.sock")->path, "/run/admin.sock");
  EXPECT_EQ(ParseListenAddress("listen", "unix:///run/admin.sock")->path, "/run/admin.sock");
  EXPECT_EQ(ParseListenAddress("listen", "unix-abstract:admin")->kind, Kind::kAbstract);
}

TEST(ListenAddress, PortsThatAreNoneAreRefusedWithTheOption) {
  for (const char* text : {"localhost:65536",
                           "localhost:99999",
                           "localhost:-1",
                           "localhost:http",
                           "localhost:",
                           "localhost",
                           ":50051",
                           "::1:50051",
                           "50051",
                           "localhost:5 0",
                           "localhost:4294967297",
                           "unix:",
                           "[]:1"}) {
    EXPECT_THAT(Refusal(text), testing::StartsWith("listen: ")) << text;
  }
}

ListeningSockets MustListen(const std::string& text) {
  auto listening = Listen(text, *ParseListenAddress("listen", text));
  EXPECT_TRUE(listening.ok()) << listening.status();
  return listening.ok() ? *std::move(listening) : ListeningSockets();
}

void CloseAll(const ListeningSockets& listening) {
  for (const int fd : listening.descriptors) ::close(fd);
}

TEST(Listen, APortThatIsTakenIsNamedWithTheReason) {
  const ListeningSockets first = MustListen("127.0.0.1:0");
  const auto second = Listen(first.address, *ParseListenAddress("listen", first.address));
  EXPECT_EQ(second.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(second.status().message()),
              testing::AllOf(testing::HasSubstr(first.address), testing::HasSubstr("in use")));
  CloseAll(first);
}

TEST(Listen, ALeftSocketFileIsReplacedAndOneInUseOrAnotherFileIsNot) {
  const ScratchDir folder;
  const std::string path = folder.File("admin.sock"), text = "unix:" + path;
  const ListenAddress address = *ParseListenAddress("listen", text);
  const ListeningSockets first = MustListen(text);
  EXPECT_EQ(std::filesystem::status(path).permissions() & std::filesystem::perms(077),
            std::filesystem::perms::none);
  EXPECT_EQ(Listen(text, address).status().code(), absl::StatusCode::kUnavailable);
  CloseAll(first);
  CloseAll(MustListen(text));
  std::filesystem::remove(path);
  std::ofstream(path) << "precious";
  EXPECT_EQ(Listen(text, address).status().code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(std::filesystem::file_size(path), 8u);
}

TEST(PortWatch, APortThatNobodyAnswersIsLostAfterSoManyLooks) {
  const ListeningSockets deaf = MustListen("127.0.0.1:0");  // its queue takes connections
  PortWatchOptions options;
  options.every_seconds = 0.01;
  options.timeout_seconds = 0.05;
  std::mutex mutex;
  std::condition_variable changed;
  std::string lost;
  int reached = 0;
  {
    PortWatch watch(
        {{deaf.address, false}},
        options,
        [&] { ++reached; },
        [&](const std::string& why) {
          const std::lock_guard lock(mutex);
          lost = why;
          changed.notify_all();
        });
    std::unique_lock lock(mutex);
    changed.wait(lock, [&] { return !lost.empty(); });
  }
  EXPECT_EQ(reached, 0);
  EXPECT_THAT(lost, testing::StartsWith(deaf.address));
  CloseAll(deaf);
}

TEST(ProbePort, AnEndedConnectionIsAnAnswerAndAClosedPortIsNone) {
  const ListeningSockets listening = MustListen("127.0.0.1:0");
  std::thread closes([&] {
    int fd = -1;
    while ((fd = ::accept(listening.descriptors[0], nullptr, nullptr)) < 0) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    ::close(fd);
  });
  EXPECT_TRUE(ProbePort({listening.address, true}, 60.0).ok());
  closes.join();
  CloseAll(listening);
  EXPECT_EQ(ProbePort({listening.address, false}, 1.0).code(), absl::StatusCode::kUnavailable);
}

}  // namespace
}  // namespace horopter
