// horopter: the operator's program. See `horopter --help`.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <string>

#include "client/commands.h"

namespace horopter {
namespace {

// Exit codes: 0 done, 1 the server or the program failed, 2 wrong usage, 3 the input was refused, 4
// the server cannot be reached or did not answer in time.
int ExitCode(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kOk:
      return 0;
    case absl::StatusCode::kInvalidArgument:
    case absl::StatusCode::kNotFound:
    case absl::StatusCode::kAlreadyExists:
    case absl::StatusCode::kFailedPrecondition:
    case absl::StatusCode::kPermissionDenied:
      return 3;
    case absl::StatusCode::kUnavailable:
    case absl::StatusCode::kDeadlineExceeded:
    case absl::StatusCode::kResourceExhausted:
      return 4;
    default:
      return 1;
  }
}

struct Arguments {
  std::string server = "localhost:50051";
  double timeout_s = 600.0;
  ObjectAddArguments add;
  ObjectUpdateArguments update;
  std::string show_id;
  bool show_json = false;
  std::vector<std::string> rm_ids;
  std::vector<std::string> rebuild_ids;
  bool recompute = false;
  std::vector<std::string> verify_ids;
  std::vector<std::string> export_ids;
  std::string folder;
  std::string backup_path;
  std::string enroll_dataset;
  DatasetRecognizeArguments recognize_dataset;
  DatasetEvaluateArguments evaluate;
  RecognizeArguments recognize;
};

using Command = std::function<absl::Status(HoropterClient&)>;

void AddVerify(CLI::App* verify, Arguments& a, Command& command) {
  verify->add_flag(
      "--recompute", a.recompute, "also make derived data anew and compare: 0.1 s per object");
  verify->callback([&] {
    command = [&](HoropterClient& c) { return CatalogVerify(c, a.recompute, a.verify_ids); };
  });
}

void AddObjectCommands(CLI::App& app, Arguments& a, Command& command) {
  CLI::App* object = app.add_subcommand("object", "parts in the catalog")->require_subcommand(1);
  object->fallthrough();

  CLI::App* add = object->add_subcommand("add", "enrol a CAD file")->fallthrough();
  add->add_option("CAD_FILE",
                  a.add.cad_path,
                  "STEP, IGES, PLY, STL, OBJ or CAO; a PLY file without faces is a point cloud, a "
                  "JSON file a reconstruction")
      ->required();
  add->add_option("--id", a.add.id, "[a-z0-9_-]{1,63}")->required();
  add->add_option("--grasps", a.add.grasps_path, "grasp poses: JSON or isaac_grasp YAML");
  add->add_option(
      "--units", a.add.unit, "of a file that does not say: mm (default), cm, m, in, ft");
  add->add_option("--name", a.add.display_name, "free text (default: the solid's in the file)");
  add->add_flag("--split", a.add.split, "one object per solid of an assembly: ID-1, ID-2, ..");
  add->callback([&] { command = [&](HoropterClient& c) { return ObjectAdd(c, a.add); }; });

  CLI::App* update = object->add_subcommand("update", "change an object")->fallthrough();
  update->add_option("ID", a.update.id)->required();
  update->add_option("--cad", a.update.cad_path, "new geometry");
  update->add_option("--units", a.update.unit, "of the CAD file, as for add");
  update->add_option(
      "--grasps", a.update.grasps_path, "JSON or isaac_grasp YAML that replaces all grasps");
  update->add_option("--name", a.update.display_name, "free text");
  update->callback(
      [&] { command = [&](HoropterClient& c) { return ObjectUpdateCommand(c, a.update); }; });

  CLI::App* list = object->add_subcommand("list", "table of all objects")->fallthrough();
  list->callback([&] { command = [](HoropterClient& c) { return ObjectList(c); }; });

  CLI::App* show = object->add_subcommand("show", "one object")->fallthrough();
  show->add_option("ID", a.show_id)->required();
  show->add_flag("--json", a.show_json);
  show->callback(
      [&] { command = [&](HoropterClient& c) { return ObjectShow(c, a.show_id, a.show_json); }; });

  CLI::App* rm = object->add_subcommand("rm", "remove objects")->fallthrough();
  rm->add_option("ID", a.rm_ids)->required();
  rm->callback([&] { command = [&](HoropterClient& c) { return ObjectRemove(c, a.rm_ids); }; });

  CLI::App* verify =
      object->add_subcommand("verify", "check what is stored of objects")->fallthrough();
  verify->add_option("ID", a.verify_ids, "report these alone (default: all)");
  AddVerify(verify, a, command);

  CLI::App* write = object->add_subcommand("export", "write objects to a folder")->fallthrough();
  write->add_option("ID", a.export_ids)->required();
  write->add_option("--out", a.folder, "new folder, BOP layout")->required();
  write->callback([&] {
    command = [&](HoropterClient& c) { return ObjectExport(c, a.export_ids, a.folder); };
  });

  CLI::App* like =
      object->add_subcommand("look-alikes", "objects it can be taken for")->fallthrough();
  like->add_option("ID", a.show_id)->required();
  like->callback(
      [&] { command = [&](HoropterClient& c) { return ObjectLookAlikes(c, a.show_id); }; });
}

void AddCatalogCommands(CLI::App& app, Arguments& a, Command& command) {
  CLI::App* catalog =
      app.add_subcommand("catalog", "the catalog as a whole")->require_subcommand(1);
  catalog->fallthrough();

  CLI::App* backup =
      catalog->add_subcommand("backup", "copy the running catalog to a file")->fallthrough();
  backup->add_option("FILE", a.backup_path, "new file; horopterd --db FILE opens it")->required();
  backup->callback(
      [&] { command = [&](HoropterClient& c) { return CatalogBackup(c, a.backup_path); }; });

  CLI::App* write =
      catalog->add_subcommand("export", "write all objects to a folder")->fallthrough();
  write->add_option("FOLDER", a.folder, "new folder, BOP layout")->required();
  write->callback([&] { command = [&](HoropterClient& c) { return CatalogExport(c, a.folder); }; });

  CLI::App* read = catalog->add_subcommand("import", "enrol a folder's objects")->fallthrough();
  read->add_option("FOLDER", a.folder, "of `catalog export`, or any dataset in BOP layout")
      ->required();
  read->callback([&] { command = [&](HoropterClient& c) { return CatalogImport(c, a.folder); }; });

  CLI::App* verify =
      catalog->add_subcommand("verify", "check everything that is stored")->fallthrough();
  AddVerify(verify, a, command);

  CLI::App* rebuild =
      catalog->add_subcommand("rebuild", "make derived data anew from the geometry")->fallthrough();
  rebuild->add_option("ID", a.rebuild_ids, "objects (default: all)");
  rebuild->callback(
      [&] { command = [&](HoropterClient& c) { return CatalogRebuild(c, a.rebuild_ids); }; });
}

void AddDatasetCommands(CLI::App& app, Arguments& a, Command& command) {
  CLI::App* dataset =
      app.add_subcommand("dataset", "datasets in BOP layout")->require_subcommand(1);
  dataset->fallthrough();

  CLI::App* enroll = dataset->add_subcommand("enroll", "enrol all its objects")->fallthrough();
  enroll->add_option("DATASET", a.enroll_dataset)->required();
  enroll->callback(
      [&] { command = [&](HoropterClient& c) { return DatasetEnroll(c, a.enroll_dataset); }; });

  CLI::App* recognize =
      dataset->add_subcommand("recognize", "recognise its scenes, from the images alone")
          ->fallthrough();
  DatasetRecognizeArguments& r = a.recognize_dataset;
  recognize->add_option("DATASET", r.dataset)->required();
  recognize->add_option("SPLIT", r.split)->required();
  recognize->add_option("--out", r.out, "BOP results; intrinsics go to *.cameras.json beside it")
      ->required();
  recognize->add_option("--scenes", r.scenes, "e.g. 1,2 (default: all)")->delimiter(',');
  recognize->add_option("--max-images", r.max_images, "per scene (default: all)")
      ->check(CLI::PositiveNumber);
  recognize->callback([&] {
    command = [&](HoropterClient& c) { return DatasetRecognize(c, a.recognize_dataset); };
  });

  CLI::App* evaluate =
      dataset->add_subcommand("evaluate", "score results against ground truth")->fallthrough();
  DatasetEvaluateArguments& e = a.evaluate;
  evaluate->add_option("DATASET", e.dataset)->required();
  evaluate->add_option("SPLIT", e.split)->required();
  evaluate->add_option("RESULTS", e.results, "CSV in BOP format")->required();
  evaluate->add_option("--scenes", e.scenes, "e.g. 1,2 (default: all)")->delimiter(',');
  evaluate->add_flag("--json", e.json);
  evaluate->callback(
      [&] { command = [&](HoropterClient&) { return DatasetEvaluate(a.evaluate); }; });
}

void AddRecognizeCommand(CLI::App& app, Arguments& a, Command& command) {
  CLI::App* recognize =
      app.add_subcommand("recognize", "recognise parts in images of one static scene")
          ->fallthrough();
  RecognizeArguments& r = a.recognize;
  recognize->add_option("IMAGE", r.images)->required();
  recognize->add_option("--out", r.overlay_path, "PNG with the recognised wireframes");
  recognize->add_flag("--json", r.json, "print the whole answer");
  recognize->add_option("--candidates", r.candidates, "ids to look for, e.g. a,b (default: all)")
      ->delimiter(',');
  recognize
      ->add_option("--reference",
                   r.reference,
                   "ID [X Y Z QW QX QY QZ]: object whose pose in the robot base is known, metres")
      ->expected(1, 8);
  recognize->callback(
      [&] { command = [&](HoropterClient& c) { return Recognize(c, a.recognize); }; });
}

int Main(int argc, char** argv) {
  CLI::App app{"Recognises known parts in images from uncalibrated cameras.", "horopter"};
  Arguments a;
  Command command;
  app.require_subcommand(1);
  app.add_option("--server", a.server, "HOST:PORT")->capture_default_str();
  app.add_option("--timeout", a.timeout_s, "seconds for one call")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  AddObjectCommands(app, a, command);
  AddCatalogCommands(app, a, command);
  AddDatasetCommands(app, a, command);
  AddRecognizeCommand(app, a, command);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  HoropterClient client(a.server, a.timeout_s);
  const absl::Status status = command(client);
  if (!status.ok()) {
    std::fprintf(stderr,
                 "horopter: %s: %s\n",
                 absl::StatusCodeToString(status.code()).c_str(),
                 std::string(status.message()).c_str());
  }
  return ExitCode(status);
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
