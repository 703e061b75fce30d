// Pairs of views of a data set with what is true of them.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/vision/matching/feature_similarity.h"
#include "tests/diagnose/true_matches.h"

namespace horopter {

// One scene, prepared once.
struct TrueScene {
  int id = 0;
  std::string tier;
  BopScene bop;
  std::vector<cv::Mat> images;
  std::vector<ImageFeatures> features;
  std::vector<MatchingView> views;
  std::vector<TrueView> truth;
  std::vector<FeatureLabels> labels;
};

struct TruePair {
  const TrueScene* scene = nullptr;
  int view_a = -1, view_b = -1;
  const cv::Mat* image_b = nullptr;
  const MatchingView* a = nullptr;
  const MatchingView* b = nullptr;
  const FeatureLabels* labels_a = nullptr;
  const FeatureLabels* labels_b = nullptr;
  std::optional<Eigen::Matrix3d> b_from_a;           // of the table z = 0, from the true cameras
  Eigen::Matrix3d F_true = Eigen::Matrix3d::Zero();  // pixels, distortion ignored
};

// Loads a scene; features by FeatureOptions().
absl::StatusOr<TrueScene> LoadTrueScene(const std::string& dataset,
                                        const std::string& split,
                                        int id,
                                        const TrueModels& models);
TruePair MakeTruePair(const TrueScene& scene, int view_a, int view_b);

// Larger distance (px) of the two points of a match from their epipolar lines.
double EpipolarDistance(const Eigen::Matrix3d& F,
                        const Eigen::Vector2d& a,
                        const Eigen::Vector2d& b);

// Share of the parts' vertices inside both images (hidden ones too; parts visible by 10 % and more
// in both) within 2 px of F.
double ShareOfVertices(const TruePair& pair, const TrueModels& models, const Eigen::Matrix3d& F);

// Calls visit for every pair of views of the given scenes (all when empty).
absl::Status ForEachTruePair(const std::string& dataset,
                             const std::string& split,
                             std::vector<int> scenes,
                             const std::function<void(const TruePair&)>& visit);

}  // namespace horopter
