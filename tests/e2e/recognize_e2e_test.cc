// The whole path on the sample data: enrol the CAD files, send the images, compare with the ground
// truth.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/client/temp_folder.h"
#include "tests/e2e/program.h"

namespace horopter {
namespace {

using testing::HasSubstr;

constexpr char kDataset[] = HOROPTER_TEST_DATA "/parts";

TEST(RecognizeE2e, ASingleKnownPartIsFoundInEveryImageFromTheImagesAlone) {
  const TempFolder folder;
  Server server(folder.path() + "/catalog.db", folder.path() + "/log");
  ASSERT_FALSE(server.address().empty()) << server.Log();
  const std::vector<std::string> to_server{"--server", server.address(), "--timeout", "400"};
  const auto run = [&](std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), to_server.begin(), to_server.end());
    return RunHoropter(arguments);
  };

  for (const char* verb : {"added", "updated"}) {  // twice: the second time all are there
    const Outcome enroll = run({"dataset", "enroll", kDataset});
    ASSERT_EQ(enroll.exit_code, 0) << enroll.out;
    EXPECT_THAT(enroll.out, HasSubstr("[20/20] obj_000020"));
    EXPECT_THAT(enroll.out, HasSubstr(verb));
  }
  EXPECT_THAT(run({"object", "list"}).out, HasSubstr("20 objects"));

  const std::string csv = folder.path() + "/results.csv";
  const Outcome recognize =
      run({"dataset", "recognize", kDataset, "val", "--scenes", "5", "--out", csv});
  ASSERT_EQ(recognize.exit_code, 0) << recognize.out << server.Log();
  const Outcome evaluate =
      RunHoropter({"dataset", "evaluate", kDataset, "val", csv, "--scenes", "5", "--json"});
  ASSERT_EQ(evaluate.exit_code, 0) << evaluate.out;
  const auto scores = nlohmann::json::parse(evaluate.out);
  EXPECT_EQ(scores["scenes"]["5"]["R@10"], 1.0) << recognize.out << evaluate.out;
  EXPECT_EQ(scores["scenes"]["5"]["false"], 0) << recognize.out;
  EXPECT_TRUE(
      scores["tiers"]["ALL"]["f_err"].is_number());  // the cameras file was written and read

  const std::string overlay = folder.path() + "/overlay.png";
  const std::string image = std::string(kDataset) + "/val/000005/rgb/000000.png";
  const std::string image_2 = std::string(kDataset) + "/val/000005/rgb/000001.png";
  const Outcome table =
      run({"recognize", image, image_2, "--candidates", "obj_000019", "--out", overlay});
  ASSERT_EQ(table.exit_code, 0) << table.out;
  EXPECT_THAT(table.out, HasSubstr("obj_000019"));
  EXPECT_GT(std::filesystem::file_size(overlay), 10000u);

  const Outcome unknown = run({"recognize", image, "--candidates", "nobody"});
  EXPECT_EQ(unknown.exit_code, 3);
  EXPECT_THAT(unknown.out, HasSubstr("nobody"));
  EXPECT_EQ(server.Terminate(), 0);
}

}  // namespace
}  // namespace horopter
