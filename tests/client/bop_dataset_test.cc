#include "client/bop_dataset.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/bop_results.h"
#include "client/bop_targets.h"
#include "tests/client/temp_folder.h"

namespace horopter {
namespace {

using testing::HasSubstr;

constexpr char kInfo[] = R"({"1": {"diameter": 100.0}, "12": {"diameter": 50.0,
  "symmetries_discrete": [[-1,0,0,2, 0,-1,0,0, 0,0,1,0, 0,0,0,1]]},
  "3": {"diameter": 10.0, "symmetries_continuous": [{"axis": [0,0,1], "offset": [1,0,0]}]}})";
constexpr char kCamera[] =
    R"({"0": {"cam_K": [500,0,320,0,500,240,0,0,1], "cam_R_w2c": [1,0,0,0,1,0,0,0,1],
  "cam_t_w2c": [0,0,1000], "cam_dist": [-0.05,0,0,0]}, "7": {"cam_K": [600,0,320,0,600,240,0,0,1]}})";
constexpr char kGt[] =
    R"({"0": [{"cam_R_m2c": [1,0,0,0,1,0,0,0,1], "cam_t_m2c": [10,20,500], "obj_id": 12}],
  "7": []})";

// 640 x 480 PNG header; nothing behind it is read.
std::string PngHeader() {
  return std::string("\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x02\x80\0\0\x01\xe0\x08\x02\0\0\0", 29);
}

struct Sample {
  TempFolder folder;
  Sample() {
    folder.Write("models/obj_000001.ply", "ply");
    folder.Write("models/obj_000012.ply", "ply");
    folder.Write("models/obj_000003.ply", "ply");
    folder.Write("models/models_info.json", kInfo);
    folder.Write("models/names.json", R"({"12": "bracket"})");
    folder.Write("cad/obj_000012.step", "x");
    folder.Write("grasps/obj_000012.json", R"({"grasps": [{"name": "g", "T_gripper_in_object":
        [1,0,0,5, 0,1,0,6, 0,0,1,7, 0,0,0,1], "jaw_opening_mm": 20, "grip_width_mm": 10}]})");
    folder.Write("val/000004/rgb/000000.png", PngHeader());
    folder.Write("val/000004/gray/000007.png", PngHeader());
    folder.Write("val/000004/scene_camera.json", kCamera);
    folder.Write("val/000004/scene_gt.json", kGt);
    folder.Write("val/000004/scene_gt_info.json", R"({"0": [{"visib_fract": 0.25}], "7": []})");
    folder.Write("val/000004/scene_meta.json", R"({"tier": "T2"})");
  }
};

TEST(BopDataset, ObjectsComeInMetresByIdWithTheirFiles) {
  const Sample sample;
  const auto dataset = ReadBopDataset(sample.folder.path());
  ASSERT_TRUE(dataset.ok()) << dataset.status();
  ASSERT_EQ(dataset->objects.size(), 3u);
  EXPECT_EQ(dataset->objects[1].obj_id, 3);
  const BopObject* object = dataset->Find(12);
  ASSERT_NE(object, nullptr);
  EXPECT_EQ(object->name, "bracket");
  EXPECT_DOUBLE_EQ(object->diameter_m, 0.05);
  EXPECT_THAT(object->cad_path, HasSubstr("cad/obj_000012.step"));
  ASSERT_EQ(object->symmetries.size(), 1u);
  EXPECT_DOUBLE_EQ(object->symmetries[0].t.x(), 0.002);
  EXPECT_TRUE(dataset->Find(1)->cad_path.empty());
  EXPECT_EQ(dataset->Find(99), nullptr);
  // A continuous symmetry is 36 rotations about its axis, which stays where it is.
  ASSERT_EQ(dataset->Find(3)->symmetries.size(), 35u);
  for (const Rigid3& s : dataset->Find(3)->symmetries) {
    EXPECT_NEAR(
        (s * Eigen::Vector3d(0.001, 0, 0.3) - Eigen::Vector3d(0.001, 0, 0.3)).norm(), 0, 1e-12);
  }
  const auto grasps = ReadGrasps(object->grasps_path);
  ASSERT_TRUE(grasps.ok()) << grasps.status();
  ASSERT_EQ(grasps->size(), 1u);
  EXPECT_DOUBLE_EQ((*grasps)[0].object_from_gripper.t.z(), 0.007);
  EXPECT_DOUBLE_EQ((*grasps)[0].jaw_opening_m, 0.02);
  EXPECT_DOUBLE_EQ((*grasps)[0].quality, 1.0);
}

