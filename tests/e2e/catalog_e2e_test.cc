// The object commands against a running server: what an operator types, sees and gets as exit code.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/client/mesh_samples.h"
#include "tests/client/temp_folder.h"
#include "tests/e2e/program.h"

namespace horopter {
namespace {

using testing::HasSubstr;
using testing::Not;

class CatalogE2e : public testing::Test {
 protected:
  void SetUp() override { Start(); }

  void Start() {
    server_ = std::make_unique<Server>(folder_.path() + "/catalog.db", folder_.path() + "/log");
    ASSERT_FALSE(server_->address().empty()) << server_->Log();
  }

  Outcome Run(std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--server", server_->address(), "--timeout", "20"});
    return RunHoropter(arguments);
  }

  TempFolder folder_;
  std::unique_ptr<Server> server_;
};

TEST_F(CatalogE2e, AnObjectIsAddedShownChangedAndRemoved) {
  const std::string cad = folder_.Write("box.stl", AsStl(Box(2, 1.5, 1)));
  const std::string grasps =
      folder_.Write("g.json", R"({"grasps": [{"name": "top", "T_gripper_in_object":
      [1,0,0,5, 0,1,0,6, 0,0,1,7, 0,0,0,1], "jaw_opening_mm": 20, "grip_width_mm": 10}]})");
  Outcome o = Run({"object", "add", cad, "--id", "box-1", "--units", "in", "--name", "a box"});
  ASSERT_EQ(o.exit_code, 0) << o.out;
  EXPECT_THAT(o.out, HasSubstr("unit in"));
  EXPECT_THAT(o.out, HasSubstr("8 corners, 12 lines"));
  o = Run({"object", "update", "box-1", "--grasps", grasps});
  EXPECT_EQ(o.exit_code, 0) << o.out;
  o = Run({"object", "list"});
  EXPECT_THAT(o.out, HasSubstr("box-1"));
  EXPECT_THAT(o.out, HasSubstr("1 objects"));
  o = Run({"object", "show", "box-1"});
  EXPECT_EQ(o.exit_code, 0) << o.out;
  EXPECT_THAT(o.out, HasSubstr("a box"));
  EXPECT_THAT(o.out, HasSubstr("diameter    68.39 mm"));
  EXPECT_THAT(o.out, HasSubstr("top at (5.0, 6.0, 7.0) mm"));
  EXPECT_THAT(o.out, HasSubstr("box.stl (stl, unit in"));
  o = Run({"object", "rm", "box-1"});
  EXPECT_EQ(o.exit_code, 0) << o.out;
  o = Run({"object", "show", "box-1"});
  EXPECT_EQ(o.exit_code, 3);
  EXPECT_THAT(o.out, HasSubstr("NOT_FOUND"));
}

TEST_F(CatalogE2e, RefusalsNameTheOffenderAndLeaveTheCatalogAsItWas) {
  const std::string cad = folder_.Write("box.ply", AsPly(Box(20, 15, 10)));
  ASSERT_EQ(Run({"object", "add", cad, "--id", "box"}).exit_code, 0);
  const std::string before = Run({"object", "list"}).out;

  Outcome o = Run({"object", "add", cad, "--id", "box"});
  EXPECT_EQ(o.exit_code, 3);
  EXPECT_THAT(o.out, HasSubstr("ALREADY_EXISTS"));
  o = Run({"object", "add", cad, "--id", "Not An Id"});
  EXPECT_EQ(o.exit_code, 3);
  EXPECT_THAT(o.out, HasSubstr("object_id"));
  o = Run({"object", "add", folder_.Write("bad.step", "letter"), "--id", "bad"});
  EXPECT_EQ(o.exit_code, 3);
  EXPECT_THAT(o.out, HasSubstr("bad.step"));
  o = Run({"object", "add", cad, "--id", "b2", "--grasps", folder_.Write("bad.json", "{")});
  EXPECT_EQ(o.exit_code, 3);
  EXPECT_THAT(o.out, HasSubstr("bad.json"));
  o = Run({"object", "rm", "nobody"});
  EXPECT_EQ(o.exit_code, 3);
  o = Run({"object", "update", "box"});
  EXPECT_EQ(o.exit_code, 3);
  o = Run({"object", "paint", "box"});
  EXPECT_EQ(o.exit_code, 2);
  o = Run({"recognize", folder_.Write("note.png", "no image")});
  EXPECT_EQ(o.exit_code, 3);
  EXPECT_THAT(o.out, HasSubstr("images[0]"));
  o = Run({"recognize", folder_.path() + "/absent.png"});
  EXPECT_EQ(o.exit_code, 3);
  EXPECT_THAT(o.out, HasSubstr("absent.png"));

  EXPECT_EQ(Run({"object", "list"}).out, before);
  EXPECT_TRUE(server_->Alive());
}

