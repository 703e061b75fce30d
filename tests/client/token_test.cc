#include "client/token.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/status/status.h"
#include "client/channel.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr char kToken[] = "0123456789abcdef";

TEST(Token, WhatStandsAroundItIsDropped) {
  const std::string token = kToken;
  const std::string mark = "\xEF\xBB\xBF";
  for (const std::string& text : {token,
                                  token + "\r\n",
                                  token + "\n\n",
                                  " \t" + token + " ",
                                  mark + token,
                                  mark + token + "\r\n",
                                  "\r\n" + token,
                                  token + mark,
                                  token + "\r",
                                  "\v\f" + token + "\v",
                                  mark + " " + token}) {
    const auto cleaned = CleanToken(text, "here");
    ASSERT_TRUE(cleaned.ok()) << text << cleaned.status();
    EXPECT_EQ(*cleaned, token) << text;
  }
  EXPECT_EQ(*CleanToken("a token of words", "here"), "a token of words");
  EXPECT_EQ(*CleanToken(" \r\n", "here"), "");
  EXPECT_EQ(*CleanToken("", "here"), "");
}

TEST(Token, OtherBytesAreRefusedByTheirColumnAndNeverShown) {
  for (const auto& [text, at] :
       {std::pair<std::string, std::string>{"0123456789\tabcdef", "line 1, column 11"},
        {"0123456789\x7f"
         "abcdef",
         "line 1, column 11"},
        {std::string("0123\0abcdef", 11), "line 1, column 5"},
        {"\xff\xfe"
         "0\0",
         "line 1, column 1"},
        {"t\xc3\xb6kens0123456789", "line 1, column 2"},
        {"01234\r\n56789abcdef", "line 1, column 6"},
        {"\n\n 0123456789\x01"
         "abcdef",
         "line 3, column 12"}}) {
    const absl::Status status = CleanToken(text, "some/file").status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << at;
    EXPECT_THAT(std::string(status.message()),
                AllOf(HasSubstr("some/file"),
                      HasSubstr(at),
                      Not(HasSubstr("0123")),
                      Not(HasSubstr("abcdef"))));
  }
}

TEST(Token, OfAFile) {
  const TempFolder folder;
  EXPECT_EQ(*ReadTokenFile(HOROPTER_TEST_DATA "/inputs/tokens/crlf"), kToken);
  EXPECT_EQ(*ReadTokenFile(folder.Write("two", "\nfirst\r\nsecond\xff\n")), "first");
  EXPECT_EQ(ReadTokenFile(folder.Write("blank", "\xEF\xBB\xBF \r\n")).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(ReadTokenFile(folder.Write("empty", "")).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(ReadTokenFile(folder.path()).status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(ReadTokenFile(folder.path() + "/no").status().code(),
            absl::StatusCode::kFailedPrecondition);
  // UTF-16, as some shells write.
  EXPECT_THAT(ReadTokenFile(folder.Write("wide",
                                         std::string("\xff\xfe"
                                                     "0\0"
                                                     "1\0",
                                                     6)))
                  .status()
                  .message(),
              HasSubstr("column 1"));
}

// gRPC would end the process.
TEST(Token, AChannelRefusesWhatMetadataCannotHold) {
  ChannelSecurity security;
  security.token = std::string(kToken) + "\x01";
  const absl::Status status = MakeChannel("localhost:1", security).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(status.message()), Not(HasSubstr("0123")));
  security.token = std::string(kToken) + "\r\n";
  EXPECT_TRUE(MakeChannel("localhost:1", security).ok());
}

}  // namespace
}  // namespace horopter