TEST(BopDataset, ScenesHoldImagesInOrderWithTruth) {
  const Sample sample;
  EXPECT_EQ(*ListBopScenes(sample.folder.path(), "val"), std::vector<int>{4});
  const auto scene = ReadBopScene(sample.folder.path(), "val", 4);
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ(scene->tier, "T2");
  ASSERT_EQ(scene->images.size(), 2u);
  const BopImage& image = scene->images[0];
  EXPECT_EQ(image.camera.width, 640);
  EXPECT_EQ(image.camera.height, 480);
  EXPECT_DOUBLE_EQ(image.camera.k1, -0.05);
  EXPECT_TRUE(image.has_pose);
  EXPECT_DOUBLE_EQ(image.camera_from_world.t.z(), 1.0);
  ASSERT_EQ(image.instances.size(), 1u);
  EXPECT_DOUBLE_EQ(image.instances[0].camera_from_object.t.y(), 0.02);
  EXPECT_DOUBLE_EQ(image.instances[0].visib_fract, 0.25);
  EXPECT_EQ(scene->images[1].im_id, 7);
  EXPECT_THAT(scene->images[1].path, HasSubstr("gray/000007.png"));
  EXPECT_FALSE(scene->images[1].has_pose);
}

TEST(BopDataset, ASceneNeedsNothingButImages) {
  const TempFolder folder;
  folder.Write("test/000001/rgb/000003.jpg", "no header");
  const auto scene = ReadBopScene(folder.path(), "test", 1);
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ(scene->tier, "all");
  EXPECT_FALSE(scene->has_ground_truth);
  EXPECT_EQ(scene->images[0].camera.width, 0);
}

// As BOP publishes: of these folders each data set has some.
TEST(BopDataset, ModelsMayBeInAnyOfTheirFolders) {
  const std::string info = R"({"15": {"diameter": 100.0}})";
  for (const std::string name :
       {"models", "models_cad", "models_reconst", "models_eval", "models_fine"}) {
    const TempFolder folder;
    folder.Write(name + "/obj_15.ply", "ply");
    folder.Write(name + "/models_info.json", info);
    const auto dataset = ReadBopDataset(folder.path());
    ASSERT_TRUE(dataset.ok()) << name << dataset.status();
    ASSERT_EQ(dataset->objects.size(), 1u);
    EXPECT_EQ(dataset->objects[0].obj_id, 15);
    EXPECT_THAT(dataset->objects[0].mesh_path, HasSubstr(name + "/obj_15.ply"));
    EXPECT_DOUBLE_EQ(dataset->objects[0].diameter_m, 0.1);
  }
}

TEST(BopDataset, TheBestModelsWinAndWhatTheyLackComesFromTheOthers) {
  const TempFolder folder;
  folder.Write("models_eval/obj_000001.ply", "ply");
  folder.Write("models_eval/obj_000002.ply", "ply");
  folder.Write("models_eval/models_info.json", kInfo);
  folder.Write("models_cad/obj_000001.ply", "ply");
  folder.Write("cad/obj_1.STEP", "x");
  folder.Write("grasps/obj_001.json", "{}");
  const auto dataset = ReadBopDataset(folder.path());
  ASSERT_TRUE(dataset.ok()) << dataset.status();
  ASSERT_EQ(dataset->objects.size(), 2u);
  EXPECT_THAT(dataset->objects[0].mesh_path, HasSubstr("models_cad/"));
  EXPECT_THAT(dataset->objects[0].cad_path, HasSubstr("obj_1.STEP"));
  EXPECT_THAT(dataset->objects[0].grasps_path, HasSubstr("obj_001.json"));
  EXPECT_DOUBLE_EQ(dataset->objects[0].diameter_m, 0.1);
  EXPECT_THAT(dataset->objects[1].mesh_path, HasSubstr("models_eval/"));
}