TEST_F(CatalogE2e, AcknowledgedObjectsSurviveAKill) {
  const std::string cad = folder_.Write("box.ply", AsPly(Box(20, 15, 10)));
  ASSERT_EQ(Run({"object", "add", cad, "--id", "box"}).exit_code, 0);
  server_->Kill();
  const Outcome o = Run({"object", "list"});
  EXPECT_EQ(o.exit_code, 4);
  EXPECT_THAT(o.out, HasSubstr("cannot be reached"));
  EXPECT_THAT(o.out, HasSubstr(server_->address()));
  Start();
  EXPECT_THAT(Run({"object", "list"}).out, HasSubstr("1 objects"));
  EXPECT_EQ(server_->Terminate(), 0);
}

TEST_F(CatalogE2e, ABackupIsACatalogAndAnExportComesBackExactly) {
  const std::string a = folder_.Write("a.stl", AsStl(Box(60, 40, 20)));
  const std::string b = folder_.Write("b.stl", AsStl(Box(60, 40, 30)));
  ASSERT_EQ(Run({"object", "add", a, "--id", "low"}).exit_code, 0);
  Outcome o = Run({"object", "add", b, "--id", "high"});
  ASSERT_EQ(o.exit_code, 0) << o.out;
  EXPECT_THAT(o.out, HasSubstr("look-alike: low is the same part stretched"));
  o = Run({"object", "verify"});
  EXPECT_EQ(o.exit_code, 0) << o.out;
  EXPECT_THAT(o.out, HasSubstr("2 objects checked, 0 problems"));

  const std::string backup = folder_.path() + "/backup.db", dump = folder_.path() + "/dump";
  o = Run({"catalog", "rebuild"});
  EXPECT_THAT(o.out, HasSubstr("2 objects rebuilt, the derived data of 0 changed"));
  EXPECT_EQ(Run({"catalog", "verify", "--recompute"}).exit_code, 0);

  EXPECT_EQ(Run({"catalog", "backup", backup}).exit_code, 0);
  EXPECT_EQ(Run({"catalog", "backup", backup}).exit_code, 3);  // never replaces a file
  EXPECT_EQ(Run({"catalog", "export", dump}).exit_code, 0);
  const std::string before = Run({"object", "show", "high", "--json"}).out;

  server_ = std::make_unique<Server>(backup, folder_.path() + "/log2");
  ASSERT_FALSE(server_->address().empty()) << server_->Log();
  EXPECT_EQ(Run({"object", "show", "high", "--json"}).out, before);

  server_ = std::make_unique<Server>(folder_.path() + "/empty.db", folder_.path() + "/log3");
  ASSERT_FALSE(server_->address().empty()) << server_->Log();
  o = Run({"catalog", "import", dump});
  EXPECT_EQ(o.exit_code, 0) << o.out;
  EXPECT_THAT(Run({"object", "list"}).out, HasSubstr("2 objects"));
  const std::string again = folder_.path() + "/again";
  EXPECT_EQ(Run({"catalog", "export", again}).exit_code, 0);
  EXPECT_EQ(Run({"catalog", "verify"}).exit_code, 0);
}

}  // namespace
}  // namespace horopter
