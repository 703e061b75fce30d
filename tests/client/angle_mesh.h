// A part in every mesh format, and what is expected of reading it.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <string>
#include <vector>

#include "client/mesh_file.h"
#include "client/polygon.h"

namespace horopter {

inline double Volume(const TriangleMesh& mesh) {
  double volume = 0.0;
  for (const auto& t : mesh.triangles) {
    volume += mesh.vertices[t[0]].dot(mesh.vertices[t[1]].cross(mesh.vertices[t[2]])) / 6.0;
  }
  return volume;
}

// An angle of 60 x 41 x 24, walls of 14 and 12.
inline constexpr double kAngleVolume = (60 * 12 + 14 * 29) * 24;
inline const std::vector<Eigen::Vector3d>& AngleCorners() {
  static const std::vector<Eigen::Vector3d> kCorners = {{0, 0, 0},
                                                        {60, 0, 0},
                                                        {60, 12, 0},
                                                        {14, 12, 0},
                                                        {14, 41, 0},
                                                        {0, 41, 0},
                                                        {0, 0, 24},
                                                        {60, 0, 24},
                                                        {60, 12, 24},
                                                        {14, 12, 24},
                                                        {14, 41, 24},
                                                        {0, 41, 24}};
  return kCorners;
}
inline const std::vector<std::vector<int>>& AngleFaces() {
  static const std::vector<std::vector<int>> kFaces = {{5, 4, 3, 2, 1, 0},
                                                       {6, 7, 8, 9, 10, 11},
                                                       {0, 1, 7, 6},
                                                       {1, 2, 8, 7},
                                                       {2, 3, 9, 8},
                                                       {3, 4, 10, 9},
                                                       {4, 5, 11, 10},
                                                       {5, 0, 6, 11}};
  return kFaces;
}
inline TriangleMesh Angle() {
  TriangleMesh mesh;
  mesh.vertices = AngleCorners();
  for (const auto& face : AngleFaces()) {
    const auto triangles = TriangulatePolygon(mesh.vertices, face);
    mesh.triangles.insert(mesh.triangles.end(), triangles.begin(), triangles.end());
  }
  return mesh;
}

inline void ExpectAngle(const absl::StatusOr<MeshFile>& file, const std::string& what) {
  ASSERT_TRUE(file.ok()) << what << ": " << file.status();
  EXPECT_EQ(file->mesh.triangles.size(), 20u) << what;
  EXPECT_NEAR(std::abs(Volume(file->mesh)), kAngleVolume, 1e-3) << what;
}

inline void ExpectRefused(const absl::StatusOr<MeshFile>& file,
                          const std::string& what,
                          const std::string& message = "") {
  ASSERT_FALSE(file.ok()) << what;
  EXPECT_EQ(file.status().code(), absl::StatusCode::kInvalidArgument) << what;
  EXPECT_THAT(std::string(file.status().message()), testing::HasSubstr(message)) << what;
}

inline std::string Replaced(std::string text, const std::string& what, const std::string& by) {
  for (size_t at = 0; (at = text.find(what, at)) != std::string::npos; at += by.size()) {
    text.replace(at, what.size(), by);
  }
  return text;
}

}  // namespace horopter