TEST(BopDataset, FoldersOfScenesMayHaveAnyNumberOfDigits) {
  for (const std::string name : {"1", "01", "0001", "000001", "00000001"}) {
    const TempFolder folder;
    folder.Write("test/" + name + "/rgb/3.png", PngHeader());
    EXPECT_EQ(*ListBopScenes(folder.path(), "test"), std::vector<int>{1}) << name;
    const auto scene = ReadBopScene(folder.path(), "test", 1);
    ASSERT_TRUE(scene.ok()) << scene.status();
    EXPECT_EQ(scene->images[0].im_id, 3);
  }
}

TEST(BopDataset, SensorsHaveFoldersAndFilesOfTheirOwn) {
  const auto truth = [](int obj_id) {
    return R"({"0": [{"cam_R_m2c": [1,0,0,0,1,0,0,0,1], "cam_t_m2c": [0,0,500], "obj_id": )" +
           std::to_string(obj_id) + "}]}";
  };
  const TempFolder folder;
  for (const std::string sensor : {"cam1", "cam2"}) {
    folder.Write("test/000000/rgb_" + sensor + "/000000.png", PngHeader());
    folder.Write("test/000000/depth_" + sensor + "/000000.png", PngHeader());
    folder.Write("test/000000/scene_camera_" + sensor + ".json",
                 sensor == "cam1" ? R"({"0": {"cam_K": [500,0,320,0,500,240,0,0,1]}})"
                                  : R"({"0": {"cam_K": [700,0,320,0,700,240,0,0,1]}})");
    folder.Write("test/000000/scene_gt_" + sensor + ".json", truth(sensor == "cam1" ? 1 : 2));
    folder.Write("test/000000/scene_gt_info_" + sensor + ".json",
                 R"({"0": [{"visib_fract": 0.5}]})");
  }
  folder.Write("test/000000/gray_photoneo/000000.png", PngHeader());
  const auto first = ReadBopScene(folder.path(), "test", 0);
  ASSERT_TRUE(first.ok()) << first.status();
  ASSERT_EQ(first->images.size(), 1u);
  EXPECT_TRUE(first->has_ground_truth);
  EXPECT_EQ(first->images[0].sensor, "cam1");
  EXPECT_DOUBLE_EQ(first->images[0].camera.focal_px, 500.0);
  EXPECT_EQ(first->images[0].instances.at(0).obj_id, 1);
  EXPECT_DOUBLE_EQ(first->images[0].instances.at(0).visib_fract, 0.5);
  const auto all = ReadBopScene(folder.path(), "test", 0, {.all_sensors = true});
  ASSERT_TRUE(all.ok()) << all.status();
  ASSERT_EQ(all->images.size(), 3u);
  EXPECT_DOUBLE_EQ(all->images[1].camera.focal_px, 700.0);
  EXPECT_EQ(all->images[1].instances.at(0).obj_id, 2);
  EXPECT_EQ(all->images[2].sensor, "photoneo");
  EXPECT_TRUE(HasBopImages(folder.path() + "/test/000000"));
  EXPECT_FALSE(HasBopImages(folder.path() + "/test"));
}

// Names of HOT3D: the folder itself is the sensor.
TEST(BopDataset, FoldersOfNumberedSensorsAreFound) {
  const TempFolder folder;
  folder.Write("test/000001/gray1/000000.jpg", "x");
  folder.Write("test/000001/gray2/000000.jpg", "x");
  folder.Write("test/000001/scene_camera_gray2.json",
               R"({"0": {"cam_K": [700,0,320,0,700,240,0,0,1]}})");
  const auto all = ReadBopScene(folder.path(), "test", 1, {.all_sensors = true});
  ASSERT_TRUE(all.ok()) << all.status();
  ASSERT_EQ(all->images.size(), 2u);
  EXPECT_DOUBLE_EQ(all->images[1].camera.focal_px, 700.0);
}

