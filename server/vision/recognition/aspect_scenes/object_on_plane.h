// A part as it may stand on a plane: faces it rests on, and what the views would show of it.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <vector>

#include "server/vision/recognition/aspect_scenes/standing_ground.h"
#include "server/vision/recognition/aspect_scenes/standing_search.h"

namespace horopter {

// Limits of what a view is asked for, pixels of its working image.
inline constexpr float kMinStandingReachPx = 4.0f, kMaxStandingReachPx = 26.0f;
// Of an aspect: that the grid asks for, and that a place is judged by.
inline constexpr std::size_t kGridPoints = 24, kJudgedPoints = 64;
inline constexpr std::size_t kShownPoints = 8;  // fewer that nothing hides say nothing in a view

// A face that lies on the plane.
struct StandingFace {
  Eigen::Matrix3d scene_from_object = Eigen::Matrix3d::Identity();  // before it is turned
  double height_m = 0.0;                                            // of the origin
  double yaw_range = 2 * std::numbers::pi;                          // until the part looks the same
};

// Of the part's centre, in the axes of the ground.
struct StandingPlace {
  double x = 0.0, y = 0.0, yaw = 0.0;
  int face = 0;
  double support = 0.0;
};

// Points of an aspect in a camera's axes, up to the place of the part's centre.
struct TurnedPoints {
  std::array<float, kJudgedPoints> x, y, z;
  std::array<std::uint8_t, kJudgedPoints> bin;
  std::size_t count = 0;
};

// Few points that nothing hides may all meet edges by chance: a place counts as if half a view more
// found what chance gives. points: shown by all views; per_view: of a view that nothing hides.
inline double Expected(double supported, double points, double per_view) {
  constexpr double kPresumedViews = 0.5, kPresumedSupport = 0.2;  // chosen
  const double more = kPresumedViews * per_view;
  return (supported + kPresumedSupport * more) / (points + more);
}

// What one view says of a place.
struct PlaceSupport {
  double mean = 0.0;       // of the points that nothing hides, above chance
  std::size_t points = 0;  // 0: the view does not count
};

// Refers to the ground.
class ObjectOnPlane {
 public:
  ObjectOnPlane(const StandingGround& ground, const AspectModel& model);

  const StandingGround& ground() const { return ground_; }
  double diameter_m() const { return diameter_m_; }
  float HiddenSlackM() const;  // by which what hides a point is nearer
  // Those that look different, the safest first.
  const std::vector<StandingFace>& faces() const { return faces_; }

  Eigen::Matrix3d RotationOf(int face, double yaw) const;
  Eigen::Vector3d CenterOf(int face, double x, double y, double yaw) const;  // scene frame
  Rigid3 PoseOf(const StandingPlace& place) const;                           // scene from object

  // The aspect that view v has of the part turned by `rotation` with its centre here, at most so
  // many points of it.
  TurnedPoints Look(std::size_t v,
                    const Eigen::Matrix3d& rotation,
                    const Eigen::Vector3d& center,
                    std::size_t most) const;

  // Support of the points that views show, above chance (Expected); edges may lie `share` of the
  // size away.
  double Judge(const StandingPlace& place, double share) const;

 private:
  void FindFaces(const AspectModel& model);
  PlaceSupport Support(std::size_t v,
                       const TurnedPoints& points,
                       const Eigen::Vector3d& center,
                       double share) const;

  const StandingGround& ground_;
  Eigen::Vector3d center_;
  double diameter_m_ = 0.0;
  Eigen::Matrix3Xf directions_;                   // to the camera, object frame, of each aspect
  std::vector<std::vector<AspectPoint>> points_;  // of each aspect
  std::vector<Rigid3> turns_;                     // identity and symmetries
  std::vector<StandingFace> faces_;
};

}  // namespace horopter
