#include "client/cao_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/cad_import.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::HasSubstr;

constexpr char kCube[] = R"(V1
# points
8
0 0 0 # origin
0.04 0 0
0.04 0.03 0
0 0.03 0
0 0 0.02
0.04 0 0.02
0.04 0.03 0.02
0 0.03 0.02
# lines
4
0 3
3 2
2 1
1 0
# faces from lines
1
4 0 1 2 3 name="bottom"
# faces from points
5
4 4 5 6 7
4 0 1 5 4
4 1 2 6 5 useLod=true
4 2 3 7 6
4 3 0 4 7
)";

TEST(CaoFileTest, ReadsFacesFromLinesAndFromPoints) {
  TempFolder folder;
  const auto cad = ImportCad(folder.Write("a.cao", kCube));
  ASSERT_TRUE(cad.ok()) << cad.status();
  EXPECT_EQ(cad->format, "CAO");
  EXPECT_EQ(cad->unit_name, "m");
  EXPECT_EQ(cad->counts.at("vertices"), 8);
  EXPECT_EQ(cad->counts.at("lines"), 12);
  EXPECT_NEAR(cad->model.diameter_m, std::sqrt(0.04 * 0.04 + 0.03 * 0.03 + 0.02 * 0.02), 1e-9);
  EXPECT_EQ(cad->counts.at("symmetries"), 3);
  EXPECT_TRUE(cad->warnings.empty()) << cad->warnings[0];
}

TEST(CaoFileTest, CylindersBecomeCircles) {
  TempFolder folder;
  const auto cad =
      ImportCad(folder.Write("a.cao", "V1\n2\n0 0 0\n0 0 0.05\n0\n0\n0\n1\n0 1 0.02\n0\n"));
  ASSERT_TRUE(cad.ok()) << cad.status();
  EXPECT_EQ(cad->counts.at("circles"), 2);
  EXPECT_EQ(cad->counts.at("lines"), 0);
}

TEST(CaoFileTest, WhatIsWrittenReadsBackAsTheSamePart) {
  TempFolder folder;
  const auto first = ImportCad(folder.Write("a.cao", kCube));
  ASSERT_TRUE(first.ok());
  const std::string path = folder.path() + "/b.cao";
  ASSERT_TRUE(WriteCao(path, first->model).ok());
  const auto second = ImportCad(path);
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_EQ(second->counts, first->counts);
  EXPECT_DOUBLE_EQ(second->model.diameter_m, first->model.diameter_m);
}

TEST(CaoFileTest, RefusalsSayWhatIsWrong) {
  TempFolder folder;
  const auto refusal = [&](const std::string& text) {
    return std::string(ReadCao(folder.Write("bad.cao", text), 1.0).status().message());
  };
  EXPECT_THAT(refusal("V2\n"), HasSubstr("V1"));
  EXPECT_THAT(refusal("V1\n3\n0 0 0\n1 0 0\n"), HasSubstr("ends too early"));
  EXPECT_THAT(refusal("V1\n1\n0 0 nan\n"), HasSubstr("finite"));
  EXPECT_THAT(refusal("V1\n-1\n"), HasSubstr("count"));
  EXPECT_THAT(refusal("V1\n999999999999\n"), HasSubstr("count"));
  EXPECT_THAT(refusal("V1\nload(\"x.cao\")\n"), HasSubstr("load"));
  EXPECT_THAT(refusal("V1\n3\n0 0 0\n1 0 0\n0 1 0\n0\n0\n1\n3 0 1 7\n"), HasSubstr("index"));
  EXPECT_THAT(refusal("V1\n3\n0 0 0\n1 0 0\n0 1 0\n"), HasSubstr("no faces"));
  EXPECT_EQ(ReadCao(folder.path() + "/none.cao", 1.0).status().code(), absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace horopter
