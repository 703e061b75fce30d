#include <google/protobuf/util/json_util.h>

#include <Eigen/Geometry>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <optional>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/answer_text.h"
#include "client/bop_results.h"
#include "client/commands.h"
#include "client/convert.h"
#include "client/interrupt.h"
#include "client/output.h"
#include "client/overlay.h"
#include "client/progress.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

absl::StatusOr<v1::RecognizeSceneRequest> BuildRequest(const RecognizeArguments& arguments) {
  v1::RecognizeSceneRequest request;
  for (const std::string& path : arguments.images) {
    HOROPTER_ASSIGN_OR_RETURN(*request.add_images()->mutable_content(), ReadFileBytes(path));
  }
  std::vector<std::string> warnings;
  HOROPTER_RETURN_IF_ERROR(AddCameraHints(arguments.cameras, &request, &warnings));
  for (const std::string& w : warnings) std::fprintf(stderr, "warning: %s\n", w.c_str());
  for (const std::string& id : arguments.candidates) {
    request.add_candidate_objects(ResourceName(id));
  }
  const std::vector<std::string>& r = arguments.reference;
  if (r.empty()) return request;
  if (r.size() != 1 && r.size() != 8) {
    return absl::InvalidArgumentError(
        "--reference takes an object id, or an id and its pose in the base: x y z qw qx qy qz");
  }
  Rigid3 base_from_object;
  if (r.size() == 8) {
    double n[7];
    for (int k = 0; k < 7; ++k) {
      char* end = nullptr;
      n[k] = std::strtod(r[static_cast<size_t>(k) + 1].c_str(), &end);
      if (*end != '\0' || end == r[static_cast<size_t>(k) + 1].c_str()) {
        return absl::InvalidArgumentError(
            absl::StrCat("--reference: not a number: ", r[static_cast<size_t>(k) + 1]));
      }
    }
    base_from_object.t = {n[0], n[1], n[2]};
    const Eigen::Quaterniond q(n[3], n[4], n[5], n[6]);
    if (!(std::abs(q.norm() - 1.0) < 0.01)) {
      return absl::InvalidArgumentError("--reference: the quaternion's norm is not 1");
    }
    base_from_object.R = q.normalized().toRotationMatrix();
  }
  request.mutable_reference()->set_object(ResourceName(r[0]));
  *request.mutable_reference()->mutable_base_from_object() = ToProto(base_from_object);
  return request;
}

// The frame the table is in: the robot base when it is known, else the first recovered camera.
struct TableFrame {
  std::string name;
  Rigid3 table_from_scene;
};

TableFrame FrameOf(const v1::RecognizeSceneResponse& response,
                   const std::vector<std::string>& paths) {
  if (response.has_base_from_scene()) {
    return {"the robot base", FromProto(response.base_from_scene())};
  }
  for (int i = 0; i < response.cameras_size(); ++i) {
    if (!response.cameras(i).recovered()) continue;
    return {absl::StrCat("the camera of image ", i + 1, " (", paths[static_cast<size_t>(i)], ")"),
            FromProto(response.cameras(i).camera_from_scene())};
  }
  return {"the scene", Rigid3{}};
}

// Roll, pitch and yaw about the fixed x, y and z axes, degrees.
Eigen::Vector3d RollPitchYawDeg(const Eigen::Matrix3d& R) {
  const double pitch = std::atan2(-R(2, 0), std::hypot(R(0, 0), R(1, 0)));
  const Eigen::Vector3d rpy(std::atan2(R(2, 1), R(2, 2)), pitch, std::atan2(R(1, 0), R(0, 0)));
  return rpy * 180.0 / M_PI;
}

std::string Triple(const Eigen::Vector3d& v) {
  return absl::StrFormat("%8.1f %8.1f %8.1f", v.x(), v.y(), v.z());
}

// " (2 through the table, 1 unsure)", empty when all are offered.
std::string DroppedText(const v1::GraspCounts& counts) {
  if (counts.considered() == 0) return " (none is enrolled)";
  std::string text;
  const auto add = [&](int n, const char* reason) {
    if (n > 0) absl::StrAppend(&text, text.empty() ? " (" : ", ", n, " ", reason);
  };
  add(counts.too_narrow(), "too narrow");
  add(counts.below_plane(), "through the table");
  add(counts.blocked(), "through another part");
  add(counts.unsure(), "unsure");
  add(counts.other_gripper(), "for another gripper");
  return text.empty() ? text : absl::StrCat(text, ")");
}

