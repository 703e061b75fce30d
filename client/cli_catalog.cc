// Command lines of `object` and `catalog`.
#include <CLI/CLI.hpp>
#include <cstdint>
#include <memory>

#include "client/cli.h"
#include "client/commands.h"

namespace horopter {
namespace {

struct CatalogArguments {
  ObjectAddArguments add;
  ObjectUpdateArguments update;
  std::string id, folder, path;
  std::vector<std::string> ids;
  bool recompute = false, remove = false;
  int64_t revision = 0;
  std::string if_match;
};

void AddAdd(CLI::App& object, Command* command) {
  auto a = std::make_shared<ObjectAddArguments>();
  CLI::App* add =
      AddCommand(object,
                 "add",
                 "enrol a CAD file",
                 "horopter object add bracket.step --id bracket-2 --grasps grasps.json");
  add->add_option("CAD_FILE",
                  a->cad_path,
                  "STEP, IGES, PLY, STL, OBJ or CAO; a PLY file without faces is a point cloud, a "
                  "JSON file a reconstruction")
      ->required();
  add->add_option("--id", a->id, "[a-z0-9_-]{1,63}")->required();
  add->add_option("--grasps", a->grasps_path, "grasp poses: JSON or isaac_grasp YAML");
  add->add_option("--units", a->unit, "of a file that does not say: mm (default), cm, m, in, ft");
  add->add_option("--name", a->display_name, "free text (default: the solid's in the file)");
  add->add_flag("--split", a->split, "one object per solid of an assembly: ID-1, ID-2, ..");
  add->add_option("--preview", a->preview_path, "PNG of what was enrolled, as object preview");
  add->callback([=] { *command = [a](HoropterClient& c) { return ObjectAdd(c, *a); }; });
}

void AddUpdate(CLI::App& object, Command* command) {
  auto a = std::make_shared<ObjectUpdateArguments>();
  CLI::App* update = AddCommand(
      object, "update", "change an object", "horopter object update bracket --grasps grasps.json");
  update->add_option("ID", a->id)->required();
  update->add_option("--cad", a->cad_path, "new geometry");
  update->add_option("--units", a->unit, "of the CAD file, as for add");
  update->add_option(
      "--grasps", a->grasps_path, "JSON or isaac_grasp YAML that replaces all grasps");
  update->add_option("--name", a->display_name, "free text");
  update->callback(
      [=] { *command = [a](HoropterClient& c) { return ObjectUpdateCommand(c, *a); }; });
}

void AddHistory(CLI::App& object, Command* command) {
  auto a = std::make_shared<CatalogArguments>();
  CLI::App* history = AddCommand(object,
                                 "history",
                                 "what an object was before its changes",
                                 "horopter object history bracket");
  history->add_option("ID", a->id)->required();
  history->callback([=] { *command = [a](HoropterClient& c) { return ObjectHistory(c, a->id); }; });

  CLI::App* restore = AddCommand(
      object, "restore", "make an object what it was", "horopter object restore bracket");
  restore->add_option("ID", a->id)->required();
  restore->add_option("REVISION", a->revision, "of `object history` (default: the one before)")
      ->check(CLI::PositiveNumber);
  restore->add_option("--if-match", a->if_match, "only while the object has this etag");
  restore->callback([=] {
    *command = [a](HoropterClient& c) { return ObjectRestore(c, a->id, a->revision, a->if_match); };
  });
}

void AddPrint(CLI::App& object, Command* command) {
  auto a = std::make_shared<CatalogArguments>();
  CLI::App* learn = AddCommand(object,
                               "learn-print",
                               "learn what is printed on an object from answered requests",
                               "horopter object learn-print bracket recordings/*.horec");
  learn->add_option("ID", a->id)->required();
  auto* files = learn->add_option(
      "RECORDING", a->ids, "of horopterd --record-dir, in which the object was answered");
  auto* remove = learn->add_flag("--remove", a->remove, "remove what was learnt")->excludes(files);
  learn->add_option("--if-match", a->if_match, "only while the object has this etag");
  learn->callback([=] {
    if (files->count() == 0 && remove->count() == 0) throw CLI::RequiredError("RECORDING");
    *command = [a](HoropterClient& c) {
      return ObjectLearnPrint(c, a->id, a->ids, a->remove, a->if_match);
    };
  });
}

void AddVerify(CLI::App& parent, const std::string& what, const char* example, Command* command) {
  auto a = std::make_shared<CatalogArguments>();
  CLI::App* verify = AddCommand(parent, "verify", what, example);
  if (parent.get_name() == "object") {
    verify->add_option("ID", a->ids, "report these alone (default: all)");
  }
  verify->add_flag(
      "--recompute", a->recompute, "also recompute derived data and compare: 0.1 s per object");
  verify->callback([=] {
    *command = [a](HoropterClient& c) { return CatalogVerify(c, a->recompute, a->ids); };
  });
}

}  // namespace

void AddObjectCommands(CLI::App& app, Command* command) {
  CLI::App& object = *app.add_subcommand("object", "parts in the catalog")->require_subcommand(1);
  object.fallthrough();
  AddAdd(object, command);
  AddUpdate(object, command);
  auto a = std::make_shared<CatalogArguments>();

  AddCommand(object, "list", "table of all objects", "horopter object list")->callback([=] {
    *command = ObjectList;
  });
  CLI::App* show = AddCommand(object, "show", "one object", "horopter object show bracket");
  show->add_option("ID", a->id)->required();
  show->callback([=] { *command = [a](HoropterClient& c) { return ObjectShow(c, a->id); }; });

  CLI::App* preview = AddCommand(object,
                                 "preview",
                                 "draw what is enrolled: edges, symmetries, grasps, stable poses",
                                 "horopter object preview bracket --out bracket.png");
  preview->add_option("ID", a->id)->required();
  preview->add_option("--out", a->path, "PNG")->required();
  preview->callback(
      [=] { *command = [a](HoropterClient& c) { return ObjectPreview(c, a->id, a->path); }; });

  CLI::App* rm = AddCommand(object, "rm", "remove objects", "horopter object rm bracket");
  rm->add_option("ID", a->ids)->required();
  rm->callback([=] { *command = [a](HoropterClient& c) { return ObjectRemove(c, a->ids); }; });

  AddHistory(object, command);
  AddPrint(object, command);
  AddVerify(object, "check what is stored of objects", "horopter object verify bracket", command);

  CLI::App* write = AddCommand(object,
                               "export",
                               "write objects to a folder",
                               "horopter object export bracket --out bracket-files");
  write->add_option("ID", a->ids)->required();
  write->add_option("--out", a->folder, "new folder, BOP layout")->required();
  write->callback(
      [=] { *command = [a](HoropterClient& c) { return ObjectExport(c, a->ids, a->folder); }; });

  CLI::App* like = AddCommand(
      object, "look-alikes", "objects it can be taken for", "horopter object look-alikes bracket");
  like->add_option("ID", a->id)->required();
  like->callback([=] { *command = [a](HoropterClient& c) { return ObjectLookAlikes(c, a->id); }; });
}

void AddCatalogCommands(CLI::App& app, Command* command) {
  CLI::App& catalog =
      *app.add_subcommand("catalog", "the catalog as a whole")->require_subcommand(1);
  catalog.fallthrough();
  auto a = std::make_shared<CatalogArguments>();

  CLI::App* backup = AddCommand(catalog,
                                "backup",
                                "copy the running catalog to a file",
                                "horopter catalog backup parts-backup.db");
  backup->add_option("FILE", a->path, "new file; horopterd --db FILE opens it")->required();
  backup->callback(
      [=] { *command = [a](HoropterClient& c) { return CatalogBackup(c, a->path); }; });

  CLI::App* restore = AddCommand(catalog,
                                 "restore",
                                 "replace the whole catalog by a backup",
                                 "horopter catalog restore parts-backup.db");
  restore->add_option("FILE", a->path, "of `catalog backup`")->required();
  restore->callback(
      [=] { *command = [a](HoropterClient& c) { return CatalogRestore(c, a->path); }; });

  CLI::App* migrate = AddCommand(
      catalog,
      "migrate",
      "copy a catalog that no server has open into an empty one, from a file to PostgreSQL or back",
      "horopter catalog migrate parts.db postgresql://horopter@db/horopter");
  migrate->add_option("FROM", a->path, "file or postgresql://USER@HOST/NAME")->required();
  migrate->add_option("TO", a->folder, "the same; a copy that was broken off is gone on with")
      ->required();
  migrate->callback(
      [=] { *command = [a](HoropterClient&) { return CatalogMigrate(a->path, a->folder); }; });

  CLI::App* write = AddCommand(
      catalog, "export", "write all objects to a folder", "horopter catalog export all-parts");
  write->add_option("FOLDER", a->folder, "new folder, BOP layout")->required();
  write->callback(
      [=] { *command = [a](HoropterClient& c) { return CatalogExport(c, a->folder); }; });

  CLI::App* read =
      AddCommand(catalog, "import", "enrol a folder's objects", "horopter catalog import parts");
  read->add_option("FOLDER", a->folder, "of `catalog export`, or any dataset in BOP layout")
      ->required();
  read->callback(
      [=] { *command = [a](HoropterClient& c) { return CatalogImport(c, a->folder); }; });

  AddVerify(catalog, "check everything that is stored", "horopter catalog verify", command);

  CLI::App* rebuild = AddCommand(catalog,
                                 "rebuild",
                                 "recompute derived data from the geometry",
                                 "horopter catalog rebuild bracket");
  rebuild->add_option("ID", a->ids, "objects (default: all)");
  rebuild->callback(
      [=] { *command = [a](HoropterClient& c) { return CatalogRebuild(c, a->ids); }; });
}

}  // namespace horopter
