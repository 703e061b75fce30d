// Command lines of `station`.
#include <CLI/CLI.hpp>
#include <memory>

#include "client/cli.h"
#include "client/commands.h"

namespace horopter {
namespace {

struct StationArguments {
  std::string id, camera, path;
  bool keep_base = false;
};

void AddSet(CLI::App& station, Command* command) {
  auto a = std::make_shared<StationSetArguments>();
  CLI::App* set = AddCommand(station,
                             "set",
                             "make a station, or change what is said of it",
                             "horopter station set cell1 --name \"press 4\" --moving arm");
  set->add_option("ID", a->id, "[a-z0-9_-]{1,63}")->required();
  set->add_option("--name", a->display_name, "free text");
  set->add_option("--fixed", a->fixed, "cameras that stand still (default)")->delimiter(',');
  set->add_option("--moving", a->moving, "cameras on the arm: only their lenses are kept")
      ->delimiter(',');
  set->add_option("--zooming", a->zooming, "cameras whose lens changes from request to request")
      ->delimiter(',');
  set->add_option("--camera-pose",
                  a->camera_pose,
                  "CAMERA X Y Z QW QX QY QZ: where a fixed camera is in the robot base, metres; "
                  "for several cameras again")
      ->expected(8, 128);
  set->add_option("--camera-pose-sigma",
                  a->camera_pose_sigma,
                  "RADIANS METRES: standard deviations of these poses (default: 0.01 and 0.005)")
      ->expected(2);
  set->callback([=] { *command = [a](HoropterClient& c) { return StationSet(c, *a); }; });
}

}  // namespace

void AddStationCommands(CLI::App& app, Command* command) {
  CLI::App& station =
      *app.add_subcommand("station", "fixed cameras that calibrate themselves by working")
           ->require_subcommand(1);
  station.fallthrough();
  AddSet(station, command);
  auto a = std::make_shared<StationArguments>();
  AddCommand(station, "list", "table of all stations", "horopter station list")->callback([=] {
    *command = StationList;
  });
  CLI::App* show = AddCommand(station,
                              "show",
                              "cameras with their deviations, and what was noticed of them",
                              "horopter station show cell1");
  show->add_option("ID", a->id)->required();
  show->callback([=] { *command = [a](HoropterClient& c) { return StationShow(c, a->id); }; });
  CLI::App* rm = AddCommand(station, "rm", "remove a station", "horopter station rm cell1");
  rm->add_option("ID", a->id)->required();
  rm->callback([=] { *command = [a](HoropterClient& c) { return StationRemove(c, a->id); }; });
  CLI::App* reset = AddCommand(station,
                               "reset",
                               "forget what was learnt, of all cameras or of one",
                               "horopter station reset cell1 --camera left");
  reset->add_option("ID", a->id)->required();
  reset->add_option("--camera", a->camera, "this one alone (default: all)");
  reset->add_flag("--keep-base",
                  a->keep_base,
                  "where the cameras are in the robot base is kept, though it was learnt");
  reset->callback([=] {
    *command = [a](HoropterClient& c) { return StationReset(c, a->id, a->camera, a->keep_base); };
  });
  CLI::App* import_ = AddCommand(station,
                                 "import",
                                 "take a camera's calibration over",
                                 "horopter station import cell1 left left.yaml");
  import_->add_option("ID", a->id)->required();
  import_->add_option("CAMERA", a->camera)->required();
  import_->add_option("FILE", a->path, "calibration, as recognize --camera takes it")->required();
  import_->callback([=] {
    *command = [a](HoropterClient& c) { return StationImport(c, a->id, a->camera, a->path); };
  });
  CLI::App* export_ = AddCommand(station,
                                 "export",
                                 "write a camera's calibration as camera_info YAML",
                                 "horopter station export cell1 left left.yaml");
  export_->add_option("ID", a->id)->required();
  export_->add_option("CAMERA", a->camera)->required();
  export_->add_option("FILE", a->path)->required();
  export_->callback([=] {
    *command = [a](HoropterClient& c) { return StationExport(c, a->id, a->camera, a->path); };
  });
}

}  // namespace horopter
