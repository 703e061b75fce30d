// Epipolar geometry x_b^T F x_a = 0: from cameras, from points, and back to cameras (thesis B.3).
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <vector>

#include "server/vision/geometry/projection.h"

namespace horopter {

// F = [e_b]x P_b P_a^+ at unit norm; zero when both centres are one point.
Eigen::Matrix3d FundamentalFromCameras(const CameraMatrix& P_a, const CameraMatrix& P_b);

// P_a = [I | 0], P_b = [[e_b]x F | e_b] with |e_b| = 1 (Hartley, Zisserman 9.5.3).
std::array<CameraMatrix, 2> CamerasFromFundamental(const Eigen::Matrix3d& F);

// Unit null vectors: F e_a = 0, F^T e_b = 0.
Eigen::Vector3d EpipoleA(const Eigen::Matrix3d& F);
Eigen::Vector3d EpipoleB(const Eigen::Matrix3d& F);

// Normalised 8-point algorithm with det F = 0 enforced. Any number >= 8 of point pairs (pixels);
// fewer, or points whose linear system has a second null vector (planar scene), give nullopt.
std::optional<Eigen::Matrix3d> EightPoint(std::span<const Eigen::Vector2d> a,
                                          std::span<const Eigen::Vector2d> b);

// The one to three real F with det F = 0 through exactly 7 pairs; empty when degenerate.
std::vector<Eigen::Matrix3d> SevenPoint(std::span<const Eigen::Vector2d, 7> a,
                                        std::span<const Eigen::Vector2d, 7> b);

// Squared Sampson distance, pixels^2: first-order distance of the pair from the epipolar
// constraint.
double SampsonSquared(const Eigen::Matrix3d& F, const Eigen::Vector2d& a, const Eigen::Vector2d& b);

// Similarity that moves points to centroid 0 and rms distance sqrt(2) (Hartley's normalisation);
// identity for fewer than 2 different points.
Eigen::Matrix3d NormalizingSimilarity(std::span<const Eigen::Vector2d> points);

}  // namespace horopter
