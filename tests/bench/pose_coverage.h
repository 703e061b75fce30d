// How often the stated covariances hold the truth, and how far off the answer is.
#pragma once

#include <Eigen/Core>
#include <ostream>
#include <string>
#include <vector>

#include "server/vision/euclidean/euclidean.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {

// 95 % of chi square with one and with six degrees of freedom.
inline constexpr double kChiSquare1 = 3.841;
inline constexpr double kChiSquare6 = 12.592;

// An estimate held against the truth.
struct PoseCheck {
  std::string tier;
  int scene = 0;
  int object = -1;     // index into MetricScene::objects
  int reference = -1;  // the other object, or the view
  double chi_square = 0.0;
  double turn_deg = 0.0;
  double shift_mm = 0.0;         // of the object's centre
  double stated_turn_deg = 0.0;  // root of the covariance's trace
  double stated_shift_mm = 0.0;
};
struct FocalCheck {
  std::string tier;
  int scene = 0;
  int view = -1;
  double error = 0.0;  // log(estimate / truth)
  double sigma = 0.0;
};
// A grasp that was offered, carried into the true scene.
struct GraspCheck {
  std::string tier;
  int scene = 0;
  double shift_mm = 0.0;  // of the gripper's origin against where the part is
  double turn_deg = 0.0;
  double success = 0.0;  // as stated
};
struct CoverageReport {
  std::vector<GraspCheck> grasps;  // in the frame of another object; of a single one none
  GraspCounts grasp_counts;
  int grasps_offered = 0;
  int objects_without_grasp = 0;

  std::vector<PoseCheck> pairs;      // object in object
  std::vector<PoseCheck> reference;  // of these, relative to the answer's first object
  std::vector<PoseCheck> cameras;    // object in camera
  std::vector<FocalCheck> focal;
  int objects = 0;  // answered
  int wrong = 0;    // of them no instance's pose
};

// The index of the true instance an answered object stands for, and the symmetry (0: none) that
// brings it nearest; instance -1: the pose is wrong (>= 10 px off).
struct TrueMatch {
  int instance = -1;
  Rigid3 symmetry;
};
std::vector<TrueMatch> MatchAnswer(const MetricScene& metric,
                                   const std::vector<const ObjectModel*>& models,
                                   const std::vector<int>& obj_ids,
                                   const BopScene& scene);

// models, obj_ids: per MetricScene object.
void CheckScene(const MetricScene& metric,
                const std::vector<const ObjectModel*>& models,
                const std::vector<int>& obj_ids,
                const BopScene& scene,
                CoverageReport* report);

// Carries every grasp that PlanGrasps offers into the true scene by way of each other object's true
// pose.
void CheckSceneGrasps(const MetricScene& metric,
                      const std::vector<const ObjectModel*>& models,
                      const std::vector<int>& obj_ids,
                      const BopScene& scene,
                      const GraspOptions& options,
                      CoverageReport* report);

// Truth of one transform against its stated covariance.
PoseCheck CheckPose(const UncertainPose& stated,
                    const Rigid3& truth,
                    const Eigen::Vector3d& center);

void PrintCoverage(const CoverageReport& report, std::ostream& out);

}  // namespace horopter
