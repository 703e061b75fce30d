// The contour fragments of a part's aspects: what an image's fragments are compared with.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "server/vision/recognition/aspects/aspect_set.h"
#include "server/vision/recognition/aspects/contour_fragments.h"
#include "server/vision/recognition/aspects/render_mesh.h"

namespace horopter {

struct AspectFragmentOptions {
  int per_aspect = 20;  // fragments kept of each aspect; more: more poses found, slower
  double min_length_diameters = 0.14;
  double max_length_diameters = 1.6;
  double length_factor = 1.3;
  double max_gap_diameters = 0.03;  // contours are linked over such gaps, as in images
  int threads = 1;
};

// Unit of length: the diameter as the aspect's camera sees it at the centre's depth; origin: the
// image of the centre of the bounding box; axes as in images.
struct AspectFragment {
  FragmentKey key{};
  Eigen::Vector2f center = Eigen::Vector2f::Zero();
  float spread = 0.0f;
  float chord_rad = 0.0f;
  float length = 0.0f;
  std::int32_t aspect = -1;  // of the part's AspectSet
};

struct PartFragments {
  std::vector<AspectFragment> fragments;
  std::vector<float> edge_length;  // of each aspect, diameters
};

// Draws the fragments of each aspect with probabilities that grow with length x turning; the same
// for the same input and any number of threads.
PartFragments MakePartFragments(const RenderMesh& mesh,
                                const AspectSet& set,
                                const AspectFragmentOptions& options = {});

// The drawing alone, from the points of one view's edges (pixels of a width x height image whose
// diameter is `render_px`).
std::vector<AspectFragment> DrawFragments(const std::vector<Eigen::Vector2f>& edge_points,
                                          int width,
                                          int height,
                                          double render_px,
                                          const Eigen::Vector2f& origin,
                                          int aspect,
                                          const AspectFragmentOptions& options);

}  // namespace horopter
