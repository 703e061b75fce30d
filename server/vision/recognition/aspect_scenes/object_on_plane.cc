#include "server/vision/recognition/aspect_scenes/object_on_plane.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/vision/recognition/aspect_search/aspect_score.h"

namespace horopter {
namespace {

constexpr int kMaxFaces = 6;         // a part is tried on, the safest first
constexpr double kSymmetric = 0.02;  // between unit vectors that are the same

}  // namespace

ObjectOnPlane::ObjectOnPlane(const StandingGround& ground, const AspectModel& model)
    : ground_(ground) {
  center_ = model.object->mesh.center.cast<double>();
  diameter_m_ = model.object->mesh.diameter_m;
  const AspectSet& set = model.object->aspects;
  directions_.resize(3, static_cast<Eigen::Index>(set.aspects.size()));
  for (std::size_t a = 0; a < set.aspects.size(); ++a) {
    directions_.col(static_cast<Eigen::Index>(a)) =
        -set.aspects[a].camera_from_object.row(2).transpose();
    points_.push_back(AspectPoints(set, static_cast<int>(a), kJudgedPoints));
  }
  turns_.push_back(Rigid3{});
  turns_.insert(turns_.end(), model.symmetries.begin(), model.symmetries.end());
  FindFaces(model);
}

void ObjectOnPlane::FindFaces(const AspectModel& model) {
  std::vector<Eigen::Vector3d> ups;
  for (const RestingFace& rest : model.resting) {
    if (static_cast<int>(faces_.size()) >= kMaxFaces) break;
    const bool known = std::any_of(ups.begin(), ups.end(), [&](const Eigen::Vector3d& up) {
      return std::any_of(turns_.begin(), turns_.end(), [&](const Rigid3& turn) {
        return (turn.R * up - rest.up).norm() < kSymmetric;
      });
    });
    if (known) continue;
    ups.push_back(rest.up);
    StandingFace face;
    face.scene_from_object =
        Eigen::Quaterniond::FromTwoVectors(rest.up, ground_.plane.normal).toRotationMatrix();
    face.height_m = rest.height_m;
    for (const Rigid3& turn : turns_) {
      const double angle = Eigen::AngleAxisd(turn.R).angle();
      if ((turn.R * rest.up - rest.up).norm() < kSymmetric && angle > kSymmetric)
        face.yaw_range = std::min(face.yaw_range, angle);
    }
    faces_.push_back(face);
  }
}

float ObjectOnPlane::HiddenSlackM() const {
  return static_cast<float>(kHiddenShare * diameter_m_);
}

Eigen::Matrix3d ObjectOnPlane::RotationOf(int face, double yaw) const {
  return Eigen::AngleAxisd(yaw, ground_.plane.normal).toRotationMatrix() *
         faces_[face].scene_from_object;
}

Eigen::Vector3d ObjectOnPlane::CenterOf(int face, double x, double y, double yaw) const {
  const Eigen::Vector3d above = RotationOf(face, yaw) * center_;
  return ground_.At(x, y) +
         (faces_[face].height_m + ground_.plane.normal.dot(above)) * ground_.plane.normal;
}

Rigid3 ObjectOnPlane::PoseOf(const StandingPlace& place) const {
  Rigid3 pose;
  pose.R = RotationOf(place.face, place.yaw);
  pose.t = CenterOf(place.face, place.x, place.y, place.yaw) - pose.R * center_;
  return pose;
}

TurnedPoints ObjectOnPlane::Look(std::size_t v,
                                 const Eigen::Matrix3d& rotation,
                                 const Eigen::Vector3d& center,
                                 std::size_t most) const {
  const Eigen::Vector3d eye = ground_.camera_from_scene[v].Inverse().t;
  const Eigen::Vector3d direction = rotation.transpose() * (eye - center).normalized();
  Eigen::Index aspect = 0;
  std::size_t symmetry = 0;
  float nearest = -2.0f;
  for (std::size_t t = 0; t < turns_.size(); ++t) {
    const Eigen::Vector3f turned = (turns_[t].R.transpose() * direction).cast<float>();
    Eigen::Index best = 0;
    const float cosine = (turned.transpose() * directions_).maxCoeff(&best);
    if (cosine > nearest) nearest = cosine, aspect = best, symmetry = t;
  }
  const Eigen::Matrix3d camera_from_object = ground_.camera_from_scene[v].R * rotation;
  const Eigen::Matrix3f R = (camera_from_object * turns_[symmetry].R).cast<float>();
  // Symmetries keep the part but not the centre of its box.
  const Eigen::Vector3f offset =
      (camera_from_object * (turns_[symmetry].t - center_)).cast<float>();
  const Eigen::Vector3f there = (ground_.camera_from_scene[v] * center).cast<float>();
  TurnedPoints out;
  most = std::min(most, points_[aspect].size());
  for (std::size_t i = 0; i < most; ++i) {
    const AspectPoint& p = points_[aspect][i];
    const Eigen::Vector3f x = R * p.point + offset;
    const Eigen::Vector3f d = R * p.direction;
    const Eigen::Vector3f at = x + there;
    out.x[out.count] = x.x();
    out.y[out.count] = x.y();
    out.z[out.count] = x.z();
    out.bin[out.count] = static_cast<std::uint8_t>(
        AspectBin(d.x() * at.z() - at.x() * d.z(), d.y() * at.z() - at.y() * d.z()));
    ++out.count;
  }
  return out;
}

// Support of the points that nothing hides, with the part's centre here; none where the view does
// not show enough of it.
PlaceSupport ObjectOnPlane::Support(std::size_t v,
                                    const TurnedPoints& points,
                                    const Eigen::Vector3d& center,
                                    double share) const {
  const PinholeCamera& camera = ground_.cameras[v];
  const AspectImage& image = ground_.images[v];
  const Eigen::Vector3d there = ground_.camera_from_scene[v] * center;
  if (!IsShown(ground_, v, there)) return {};
  const double size_px = camera.focal_px * diameter_m_ / there.z();
  if (size_px < kLeastStandingPx || points.count == 0) return {};
  const float reach_px =
      std::clamp(static_cast<float>(share * size_px), kMinStandingReachPx, kMaxStandingReachPx);
  const float reach = reach_px * AspectImage::kDistanceScale;
  const Eigen::Vector3f c = there.cast<float>();
  const float f = static_cast<float>(camera.focal_px), k1 = static_cast<float>(camera.k1);
  const float cx = static_cast<float>(camera.cx), cy = static_cast<float>(camera.cy);
  const int level = AspectImage::ChanceLevel(reach_px);
  const HidingMap& hiding = ground_.hiding[v];
  const bool may_be_hidden = IsCoveredNear(ground_, v, Project(camera, there), 0.5 * size_px);
  const float slack_m = HiddenSlackM();
  float sum = 0.0f, chance = 0.0f;
  std::size_t shown = 0;
  for (std::size_t i = 0; i < points.count; ++i) {
    const float depth = points.z[i] + c.z();
    const float z = 1.0f / depth;
    const float x = (points.x[i] + c.x()) * z, y = (points.y[i] + c.y()) * z;
    const float scale = f * (1.0f + k1 * (x * x + y * y));
    const float u = scale * x + cx, w = scale * y + cy;
    if (may_be_hidden &&
        hiding.Hides(static_cast<int>(0.5f * u), static_cast<int>(0.5f * w), depth - slack_m))
      continue;
    ++shown;
    const float d = image.DistanceAt(u, w, points.bin[i]);
    sum += std::max(0.0f, 1.0f - d / reach);
    chance += image.ChanceAt(u, w, points.bin[i], level);
  }
  if (shown < kShownPoints) return {};
  const double n = static_cast<double>(shown);
  const double excess = std::clamp(chance / (255.0 * n) - kFreeChance, 0.0, 0.9);
  return {(sum / n - excess) / (1.0 - excess), shown};
}

double ObjectOnPlane::Judge(const StandingPlace& p, double share) const {
  const Eigen::Matrix3d rotation = RotationOf(p.face, p.yaw);
  const Eigen::Vector3d center = CenterOf(p.face, p.x, p.y, p.yaw);
  double sum = 0.0, points = 0.0, per_view = 0.0;
  std::size_t views = 0;
  for (std::size_t v = 0; v < ground_.images.size(); ++v) {
    const TurnedPoints look = Look(v, rotation, center, kJudgedPoints);
    const PlaceSupport s = Support(v, look, center, share);
    sum += s.mean * static_cast<double>(s.points);
    points += static_cast<double>(s.points);
    views += s.points > 0;
    per_view = std::max(per_view, static_cast<double>(look.count));
  }
  return views < ground_.least_views ? 0.0 : Expected(sum, points, per_view);
}

}  // namespace horopter
