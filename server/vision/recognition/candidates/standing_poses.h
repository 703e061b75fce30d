// Candidate poses of parts that stand on the supporting plane: kept by quick score, told apart,
// judged in all views.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

#include "server/vision/recognition/candidates/plane_sighting.h"
#include "server/vision/recognition/candidates/pose_votes.h"
#include "server/vision/recognition/object/prepared_object.h"
#include "server/vision/recognition/search_options.h"

namespace horopter {

// Scales that differ by less, in log, are one.
inline constexpr double kDistinctScale = 0.05;

struct PooledPose {
  Rigid3 plane_from_object;  // metres
  double units_per_metre = 1.0;
  double quick = 0.0;
  double votes = 0.0;
};

// Keeps the best of many poses.
class PosePool {
 public:
  explicit PosePool(double floor) : floor_(floor) {}
  // Poses below it need not be added.
  double floor() const { return floor_; }
  void Add(const PooledPose& p) {
    if (p.quick < floor_) return;
    poses_.push_back(p);
    if (poses_.size() < 2 * kPool) return;
    std::nth_element(poses_.begin(), poses_.begin() + kPool, poses_.end(), Better);
    floor_ = poses_[kPool].quick;
    poses_.resize(kPool);
  }
  std::vector<PooledPose> Sorted() && {
    std::stable_sort(poses_.begin(), poses_.end(), Better);
    return std::move(poses_);
  }

 private:
  static constexpr std::size_t kPool = 150;  // poses that are kept; for time
  static bool Better(const PooledPose& a, const PooledPose& b) { return a.quick > b.quick; }
  std::vector<PooledPose> poses_;
  double floor_;
};

// The standing part turned and moved on the supporting plane, metres.
Rigid3 PlaceOnPlane(const StandingObject& standing, const PlaneYaw& yaw);

// Mean quick score over the views that show the part's centre, at least two.
double MeanQuick(const PreparedObject& object,
                 std::span<const KnownView> views,
                 double units_per_metre,
                 const Rigid3& plane_from_object,
                 float reach_px,
                 double give_up);

// The best `kept` of `sorted` that differ by 14 working pixels in some view, or in scale.
std::vector<PooledPose> DistinctPoses(const PreparedObject& object,
                                      std::span<const KnownView> views,
                                      std::vector<PooledPose> sorted,
                                      int kept);

// The best by quick score and the best by votes in turn: a cell's mean may lie some pixels off,
// where fine texture scores as well, and votes of texture may outnumber those of a part.
std::vector<PooledPose> InTurn(std::vector<PooledPose> by_quick);

// The best of distinct poses (scale known), refined over all views: fine texture supports anything
// within the first reach, settled poses tell truth from chance. Best first.
std::vector<PooledPose> SettledPoses(const PreparedObject& object,
                                     std::span<const KnownView> views,
                                     std::vector<PooledPose> sorted,
                                     const SettleOptions& options);

// Are both model edges of the standing part mostly visible from the camera centre `eye` (table
// units)?
bool EdgesVisible(const PreparedObject& object,
                  const StandingObject& standing,
                  const PlaneYaw& yaw,
                  const Eigen::Vector3d& eye,
                  int first,
                  int second);

// Holds the suggested poses against the edge maps of all views.
void ScorePeaks(const PreparedObject& object,
                const StandingObject& standing,
                std::span<const KnownView> views,
                const std::vector<PoseVotes::Peak>& peaks,
                float reach_px,
                PosePool* pool);

}  // namespace horopter