TEST(BopDataset, NotNumbersAndImagesWithoutVisibilityAreTruthAllTheSame) {
  const Sample sample;
  sample.folder.Write("val/000004/scene_gt_info.json", R"({"0": [{"visib_fract": NaN}], "7": []})");
  auto scene = ReadBopScene(sample.folder.path(), "val", 4);
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_DOUBLE_EQ(scene->images[0].instances[0].visib_fract, 0.0);
  sample.folder.Write("val/000004/scene_gt_info.json", "{}");
  scene = ReadBopScene(sample.folder.path(), "val", 4);
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_DOUBLE_EQ(scene->images[0].instances[0].visib_fract, 1.0);
  // A word in a name is no number, and not a number is no pose.
  sample.folder.Write("models/names.json", R"({"12": "NaN \" Infinity"})");
  EXPECT_EQ(ReadBopDataset(sample.folder.path())->Find(12)->name, "NaN \" Infinity");
  sample.folder.Write("val/000004/scene_camera.json", R"({"0": {"cam_K": [NaN,0,1,0,1,1,0,0,1]}})");
  EXPECT_EQ(ReadBopScene(sample.folder.path(), "val", 4).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(BopDataset, TruthIsNotOpenedWhereNobodyWantsIt) {
  const Sample sample;
  sample.folder.Write("val/000004/scene_gt.json", "no JSON");
  sample.folder.Write("val/000004/scene_gt_info.json", "no JSON");
  sample.folder.Write("val/000004/scene_camera.json", "no JSON");
  const auto scene =
      ReadBopScene(sample.folder.path(), "val", 4, {.cameras = false, .truth = false});
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ(scene->images.size(), 2u);
}

TEST(BopDataset, NamesInLatin1BecomeUtf8) {
  const Sample sample;
  sample.folder.Write("models/names.json", "{\"12\": \"Tr\xe4ger\"}");
  EXPECT_EQ(ReadBopDataset(sample.folder.path())->Find(12)->name, "Tr\xc3\xa4ger");
}

TEST(BopTargets, OfSeveralViewsAreTakenTogetherAsTheyAreWritten) {
  const TempFolder folder;
  folder.Write("test_targets_multiview_bop25.json",
               R"([{"scene_id": 3, "im_ids": [2, 0, 1], "obj_id": 8, "inst_count": 2},
                   {"scene_id": 3, "im_ids": [0, 1, 2], "obj_id": 9, "inst_count": 1},
                   {"scene_id": 3, "im_ids": [4, 5]},
                   {"scene_id": "000004", "im_ids": ["000001", {"im_id": 2, "sensor": "cam1"}]}])");
  const std::string path = MultiviewTargetsOf(folder.path(), "test");
  EXPECT_EQ(path, MultiviewTargetsOf(folder.path(), "test_primesense"));
  EXPECT_EQ(MultiviewTargetsOf(folder.path(), "val"), "");
  const auto sets = ReadBopTargets(path);
  ASSERT_TRUE(sets.ok()) << sets.status();
  ASSERT_EQ(sets->size(), 3u);
  EXPECT_EQ((*sets)[0].im_ids, (std::vector<int>{0, 1, 2}));
  EXPECT_EQ((*sets)[1].im_ids, (std::vector<int>{4, 5}));
  EXPECT_EQ((*sets)[2].scene_id, 4);
  EXPECT_EQ((*sets)[2].sensors, std::vector<std::string>{"cam1"});
}

TEST(BopTargets, OfSingleImagesAreTheirSceneTogether) {
  const TempFolder folder;
  folder.Write("t.json",
               R"([{"im_id": 9, "inst_count": 1, "obj_id": 2, "scene_id": 1},
                   {"im_id": 3, "inst_count": 1, "obj_id": 2, "scene_id": 1},
                   {"im_id": 9, "inst_count": 1, "obj_id": 5, "scene_id": 1},
                   {"im_id": 0, "scene_id": 2}])");
  const auto sets = ReadBopTargets(folder.path() + "/t.json");
  ASSERT_TRUE(sets.ok()) << sets.status();
  ASSERT_EQ(sets->size(), 2u);
  EXPECT_EQ((*sets)[0].im_ids, (std::vector<int>{3, 9}));
  for (const char* wrong : {"{}",
                            R"([{"im_id": 1}])",
                            R"([{"scene_id": 1}])",
                            R"([{"scene_id": 1, "im_ids": []}])",
                            R"([{"scene_id": 1, "im_ids": ["x"]}])",
                            R"([{"scene_id": 1.5, "im_id": 1}])",
                            "[1]"}) {
    folder.Write("t.json", wrong);
    EXPECT_EQ(ReadBopTargets(folder.path() + "/t.json").status().code(),
              absl::StatusCode::kInvalidArgument)
        << wrong;
  }
  EXPECT_EQ(ReadBopTargets(folder.path() + "/none").status().code(), absl::StatusCode::kNotFound);
}

