// Which votes of a part differ, and the poses they mean.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/vision/recognition/aspect_search/aspect_votes.h"

namespace horopter {
namespace {

constexpr float kSameSize = 1.1f;      // votes this alike in size, place and turn are one
constexpr float kSamePlace = 0.06f;    // ... of the size
constexpr float kSameTurnRad = 0.2f;   // ... 11 degrees; chosen
constexpr float kPlaceRadius = 0.25f;  // of the size: centres nearer than this are in one place

// Direction of view in the object's frame and the axis that is up in the image: two aspects with
// their turns are alike when the rotation between them is small.
Eigen::Matrix3f RotationOf(const AspectVote& vote, const FragmentIndex& index) {
  return Eigen::AngleAxisf(vote.turn_rad, Eigen::Vector3f::UnitZ()) *
         index.aspects[vote.aspect].camera_from_object;
}

struct Chosen {
  AspectVote vote;
  Eigen::Matrix3f rotation;
};

bool SamePose(const Chosen& a, const Chosen& b, std::span<const Rigid3> symmetries) {
  const float ratio = a.vote.size_px / b.vote.size_px;
  if (ratio > kSameSize || ratio < 1 / kSameSize) return false;
  const float dx = a.vote.x - b.vote.x, dy = a.vote.y - b.vote.y;
  const float reach = kSamePlace * b.vote.size_px;
  if (dx * dx + dy * dy > reach * reach) return false;
  // Trace of the rotation between them.
  const Eigen::Matrix3f between = b.rotation.transpose() * a.rotation;
  const float least = 1.0f + 2.0f * std::cos(kSameTurnRad);
  if (between.trace() > least) return true;
  return std::any_of(symmetries.begin(), symmetries.end(), [&](const Rigid3& s) {
    return between.cwiseProduct(s.R.cast<float>()).sum() > least;
  });
}

}  // namespace

std::vector<AspectVote> ChooseDistinct(std::vector<AspectVote> pool,
                                       const FragmentIndex& index,
                                       std::span<const Rigid3> symmetries,
                                       const AspectVoteOptions& options) {
  std::sort(pool.begin(), pool.end(), [](const AspectVote& p, const AspectVote& q) {
    if (p.rank != q.rank) return p.rank > q.rank;
    if (p.aspect != q.aspect) return p.aspect < q.aspect;
    return p.x < q.x;
  });
  if (static_cast<int>(pool.size()) > options.pool) pool.resize(options.pool);
  std::vector<Chosen> chosen;
  for (const AspectVote& vote : pool) {
    if (static_cast<int>(chosen.size()) >= options.max_per_object) break;
    const Chosen candidate{vote, RotationOf(vote, index)};
    int here = 0;
    bool known = false;
    for (const Chosen& other : chosen) {
      const float dx = vote.x - other.vote.x, dy = vote.y - other.vote.y;
      const float reach = kPlaceRadius * std::min(vote.size_px, other.vote.size_px);
      here += dx * dx + dy * dy < reach * reach ? 1 : 0;
      known = known || SamePose(candidate, other, symmetries);
    }
    if (known || here >= options.max_per_place) continue;
    chosen.push_back(candidate);
  }
  std::vector<AspectVote> out;
  for (const Chosen& c : chosen) out.push_back(c.vote);
  return out;
}

Rigid3 PoseOfVote(const AspectVote& vote, const FragmentIndex& index, const PinholeCamera& camera) {
  const IndexedAspect& a = index.aspects[vote.aspect];
  const AspectSet& set = index.models[a.model].object->aspects;
  const Eigen::Vector3d ray(
      (vote.x - camera.cx) / camera.focal_px, (vote.y - camera.cy) / camera.focal_px, 1.0);
  const double depth = camera.focal_px * set.diameter_m / vote.size_px;
  const Eigen::Matrix3d onto_ray =
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), ray).toRotationMatrix();
  Rigid3 pose;
  pose.R = onto_ray *
           Eigen::AngleAxisd(vote.turn_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix() *
           set.aspects[a.aspect].camera_from_object.cast<double>();
  pose.t = depth * ray - pose.R * set.center.cast<double>();
  return pose;
}

}  // namespace horopter
