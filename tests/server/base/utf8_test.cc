#include "server/base/utf8.h"

#include <gtest/gtest.h>

namespace horopter {
namespace {

TEST(Utf8, IsWhatTheStandardAllowsAndNothingElse) {
  for (const char* good : {"",
                           "bracket",
                           "Tr\xc3\xa4ger",
                           "\xe6\x94\xaf\xe6\x9e\xb6",
                           "\xf0\x9f\x94\xa9",
                           "\xed\x9f\xbf",
                           "\xf4\x8f\xbf\xbf"}) {
    EXPECT_TRUE(IsUtf8(good)) << good;
    EXPECT_EQ(ToUtf8(good), good);
  }
  for (const char* bad : {"\xe4",
                          "a\xc3",
                          "\xc0\xaf",
                          "\xe0\x80\x80",
                          "\xed\xa0\x80",
                          "\xf0\x80\x80\x80",
                          "\xf4\x90\x80\x80",
                          "\xff",
                          "\x80"}) {
    EXPECT_FALSE(IsUtf8(bad));
    EXPECT_TRUE(IsUtf8(ToUtf8(bad)));
  }
}

TEST(Utf8, OtherTextIsWindows1252) {
  EXPECT_EQ(ToUtf8("Tr\xe4ger \x80"), "Tr\xc3\xa4ger \xe2\x82\xac");
  EXPECT_EQ(ToUtf8("\x81"), "\xef\xbf\xbd");
}

}  // namespace
}  // namespace horopter
