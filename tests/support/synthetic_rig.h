// A rig of cameras around a middle, and what requests say of it: Gaussian evidence with known
// truth.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <random>
#include <string>
#include <vector>

#include "server/vision/geometry/pose_perturbation.h"
#include "server/vision/station/station_filter.h"

namespace horopter {

struct SyntheticRig {
  std::vector<PinholeCamera> cameras;
  std::vector<Rigid3> poses;  // camera_from_world
};

inline Eigen::VectorXd NormalVector(int n, std::mt19937* rng) {
  std::normal_distribution<double> normal;
  Eigen::VectorXd v(n);
  for (int i = 0; i < n; ++i) v(i) = normal(*rng);
  return v;
}

inline SyntheticRig MakeSyntheticRig(int cameras, unsigned seed) {
  std::mt19937 rng(seed);
  SyntheticRig rig;
  for (int c = 0; c < cameras; ++c) {
    PinholeCamera camera = CenteredCamera(1280, 960, 1800.0);
    const Eigen::VectorXd off = NormalVector(4, &rng);
    camera.focal_px *= std::exp(0.1 * off(0));
    camera.cx += 8.0 * off(1);
    camera.cy += 8.0 * off(2);
    camera.k1 = 0.02 * off(3);
    rig.cameras.push_back(camera);
    const Eigen::Vector3d w(0.6, 0.7 * c, 0.1 * c);
    rig.poses.push_back({Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix(),
                         Eigen::Vector3d(0.05 * c, 0.02, 0.6)});
  }
  return rig;
}

// Deviations of what one request says; `noise` scales them all. Turn and principal point of a
// camera err together, as in images.
inline CameraEvidence SayOf(const SyntheticRig& rig,
                            const std::vector<int>& images,
                            double noise,
                            std::mt19937* rng) {
  CameraEvidence out;
  const int n = static_cast<int>(images.size());
  Eigen::VectorXd sigmas(kGroupParameters);
  sigmas << 0.003, 0.003, 0.003, 0.001, 0.001, 0.002, 0.006, 5.0, 5.0, 0.01;
  Eigen::MatrixXd L = Eigen::MatrixXd::Zero(kGroupParameters * n, kGroupParameters * n);
  std::vector<AdjustedView> truth;
  for (int i = 0; i < n; ++i) {
    const int c = images[i];
    truth.push_back({true, rig.cameras[c], rig.poses[c]});
    out.group.views.push_back(i);
    // Linearised near the truth, not at it.
    const Eigen::VectorXd off = NormalVector(kGroupParameters, rng);
    PinholeCamera camera = rig.cameras[c];
    camera.focal_px *= std::exp(0.003 * off(0));
    camera.cx += 2.0 * off(1);
    out.group.cameras.push_back(camera);
    Vector6d d = Vector6d::Zero();
    if (i > 0) d = 0.001 * off.head<6>();
    out.group.camera_from_anchor.push_back(
        Perturbed(rig.poses[c] * rig.poses[images[0]].Inverse(), d));
    auto block =
        L.block<kGroupParameters, kGroupParameters>(kGroupParameters * i, kGroupParameters * i);
    block.diagonal() = noise * sigmas;
    block(1, 7) = 0.7 * noise * sigmas(1);
    block(0, 8) = -0.7 * noise * sigmas(0);
  }
  std::vector<int> kept;
  for (int i = 6; i < kGroupParameters * n; ++i) kept.push_back(i);
  const Eigen::MatrixXd P = L * L.transpose();
  Eigen::MatrixXd of_kept(kept.size(), kept.size());
  for (std::size_t i = 0; i < kept.size(); ++i) {
    for (std::size_t j = 0; j < kept.size(); ++j) of_kept(i, j) = P(kept[i], kept[j]);
  }
  const Eigen::LLT<Eigen::MatrixXd> llt(of_kept);
  const Eigen::MatrixXd information =
      llt.solve(Eigen::MatrixXd::Identity(of_kept.rows(), of_kept.rows()));
  const Eigen::VectorXd noise_of = llt.matrixL() * NormalVector(static_cast<int>(kept.size()), rng);
  Eigen::VectorXd mean = GroupOffset(out.group, truth);
  for (std::size_t i = 0; i < kept.size(); ++i) mean(kept[i]) += noise_of(static_cast<int>(i));
  out.information = Eigen::MatrixXd::Zero(P.rows(), P.cols());
  for (std::size_t i = 0; i < kept.size(); ++i) {
    for (std::size_t j = 0; j < kept.size(); ++j)
      out.information(kept[i], kept[j]) = information(static_cast<int>(i), static_cast<int>(j));
  }
  out.vector = out.information * mean;
  return out;
}

inline StationState FreshStation(const SyntheticRig& rig, const StationOptions& options) {
  StationState state;
  for (std::size_t c = 0; c < rig.cameras.size(); ++c) {
    AddStationCamera(
        "camera" + std::to_string(c), rig.cameras[c].width, rig.cameras[c].height, options, &state);
  }
  return state;
}

}  // namespace horopter