TEST(BopDataset, BrokenFilesAreNamed) {
  const std::pair<const char*, const char*> files[] = {
      {"models/models_info.json", "{"},
      {"models/models_info.json", R"({"1": {}})"},
      {"models/models_info.json", R"({"12": {"diameter": 1, "symmetries_discrete": [[1,2]]}})"},
      {"models/models_info.json",
       R"({"12": {"diameter": 1, "symmetries_discrete": [[-1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]]}})"},
      {"models/models_info.json",
       R"({"12": {"diameter": 1, "symmetries_continuous": [{"axis": [0,0,0]}]}})"},
      {"models/names.json", "names"},
      {"val/000004/scene_camera.json", R"({"0": {}})"},
      {"val/000004/scene_camera.json", R"({"a": {"cam_K": [1,0,0,0,1,0,0,0,1]}})"},
      {"val/000004/scene_camera.json", R"({"0": {"cam_K": [9,0,0,0,9,0,5,5,1]}})"},
      {"val/000004/scene_gt.json", R"({"0": [{"obj_id": 1}]})"},
      {"val/000004/scene_gt_info.json", R"({"0": [], "7": []})"},
      {"val/000004/scene_meta.json", ""},
      {"grasps/obj_000012.json", R"({"grasps": [{"name": "g", "T_gripper_in_object": [1]}]})"},
      {"grasps/obj_000012.json", "[]"},
  };
  for (const auto& [name, content] : files) {
    const Sample sample;
    sample.folder.Write(name, content);
    absl::Status status = ReadBopDataset(sample.folder.path()).status();
    if (status.ok()) status = ReadBopScene(sample.folder.path(), "val", 4).status();
    if (status.ok()) status = ReadGrasps(sample.folder.path() + "/grasps/obj_000012.json").status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << name << content << status;
    EXPECT_THAT(std::string(status.message()), HasSubstr(name));
  }
}

absl::StatusOr<std::vector<Grasp>> GraspOf(const Sample& sample, const std::string& numbers) {
  const std::string file = "grasps/obj_000012.json";
  sample.folder.Write(file,
                      R"({"grasps": [{"name": "g", "T_gripper_in_object": [)" + numbers + "]}]}");
  return ReadGrasps(sample.folder.path() + "/" + file);
}

TEST(BopDataset, AGraspOfFewDigitsIsTheNearestRigidOne) {
  const Sample sample;
  for (const char* numbers : {"0.71,-0.71,0,5, 0.71,0.71,0,6, 0,0,1,7, 0,0,0,1",
                              "0.866,-0.5,0,5, 0.5,0.866,0,6, 0,0,1,7, 0,0,0,1",
                              "1,0.0004,0,5, 0,1,0,6, 0,0,1,7, 0,0,1e-7,1"}) {
    const auto grasps = GraspOf(sample, numbers);
    ASSERT_TRUE(grasps.ok()) << grasps.status();
    const Eigen::Matrix3d& R = grasps->front().object_from_gripper.R;
    EXPECT_LT((R * R.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  }
}

TEST(BopDataset, WhatIsNoRigidTransformIsRefusedByItsName) {
  const Sample sample;
  for (const auto& [numbers, what] :
       {std::pair{"1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,10,1", "row vectors?"},
        {"1,0,0,5, 0,1,0,6, 0,0,1,7, 0,0,0,0", "last row"},
        {"1,0,0,5, 0,1,0,6, 0,0,1,7, 0,0,0.001,1", "last row"},
        {"1,0.015,0,5, 0,1,0,6, 0,0,1,7, 0,0,0,1", "orthonormal"},
        {"1,0.01,0,5, 0,1,0,6, 0,0,1,7, 0,0,0,1", "orthonormal"},
        {"1.01,0,0,5, 0,1.01,0,6, 0,0,1.01,7, 0,0,0,1", "orthonormal"},
        {"1,0,0,5, 0,1,0,6, 0,0,-1,7, 0,0,0,1", "mirror"},
        {"0,0,0,5, 0,0,0,6, 0,0,0,7, 0,0,0,1", "orthonormal"}}) {
    const absl::Status status = GraspOf(sample, numbers).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << numbers;
    EXPECT_THAT(std::string(status.message()),
                testing::AllOf(HasSubstr(what), HasSubstr("T_gripper_in_object")));
  }
  EXPECT_THAT(
      std::string(
          ReadGrasps(HOROPTER_TEST_DATA "/inputs/grasps/transposed.json").status().message()),
      HasSubstr("row vectors?"));
}

TEST(BopDataset, SymmetriesAreRigidTransforms) {
  const Sample sample;
  sample.folder.Write("models/models_info.json",
                      R"({"12": {"diameter": 50, "symmetries_discrete":
      [[-1,0,0,0, 0,-1,0,0, 0,0,1,0, 3,0,0,1]]}})");
  EXPECT_THAT(std::string(ReadBopDataset(sample.folder.path()).status().message()),
              testing::AllOf(HasSubstr("symmetries_discrete"), HasSubstr("row vectors?")));
}

