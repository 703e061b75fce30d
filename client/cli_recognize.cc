// Command lines of `dataset` and `recognize`.
#include <CLI/CLI.hpp>
#include <memory>

#include "client/camera_hints.h"
#include "client/cli.h"
#include "client/commands.h"

namespace horopter {
namespace {

constexpr const char* kCroppedHelp =
    "the images are cut-outs: the cameras' principal points may be far from their middles";

void AddEnroll(CLI::App& dataset, Command* command) {
  auto folder = std::make_shared<std::string>();
  CLI::App* enroll =
      AddCommand(dataset, "enroll", "enrol all its objects", "horopter dataset enroll parts");
  enroll->add_option("DATASET", *folder)->required();
  enroll->callback(
      [=] { *command = [folder](HoropterClient& c) { return DatasetEnroll(c, *folder); }; });
}

void AddDatasetRecognize(CLI::App& dataset, Command* command) {
  auto a = std::make_shared<DatasetRecognizeArguments>();
  CLI::App* recognize =
      AddCommand(dataset,
                 "recognize",
                 "recognise its scenes, from the images alone",
                 "horopter dataset recognize parts val --scenes 5 --hints focal --out results.csv");
  recognize->add_option("DATASET", a->dataset)->required();
  recognize->add_option("SPLIT", a->split)->required();
  recognize->add_option("--out", a->out, "BOP results; intrinsics go to *.cameras.json beside it")
      ->required();
  recognize->add_option("--scenes", a->scenes, "e.g. 1,2 (default: all)")->delimiter(',');
  recognize->add_option("--targets",
                        a->targets,
                        "BOP target file that says which images are taken together (default: "
                        "SPLIT_targets_multiview_bop25.json of the dataset where it is there, else "
                        "all of a scene; none: all of a scene)");
  recognize->add_option("--max-images", a->max_images, "per scene (default: all)")
      ->check(CLI::PositiveNumber);
  recognize
      ->add_option("--hints",
                   a->hints,
                   "what the server is told of the cameras: none (default), focal (the true focal "
                   "length), truth (principal point and distortion as well)")
      ->transform(CLI::CheckedTransformer(kHints));
  recognize->add_flag("--cropped", a->cropped, kCroppedHelp);
  recognize
      ->add_option("--true-regions",
                   a->regions,
                   "true boxes of what is to be found that the server is told, an oracle: none "
                   "(default), parts (of each visible instance), all (one that holds them all)")
      ->transform(CLI::CheckedTransformer(kTrueRegions));
  recognize
      ->add_option("--region-margin",
                   a->region_margin,
                   "by which share of their longer side these are grown on every side")
      ->check(CLI::Range(0.0, 10.0))
      ->capture_default_str();
  recognize->callback(
      [=] { *command = [a](HoropterClient& c) { return DatasetRecognize(c, *a); }; });
}

void AddDatasetEvaluate(CLI::App& dataset, Command* command) {
  auto a = std::make_shared<DatasetEvaluateArguments>();
  CLI::App* evaluate = AddCommand(dataset,
                                  "evaluate",
                                  "score results against ground truth; needs no server",
                                  "horopter dataset evaluate parts val results.csv --scenes 5");
  evaluate->add_option("DATASET", a->dataset)->required();
  evaluate->add_option("SPLIT", a->split)->required();
  evaluate->add_option("RESULTS", a->results, "CSV in BOP format")->required();
  evaluate->add_option("--scenes", a->scenes, "e.g. 1,2 (default: all)")->delimiter(',');
  evaluate
      ->add_option("--min-visib",
                   a->min_visib,
                   "an instance of which an image shows less is no target there")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  evaluate->callback([=] { *command = [a](HoropterClient&) { return DatasetEvaluate(*a); }; });
}

// What `recognize` and `explain` have in common.
void AddSceneOptions(CLI::App* command, RecognizeArguments& a) {
  command->add_option("--out",
                      a.overlay_path,
                      "drawing over the images, made by the server: FILE.png or FILE.jpg is one "
                      "picture of all, FILE.svg becomes "
                      "FILE-1.svg and so on, to be laid over them");
  command->add_flag(
      "--unexplained", a.unexplained, "also draw the edges that belong to no recognised object");
  command->add_option("--candidates", a.candidates, "ids to look for, e.g. a,b (default: all)")
      ->delimiter(',');
  command
      ->add_option("--reference",
                   a.reference,
                   "ID [X Y Z QW QX QY QZ]: object whose pose in the robot base is known, metres; "
                   "several, each with its pose, decide what a symmetric one leaves open")
      ->expected(1, 128);
  command
      ->add_option("--reference-sigma",
                   a.reference_sigma,
                   "RADIANS METRES: standard deviations of the references' poses (default: exact)")
      ->expected(2);
  command->add_option(
      "--focal", a.cameras.focal_px, "focal length in pixels: one for all images, or one for each");
  command
      ->add_option("--focal-sigma",
                   a.cameras.focal_sigma,
                   "standard deviation of its logarithm (default: the server's, 0.02)")
      ->check(CLI::Range(1e-6, 2.0));
  command->add_option("--camera",
                      a.cameras.camera,
                      "calibration, one for all images or one for each, FILE or FILE#NAME of one "
                      "camera of several: camera_info of ROS, OpenCV (YAML, XML, lists of Python), "
                      "BOP camera.json, Kalibr camchain, COLMAP cameras.txt; roi and binning are "
                      "applied, without them another size counts as scaled");
  command->add_flag("--cropped", a.cropped, kCroppedHelp);
  command->add_flag("--ignore-exif",
                    a.ignore_exif,
                    "do not use the focal lengths that the images' files give (Exif)");
  command->add_option("--station",
                      a.station,
                      "ID of the station whose cameras took the images: see horopter station");
  command
      ->add_option("--station-cameras",
                   a.station_cameras,
                   "its camera of each image, e.g. left,right (default: camera1,camera2,..)")
      ->delimiter(',');
  command->add_option("--camera-pose",
                      a.cameras.camera_pose,
                      "X Y Z QW QX QY QZ of each camera in the robot base, metres; the camera "
                      "looks along its z, x is right");
  command
      ->add_option(
          "--camera-pose-sigma",
          a.cameras.camera_pose_sigma,
          "RADIANS METRES: standard deviations of these poses (default: the server's, 0.01 "
          "and 0.005)")
      ->expected(2);
  command
      ->add_option("--region",
                   a.regions.boxes,
                   "IMAGE:X,Y,WIDTH,HEIGHT: look for parts there only, e.g. 1:200,150,320,240 in "
                   "the first image, pixels; may be given several times. What is small in it is "
                   "looked at enlarged")
      ->allow_extra_args(false);
  command
      ->add_option("--region-box",
                   a.regions.space_boxes,
                   "X Y Z QW QX QY QZ SX SY SZ: look for parts in this box only: the pose of its "
                   "middle in the robot base and its size, metres; needs known cameras "
                   "(--camera with --camera-pose, or --station)")
      ->expected(10, 160);
  command
      ->add_option(
          "--unknown-share",
          a.unknown_share,
          "of what lies in such scenes and may be taken for a part of the catalog, the share "
          "that is none of it (default: the server's, 0.1); more: less is answered")
      ->check(CLI::Range(1e-6, 1.0 - 1e-6));
  command->add_flag("--read-only", a.read_only, "the station is used, and learns nothing");
}

}  // namespace

void AddDatasetCommands(CLI::App& app, Command* command) {
  CLI::App& dataset =
      *app.add_subcommand("dataset", "datasets in BOP layout")->require_subcommand(1);
  dataset.fallthrough();
  AddEnroll(dataset, command);
  AddDatasetRecognize(dataset, command);
  AddDatasetEvaluate(dataset, command);
}

void AddRecognizeCommand(CLI::App& app, Command* command) {
  auto a = std::make_shared<RecognizeArguments>();
  CLI::App* recognize =
      AddCommand(app,
                 "recognize",
                 "recognise parts in images of one static scene",
                 "horopter recognize 0.png 1.png 2.png --out overlay.png\n"
                 "  horopter recognize 0.png 1.png --focal 1000 --json\n"
                 "  horopter recognize 0.png 1.png --camera left.yaml right.yaml\n"
                 "  horopter recognize 0.png 1.png --region 1:200,150,320,240\n"
                 "  horopter recognize 0.png 1.png --expect bracket=1");
  recognize->add_option("IMAGE", a->images)->required();
  AddSceneOptions(recognize, *a);
  recognize
      ->add_option("--expect",
                   a->expected,
                   "what should lie there: ID, ID=COUNT or FILE.json with places and tolerances "
                   "(ExpectedPart in recognition.proto); ends with exit code 5 where not all is")
      ->delimiter(',');
  recognize->callback([=] { *command = [a](HoropterClient& c) { return Recognize(c, *a); }; });
}

void AddExplainCommand(CLI::App& app, Command* command) {
  auto a = std::make_shared<RecognizeArguments>();
  auto object = std::make_shared<std::string>();
  CLI::App* explain = AddCommand(
      app,
      "explain",
      "why an object is, or is not, recognised: its best pose, its edges, the test that refused it",
      "horopter explain bracket 0.png 1.png 2.png --out why.png\n"
      "  horopter explain bracket 0.png 1.png --unexplained --out why.svg");
  explain->add_option("OBJECT", *object, "id")->required();
  explain->add_option("IMAGE", a->images)->required();
  AddSceneOptions(explain, *a);
  explain->callback(
      [=] { *command = [a, object](HoropterClient& c) { return Explain(c, *object, *a); }; });
}

}  // namespace horopter
