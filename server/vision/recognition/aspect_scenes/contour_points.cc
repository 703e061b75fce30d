#include "server/vision/recognition/aspect_scenes/contour_points.h"

namespace horopter {
namespace {

constexpr std::size_t kMostPoints = 64;  // of an aspect: the first ones are spread evenly
constexpr float kSameSideCos = 0.9986f;  // 3 degrees, a third of what aspects are apart

}  // namespace

ContourPoints::ContourPoints(std::span<const AspectModel> models)
    : models_(models), stored_(models.size()) {}

void ContourPoints::Prepare(int object) {
  if (stored_[object]) return;
  const AspectSet& set = models_[object].object->aspects;
  Stored& stored = stored_[object].emplace();
  for (int a = 0; a < static_cast<int>(set.aspects.size()); ++a) {
    stored.toward.emplace_back(-set.aspects[a].camera_from_object.row(2).transpose());
    std::vector<ModelEdgePoint>& points = stored.points.emplace_back();
    for (const AspectPoint& p : AspectPoints(set, a)) {
      if (points.size() >= kMostPoints) break;
      points.push_back({p.point, p.direction, 1.0f});
    }
  }
}

void ContourPoints::See(int object, const Rigid3& camera_from_object, Seen* seen) const {
  const Eigen::Vector3d center = models_[object].object->mesh.center.cast<double>();
  const Eigen::Vector3f toward =
      (-(camera_from_object.R.transpose() * (camera_from_object * center)).normalized())
          .cast<float>();
  if (!seen->points.empty() && seen->toward.dot(toward) > kSameSideCos) return;
  const Stored& stored = *stored_[object];
  float best = -2.0f;
  std::size_t aspect = 0;
  const Rigid3* turn = nullptr;
  const auto look = [&](const Eigen::Vector3f& direction, const Rigid3* symmetry) {
    for (std::size_t a = 0; a < stored.toward.size(); ++a) {
      const float cosine = stored.toward[a].dot(direction);
      if (cosine > best) best = cosine, aspect = a, turn = symmetry;
    }
  };
  look(toward, nullptr);
  // Of views that symmetries make equal one is stored.
  for (const Rigid3& symmetry : models_[object].symmetries)
    look(symmetry.R.transpose().cast<float>() * toward, &symmetry);
  seen->toward = toward;
  if (stored.points.empty()) return;
  seen->points = stored.points[aspect];
  if (turn == nullptr) return;
  const Eigen::Matrix3f R = turn->R.cast<float>();
  const Eigen::Vector3f t = turn->t.cast<float>();
  for (ModelEdgePoint& p : seen->points) {
    p.point = R * p.point + t;
    p.direction = R * p.direction;
  }
}

}  // namespace horopter
