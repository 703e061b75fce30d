#include "server/vision/recognition/object/aspect_part.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <optional>

namespace horopter {
namespace {

constexpr int kNearTurns = 24;      // of a surface that is nearly one of revolution
constexpr int kRoundTurns = 20;     // symmetric turns about an axis that stand for any
constexpr double kSameAxis = 1e-3;  // length of the difference of unit axes

// The axis about which at least kRoundTurns of the symmetries turn.
std::optional<SymmetryAxis> RoundAxis(std::span<const Rigid3> symmetries) {
  for (const Rigid3& s : symmetries) {
    const Eigen::AngleAxisd turn(s.R);
    if (turn.angle() < 1e-3) continue;
    const auto about = std::count_if(symmetries.begin(), symmetries.end(), [&](const Rigid3& o) {
      return (o.R * turn.axis() - turn.axis()).norm() < kSameAxis;
    });
    if (about < kRoundTurns) continue;
    SymmetryAxis axis;
    axis.axis = turn.axis();
    axis.order = 0;
    // What the turn leaves in place, nearest to the origin.
    axis.point = (Eigen::Matrix3d::Identity() - s.R)
                     .jacobiSvd(Eigen::ComputeFullU | Eigen::ComputeFullV)
                     .setThreshold(1e-6)
                     .solve(s.t);
    return axis;
  }
  return std::nullopt;
}

}  // namespace

AspectPart AspectPartOf(const PreparedObject& object) {
  AspectPart part;
  part.object = &object.aspects->object;
  part.fragments = &object.aspects->fragments;
  part.symmetries = object.model.symmetries;
  for (const NearSymmetry& near : object.near_symmetries) {
    const std::vector<Rigid3> turns = TurnsOf(near.axis, kNearTurns);
    part.near_turns.insert(part.near_turns.end(), turns.begin(), turns.end());
    if (near.axis.order == 0 || near.axis.order >= kRoundTurns) part.round.push_back(near.axis);
  }
  if (const auto axis = RoundAxis(part.symmetries)) part.round.push_back(*axis);
  for (const StablePose& pose : object.stable_poses)
    part.resting.push_back({pose.up, pose.height_m});
  return part;
}

}  // namespace horopter
