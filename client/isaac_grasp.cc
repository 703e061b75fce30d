#include "client/isaac_grasp.h"

#include <yaml-cpp/yaml.h>

#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "server/base/status_macros.h"
#include "server/vision/geometry/grasp_kind.h"

namespace horopter {
namespace {

// Distance between the fingers that a joint position stands for.
double Opening(const YAML::Node& joints) {
  if (!joints || !joints.IsMap()) return 0.0;
  double sum = 0.0;
  for (const auto& joint : joints) sum += joint.second.as<double>();
  return joints.size() == 1 ? 2.0 * sum : sum;
}

YAML::Node Joints(double opening) {
  YAML::Node joints;
  joints["finger_joint"] = 0.5 * opening;
  joints.SetStyle(YAML::EmitterStyle::Flow);
  return joints;
}

absl::StatusOr<Rigid3> Pose(const YAML::Node& position,
                            const YAML::Node& orientation,
                            const std::string& where) {
  const std::vector<double> t = position.as<std::vector<double>>();
  const std::vector<double> xyz = orientation["xyz"].as<std::vector<double>>();
  const double w = orientation["w"].as<double>();
  if (t.size() != 3 || xyz.size() != 3) {
    return absl::InvalidArgumentError(where + ": position and xyz need three numbers");
  }
  const Eigen::Quaterniond q(w, xyz[0], xyz[1], xyz[2]);
  if (!(std::abs(q.norm() - 1.0) < 0.01) || !std::isfinite(t[0] + t[1] + t[2])) {
    return absl::InvalidArgumentError(where + ": the orientation is no unit quaternion");
  }
  Rigid3 pose;
  pose.R = q.normalized().toRotationMatrix();
  pose.t = {t[0], t[1], t[2]};
  return pose;
}

void WritePose(const Rigid3& pose, const std::string& prefix, YAML::Emitter& out) {
  Eigen::Quaterniond q(pose.R);
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  out << YAML::Key << prefix + "position" << YAML::Value << YAML::Flow
      << std::vector<double>{pose.t.x(), pose.t.y(), pose.t.z()};
  out << YAML::Key << prefix + "orientation" << YAML::Value << YAML::BeginMap << YAML::Key << "w"
      << YAML::Value << q.w() << YAML::Key << "xyz" << YAML::Value << YAML::Flow
      << std::vector<double>{q.x(), q.y(), q.z()} << YAML::EndMap;
}

}  // namespace

absl::StatusOr<std::vector<Grasp>> ReadIsaacGrasps(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) {
    return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  }
  std::string at = "the file";
  try {
    const YAML::Node file = YAML::LoadFile(path);
    if (!file.IsMap() || file["format"].as<std::string>("") != "isaac_grasp") {
      return absl::InvalidArgumentError(absl::StrCat(path, ": is no isaac_grasp file"));
    }
    std::vector<Grasp> grasps;
    for (const auto& entry : file["grasps"]) {
      Grasp grasp;
      grasp.name = at = entry.first.as<std::string>();
      const YAML::Node& node = entry.second;
      grasp.quality = node["confidence"].as<double>(1.0);
      grasp.grip_width_m = Opening(node["cspace_position"]);
      grasp.jaw_opening_m = Opening(node["pregrasp_cspace_position"]);
      const std::string where = absl::StrCat(path, ": ", at);
      HOROPTER_ASSIGN_OR_RETURN(grasp.object_from_gripper,
                                Pose(node["position"], node["orientation"], where));
      if (node["pregrasp_position"] || node["pregrasp_orientation"]) {
        HOROPTER_ASSIGN_OR_RETURN(
            grasp.object_from_pregrasp,
            Pose(node["pregrasp_position"], node["pregrasp_orientation"], where + ": pregrasp"));
      }
      grasps.push_back(std::move(grasp));
    }
    return grasps;
  } catch (const YAML::Exception& e) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", at, ": ", e.what()));
  }
}

absl::Status WriteIsaacGrasps(const std::string& path,
                              const std::string& object_frame,
                              const std::vector<Grasp>& grasps) {
  YAML::Emitter out;
  out.SetDoublePrecision(17);
  out << YAML::BeginMap << YAML::Key << "format" << YAML::Value << "isaac_grasp";
  out << YAML::Key << "format_version" << YAML::Value << YAML::DoubleQuoted << "1.0";
  out << YAML::Key << "object_frame_link" << YAML::Value << object_frame;
  out << YAML::Key << "gripper_frame_link" << YAML::Value << "gripper";
  out << YAML::Key << "grasps" << YAML::Value << YAML::BeginMap;
  for (const Grasp& grasp : grasps) {
    if (IsSuction(grasp)) continue;  // the format knows joints only
    out << YAML::Key << grasp.name << YAML::Value << YAML::BeginMap;
    out << YAML::Key << "confidence" << YAML::Value << grasp.quality;
    WritePose(grasp.object_from_gripper, "", out);
    out << YAML::Key << "cspace_position" << YAML::Value << Joints(grasp.grip_width_m);
    out << YAML::Key << "pregrasp_cspace_position" << YAML::Value << Joints(grasp.jaw_opening_m);
    if (grasp.object_from_pregrasp) WritePose(*grasp.object_from_pregrasp, "pregrasp_", out);
    out << YAML::EndMap;
  }
  out << YAML::EndMap << YAML::EndMap;
  std::ofstream file(path);
  file << out.c_str() << "\n";
  file.close();
  if (!file) return absl::FailedPreconditionError(absl::StrCat(path, ": cannot be written"));
  return absl::OkStatus();
}

}  // namespace horopter
