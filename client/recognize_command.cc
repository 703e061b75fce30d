#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/answer_text.h"
#include "client/commands.h"
#include "client/convert.h"
#include "client/expected_file.h"
#include "client/output.h"
#include "client/scene_request.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

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

// What else may stand there, and where an image would have to be taken from to decide.
void PrintAlternatives(const v1::RecognizedObject& o, const Rigid3& table_from_scene) {
  if (o.alternatives().empty()) {  // of servers that tell no probabilities
    for (const std::string& other : o.alternative_objects())
      Say("               could also be %s\n", IdOfResource(other).c_str());
  }
  for (const v1::ObjectAlternative& a : o.alternatives()) {
    Say("               could also be %s\n", AlternativeText(a, table_from_scene).c_str());
  }
}

void PrintObjects(const v1::RecognizeSceneResponse& response,
                  const std::vector<std::string>& paths,
                  const std::map<std::string, ObjectModel>& models) {
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
    PrintAlternatives(o, frame.table_from_scene);
  }
}

void PrintStation(const v1::StationReport& station) {
  Say("%s: %s, %s\n",
      station.station().c_str(),
      station.prior_used() ? "what is known of its cameras was used"
                           : "its cameras by the images alone",
      station.learnt()      ? "learnt from this request"
      : station.read_only() ? "learns nothing from this request"
                            : "learnt nothing");
  for (const v1::StationFinding& f : station.findings()) {
    Say("%s: %s\n",
        v1::StationFinding::Kind_Name(f.kind()).substr(sizeof("KIND_") - 1).c_str(),
        f.detail().c_str());
  }
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
        step.cause() == v1::UnsearchedStep::CAUSE_TIME          ? "time"
        : step.cause() == v1::UnsearchedStep::CAUSE_PREPARING   ? "objects that are being prepared"
        : step.cause() == v1::UnsearchedStep::CAUSE_UNAVAILABLE ? "an answer of a server"
                                                                : "a smaller catalog",
        step.step().c_str());
  }
  for (int i = 0; i < response.cameras_size(); ++i) {
    Say("image %d: %s\n", i + 1, CameraText(response.cameras(i)).c_str());
  }
  if (response.objects_size() > 0) PrintObjects(response, paths, models);
  for (const v1::SceneFinding& f : response.findings()) {
    Say("%s: %s\n", FindingName(f).c_str(), f.detail().c_str());
  }
  for (const v1::BaseAlternative& b : response.base_alternatives()) {
    const Rigid3 base_from_scene = FromProto(b.base_from_scene());
    Say("the base could be, by %s (instance %d, symmetry %d): scene at %s mm, %s degrees\n",
        IdOfResource(b.object()).c_str(),
        b.instance(),
        b.symmetry_index(),
        Triple(base_from_scene.t * 1e3).c_str(),
        Triple(RollPitchYawDeg(base_from_scene.R)).c_str());
  }
  if (response.has_station()) PrintStation(response.station());
  double seconds = 0.0;
  for (const v1::StageReport& s : response.stages()) {
    seconds += static_cast<double>(s.elapsed().seconds()) + 1e-9 * s.elapsed().nanos();
  }
  Say("\n%.2f s in the stages\n", seconds);
}

}  // namespace

absl::Status Recognize(HoropterClient& client, const RecognizeArguments& arguments) {
  HOROPTER_ASSIGN_OR_RETURN(v1::RecognizeSceneRequest request, BuildSceneRequest(arguments));
  if (!arguments.overlay_path.empty()) {
    HOROPTER_RETURN_IF_ERROR(CheckOverlayPath(arguments.overlay_path));
    request.mutable_overlay()->set_format(OverlayFormatOf(arguments.overlay_path));
    request.mutable_overlay()->set_unexplained_edges(arguments.unexplained);
  }
  HOROPTER_ASSIGN_OR_RETURN(v1::RecognizeSceneResponse response, client.RecognizeScene(request));
  std::map<std::string, ObjectModel> models;
  if (!JsonOutput()) {
    for (const v1::RecognizedObject& o : response.objects()) {
      const std::string id = IdOfResource(o.object());
      if (models.contains(id)) continue;
      HOROPTER_ASSIGN_OR_RETURN(const v1::Object object,
                                client.GetObject(id, v1::OBJECT_VIEW_GEOMETRY));
      models[id] = FromProto(object);
    }
  }
  std::vector<std::string> drawn;
  if (!arguments.overlay_path.empty()) {
    HOROPTER_ASSIGN_OR_RETURN(drawn, WriteOverlays(response, arguments.overlay_path));
  }
  const absl::Status expected = StatusOfExpected(response.expected());
  if (JsonOutput()) {
    response.clear_overlays();  // they are in their files
    HOROPTER_RETURN_IF_ERROR(SayMessage(response));
    return expected;
  }
  PrintTable(response, arguments.images, models);
  if (response.has_expected()) Say("%s", ExpectedText(response.expected(), request).c_str());
  if (!drawn.empty()) Say("overlay in %s\n", absl::StrJoin(drawn, ", ").c_str());
  return expected;
}

}  // namespace horopter
