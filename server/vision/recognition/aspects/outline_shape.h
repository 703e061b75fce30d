// The convex hull of an outline described so that place, turn and size do not matter: Fourier
// orders of its support function about the Steiner point. A hull needs no order of the points, so
// that an aspect's edge points have the shape of the closed outline that an image shows of it.
#pragma once

#include <Eigen/Core>
#include <array>
#include <complex>
#include <optional>
#include <span>
#include <vector>

namespace horopter {

inline constexpr int kOutlineOrders = 6;  // 2 .. 7 of the support function; the first is the place

// Laws: magnitudes of `orders` are unchanged by similarities; a turn by t multiplies order n by
// exp(-i n t), a mirror image conjugates.
struct OutlineShape {
  Eigen::Vector2f center = Eigen::Vector2f::Zero();  // Steiner point of the hull
  float width = 0.0f;                                // mean width, in the unit of the points
  std::array<std::complex<float>, kOutlineOrders> orders{};  // over half the mean width

  std::array<double, kOutlineOrders> Key() const;  // magnitudes
};

// Nothing of fewer than three points or of points in one place.
std::optional<OutlineShape> ShapeOf(std::span<const Eigen::Vector2f> points);

struct OutlineTurn {
  float turn_rad = 0.0f;  // of the model's outline to the image's, from x towards y
  float apart = 0.0f;     // distance of the orders after it
};

// The turns at which the two differ least, best first, at most `most`; evenly spread ones of round
// outlines, which any turn fits.
std::vector<OutlineTurn> TurnsBetween(const OutlineShape& model,
                                      const OutlineShape& image,
                                      int most);

}  // namespace horopter