std::string GraspText(const v1::RecognizedObject& object, const Rigid3& table_from_scene) {
  if (object.grasps_size() == 0) return absl::StrCat("none", DroppedText(object.grasp_counts()));
  const v1::RecognizedGrasp* best = &object.grasps(0);  // best first
  const Eigen::Vector3d t = (table_from_scene * FromProto(best->scene_from_gripper())).t * 1e3;
  return absl::StrFormat("%s at (%.1f, %.1f, %.1f), %s; %d in all%s",
                         best->name(),
                         t.x(),
                         t.y(),
                         t.z(),
                         GripperText(*best),
                         object.grasps_size(),
                         DroppedText(object.grasp_counts()));
}

void PrintTable(const v1::RecognizeSceneResponse& response,
                const std::vector<std::string>& paths,
                const std::map<std::string, ObjectModel>& models) {
  Say("%s\n", OutcomeText(response).c_str());
  for (const v1::SceneReason& reason : response.reasons()) {
    if (!reason.detail().empty()) Say("%s\n", reason.detail().c_str());
  }
  for (const v1::UnsearchedStep& step : response.unsearched()) {
    Say("not searched for want of %s: %s\n",
        step.cause() == v1::UnsearchedStep::CAUSE_TIME ? "time" : "a smaller catalog",
        step.step().c_str());
  }
  for (int i = 0; i < response.cameras_size(); ++i) {
    const v1::Camera& c = response.cameras(i);
    if (c.recovered()) {
      Say("image %d: focal length %.0f px (+- %.1f %%)\n",
          i + 1,
          c.focal_px(),
          c.focal_log_sigma() * 100.0);
    } else {
      Say("image %d: camera not recovered\n", i + 1);
    }
  }
  if (response.objects_size() > 0) {
    const TableFrame frame = FrameOf(response, paths);
    Say("\nposition (mm) and orientation (roll pitch yaw, degrees) in %s\n", frame.name.c_str());
    Say("%-14s %-20s %5s  %26s  %26s  %s\n",
        "object",
        "name",
        "score",
        "position",
        "orientation",
        "grasp (mm)");
    for (const v1::RecognizedObject& o : response.objects()) {
      const Rigid3 pose = frame.table_from_scene * FromProto(o.scene_from_object());
      const std::string id = IdOfResource(o.object());
      const auto model = models.find(id);
      Say("%-14s %-20s %5.2f  %s  %s  %s\n",
          id.c_str(),
          model == models.end() ? "" : model->second.display_name.c_str(),
          o.score(),
          Triple(pose.t * 1e3).c_str(),
          Triple(RollPitchYawDeg(pose.R)).c_str(),
          GraspText(o, frame.table_from_scene).c_str());
      for (const std::string& other : o.alternative_objects()) {
        Say("               could also be %s\n", IdOfResource(other).c_str());
      }
    }
  }
  for (const v1::SceneFinding& f : response.findings()) {
    Say("%s: %s\n", FindingName(f).c_str(), f.detail().c_str());
  }
  double seconds = 0.0;
  for (const v1::StageReport& s : response.stages()) {
    seconds += static_cast<double>(s.elapsed().seconds()) + 1e-9 * s.elapsed().nanos();
  }
  Say("\n%.2f s in the stages\n", seconds);
}

PinholeCamera CameraOf(const v1::Camera& c) {
  return {c.image_width_px(),
          c.image_height_px(),
          c.focal_px(),
          c.principal_point_x_px(),
          c.principal_point_y_px(),
          c.k1()};
}

