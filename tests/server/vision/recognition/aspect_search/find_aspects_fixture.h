#pragma once

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>
#include <vector>

#include "server/vision/recognition/aspect_search/find_aspects.h"
#include "tests/support/part_photos.h"
#include "tests/support/solid_meshes.h"

namespace horopter {

// An angle with arms of different length, a block and a cylinder; made once.
class FindAspects : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    parts_ = new std::vector<PhotoPart>(AngleBlockCylinder({0.04, 0.025, 0.012}, 0.02, 0.035));
    for (const PhotoPart& p : *parts_)
      list_.push_back({&p.object, &p.fragments, p.model.symmetries});
    index_ = new FragmentIndex(BuildFragmentIndex(list_));
  }
  static void TearDownTestSuite() {
    delete index_;
    delete parts_;
  }

  static PinholeCamera Camera() { return CenteredCamera(640, 480, 700.0); }
  static Rigid3 Pose() {
    Rigid3 pose;
    pose.R = (Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()) *
              Eigen::AngleAxisd(-2.2, Eigen::Vector3d::UnitX()) *
              Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitY()))
                 .toRotationMatrix();
    pose.t = {0.02, -0.01, 0.28};
    return pose;
  }

  static cv::Mat Photo(int part, const Rigid3& pose) {
    return PhotoOf({{&(*parts_)[part].object.mesh, pose}}, Camera());
  }

  static double ErrorPx(const AspectHypothesis& h, const Rigid3& truth) {
    return PoseDistancePx(list_[h.object], h.camera, h.camera_from_object, Camera(), truth);
  }

  static inline std::vector<PhotoPart>* parts_ = nullptr;
  static inline std::vector<AspectModel> list_;
  static inline FragmentIndex* index_ = nullptr;
};

}  // namespace horopter
