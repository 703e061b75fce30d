#include "server/vision/recognition/object/aspect_model.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <optional>

namespace horopter {
namespace {

constexpr int kNearTurns = 24;   // of a surface that is nearly one of revolution
constexpr int kRoundTurns = 20;  // symmetric turns about an axis that stand for any
// Rims that start a search, and of the diameter the radius of the smallest; chosen, for time.
constexpr int kRims = 6;
constexpr double kRimShare = 0.04;
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

AspectModel AspectModelOf(const PreparedObject& object) {
  AspectModel model;
  model.object = &object.aspects->object;
  model.fragments = &object.aspects->fragments;
  model.symmetries = object.model.symmetries;
  for (const NearSymmetry& near : object.near_symmetries) {
    const std::vector<Rigid3> turns = TurnsOf(near.axis, kNearTurns);
    model.near_turns.insert(model.near_turns.end(), turns.begin(), turns.end());
    if (near.axis.order == 0 || near.axis.order >= kRoundTurns) model.round.push_back(near.axis);
  }
  if (const auto axis = RoundAxis(model.symmetries)) model.round.push_back(*axis);
  for (const StablePose& pose : object.stable_poses)
    model.resting.push_back({pose.up, pose.height_m});
  model.rims = LargeRims(object.model, kRimShare, kRims);
  return model;
}

}  // namespace horopter