// The best grasp of each object, as a gripper.
void DrawBestGrasps(const v1::RecognizeSceneResponse& response, int image_index, cv::Mat* image) {
  const cv::Scalar kGripper(0, 165, 255);
  constexpr double kFingerM = 0.04;
  const v1::Camera& camera = response.cameras(image_index);
  for (const v1::RecognizedObject& o : response.objects()) {
    if (o.grasps_size() == 0) continue;
    const v1::RecognizedGrasp& best = o.grasps(0);
    DrawGripper(CameraOf(camera),
                FromProto(camera.camera_from_scene()) * FromProto(best.scene_from_gripper()),
                best.has_suction() ? 2.0 * best.suction().cup_radius_m()
                                   : best.parallel_jaw().jaw_opening_m(),
                kFingerM,
                kGripper,
                image);
  }
}

absl::Status WriteOverlay(const v1::RecognizeSceneRequest& request,
                          const v1::RecognizeSceneResponse& response,
                          const std::map<std::string, ObjectModel>& models,
                          const std::string& path) {
  constexpr int kTileWidth = 800;
  try {
    std::vector<cv::Mat> tiles;
    for (int i = 0; i < request.images_size(); ++i) {
      const std::string& bytes = request.images(i).content();
      cv::Mat image = cv::imdecode(std::vector<uchar>(bytes.begin(), bytes.end()),
                                   cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);
      if (image.empty()) return absl::InvalidArgumentError(absl::StrCat("image ", i + 1));
      const bool recovered = i < response.cameras_size() && response.cameras(i).recovered();
      if (recovered) {
        std::vector<OverlayObject> objects;
        for (int k = 0; k < response.objects_size(); ++k) {
          const v1::RecognizedObject& o = response.objects(k);
          const std::string id = IdOfResource(o.object());
          if (i >= o.images_size() || !o.images(i).has_camera_from_object()) continue;
          const ObjectModel& model = models.at(id);
          const std::string& name = model.display_name.empty() ? id : model.display_name;
          objects.push_back({&model,
                             FromProto(o.images(i).camera_from_object()),
                             absl::StrFormat("%s %.2f", name, o.score()),
                             k});
        }
        DrawOverlay(CameraOf(response.cameras(i)), objects, &image);
        DrawBestGrasps(response, i, &image);
      }
      DrawCaption(recovered ? absl::StrFormat(
                                  "image %d, f = %.0f px", i + 1, response.cameras(i).focal_px())
                            : absl::StrFormat("image %d, camera not recovered", i + 1),
                  &image);
      tiles.push_back(image);
    }
    std::vector<uchar> png;
    cv::imencode(".png", Tile(tiles, kTileWidth), png);
    return WriteFileAtomically(path, std::string(png.begin(), png.end()));
  } catch (const std::exception& e) {
    return absl::InternalError(absl::StrCat("overlay: ", e.what()));
  }
}

}  // namespace

absl::Status Recognize(HoropterClient& client, const RecognizeArguments& arguments) {
  HOROPTER_ASSIGN_OR_RETURN(const v1::RecognizeSceneRequest request, BuildRequest(arguments));
  HOROPTER_ASSIGN_OR_RETURN(const v1::RecognizeSceneResponse response,
                            client.RecognizeScene(request));
  std::map<std::string, ObjectModel> models;
  if (!JsonOutput() || !arguments.overlay_path.empty()) {
    for (const v1::RecognizedObject& o : response.objects()) {
      const std::string id = IdOfResource(o.object());
      if (models.contains(id)) continue;
      HOROPTER_ASSIGN_OR_RETURN(const v1::Object object,
                                client.GetObject(id, v1::OBJECT_VIEW_GEOMETRY));
      models[id] = FromProto(object);
    }
  }
  if (JsonOutput()) {
    google::protobuf::util::JsonPrintOptions options;
    options.add_whitespace = true;
    options.preserve_proto_field_names = true;
    options.always_print_primitive_fields = true;
    std::string text;
    const auto status = google::protobuf::util::MessageToJsonString(response, &text, options);
    if (!status.ok()) return absl::InternalError(status.ToString());
    std::printf("%s", text.c_str());
  } else {
    PrintTable(response, arguments.images, models);
  }
  if (!arguments.overlay_path.empty()) {
    HOROPTER_RETURN_IF_ERROR(WriteOverlay(request, response, models, arguments.overlay_path));
    if (!JsonOutput()) Say("overlay in %s\n", arguments.overlay_path.c_str());
  }
  return absl::OkStatus();
}

}  // namespace horopter
