// Byte layout of the geometry that the catalog stores as blobs. All numbers little-endian, no
// padding.
//
// Polyline                              Mesh
//   0  4  magic "HPOL"                    0  4  magic "HMSH"
//   4  2  version, 1                      4  2  version, 1; with colours 2
//   6  2  zero                            6  2  zero
//   8  4  n, number of points             8  4  n, number of vertices
//  12     n x (x, y, z) as f64, metres   12  4  m, number of triangles
//                                        16     n x (x, y, z) as f64, metres
//                                               m x (a, b, c) as i32, vertex indices
//                                               version 2: m x (red, green, blue, opacity) as u8
//
// Print
//   0  4  magic "HPRI"
//   4  2  version, 1
//   6  2  zero
//   8  4  n, number of places
//  12  4  views it was learnt from
//  16     n x (x, y, z, metres; normal; brightness) as f32
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/vision/geometry/object_model.h"

namespace horopter {

std::string EncodePolyline(const std::vector<Eigen::Vector3d>& points);
std::string EncodeMesh(const TriangleMesh& mesh);
std::string EncodePrint(const SurfacePrint& print);

// Errors: DATA_LOSS (wrong magic, version or size).
absl::StatusOr<std::vector<Eigen::Vector3d>> DecodePolyline(std::string_view blob);
absl::StatusOr<TriangleMesh> DecodeMesh(std::string_view blob);
absl::StatusOr<SurfacePrint> DecodePrint(std::string_view blob);

}  // namespace horopter
