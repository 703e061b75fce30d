// What single images say of the supporting plane: where rays meet it, at which heights an edge may
// lie, and how a standing part must be turned to be seen there.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/vision/recognition/candidates/pose_votes.h"
#include "server/vision/recognition/scene/scene_model.h"
#include "server/vision/recognition/scoring/pose_refine.h"

namespace horopter {

// A model edge whose horizontal extent is below this share of its length fixes no yaw.
inline constexpr double kUprightShare = 0.15;
// Edges whose ends differ by less in height are level, metres.
inline constexpr double kLevel = 1e-6;

// A part at rest: lowest points on z = 0, turned in one of its stable poses, yaw zero.
struct StandingObject {
  Rigid3 plane_from_object;
  std::vector<Eigen::Vector3d> vertices;  // of the model, in the supporting plane frame, metres
  Eigen::Vector2d outline_middle = Eigen::Vector2d::Zero();  // seen from above, plane frame, metres
};
std::vector<StandingObject> StandingObjects(const PreparedObject& object);

// Where a pixel's ray meets the supporting plane and how that point moves with height: the ray is
// at base + z * shift, at height z (plane frame).
struct PlaneSighting {
  Eigen::Vector2d base = Eigen::Vector2d::Zero();
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();
};
// False for rays that do not go down to the supporting plane.
bool SightPlane(const PinholeCamera& camera,
                const Rigid3& camera_from_plane,
                const Eigen::Vector2d& pixel,
                PlaneSighting* sighting);

// The heights at which a level edge seen as one segment would also be seen in other views.
class HeightMask {
 public:
  static constexpr int kBins = 128;  // of heights, two words of 64 bits
  void Set(int bin) { bits_[bin >> 6] |= 1ull << (bin & 63); }
  // height_share: height / the largest height the mask covers.
  bool At(double height_share) const {
    const int bin = static_cast<int>(height_share * kBins);
    return bin >= 0 && bin < kBins && (bits_[bin >> 6] >> (bin & 63) & 1);
  }

 private:
  std::uint64_t bits_[2] = {0, 0};
};

// Parts are looked for up to this height above the supporting plane: a share of the lowest
// camera's, in the units of the views.
double MaxHeight(std::span<const KnownView> views);

// Level edges between the two sightings of view `own` that other views show as well: two of them,
// or one where there are only two views. Heights above `needed_height` are not looked at.
HeightMask SupportedHeights(std::span<const KnownView> views,
                            std::size_t own,
                            const PlaneSighting& from,
                            const PlaneSighting& to,
                            double max_height,
                            double needed_height);

// v turned by the angle of which cosine and sine are given.
inline Eigen::Vector2d Turned(double c, double s, const Eigen::Vector2d& v) {
  return {c * v.x() - s * v.y(), s * v.x() + c * v.y()};
}

inline bool IsUpright(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return (b - a).head<2>().norm() < kUprightShare * (b - a).norm();
}

// Poses, up to two, in which the ends a, b of an edge that is not upright are seen at these
// sightings, scale unknown.
int YawsFromEdge(const Eigen::Vector3d& a,
                 const Eigen::Vector3d& b,
                 const PlaneSighting& at_a,
                 const PlaneSighting& at_b,
                 PlaneYaw out[2]);

// Distance, metres on the supporting plane, between a vertex in a pose and what is sighted at its
// height.
double MissOf(const PlaneYaw& yaw, const Eigen::Vector3d& vertex, const PlaneSighting& sighting);

// Poses, up to two, in which the vertices a, b, c of a standing part are seen at the sightings of
// the same names, scale unknown: a and b are met exactly, c within `tolerance` of the path's
// length.
int PosesFromSightings(const Eigen::Vector3d vertices[3],
                       const PlaneSighting sightings[3],
                       double tolerance,
                       PlaneYaw out[2]);

}  // namespace horopter
