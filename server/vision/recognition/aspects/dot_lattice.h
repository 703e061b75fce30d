// Lattices of dots, as the holes of a perforated sheet make them before a camera.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace horopter {

// A hole or a speck: the middle of its box and the longer side, pixels.
struct Dot {
  Eigen::Vector2f middle = Eigen::Vector2f::Zero();
  float size = 0.0f;
};

// Whether each dot stands where its neighbours' rows and columns expect one of its size.
std::vector<char> RegularDots(const std::vector<Dot>& dots);

// A plane's lattice before a camera: a projective map from pairs of integers.
struct PlaneLattice {
  Eigen::Matrix3d image_from_index = Eigen::Matrix3d::Identity();
  double size_share = 0.0;  // of a dot's size, of the spacing where it stands; median
};

// The map that places the dots: numbered from one to its neighbours, then by the linear method with
// normalised coordinates (Hartley 1997). `fits`: false where too few dots agree.
struct PlaneLatticeFit {
  bool fits = false;
  PlaneLattice lattice;
  std::vector<Dot> dots;                 // those that agree
  std::vector<Eigen::Vector2i> indices;  // ... and their numbers
};
PlaneLatticeFit FitPlaneLattice(const std::vector<Dot>& dots);

// Whether each of the boxes stands where the lattice of `dots` has a hole and is no larger than it:
// where a plane's lattice fits all of them anywhere on that plane, else beside dots, or such boxes,
// whose rows and columns go on.
std::vector<char> HolesOfLattice(const std::vector<Dot>& dots, const std::vector<Dot>& boxes);

}  // namespace horopter
