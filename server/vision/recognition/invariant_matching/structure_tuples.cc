#include "server/vision/recognition/invariant_matching/structure_tuples.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "server/vision/invariants/six_point_sets.h"

namespace horopter {
namespace {

// 24 x 24 of homogeneous points with w = 1.
Eigen::MatrixXd HomogeneousCovariance(const SceneStructure& structure,
                                      const std::array<int, 6>& points) {
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(24, 24);
  for (int i = 0; i < 6; ++i) {
    for (int k = 0; k < 6; ++k) {
      out.block<3, 3>(4 * i, 4 * k) =
          structure.covariance.block<3, 3>(3 * points[i], 3 * points[k]);
    }
  }
  return out;
}

}  // namespace

std::vector<SixTuple> ChooseSixTuples(const SceneStructure& structure,
                                      std::span<const int> component,
                                      const FeatureTransform& transform,
                                      const SixTupleOptions& options) {
  // Variance that the stored values' single precision and first order leave.
  constexpr double kFloor = 1e-10;
  std::vector<SixTuple> out;
  std::vector<Eigen::Vector3d> all;
  for (const int i : component) all.push_back(structure.points[i]);
  for (const std::array<int, 6>& set : WellSpreadSets(all, options.max_sets, options.sets)) {
    SixTuple tuple;
    std::array<Eigen::Vector4d, 6> points;
    for (int k = 0; k < 6; ++k) {
      tuple.points[k] = component[set[k]];
      points[k] = structure.points[tuple.points[k]].homogeneous();
    }
    // Most sets fail the test of conditioning: it needs no covariance.
    if (!InvariantsOfSixPoints(points, {}, options.invariants)) continue;
    auto found = InvariantsOfSixPoints(
        points, HomogeneousCovariance(structure, tuple.points), options.invariants);
    if (!found || found->invariants != 3) continue;
    bool usable = true;
    for (SixPointLabeling& labeling : found->labelings) {
      labeling.key.covariance.diagonal().array() += kFloor;
      InvariantKey flat = labeling.key;
      if (transform.dimensions() == 3) flat = transform.Apply(labeling.key);
      const double determinant = flat.covariance.determinant();
      usable = usable && determinant >= 0.0 && std::isfinite(determinant);
      // Volume of the ellipsoid.
      tuple.expected_share +=
          4.0 / 3.0 * M_PI * std::pow(options.gate, 1.5) * std::sqrt(std::max(0.0, determinant));
    }
    if (!usable) continue;
    tuple.invariants = *std::move(found);
    out.push_back(std::move(tuple));
  }
  std::stable_sort(out.begin(), out.end(), [](const SixTuple& a, const SixTuple& b) {
    return a.expected_share < b.expected_share;
  });
  if (static_cast<int>(out.size()) > options.max_tuples) out.resize(options.max_tuples);
  return out;
}

}  // namespace horopter
