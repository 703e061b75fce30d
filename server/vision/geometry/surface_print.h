// What is printed on an object's surface, an optional appearance that is learnt from images.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace horopter {

// Places of a print at most: some 110 kB in memory.
inline constexpr std::size_t kMaxPrintPlaces = 4000;

struct PrintPlace {
  Eigen::Vector3f point = Eigen::Vector3f::Zero();    // object frame, metres
  Eigen::Vector3f normal = Eigen::Vector3f::UnitZ();  // outward, unit
  // By which it is brighter than the surface that faces the same way, -1 .. 1; one unit all over.
  float brightness = 0.0f;
};

struct SurfacePrint {
  std::vector<PrintPlace> places;  // empty: no print is known
  int views = 0;                   // it was learnt from
};

}  // namespace horopter