TEST(BopDataset, MissingThingsAreNotFound) {
  const Sample sample;
  const std::string& path = sample.folder.path();
  for (const absl::Status& status : {ReadBopDataset(path + "/none").status(),
                                     ReadBopDataset(path + "/val").status(),
                                     ListBopScenes(path, "test").status(),
                                     ReadBopScene(path, "val", 5).status(),
                                     ReadGrasps(path + "/none.json").status(),
                                     ReadBopResults(path + "/none.csv").status()}) {
    EXPECT_EQ(status.code(), absl::StatusCode::kNotFound) << status;
  }
}

TEST(BopResults, WhatIsWrittenIsRead) {
  const TempFolder folder;
  BopResults results;
  BopEstimate e{1, 2, 3, 0.5, {}, 12.25};
  e.camera_from_object.t = {0.1, -0.2, 0.75};
  results.estimates = {e};
  results.cameras[1][2] << 500, 0, 320, 0, 500, 240, 0, 0, 1;
  const std::string path = folder.path() + "/results.csv";
  ASSERT_TRUE(WriteBopResults(results, path).ok());
  EXPECT_EQ(CamerasPathOf(path), folder.path() + "/results.cameras.json");
  const auto read = ReadBopResults(path);
  ASSERT_TRUE(read.ok()) << read.status();
  ASSERT_EQ(read->estimates.size(), 1u);
  EXPECT_EQ(read->estimates[0].obj_id, 3);
  EXPECT_NEAR((read->estimates[0].camera_from_object.t - e.camera_from_object.t).norm(), 0, 1e-9);
  EXPECT_DOUBLE_EQ(read->estimates[0].time_s, 12.25);
  EXPECT_EQ(read->cameras.at(1).at(2)(1, 2), 240);
  int files = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder.path()))
    ++files;
  EXPECT_EQ(files, 2);  // no temporary file is left
}

TEST(BopResults, BrokenRowsAreNamedByLine) {
  for (const char* row : {"1,2,3",
                          "1,2,3,0.5,1 0 0 0 1 0 0 0,0 0 0,1",
                          "1,2,3,0.5,1 0 0 0 1 0 0 0 nan,0 0 0,1",
                          "a,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 0,1"}) {
    const TempFolder folder;
    const auto read = ReadBopResults(
        folder.Write("r.csv", std::string("scene_id,im_id,obj_id,score,R,t,time\n") + row + "\n"));
    EXPECT_EQ(read.status().code(), absl::StatusCode::kInvalidArgument) << row;
    EXPECT_THAT(std::string(read.status().message()), HasSubstr("r.csv:2"));
  }
}

TEST(BopResults, UnwritableOutputLeavesNothing) {
  const TempFolder folder;
  EXPECT_EQ(WriteBopResults({}, folder.path() + "/no/such/folder.csv").code(),
            absl::StatusCode::kPermissionDenied);
}

}  // namespace
}  // namespace horopter
